"""The two curves of a night: its temperatures, and the running averages of the present collect (or the last one).

They come from the trace that the controller writes at one second; a night without one (recorded elsewhere, or before
there was any) is drawn from the journal's signs of life, one a minute.
"""

from pathlib import Path
from typing import Any

import numpy as np

from hil.records import JournalReader
from hil.records.curve import TEMPERATURE, Curve, rows_of
from hil.records.live import Rows, TraceReader

_ROWS_AT_ONCE = 20_000
_COLLECT_BUCKETS = 600
_MEAN, _SE = " mean", " se"


class NightCurves:
    """Curves that grow with a night. `changes` reads what is new and returns the parts to draw anew."""

    def __init__(self, folder: Path) -> None:
        self._trace = TraceReader(folder)
        self._begin([])
        self._last_heartbeat = 0

    def _begin(self, columns: list[str]) -> None:
        self._columns = columns
        self._temperatures = [name for name in columns if name.endswith(TEMPERATURE)]
        self._averages = [name for name in columns if name.endswith((_MEAN, _SE))]
        self._night = Curve(len(self._temperatures))
        self._collect = self._empty_collect()
        self._collecting = False

    def _empty_collect(self) -> Curve:
        return Curve(len(self._averages), _COLLECT_BUCKETS, digits=4)

    def take_heartbeats(self, journal: JournalReader) -> None:
        """Draw from the journal while there is no trace."""
        if self._trace.columns:
            return
        beats = journal.heartbeats(self._last_heartbeat)
        if not beats:
            return
        columns, rows = rows_of(beats, self._columns)
        if columns != self._columns:
            self._begin(columns)
            _, rows = rows_of(journal.heartbeats())
        self._last_heartbeat = beats[-1].number
        self._add(rows)

    def changes(self) -> dict[str, Any]:
        """Read what the trace has got meanwhile; return the curves that changed, from their first new bucket on."""
        while len(rows := self._trace.read(_ROWS_AT_ONCE)):
            if self._trace.begun_anew or self._columns != self._trace.columns:
                self._begin(self._trace.columns)
            self._add(rows)
        found = {"temperatures": self._night.changes(), "collect": self._collect.changes()}
        return {name: self._named(name, curve) for name, curve in found.items() if curve is not None}

    def whole(self) -> dict[str, Any]:
        """Return both curves from their beginnings."""
        found = {"temperatures": self._night.whole(), "collect": self._collect.whole()}
        return {name: self._named(name, curve) for name, curve in found.items()}

    def _named(self, name: str, curve: dict[str, Any]) -> dict[str, Any]:
        return {"columns": self._temperatures if name == "temperatures" else self._averages, **curve}

    def _add(self, rows: Rows) -> None:
        values = rows.astype(float)
        times_s = values[:, 0]
        self._night.add(times_s, values[:, self._where(self._temperatures)])
        if self._averages:
            self._add_averages(times_s, values[:, self._where(self._averages)])

    def _add_averages(self, times_s: Any, averages: Any) -> None:
        """Keep the newest collect: the rows since running means last began."""
        during = np.isfinite(averages).any(axis=1)
        begins = np.flatnonzero(during & ~np.concatenate([[self._collecting], during[:-1]]))
        if len(begins):
            self._collect = self._empty_collect()
            times_s, averages, during = times_s[begins[-1] :], averages[begins[-1] :], during[begins[-1] :]
        self._collect.add(times_s[during], averages[during])
        self._collecting = bool(during[-1])

    def _where(self, names: list[str]) -> list[int]:
        return [self._columns.index(name) for name in names]
