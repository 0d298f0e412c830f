"""The checksum of a frame: verify it, in one frame or in thousands at once, and write it."""

from collections.abc import Callable
from functools import partial
from operator import itemgetter
from typing import Any

import numpy as np
from numpy.typing import NDArray

from drivers.frames.checksum_kinds import ChecksumDescription, CrcKind, FletcherKind, SumKind
from drivers.frames.crc import Crc
from drivers.frames.wire import Rows, read_column, write_column


def _sum(kind: SumKind, rows: Rows) -> NDArray[Any]:
    words = np.ascontiguousarray(rows).view(f"{'<' if kind.word_order == 'little' else '>'}u{kind.word}")
    total: NDArray[Any] = words.sum(axis=1, dtype=np.int64)
    return (-total if kind.negate else total) & ((1 << kind.width) - 1)


def _fletcher(rows: Rows) -> NDArray[Any]:
    """First sum Σb, second sum Σ of the first sums, both modulo 256."""
    second = rows.astype(np.int64) @ np.arange(rows.shape[1], 0, -1, dtype=np.int64)
    both: NDArray[Any] = (rows.sum(axis=1, dtype=np.int64) & 0xFF) << 8 | (second & 0xFF)
    return both


def _xor(rows: Rows) -> NDArray[Any]:
    return np.asarray(np.bitwise_xor.reduce(rows, axis=1))


class FrameChecksum:
    """The checksum of frames of one type and length, whose delimiter, if there is one, begins at `body_end`."""

    def __init__(self, kind: ChecksumDescription, body_end: int) -> None:
        self._at = kind.position(body_end)
        self._size = kind.size
        self._order = kind.stored
        self._parts = [slice(*part) if isinstance(part, tuple) else part for part in kind.covered(body_end)]
        first = self._parts[0]
        plain = len(self._parts) == 1 and isinstance(first, slice)
        self._covered: Callable[[bytes], bytes] = itemgetter(first) if plain else self._joined
        self._of_rows: Callable[[Rows], NDArray[Any]]
        self._of_bytes: Callable[[bytes], int] = self._alone
        if isinstance(kind, CrcKind):
            crc = Crc(kind, len(self._covered(bytes(body_end))))
            self._of_rows, self._of_bytes = crc.of_rows, crc.of_bytes
        elif isinstance(kind, SumKind):
            self._of_rows = partial(_sum, kind)
        else:
            self._of_rows = _fletcher if isinstance(kind, FletcherKind) else _xor

    def _joined(self, frame: bytes) -> bytes:
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

    def matches(self, frame: bytes) -> bool:
        """Tell whether one whole frame carries the right checksum."""
        stored = int.from_bytes(frame[self._at : self._at + self._size], self._order)
        return not self._size or self._of_bytes(self._covered(frame)) == stored

    def _alone(self, covered: bytes) -> int:
        return int(self._of_rows(np.frombuffer(covered, np.uint8).reshape(1, -1))[0])

    def matches_rows(self, rows: Rows) -> NDArray[np.bool_]:
        """Tell it for n whole frames, shape (n, length), contiguous; the result has shape (n,)."""
        if not self._size:
            return np.ones(len(rows), np.bool_)
        stored = read_column(rows, self._at, f"u{8 * self._size}", self._order)
        return np.asarray(self._of_rows(self._covered_rows(rows)) == stored, dtype=np.bool_)

    def write(self, rows: Rows) -> None:
        """Compute and store the checksums of n whole frames, (n, length), in place."""
        if self._size:
            values = self._of_rows(self._covered_rows(rows))
            write_column(rows, self._at, f"u{8 * self._size}", self._order, values)
