"""A curve of bounded size: least and greatest value per bucket of time, with buckets that double when space runs out.

A bucket is about a pixel of the screen, so that a spike of one second in fifteen hours is still drawn, and a night of
any length costs the same memory.
"""

import math
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from hil.campaign import FloatArray
from hil.errors import Damaged
from hil.files.document import plain
from hil.records.live import TRACE_NAME, Rows, TraceReader
from hil.records.rows import Heartbeat
from hil.records.witnesses import seal

TEMPERATURE = "_degC"
"""How the names of columns of temperatures end."""

_FIRST_WIDTH_S = 1.0
_OF_ALL, _AT_MOST = 2048, 10_000_000  # buckets of a whole night, about the points that a page's width has; rows


class Curve:
    """Several values over one time, in at most `buckets` buckets (an even number)."""

    def __init__(self, columns: int, buckets: int = 2048, digits: int = 2) -> None:
        self._least = np.full((buckets, columns), np.nan)
        self._greatest = np.full((buckets, columns), np.nan)
        self._digits = digits
        self._start_s = math.nan
        self._width_s = _FIRST_WIDTH_S
        self._used = 0
        self._unsent = 0

    def add(self, times_s: FloatArray, values: FloatArray) -> None:
        """Take in values, shape (n, columns), at times, shape (n,), that do not go backwards. NaN is no value."""
        if not len(times_s):
            return
        if math.isnan(self._start_s):
            self._start_s = float(times_s[0])
        while (times_s[-1] - self._start_s) // self._width_s >= len(self._least):
            self._double()
        index = np.maximum((np.asarray(times_s, dtype=float) - self._start_s) // self._width_s, 0).astype(int)
        np.fmin.at(self._least, index, values)
        np.fmax.at(self._greatest, index, values)
        self._unsent = min(self._unsent, int(index[0]))
        self._used = max(self._used, int(index[-1]) + 1)

    def points(self) -> tuple[FloatArray, FloatArray]:
        """Return times, s, (n,), and values, (n, columns): of each bucket that is not empty, its least and greatest."""
        both = np.stack([self._least[: self._used], self._greatest[: self._used]], axis=1)
        told = np.isfinite(both).any(axis=2)
        told[:, 1] &= (both[:, 0] < both[:, 1]).any(axis=1)
        times_s = self._start_s + self._width_s * np.arange(self._used)
        return np.repeat(times_s, 2)[told.ravel()], both[told]

    def whole(self, first: int = 0) -> dict[str, Any]:
        """Return what there is to draw, from bucket `first` on: where they begin, how wide they are, each column."""
        part = slice(first, self._used)
        return {
            "from": first,
            "start_s": None if math.isnan(self._start_s) else round(self._start_s, 3),
            "width_s": self._width_s,
            "least": plain(np.round(self._least[part].T, self._digits)),
            "greatest": plain(np.round(self._greatest[part].T, self._digits)),
        }

    def changes(self) -> dict[str, Any] | None:
        """Return what changed since the last call, from its first bucket on; None where nothing did."""
        if self._unsent >= self._used:
            return None
        document = self.whole(self._unsent)
        self._unsent = self._used
        return document

    def _double(self) -> None:
        """Put two neighbours into one bucket, so that half of the buckets are free again."""
        half = len(self._least) // 2
        for table, smaller in ((self._least, np.fmin), (self._greatest, np.fmax)):
            table[:half] = smaller(table[0::2], table[1::2])
            table[half:] = np.nan
        self._width_s *= 2.0
        self._used = (self._used + 1) // 2
        self._unsent = 0


def rows_of(beats: Sequence[Heartbeat], columns: Sequence[str] = ()) -> tuple[list[str], Rows]:
    """Return the temperatures of the journal's signs of life, (n, columns), as a trace has them: by `t_s` and name."""
    named = {name for beat in beats for name in beat.readings if name.endswith(TEMPERATURE)}
    columns = ["t_s", *sorted(named.union(columns[1:]))]
    rows = [[beat.at_s, *(beat.readings.get(name, np.nan) for name in columns[1:])] for beat in beats]
    return columns, np.array(rows, dtype="<f4").reshape(-1, len(columns))


def trace_damage(folder: Path, recorded: Mapping[str, Any]) -> list[str]:
    """Return in words that a night's trace of full length is not what was `recorded` of it (`seal`)."""
    found = seal(folder / TRACE_NAME, recorded["size"]) if recorded else {}
    if found == recorded or found.get("size") != recorded["size"]:
        return []
    return [f"{TRACE_NAME}: is not what was written; without it the journal's marks are drawn"]


def temperatures(
    folder: Path, beats: Sequence[Heartbeat], recorded: Mapping[str, Any] | None = None
) -> tuple[list[str], FloatArray, FloatArray]:
    """Return the names of a night's temperatures, times of the campaign, s, (n,), and values, °C, (n, names).

    They are those of its trace, a row a second, and of its signs of life, one a minute: a trace may be lost or cut off
    with the power. Raises `Damaged` as `trace_damage` says.
    """
    for damage in trace_damage(folder, recorded or {}):
        raise Damaged(f"{folder}/{damage}")
    trace = TraceReader(folder)
    rows = trace.read(_AT_MOST)
    traced = [name for name in trace.columns if name.endswith(TEMPERATURE)]
    columns, all_rows = rows_of(beats, ["t_s", *traced])
    missing = np.full((len(rows), 1), np.nan)
    taken = [rows[:, [trace.columns.index(name)]] if name in trace.columns else missing for name in columns]
    both = np.concatenate([all_rows, np.hstack(taken)]).astype(float)
    both = both[np.argsort(both[:, 0], kind="stable")]
    curve = Curve(len(columns) - 1, _OF_ALL)
    curve.add(both[:, 0], both[:, 1:])
    times_s, values = curve.points()
    return columns[1:], times_s, np.round(values, 4)  # of four bytes, in which 60.1 is 60.099998
