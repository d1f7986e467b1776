"""The shared suite gets the readable assertions of a test module."""

import pytest

pytest.register_assert_rewrite("transports.tests.suite")
