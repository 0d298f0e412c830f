"""The checksum of a frame: verify it, in one frame or in thousands at once, and write it."""

from __future__ import annotations

from collections.abc import Callable
from functools import reduce
from operator import xor
from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray

from drivers.frames.checksum_kinds import ChecksumDescription, CrcKind, FletcherKind, SumKind, XorKind
from drivers.frames.crc import Crc, Residue, residue_test
from drivers.frames.wire import Rows, read_column, write_column


class _Algorithm(Protocol):
    def of_bytes(self, message: bytes) -> int: ...

    def of_rows(self, rows: Rows) -> NDArray[Any]: ...


class _Sum:
    def __init__(self, kind: SumKind) -> None:
        self._kind = kind
        self._mask = (1 << kind.width) - 1

    def of_bytes(self, message: bytes) -> int:
        kind, total = self._kind, 0
        for start in range(0, len(message), kind.word):
            total += int.from_bytes(message[start : start + kind.word], kind.word_order)
        return (-total if kind.negate else total) & self._mask

    def of_rows(self, rows: Rows) -> NDArray[Any]:
        kind = self._kind
        words = np.ascontiguousarray(rows).view(f"{'<' if kind.word_order == 'little' else '>'}u{kind.word}")
        total: NDArray[Any] = words.sum(axis=1, dtype=np.int64)
        return (-total if kind.negate else total) & self._mask


class _Fletcher:
    """First sum Σb, second sum Σ of the first sums, both modulo 256."""

    def of_bytes(self, message: bytes) -> int:
        first = second = 0
        for byte in message:
            first += byte
            second += first
        return (first & 0xFF) << 8 | (second & 0xFF)

    def of_rows(self, rows: Rows) -> NDArray[Any]:
        weights = np.arange(rows.shape[1], 0, -1, dtype=np.int64)
        first = rows.sum(axis=1, dtype=np.int64)
        second = rows.astype(np.int64) @ weights
        both: NDArray[Any] = (first & 0xFF) << 8 | (second & 0xFF)
        return both


class _Xor:
    def of_bytes(self, message: bytes) -> int:
        return reduce(xor, message)

    def of_rows(self, rows: Rows) -> NDArray[Any]:
        return np.asarray(np.bitwise_xor.reduce(rows, axis=1))


class _None:
    def of_bytes(self, message: bytes) -> int:  # noqa: ARG002 - nothing is covered
        return 0

    def of_rows(self, rows: Rows) -> NDArray[Any]:
        return np.zeros(len(rows), np.int64)


class FrameChecksum:
    """The checksum of frames of one type and length: what it covers, where it stands, and how it is computed.

    `body_end` is where the delimiter begins, if there is one.
    """

    def __init__(self, kind: ChecksumDescription, body_end: int) -> None:
        self._at = kind.position(body_end)
        self._size = kind.size
        self._order = kind.stored
        self._parts = [slice(*part) if isinstance(part, tuple) else part for part in kind.covered(body_end)]
        self._algorithm: _Algorithm
        if isinstance(kind, CrcKind):
            self._algorithm = Crc(kind, len(self._covered(bytes(body_end))))
        elif isinstance(kind, SumKind):
            self._algorithm = _Sum(kind)
        elif isinstance(kind, FletcherKind):
            self._algorithm = _Fletcher()
        else:
            self._algorithm = _Xor() if isinstance(kind, XorKind) else _None()
        self.residue: Residue | None = None
        first = self._parts[0]
        if isinstance(kind, CrcKind) and isinstance(first, slice) and len(self._parts) == 1 and self._at == first.stop:
            self.residue = residue_test(kind, first.start, first.stop)
        self.matches: Callable[[bytes], bool] = self._matches if self.residue is None else self.residue.matches

    def _covered(self, frame: bytes) -> bytes:
        return b"".join([frame[part] if isinstance(part, slice) else part for part in self._parts])

    def _covered_rows(self, rows: Rows) -> Rows:
        if len(self._parts) == 1 and isinstance(self._parts[0], slice):
            return rows[:, self._parts[0]]
        constant = np.frombuffer(b"".join(part for part in self._parts if isinstance(part, bytes)), np.uint8)
        extended, at, columns = np.hstack([rows, np.tile(constant, (len(rows), 1))]), rows.shape[1], list[int]()
        for part in self._parts:
            columns += range(part.start, part.stop) if isinstance(part, slice) else range(at, at + len(part))
            at += len(part) if isinstance(part, bytes) else 0
        return extended[:, columns]

    def _matches(self, frame: bytes) -> bool:
        """Tell whether one whole frame carries the right checksum."""
        stored = int.from_bytes(frame[self._at : self._at + self._size], self._order)
        return self._algorithm.of_bytes(self._covered(frame)) == stored

    def matches_rows(self, rows: Rows) -> NDArray[np.bool_]:
        """Tell it for n whole frames, shape (n, length), contiguous; the result has shape (n,)."""
        if not self._size:
            return np.ones(len(rows), np.bool_)
        stored = read_column(rows, self._at, f"u{8 * self._size}", self._order)
        return np.asarray(self._algorithm.of_rows(self._covered_rows(rows)) == stored, dtype=np.bool_)

    def write(self, rows: Rows) -> None:
        """Compute and store the checksums of n whole frames, (n, length), in place."""
        if self._size:
            values = self._algorithm.of_rows(self._covered_rows(rows))
            write_column(rows, self._at, f"u{8 * self._size}", self._order, values)
