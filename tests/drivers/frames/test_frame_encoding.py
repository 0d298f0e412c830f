"""Encoding is the inverse of decoding, for every type of field."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from drivers.frames.decoder import StreamDecoder
from drivers.frames.description import parse_description
from drivers.frames.layout import encode
from tests.drivers.frames.streams import mfs

BITS = {"u8": 8, "i8": 8, "u16": 16, "i16": 16, "u24": 24, "i24": 24, "u32": 32, "i32": 32, "u64": 64, "i64": 64}


def one_field(kind: str, order: str, extra: str = "") -> str:
    """Return a description of a frame with one field at an odd place."""
    return f"""
schema: hil.frames/1
name: one field
sample_rate_hz: 1
byte_order: {"big" if order == "little" else "little"}
frames:
  only:
    id: AA
    length: 20
    checksum: {{kind: crc, width: 16, poly: 0x1021}}
    fields: {{value: {{type: {kind}, at: 3, byte_order: {order}{extra}}}}}
"""


# Quick is each width, by turns unsigned in one order and signed in the other.
EVERY = [(kind, order) for kind in BITS for order in ("little", "big")]
QUICK = {("u8", "little"), ("i16", "big"), ("u24", "little"), ("i32", "big"), ("u64", "little"), ("i64", "big")}


@pytest.mark.parametrize(
    ("kind", "order"), [pytest.param(*each, marks=() if each in QUICK else pytest.mark.slow) for each in EVERY]
)
@given(data=st.data())
def test_an_integer_of_every_width_and_order_comes_back(kind: str, order: str, data: st.DataObject) -> None:
    """The wire holds the integer as Python's own conversion has it."""
    low, high = (0, 2 ** BITS[kind] - 1) if kind[0] == "u" else (-(2 ** (BITS[kind] - 1)), 2 ** (BITS[kind] - 1) - 1)
    values = data.draw(st.lists(st.integers(low, high), min_size=1, max_size=4))
    description = parse_description(one_field(kind, order))
    column = np.array(values, np.uint64 if kind[0] == "u" else np.int64)
    sent = encode(description, "only", {"value": column})
    size = BITS[kind] // 8
    for number, value in enumerate(values):
        wire = sent[20 * number + 3 : 20 * number + 3 + size]
        assert wire == value.to_bytes(size, order, signed=kind[0] == "i")  # type: ignore[arg-type]
    assert StreamDecoder(description).feed(sent)["only"].wire("value").tolist() == values


@pytest.mark.parametrize(("kind", "dtype"), [("f32", np.float32), ("f64", np.float64)])
@given(values=st.lists(st.floats(width=32, allow_nan=False), min_size=1, max_size=4))
def test_a_floating_point_field_comes_back(kind: str, dtype: type, values: list[float]) -> None:
    """Single and double precision, infinities included."""
    description = parse_description(one_field(kind, "big"))
    sent = encode(description, "only", {"value": np.array(values)})
    wire = np.array(values[0], np.dtype(dtype).newbyteorder(">")).tobytes()
    assert sent[3 : 3 + len(wire)] == wire
    assert StreamDecoder(description).feed(sent)["only"].column("value").tolist() == values


@given(st.lists(st.floats(-3e5, 3e5), min_size=1, max_size=5))
def test_scale_and_offset_come_back_within_half_a_step(values: list[float]) -> None:
    """Value = wire × scale + offset, both ways."""
    description = parse_description(one_field("i24", "little", ", scale: 1/16, offset: -40, unit: degC"))
    decoded = StreamDecoder(description).feed(encode(description, "only", {"value": np.array(values)}))["only"]
    assert decoded.column("value") == pytest.approx(np.array(values), abs=1 / 32 + 1e-9)
    assert decoded.column("value") == pytest.approx(decoded.wire("value") / 16 - 40, abs=1e-9)


def test_a_value_beyond_the_range_is_held_at_its_end() -> None:
    """As a converter saturates; it never wraps round to the other sign."""
    ends = [("i16", -(2**15), 2**15 - 1), ("i32", -(2**31), 2**31 - 1), ("u8", 0, 255), ("i64", -(2**63), 2**63 - 1)]
    for kind, low, high in [*ends, ("u64", 0, 2**64 - 1)]:
        description = parse_description(one_field(kind, "big"))
        for value, held in ((1e30, high), (-1e30, low)):
            sent = encode(description, "only", {"value": np.array([value, 1.0])})
            assert StreamDecoder(description).feed(sent)["only"].wire("value").tolist() == [held, 1]


def test_nan_in_an_integer_field_is_refused() -> None:
    """There is no integer for it."""
    with pytest.raises(ValueError, match="rate_A1: an integer field cannot hold NaN"):
        encode(mfs(), "sample", {"rate_A1": np.array([np.nan])})


def test_a_field_that_the_frame_lacks_is_refused() -> None:
    """A misspelt column is no silent zero."""
    with pytest.raises(KeyError):
        encode(mfs(), "sample", {"rate_A3": 1.0})


def test_text_comes_back_without_its_padding_and_too_long_text_is_refused() -> None:
    """Text fields are ASCII of a fixed size."""
    description = mfs()
    sent = encode(description, "identity", {"model": "MFS", "serial": "014", "firmware": "2.1"})
    batch = StreamDecoder(description).feed(sent)["identity"]
    assert [batch.text(name) for name in ("model", "serial", "firmware")] == [["MFS"], ["014"], ["2.1"]]
    with pytest.raises(ValueError, match=r"serial: .* at most 16"):
        encode(description, "identity", {"serial": "x" * 17})


def test_no_rows_are_no_bytes() -> None:
    """An empty column makes no frame."""
    assert encode(mfs(), "sample", {"rate_A1": np.empty(0)}) == b""
