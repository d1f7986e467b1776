"""Reads and writes transds.def, the file in which firmware lists its transducers.

What flows in: the text of the file (thesis, listings 9.2 and 9.5), or descriptors of a board. What
flows out: the descriptors that firmware makes of the file, or a file that makes such descriptors.
Rule: each mistake is one error, which tells file, line and column.
"""

import re
from collections.abc import Callable, Iterable, Iterator, Mapping
from dataclasses import replace
from typing import Final

from j2a_spec.nearest import did_you_mean

from j2a.errors import LocalError, SignatureError
from j2a.types.definition_file import (
    C_INT,
    DEFINITIONS,
    MAX_ITEMS,
    Line,
    entry_line,
    is_group,
    octal_problem,
    type_text,
)
from j2a.types.descriptors import KEYS, parse_transducer
from j2a.types.header import C_TYPES
from j2a.types.macros import Arguments, MacroReader, Node, Opener, Word, bare_text
from j2a.types.model import Enumeration, Field, Structure
from j2a.types.naming import C_KEYWORDS
from j2a.types.parser import A_UNIT, NAME, UNIT, Scanner, read_definition
from j2a.types.transducers import NONE, Descriptors, Transducer, numbers_element

__all__ = ["read_transds", "strange_keys", "transds_text"]

_KINDS: Final = {"SENSOR": "sensor", "SENSOR_EX": "sensor", "ACTUATOR": "actuator"}
_FIELDS: Final = ("a name", "an id", "a prefix", "a model", "a number of channels", "a type")
_C_NAMES: Final = {name: c_name for name, c_name in C_TYPES.items() if name != "bool"}
_C_TYPES: Final = {c_name: name for name, c_name in _C_NAMES.items()}
_OF_ANY_SIZE: Final = {
    "char": ("int8_t", "uint8_t"),
    "int": ("int16_t", "int32_t"),
    "unsigned": ("uint16_t", "uint32_t"),
    "long": ("int32_t", "int64_t"),
}
"""Types whose size or sign is that of the chip."""
_KIND_OF: Final = {
    "watchdog": "actuator",
    **dict.fromkeys(("period", "enabled", "queue", "decimation", "threshold", "trigger"), "sensor"),
}
_DIGITS: Final = re.compile(r"([0-9]*)(.*)", re.DOTALL)
_OCTAL: Final = re.compile(r"(-?)0+([0-9]+)")
_WHOLE: Final = re.compile(r"-?[0-9]{19,400}")
_TOP: Final = 1 << 63
_STRING: Final = re.compile(r'"(?:[^"\\\n]|\\.)*"')
_TEXTS: Final = ("model", "unit", "topic")
_DECIMALS: Final = ("scale", "offset", "accuracy")
"""Numbers in the unit, of which none is hexadecimal."""
_QUOTED: Final = re.compile(r"\".*\"|'.+'")  # '' is the second of arc, a unit
_ASSIGNED: Final = re.compile(rf"({NAME.pattern})\s*[=:]\s*(.+)")
_UNQUOTED: Final = re.compile(r"[^\s(),\"'\\]+(?: [^\s(),\"'\\]+)*")
_BOOL: Final = re.compile(r"\bbool\b")


