"""Readable assertions in what the tests share."""

import pytest

pytest.register_assert_rewrite(
    "j2a.tests.library.support", "j2a.tests.library.virtual", "j2a.tests.library.wire"
)
