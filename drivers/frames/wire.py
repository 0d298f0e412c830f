"""Numbers on the wire, one column at a time: n frames of equal length are a contiguous array of shape (n, length)."""

from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

Rows = NDArray[np.uint8]
FloatArray = NDArray[np.float64]
IntArray = NDArray[np.int64]
ByteOrder = Literal["little", "big"]

_NATIVE = {"u": (1, 2, 4, 8), "i": (1, 2, 4, 8), "f": (2, 4, 8)}


def native_type(kind: str, order: ByteOrder) -> str | None:
    """Return numpy's name of a type on the wire (u8, i24, f32 …), None where numpy has none."""
    if kind[:2] == "fp":  # fixed point is an integer; that of 48 bits comes in pieces
        kind = {"fp12.20": "i32", "fp16.32": "i48"}[kind]
    size = int(kind[1:]) // 8
    return f"{'<' if order == 'little' else '>'}{kind[0]}{size}" if size in _NATIVE[kind[0]] else None


def _view(rows: Rows, offset: int, dtype: str) -> NDArray[Any]:
    if not len(rows):
        return np.empty(0, dtype)
    return np.ndarray((len(rows),), dtype, rows, offset, (rows.shape[1],))


def read_column(rows: Rows, offset: int, kind: str, order: ByteOrder) -> NDArray[Any]:
    """Return a column's wire values, (n,), in the smallest native type; `kind`: u8, i24, f32, u40, fp12.20."""
    native = native_type(kind, order)
    if native is not None:
        return _view(rows, offset, native)
    if kind == "fp16.32":  # the 32 bits of the fraction first, then the 16 bits before the point
        fraction, whole = (native_type(part, order) or "" for part in ("u32", "i16"))
        return _view(rows, offset + 4, whole).astype(np.int64) << 32 | _view(rows, offset, fraction).astype(np.int64)
    size, signed = int(kind[1:]) // 8, kind[0] == "i"
    dtype: type[np.integer[Any]] = np.int32 if size == 3 else np.int64 if signed else np.uint64
    value: NDArray[Any] = np.zeros(len(rows), dtype)
    for position in range(size) if order == "big" else reversed(range(size)):
        value <<= dtype(8)
        value |= rows[:, offset + position]
    return sign_extended(value, 8 * size) if signed else value


def sign_extended(values: NDArray[Any], bits: int) -> NDArray[Any]:
    """Return integers, (n,), whose lowest `bits` hold a two's complement number, with the sign above these."""
    above = values.dtype.type(8 * values.dtype.itemsize - bits)
    return np.asarray((values << above) >> above)


def write_column(rows: Rows, offset: int, kind: str, order: ByteOrder, values: NDArray[Any]) -> None:
    """Store `values`, shape (n,), at `offset` of every row. Integers must already be in range."""
    native = native_type(kind, order)
    if native is not None:
        _view(rows, offset, native)[:] = values
        return
    if kind == "fp16.32":
        write_column(rows, offset, "u32", order, values & 0xFFFFFFFF)
        write_column(rows, offset + 4, "i16", order, values >> 32)
        return
    size = int(kind[1:]) // 8
    rest = values.astype(np.int64 if kind[0] == "i" else np.uint64)
    for position in reversed(range(size)) if order == "big" else range(size):
        rows[:, offset + position] = (rest & rest.dtype.type(0xFF)).astype(np.uint8)
        rest = rest >> rest.dtype.type(8)