def read_transds(
    text: str,
    options: Mapping[str, str | None] | None = None,
    *,
    file: str = "transds.def",
    opener: Opener | None = None,
    warn: Callable[[str], object] | None = None,
    are_boards: bool = False,
) -> Descriptors:
    """Return the transducers that a transds.def lists.

    Args:
        text: of the file.
        options: what names stand for in conditions such as `#if NAME`; None for one that the build
            does not define.
        file: its name, for errors.
        opener: opens the files that it includes; None includes nothing.
        warn: called with what is well formed and the build of the firmware refuses all the same.
        are_boards: each file that it includes may be of a board of its own, whose ids and prefixes
            are those of others, too (listing 9.5); for messages, which have names alone.

    Raises:
        SignatureError: an entry is wrong; the error tells file, line and column.
    """
    reader = MacroReader(text, options or {}, file=file, opener=opener, bodies=("SENSORS",))
    types: dict[str, Enumeration | Structure] = {}
    found: dict[str, Transducer] = {}
    names: dict[str, Node] = {}
    ids: dict[tuple[object, int], Node] = {}
    prefixes: dict[tuple[object, str], str] = {}
    entries = reader.entries()
    for macro, arguments in entries:  # all of them come first, wherever they stand
        if make := DEFINITIONS.get(macro):
            _define(entry_line(reader, make, macro, arguments), types)
    for macro, arguments in entries:
        if macro in _KINDS:
            transducer = _Entry(reader, macro, arguments, types).read()
            if transducer.name in found:
                what = f"another transducer has the name {transducer.name}"
                what += _elsewhere(reader, names[transducer.name], arguments[0])
                raise reader.error(what, arguments[0])
            board = arguments[0].source if are_boards else None
            if before := ids.get((board, transducer.id)):
                what = f"{before} has the id {transducer.id}, too"
                what += _elsewhere(reader, before, arguments[1])
                raise reader.error(what, arguments[1])
            if transducer.is_sensor and (board, transducer.prefix) in prefixes:
                what = (
                    f"{prefixes[board, transducer.prefix]} has the prefix {transducer.prefix}, "
                    "too; a driver has one callback, so only the last of them would get values"
                )
                raise reader.error(what, arguments[2])
            if transducer.is_sensor:
                prefixes[board, transducer.prefix] = transducer.name
            ids[board, transducer.id] = names[transducer.name] = arguments[0]
            found[transducer.name] = transducer
        elif macro not in DEFINITIONS:
            hint = did_you_mean(macro.upper(), (*_KINDS, *DEFINITIONS))
            what = f"{macro} is no entry of transds.def"
            raise reader.error(f"{what}; {hint}" if hint else what, macro)
    if warn is not None:
        for name in reader.continued:
            warn(f"{name}: the last line ends in a backslash, which the firmware's build refuses")
    return Descriptors(tuple(types.values()), tuple(found.values()))


def _elsewhere(reader: MacroReader, other: Node, node: Node) -> str:
    """Return what to add to an error about two entries where they stand in two files."""
    if other.source is node.source:
        return ""
    place = reader.error("", other)
    return (
        f", in {place.file}:{place.line}; a file is of one board, unless only messages are made of "
        "it, by --ros1 or --ros2: run j2a transds once for the file of each"
    )


def _define(line: Line, types: dict[str, Enumeration | Structure]) -> None:
    scanner = Scanner(str(line))
    try:
        read_definition(scanner, types, [])
    except SignatureError as error:
        raise line.error(error.reason, error.position) from None
    if scanner.unknown is not None:
        raise line.error("this type is not defined", scanner.unknown)


