"""Devices that do what the specification allows in a way that no device of ours does."""

import pytest
from j2a_conformance import Verdict
from j2a_spec import constants as c


class EmptyLast:
    """Ends the properties by an empty chunk (J2A-MANY-020)."""

    def read_properties(self, write, offset):
        code, _, part = super().read_properties(write, offset)
        return code, write or not part, part


class EmptyLastAtOdd(EmptyLast):
    """Does so at some offsets only, as a fault does."""

    def read_properties(self, write, offset):
        code, is_last, part = super().read_properties(write, offset)
        is_end = offset + len(part) == len(self.property_bytes())
        return code, is_last or (is_end and offset % 2 == 0), part


class NeverLast:
    """Says of no chunk with data that it is the last one, nor at the end."""

    def read_properties(self, write, offset):
        code, _, part = super().read_properties(write, offset)
        return code, write or offset > len(self.property_bytes()), part


@pytest.mark.parametrize(
    ("mixin", "verdict"),
    [(EmptyLast, Verdict.OK), (EmptyLastAtOdd, Verdict.FAILED), (NeverLast, Verdict.FAILED)],
)
def test_the_last_chunk_may_be_empty(mixin, verdict, reference, judged):
    device = type(mixin.__name__, (mixin, reference), {})
    found = judged(device, ["properties.content", "many.read-requests", "properties.behind-end"])
    results = {result.case: result for result in found.results}
    assert results["properties.content"].verdict is verdict
    assert c.GET_PROPERTIES in found.claims.functions
    if verdict is Verdict.OK:
        assert found.conformant
