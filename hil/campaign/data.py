"""Measured data as everything downstream sees it: a campaign of stationary collects (schema hil.campaign/1).

The controller's own nights and a folder written by hand in a spreadsheet become the same objects here, so that solve,
reconcile, thermal and report work on data that this project did not record.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from pathlib import Path
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

from procedures.pose import PoseTolerance
from procedures.verdict import Judgement

EARTH_RATE_DEG_PER_HR = 15.041067
"""Rotation of the Earth with respect to inertial space (one turn in a sidereal day of 86 164.0989 s)."""

FloatArray = NDArray[np.float64]
IntArray = NDArray[np.int64]
TextArray = NDArray[np.str_]
BoolArray = NDArray[np.bool_]
RowIndex = BoolArray | IntArray

SCHEMA = "hil.campaign/1"
_EDGE = 1e-6  # a sample on the edge between two blocks belongs to the later one, whatever the rounding

Technology = Literal["", "rotor", "DTG", "RLG", "FOG", "MEMS", "gas"]
"""What a gyro may be, as far as typical sizes of effects differ by it; empty where nobody stated it."""


def known_mean(values: FloatArray) -> float:
    """Return the mean of those of values, (n,), that are known; NaN where none is."""
    known = values[np.isfinite(values)]
    return float(known.mean()) if len(known) else np.nan


@dataclass(frozen=True)
class Sensor:
    """A sensor's layout: its three axes, and which axis each channel measures rate about (in column order).

    Effects have other typical sizes in another `technology`.
    """

    number: int
    axes: tuple[str, str, str]
    channels: Mapping[str, str]
    technology: Technology = ""

    @property
    def channel_axes(self) -> IntArray:
        """Index into `axes` of each channel's axis, shape (c,)."""
        return np.array([self.axes.index(axis) for axis in self.channels.values()], dtype=np.int64)

    @property
    def is_rotor(self) -> bool:
        """True for the report's two-channel sensor: channels about the first two axes, the third is the spin axis."""
        return tuple(self.channel_axes) == (0, 1)

    @property
    def is_triad(self) -> bool:
        """True for a three-axis gyro triad."""
        return sorted(self.channel_axes) == [0, 1, 2]


@dataclass(frozen=True, eq=False)
class Conditions:
    """What was known about n collects (or n samples) of one sensor, without the rates: what an effect may depend on.

    `f_g` and `w_deg_per_hr` have shape (n, 3), along the sensor's axes. `columns` holds every other column by its name
    in collects.csv (`temperature_degC`, `dTdt_degC_per_min`, `supply_V`, …), shape (n,), NaN where a cell is empty; a
    column that the data lacks is absent.
    """

    sensor: Sensor
    collect: IntArray
    run: IntArray
    position: TextArray
    start_s: FloatArray
    duration_s: FloatArray
    f_g: FloatArray
    w_deg_per_hr: FloatArray
    columns: Mapping[str, FloatArray] = field(default_factory=dict)

    def __len__(self) -> int:
        return len(self.start_s)

    def rows(self, index: RowIndex) -> Conditions:
        """Return the chosen rows: a mask or an array of indices, shape (n,) or (k,)."""
        chosen: dict[str, Any] = {
            name: each[index] for name, each in vars(self).items() if isinstance(each, np.ndarray)
        }
        return replace(self, **chosen, columns={name: values[index] for name, values in self.columns.items()})

    @cached_property
    def of_each_run(self) -> Mapping[int, IntArray]:
        """The rows of each run, (k,), by its number in rising order: a life has thousands, and is gone through once."""
        order = np.argsort(self.run, kind="stable")
        runs, begins = np.unique(self.run[order], return_index=True)
        return dict(zip(runs.tolist(), np.split(order, begins[1:]), strict=True)) if len(runs) else {}

    @property
    def w_channels_deg_per_hr(self) -> FloatArray:
        """Earth rate about each channel's own axis, shape (n, c)."""
        return self.w_deg_per_hr[:, self.sensor.channel_axes]


@dataclass(frozen=True, eq=False)
class Collects:
    """The collects of one sensor: conditions, averaged rates and their standard errors. No two are the same.

    `rates_deg_per_hr` and `rates_se_deg_per_hr` have shape (n, c); NaN where not measured or not stated.
    """

    conditions: Conditions
    rates_deg_per_hr: FloatArray
    rates_se_deg_per_hr: FloatArray

    def __len__(self) -> int:
        return len(self.conditions)

    def rows(self, index: RowIndex) -> Collects:
        """Return the chosen rows: a mask or an array of indices, shape (n,) or (k,)."""
        if isinstance(index, np.ndarray) and index.dtype == bool and index.all():
            return self  # what is known of these is known
        return Collects(self.conditions.rows(index), self.rates_deg_per_hr[index], self.rates_se_deg_per_hr[index])