class _Entry:
    """One transducer of a file: the lines of its descriptor, each with the argument it is from."""

    def __init__(
        self,
        reader: MacroReader,
        macro: Word,
        arguments: Arguments,
        types: Mapping[str, Enumeration | Structure],
    ) -> None:
        self._reader = reader
        self._macro = macro
        self._kind = _KINDS[macro]
        self._arguments = arguments
        self._types = types

    def read(self) -> Transducer:
        """Return the transducer.

        Raises:
            SignatureError: an argument is wrong.
        """
        fields = (*_FIELDS, "the value of N/A" if self._kind == "sensor" else "a safe value")
        if len(self._arguments) < len(fields):
            missing = fields[len(self._arguments)]
            raise self._reader.error(f"{missing} is missing: {', '.join(fields)}", self._macro)
        words = self._arguments[: len(fields)]
        for word, what in zip(words, fields, strict=True):
            if not isinstance(word, Word) and what not in ("a model", "a type"):
                order = ", ".join(fields)
                raise self._reader.error(f"{what} is expected here, in the order {order}", word)
        name, number, prefix, model, channels, kind, na = words
        unit, doc, lines = self._items(self._arguments[len(fields) :])
        head: list[tuple[str, Node]] = [(self._kind, name), (f" {name}", name)]
        head += [(f" {number}", number), (f" {channels}", channels), (f" {self._type(kind)}", kind)]
        head += [(f" {unit}", unit)] if unit else []
        head += [(f" # {bare_text(doc)}", doc)] if doc else []
        self._check_names(name, prefix, kind)
        self._check_quotes("model", model)
        for word in (number, channels, na):
            self._check_number(str(word), word)
        for word, article, what in ((number, "an", "id"), (channels, "a", "number of channels")):
            digits, rest = _DIGITS.findall(str(word))[0]
            if not digits:
                wrong = f"{article} {what} is expected, in decimal digits, not {word}"
                raise self._reader.error(wrong, word)
            if rest:
                wrong = f"{rest} stands behind the {what}, {digits}: write decimal digits only"
                raise self._reader.error(wrong, word)
        key = "na" if self._kind == "sensor" else "safe"
        lines = [
            ("prefix", str(prefix), prefix),
            ("model", model.text, model),
            (key, str(na), na),
            *lines,
        ]
        for key, value, node in (("", str(name), name), *lines):
            if _BOOL.search(_STRING.sub("", f"{key} {value}")):
                raise self._reader.error("C99 makes _Bool of bool, where it is no type", node)
        transducer = self._parsed(head, lines)
        nodes = {key: node for key, _, node in lines}
        for key, wrong in _nonsense(transducer):
            raise self._reader.error(wrong, nodes[key])
        return transducer

    def _check_names(self, name: Node, prefix: Node, kind: Node) -> None:
        for word, what in ((name, "name"), (prefix, "prefix")):
            if not NAME.fullmatch(str(word)):
                raise self._reader.error(
                    f"a {what} is 1 to 32 letters, digits and _, and begins with no digit", word
                )
        if str(name) in C_KEYWORDS:  # the firmware has a member of this name
            raise self._reader.error(f"{name} is a word of C, which takes it for no name", name)
        element = self._type(kind).partition("[")[0]
        known = (*self._types, *_C_NAMES, "bool", "text", "bytes")
        if element not in known:
            hint = f"; {did_you_mean(element, (*known, *_C_TYPES))}".removesuffix("; ")
            if element in _OF_ANY_SIZE:
                likely = _OF_ANY_SIZE[element]
                if self._type(kind) != element:  # an array
                    likely = (_C_TYPES[likely[0]], _C_TYPES[likely[1]])
                hint = f"; did you mean {' or '.join(likely)}?"
            if element in _C_TYPES:
                hint = f" in an array; write {_C_TYPES[element]}"
            raise self._reader.error(f"{element} is no type{hint}", kind)

    def _check_quotes(self, key: str, node: Node) -> None:
        """Refuse quotation marks: the firmware would put them into the descriptor, too."""
        if isinstance(node, Word) and _QUOTED.fullmatch(node):
            plain = node[1:-1]
            what = f"the quotation marks would be part of the {key}; "
            what += f"write {plain}" if _UNQUOTED.fullmatch(plain) else "leave them out"
            raise self._reader.error(what, node)

    def _check_number(self, text: str, node: Node, key: str = "") -> None:
        """Refuse what C reads in another way than people do."""
        if what := octal_problem(text):
            raise self._reader.error(what, node)
        if (written := _c_number(text, key)) != text:
            raise self._reader.error(f"C has no decimal number {text}; write {written}", node)

    def _type(self, node: Node) -> str:
        try:
            text = type_text(node)
        except ValueError:
            what = "this is no type: write one word such as uint16_t, or array(uint16_t, 3)"
            raise self._reader.error(what, node) from None
        return _C_TYPES.get(text, text)

    def _items(
        self, items: list[Node]
    ) -> tuple[Word | None, Word | None, list[tuple[str, str, Node]]]:
        """Return the unit, the text for people, and key, value and place of each attribute."""
        unit: Word | None = None
        doc: Word | None = None
        lines: dict[str, tuple[str, str, Node]] = {}
        for many, most in ((items, MAX_ITEMS), *((item, MAX_ITEMS + 1) for item in items)):
            if isinstance(many, list) and len(many) > most:
                what = f"the compiler takes {MAX_ITEMS} of these at most"
                raise self._reader.error(what, many[most])
        for item in items:
            if isinstance(item, Word):
                if not item.startswith('"'):
                    raise self._reader.error(f"write (key, value) in place of {item}", item)
                if doc is not None:
                    raise self._reader.error("there is a text already", item)
                if item == '""':
                    raise self._reader.error("this text is empty; leave it out", item)
                doc = item
                continue
            key = item[0] if item and is_group(item) else None
            if not isinstance(key, Word) or not NAME.fullmatch(key):
                what = "a key is expected behind this parenthesis"
                if match := _ASSIGNED.fullmatch(str(key)):
                    what = f"write ({match[1]}, {match[2]}), with a comma"
                raise self._reader.error(what, item)
            if key in lines or (key == "unit" and unit is not None):
                raise self._reader.error(f"the key {key} stands here twice", key)
            if key in _TEXTS:
                for word in item[1:]:
                    self._check_quotes(key, word)
            if key == "unit":
                if len(item) != 2 or not isinstance(item[1], Word):
                    raise self._reader.error("unit is one symbol of UCUM, such as (unit, mV)", item)
                unit = item[1]
                if not UNIT.fullmatch(unit):
                    raise self._reader.error(f"{A_UNIT} is expected, not {unit}", unit)
                continue
            if key in ("prefix", "model", "na" if self._kind == "sensor" else "safe"):
                raise self._reader.error(f"{key} has its place in the first seven", key)
            value = item.text[1:-1].partition(",")[2].strip(" ")
            if key == "range" and len(item) == 3:
                value = f"{item[1]}, {item[2]}"
            if key in KEYS and key != "topic":
                for text in value.split(", "):
                    self._check_number(text, item[1] if len(item) > 1 else key, key)
            lines[key] = (str(key), value, item[1] if len(item) > 1 else key)
        return unit, doc, list(lines.values())

    def _parsed(
        self, head: list[tuple[str, Node]], lines: list[tuple[str, str, Node]]
    ) -> Transducer:
        """Return the transducer of the lines of a descriptor."""
        text = "".join(piece for piece, _ in head)
        rest = [f" {key}{value and ' '}{value}" for key, value, _ in lines]
        try:
            transducer = parse_transducer([text, *rest], 1, self._types)
        except SignatureError as error:
            number = error.line or 1
            node = lines[number - 2][2] if number > 1 else head[0][1]
            at = 0
            for piece, place in head if number == 1 else ():
                node = place
                at += len(piece)
                if at > error.position:
                    break
            raise self._reader.error(error.reason, node) from None
        assert transducer is not None
        if not transducer.kind:
            raise self._reader.error("its type uses one that is not defined", head[4][1])
        return transducer


