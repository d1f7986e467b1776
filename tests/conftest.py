"""Readable assertions in what the tests share."""

import pytest

pytest.register_assert_rewrite(
    "tests.library.support", "tests.library.virtual", "tests.library.wire"
)
