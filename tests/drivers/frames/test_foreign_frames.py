"""Bytes that nobody here made are read by the descriptions that ship: public frames and lines, each with its source."""

from __future__ import annotations

import pytest

from drivers.frames.counts import StreamCounts
from drivers.frames.description import load_description
from tests.drivers.frames.foreign import FOREIGN, Foreign
from tests.drivers.frames.test_shipped_descriptions import IMUS, decode_all

CASES = [(name, each) for name, frames in FOREIGN.items() for each in frames]


@pytest.mark.parametrize(("name", "foreign"), CASES, ids=[f"{name}-{each.frame}" for name, each in CASES])
def test_a_public_frame_has_the_values_that_its_source_gives(name: str, foreign: Foreign) -> None:
    """Whole and byte by byte; one flipped bit of it is not believed."""
    description = load_description(IMUS / f"{name}.yaml", parameters=foreign.settings)
    for piece in (1 << 20, 1):
        batches, counts = decode_all(description, foreign.sent, piece)
        assert counts == StreamCounts(ok=foreign.ok)
        for field, value in foreign.values.items():
            assert batches[foreign.frame][0].column(field)[0] == pytest.approx(value, rel=2e-3, abs=1e-9), field
    spoiled = bytearray(foreign.sent)
    spoiled[-6] ^= 0x10
    assert decode_all(description, bytes(spoiled))[1].ok < foreign.ok