def _nonsense(transducer: Transducer) -> Iterator[tuple[str, str]]:
    """Yield a key and why its value, which is well formed, makes no sense here."""
    kind, name = transducer.kind, transducer.name
    for key, _ in transducer.attributes:
        if _KIND_OF.get(key, kind) != kind:
            yield key, f"{key} is for {_KIND_OF[key]}s, and {name} is none"
        if key in ("scale", "offset") and numbers_element(transducer.type) is None:
            yield key, f"{key} is for numbers and arrays of them, and {name} has {transducer.type}"
    if transducer.scale == 0:
        yield "scale", "with a scale of 0 all values are the same"
    if (transducer.accuracy or 0) < 0:
        yield "accuracy", "accuracy is the largest error, which is not below 0"
    if transducer.range is not None and kind == "actuator":
        low, high = transducer.range
        safe = transducer.safe or 0
        if not low <= safe <= high:
            told = (
                "none stands for 0, which" if transducer.safe is None else f"the safe value {safe}"
            )
            yield "safe", f"{told} is outside of the range, {transducer.get('range')}"


def strange_keys(descriptors: Descriptors) -> Iterator[str]:
    """Yield a note for each key that has no meaning but is near one that has."""
    for transducer in descriptors.transducers:
        for key, _ in transducer.attributes:
            if key not in KEYS and (hint := did_you_mean(key, (*KEYS, "unit"))):
                yield f"{transducer.name}: the key {key} means nothing to J2A; {hint}"


# ------------------------------------------------------------------------- writing


def transds_text(descriptors: Descriptors, source: str) -> str:
    """Return a transds.def that makes firmware describe these transducers.

    Args:
        descriptors: of a board.
        source: where they come from, for the comment.

    Raises:
        LocalError: what the board says cannot stand in such a file.
    """
    transducers = [replace(one, attributes=_attributes(one)) for one in descriptors.transducers]
    due = replace(descriptors, transducers=tuple(transducers))
    lines = [*map(_definition, due.types), *map(_entry, transducers)]
    text = "".join(f"{line}\n" for line in lines)
    _check_meaning(text, due)
    return f"/* The transducers of {_comment(source)}, written by j2a transds. */\n{text}"


def _check_meaning(text: str, due: Descriptors) -> None:
    """Refuse a file that would not be read, or would be of another board."""
    all_due = (*due.types, *due.transducers)  # each has a line of the file
    try:
        again = read_transds(text)
    except SignatureError as error:
        name = all_due[(error.line or 1) - 1].name
        raise LocalError(f"{name} cannot stand in a transds.def: {error.reason}") from None
    read = {str(one) for one in (*again.types, *again.transducers)}
    for one in all_due:
        if str(one) not in read:
            raise LocalError(f"{one.name} cannot stand in a transds.def: it would be another one")


