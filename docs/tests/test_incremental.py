"""A page that is made from the project's own sources is made again in each build."""

import pytest

from docs.tests.one_page import built


@pytest.mark.parametrize(
    "source",
    [
        "```{c-api} firmware/core/j2a.h\n```",
        "```{conformance-cases}\n```",
        "```{kill-matrix}\n```",
        "```{packet-figure} packet\n```",
        "<!-- figure: packet -->",
        "```{program-help} j2a call\n```",
        "```{requirements-table}\n```",
        "```{transport-options}\n```",
        "```{transport-urls}\n```",
        "```{usb-checks}\n```",
    ],
)
def test_a_generated_page_is_read_again(tmp_path, source):
    assert "index" in built(tmp_path, f"# A\n\n{source}\n", "dummy").env.reread_always
