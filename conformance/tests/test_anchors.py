"""The place of an edit is found again where layout or names have changed, and only there."""

import pytest

from conformance.mutants.anchors import AnchorError, function_at, locate
from conformance.mutants.tables import ROOT, Edit, TableError, changed, find, load

C = """
static void first(uint8_t length) {
    put(opcode); // not put(length);
    put(length);
}

NOINLINE void second(uint8_t length) {
    send(length,
         2);
}
"""
PYTHON = '''
def reply(seq, code):
    """Send seq and code."""
    send(
        seq,
        code,
    )
    return seq


class Device:
    def stop(self, code):
        self.reply(code, 0)
'''


def edited(text, old, new, is_python, known=()):
    place = locate(text, old, is_python=is_python, known=known)
    return text[: place.start] + place.text(old, new) + text[place.end :]


@pytest.mark.parametrize(
    ("text", "old", "new", "was", "becomes"),
    [
        (C, "    send(length, 2);", "    send(2, length);", "length,\n         2", "2, length"),
        (C, "send(length /* 1 */, 2)", "end()", "send(length,\n         2)", "end()"),
        (PYTHON, "send(seq, code)\n", "send(code)\n", "send(\n        seq,\n        code,\n    )",
         "send(code)"),
        (PYTHON, "    return seq\n", "    return 1\n", "return seq", "return 1"),
    ],
)  # fmt: skip
def test_another_layout_is_the_same_place(text, old, new, was, becomes):
    assert edited(text, old, new, text is PYTHON) == text.replace(was, becomes)


def test_new_names_are_followed_into_the_edit():
    assert edited(C, "send(size, 2);", "send(size + 1, size, 2);", False) == C.replace(
        "send(length,\n         2);", "send(length + 1, length, 2);"
    )
    assert edited(PYTHON, "self.answer(reason, 0)", "self.answer(1, reason)", True) == (
        PYTHON.replace("self.reply(code, 0)", "self.reply(1, code)")
    )


def test_words_in_texts_are_not_renamed():
    place = locate(PYTHON, "self.reply(why, 0)", is_python=True)
    assert place.text("self.reply(why, 0)", 'log("why", why)') == 'log("why", code)'


@pytest.mark.parametrize(
    ("text", "old", "known", "said"),
    [
        (C, "length", (), "occurs 5 times"),
        (C, "put(seq);", (), "places like it are in the lines 3, 4"),
        (C, "send(length, 3);", (), "is gone"),
        (C, "send(size, 2);", {"length"}, "is gone"),  # which is no new name
        (C, "if (length, 2);", (), "is gone"),
        (C, "send(opcode + length, 2);", (), "is gone"),
        (PYTHON, "send(code, code)", (), "is gone"),
        (PYTHON, "self.reply(0, code)", (), "is gone"),
        # A name that the function still has was not changed.
        (PYTHON.replace("0)", "why)"), "self.reply(why, why)", (), "is gone"),
        (PYTHON.replace("stop(self", "stop(self, why"), "self.reply(why, 0)", (), "is gone"),
    ],
)
def test_a_place_that_is_not_certain_is_none(text, old, known, said):
    with pytest.raises(AnchorError, match=said):
        locate(text, old, is_python=text is not C, known=known)


def test_the_function_around_a_place():
    assert function_at(C, C.index("put(length);"), False)[0] == "first"
    assert function_at(C, C.index("2);"), False)[0] == "second"
    assert function_at(C, 0, False)[0] == ""
    name, start, end = function_at(PYTHON, PYTHON.index("0)"), True)
    assert name == "Device.stop"
    assert PYTHON[start:end] == "    def stop(self, code):\n        self.reply(code, 0)\n"


def test_an_edit_without_a_place_names_its_mutant():
    edit = Edit("firmware/core/j2a_tx.c", "gone(length);", "")
    with pytest.raises(TableError, match=r"core-x-001: firmware/core/j2a_tx\.c: 'gone\(length"):
        changed(C, edit, "core-x-001")


def test_names_that_other_edits_know_are_no_new_ones():
    """`put(length)` and `put(opcode)` are both in the table: neither stands for the other."""
    (edit,) = next(m for m in load("core").mutants if m.id == "core-frame-001-b").edits
    text = (ROOT / edit.file).read_text("utf-8")
    assert edit.find.strip() == "put(checksum);"
    with pytest.raises(TableError, match="is gone"):
        changed(text.replace("put(checksum);", ""), edit, "core-frame-001-b")
    renamed = text.replace("checksum", "sum_of_it")
    assert "put(sum_of_it);" in changed(renamed, edit, "core-frame-001-b")


def test_a_table_names_files_and_the_list_of_files_says_where_they_are():
    mutant, _ = find("device-frame-002")
    assert [edit.file for edit in mutant.edits] == ["j2a/protocol/server.py"]