@dataclass(frozen=True)
class Series:
    """The rates within one collect: `t_s` (k,) from its start, `rates_deg_per_hr` (k, c), NaN where a cell is empty.

    `temperature_degC` has shape (k,) or is None; `block_s` is the averaging time of each row, None for single samples,
    `n_samples`, (k,) or None, of how many samples each is the mean.
    """

    t_s: FloatArray
    rates_deg_per_hr: FloatArray
    temperature_degC: FloatArray | None = None
    block_s: float | None = None
    n_samples: FloatArray | None = None

    def in_blocks(self, block_s: float) -> Series | None:
        """Return the means over `block_s`, s, of rows in which every cell is filled; None where none is."""
        good = np.isfinite(self.rates_deg_per_hr).all(axis=1)
        if not good.any():
            return None
        t_s = self.t_s[good]
        _, where, counts = np.unique(np.floor(t_s / block_s + _EDGE), return_inverse=True, return_counts=True)
        whole = counts > 0.5 * counts.max()  # a few samples at the end of a collect are no block: they join the last
        joined = np.maximum.accumulate(np.where(whole, np.arange(len(whole)), np.argmax(whole)))
        _, where, counts = np.unique(joined[where], return_inverse=True, return_counts=True)

        def means(values: FloatArray) -> FloatArray:
            return np.asarray(np.bincount(where, weights=values[good]) / counts)

        rates = np.stack([means(channel) for channel in self.rates_deg_per_hr.T], axis=1)
        temperature = None if self.temperature_degC is None else means(self.temperature_degC)
        return Series(means(self.t_s), rates, temperature, block_s, counts.astype(np.float64))


TELL_TEMPERATURE = ("setpoint_degC", "temperature_degC", "case_degC", "chamber_degC")
"""Columns that say at what temperature a collect was made, the first that can."""


@dataclass(frozen=True, eq=False)
class Campaign:
    """A campaign folder in memory. `warnings` names suspicious but legal input; every report repeats them.

    `recorded` reads, by its number, what was kept of a collect beside its averages, whoever wrote it; see `series`.
    `verdicts` says how each run was measured, by whoever recorded it, `missing` what was planned and is not there,
    `contradicted` what its records contradict of each other, by run and sensor (hil.campaign.plausibility), and
    `exchanged` by sensor the pairs of collects that have each other's pose by the unit's accelerometers; `not_used` by
    sensor the runs that are in no mean and in no search (`hil.solve.wrong_rows`); `pose` how far these may be from f,
    `largest_se` how large a standard error is accepted, deg/hr (of a sensitivity at 1 g), None for what is usual.
    `identity` holds what is known of `model` and `serial` of the unit, the `operator`, their `note`, and what they went
    on `despite`. Where it is `rebuilt` from printed means, rows that were not printed are copies of others;
    parameters that nobody measured or printed, so that its rates were made without them, are `taken_as_zero`.
    `run_scatter` is by sensor and parameter what a model that is read beside it states to scatter from run to run.
    Two campaigns are the same where they are one object: what was asked of one is remembered by that.
    """

    title: str
    source: str
    sensors: Mapping[int, Collects]
    condition_units: Mapping[str, str] = field(default_factory=dict)
    simulated: bool = False
    site: Mapping[str, float] = field(default_factory=dict)
    centrifuge: bool = False
    warnings: Sequence[str] = ()
    folder: Path | None = None
    notes: str = ""
    recorded: Mapping[int, Callable[[], Series | None]] = field(default_factory=dict)
    series_block_s: float | None = None
    verdicts: Mapping[int, Judgement] = field(default_factory=dict)
    missing: Sequence[str] = ()
    contradicted: Mapping[tuple[int, int], Judgement] = field(default_factory=dict)
    exchanged: Mapping[int, Sequence[tuple[int, int]]] = field(default_factory=dict)
    not_used: Mapping[int, Sequence[int]] = field(default_factory=dict)
    rebuilt: bool = False
    taken_as_zero: Sequence[str] = ()
    identity: Mapping[str, str] = field(default_factory=dict)
    pose: PoseTolerance = field(default_factory=PoseTolerance)
    largest_se: float | None = None
    run_scatter: Mapping[int, Mapping[str, float]] = field(default_factory=dict)

    def series(self, collect: int) -> Series | None:
        """Read the rates within a collect as an export has them: samples as means over `series_block_s`.

        None where only its average was kept. Raises `InputError` where it cannot be read.
        """
        found = self.samples(collect)
        if found is None or found.block_s is not None or self.series_block_s is None:
            return found
        return found.in_blocks(self.series_block_s)

    def samples(self, collect: int) -> Series | None:
        """Read the rates within a collect as finely as they were kept, NaN where rejected; as `series` otherwise."""
        return self.recorded[collect]() if collect in self.recorded else None