def _comment(text: str) -> str:
    return text.replace("*/", "* /")


def _definition(one: Enumeration | Structure) -> str:
    fields = () if isinstance(one, Enumeration) else one.fields
    _refuse_c_words(one.name, (one.name, *(field.name for field in fields)))
    if isinstance(one, Enumeration):
        for name, number in one.values:
            if number not in C_INT:
                raise LocalError(
                    f"{one.name}: {name} is {number}, which no int of C holds, so it cannot stand "
                    "in a transds.def"
                )
        values = "".join(f", ({name}, {number})" for name, number in one.values)
        return f"J2A_ENUM({one.name}, {one.integer}{values})"
    return f"J2A_STRUCT({one.name}, {', '.join(map(_field, one.fields))})"


def _field(field: Field) -> str:
    unit = field.type.unit and f", {field.type.unit}"
    return f"({_element(str(field.type).partition(' ')[0])}, {field.name}{unit})"


def _c_number(text: str, key: str = "") -> str:
    """Return a number as C can read it: decimal constants end at the largest int64_t.

    No zero stands in front of one, which would be octal.

    Args:
        text: the number.
        key: whose value it is.
    """
    if match := _OCTAL.fullmatch(text):
        text = f"{match[1]}{match[2]}"
    if not _WHOLE.fullmatch(text) or -_TOP < int(text) < _TOP:
        return text
    number = int(text)
    is_hex = key not in _DECIMALS and -_TOP <= number < 2 * _TOP
    return f"{number:#X}".replace("X", "x") if is_hex else f"{text}.0"


def _element(text: str) -> str:
    name, bracket, count = text.rstrip("]").partition("[")
    return f"array({name}, {count})" if bracket else name


def _refuse_c_words(owner: str, names: Iterable[str]) -> None:
    """Refuse to write a name that the compiler would not take."""
    for name in names:
        if name in C_KEYWORDS:
            raise LocalError(f"{owner}: {name} is a word of C, so it cannot stand in a transds.def")


def _attributes(one: Transducer) -> tuple[tuple[str, str], ...]:
    """Return the attributes as a file has them: always with those of the first seven arguments."""
    key = "na" if one.is_sensor else "safe"
    found = {"prefix": one.prefix or one.name, "model": one.model or "unknown"}
    found |= {key: one.get(key) or NONE}
    found |= {name: value for name, value in one.attributes if name not in found}
    for name, value in found.items():
        if name in KEYS and name not in ("prefix", *_TEXTS):
            found[name] = ", ".join(_c_number(one, name) for one in value.split(", "))
    return tuple(found.items())


def _entry(one: Transducer) -> str:
    _refuse_c_words(one.name, (one.name,))
    kind = str(one.type).partition(" ")[0]
    (_, prefix), (_, model), (_, na), *others = one.attributes
    first: list[str] = [one.name, str(one.id), prefix]
    first += [_argument(one, "model", model), str(one.channels)]
    first += [_C_NAMES.get(kind, _element(kind)), na]
    items = [f"(unit, {one.unit})"] if one.unit else []
    for name, value in others:
        text = _argument(one, name, value, can_have_commas=True)
        items.append(f"({name}, {text})" if text else f"({name})")
    if one.doc:
        text = one.doc.replace("\\", "\\\\").replace('"', '\\"')
        text = re.sub(r"\?(?=\?)", '?" "', text)  # no trigraphs
        items.append(f'"{text}"')
    macro = "ACTUATOR" if not one.is_sensor else "SENSOR_EX" if items else "SENSOR"
    return f"{macro}({', '.join([*first, *items])})"


def _argument(one: Transducer, key: str, value: str, can_have_commas: bool = False) -> str:
    """Return a value, unless a compiler, or who reads the file, would take it for another one."""
    depth = 0
    bare = value if key in _TEXTS else _STRING.sub("", value)
    for character in bare:
        depth += (character == "(") - (character == ")")
        if depth < 0 or character in "\"'#\\" or (character == "," and not can_have_commas):
            depth = 1
            break
    is_other = "??" in value or "//" in bare or "/*" in bare or bare != " ".join(bare.split())
    is_other |= key == "unit" or not value.isprintable()  # (unit, mm) is the unit itself
    if depth or is_other:
        raise LocalError(f"{one.name}: {key} {value!r} cannot stand in a transds.def")
    return value
