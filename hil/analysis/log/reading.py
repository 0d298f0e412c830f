"""A log of rates and accelerations as arrays in the project's units, and in words what was taken for what.

    log = read_log(read_columns(Path("poses.csv")), scales={RATE: "0.0076 deg/s", ACCELERATION: "0.122 mg"})
    log.rates_deg_per_hr, log.f_g, log.notes

A column is recognised by its name, its unit by what the name says in brackets or at its end; an option wins over both.
Nothing is guessed: where two columns could be meant, or no unit is stated, the log is refused with the option to give.
Rows that hold no measurement (empty cells, accelerations of exactly zero, times that do not go on) are left out, and
told with their numbers.
"""

import re
from collections.abc import Mapping
from dataclasses import dataclass, fields, replace
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np

from drivers.frames.decoder import StreamDecoder
from drivers.frames.description import StreamDescription
from drivers.given_file import RECORDING_MB, read_bytes
from hil.campaign import BoolArray, FloatArray, IntArray, TextArray
from hil.errors import InputError, worded
from hil.files.columns import Columns, is_number
from hil.files.units import ACCELERATION, RATE, TIME, Kind, worth
from procedures.words import choice, counted, listed, plural, ranges

AXES = ("X", "Y", "Z")
CHANNELS = ("GX", "GY", "GZ")
NAMES = (*CHANNELS, *(f"accelerometer {axis}" for axis in AXES))
"""What the six columns of `Log.values` are called."""

_SPELT = {"deg_per_hr": "deg/hr", "deg_per_s": "deg/s", "dps": "deg/s", "rad_per_s": "rad/s", "rads": "rad/s"}
_SPELT |= {"m_per_s2": "m/s^2", "mps2": "m/s^2", "ms2": "m/s^2"}
_UNIT = re.compile(rf"\s*[\[(](.*)[\])]\s*$|_({'|'.join(_SPELT)}|mg|g|ms|us|ns|s|degC)$")
_AXIS = re.compile(r"^([xyz])_?(?=acc|gyr)|([xyz])$")
_TEMPERATURE = re.compile(r"temp.*(degC|°C|C|Celsius)\W*$", re.IGNORECASE)
_LABEL = re.compile(r"^(label|position|pose|orientation)$", re.IGNORECASE)
_STANDS = 0.05  # of the rows: more times than these that do not go on are no clock's
_GAP, _GAP_S = 1.5, 0.1  # intervals, and s: nobody moves a unit in less, and its neighbours would show it
_FEW = 100  # samples, of which no pose could be made


@dataclass(frozen=True)
class _Sought:
    """What is looked for: its name in words and as an option, how columns are called, how many, and units they have."""

    words: str
    option: str
    names: re.Pattern[str]
    axes: tuple[str, ...]
    units: str


_SOUGHT = {
    RATE: _Sought(
        "rates", "--gyro", re.compile(r"gyr|omega|angular|rate|^[gw]_?[xyz]$"), AXES, "deg/s, rad/s or '0.0076 deg/s'"
    ),
    ACCELERATION: _Sought(
        "accelerations", "--accelerometer", re.compile(r"acc|^[af]_?[xyz]$"), AXES, "g, m/s^2 or '0.122 mg'"
    ),
    TIME: _Sought("times", "--time", re.compile(r"^(t|time|time_?stamp|seconds)$"), ("",), "s, ms or '25 us'"),
}


@dataclass(frozen=True)
class Log:
    """n samples of a triad, in order: times (n,), rates and accelerations (n, 3), and of each its `row` in the file.

    `temperature_degC` (n,) and `labels` (n,) are None where the log has none. `notes` say what was taken for what, and
    what was left out.
    """

    path: Path
    row: IntArray
    time_s: FloatArray
    rates_deg_per_hr: FloatArray
    f_g: FloatArray
    temperature_degC: FloatArray | None
    labels: TextArray | None
    simulated: bool
    notes: tuple[str, ...]

    @cached_property
    def interval_s(self) -> float:
        """The usual step from sample to sample."""
        return float(np.median(np.diff(self.time_s)))

    @property
    def begins(self) -> BoolArray:
        """Where a sample does not follow on the one before it, (n,)."""
        return np.asarray(np.diff(self.time_s, prepend=-np.inf) > max(_GAP_S, _GAP * self.interval_s))

    @cached_property
    def values(self) -> FloatArray:
        """Rates, deg/hr, and accelerations, g, of every sample, (n, 6)."""
        return np.hstack([self.rates_deg_per_hr, self.f_g])

    def rows(self, index: BoolArray) -> "Log":
        """Return the samples where `index`, (n,), is true."""
        own = {each.name: getattr(self, each.name) for each in fields(self)}
        chosen: dict[str, Any] = {name: each[index] for name, each in own.items() if isinstance(each, np.ndarray)}
        return replace(self, **chosen)


def read_log(
    table: Columns,
    columns: Mapping[Kind, str] | None = None,
    scales: Mapping[Kind, str] | None = None,
    *,
    labels: str | None = None,
    rate_hz: float | None = None,
) -> Log:
    """Return the log that a table holds; raise `InputError` saying what is missing.

    `columns` names those of the rates, accelerations (X, Y, Z, with commas) and times, `scales` their units, with a
    factor for counts, where the table itself is not to be asked; with `rate_hz` samples are counted instead of times.
    """
    found = {
        kind: _in_unit(table, kind, _names(table, kind, (columns or {}).get(kind)), (scales or {}).get(kind))
        for kind in (_SOUGHT if rate_hz is None else (RATE, ACCELERATION))
    }
    notes = [words for _, words in found.values()]
    thermometer = next((name for name in table.values if _TEMPERATURE.search(name)), None)
    every = {**table.texts, **table.values}
    label = labels or next((name for name in every if _LABEL.match(name)), None)
    if label is not None and label not in every:
        raise InputError(f"{table.path}: --labels: there is no column {label}; there are {choice(every)}")
    notes += [f"temperatures: column {name}" for name in (thermometer,) if name]
    notes += [f"labels of positions: column {name}" for name in (label,) if name]
    rows = np.arange(len(found[RATE][0]))
    numbers = None if label in table.texts or label is None else [f"{each:g}" for each in table.values[label]]
    return _measured(
        Log(
            table.path,
            rows + 2,
            found[TIME][0][:, 0] if rate_hz is None else rows / rate_hz,
            found[RATE][0],
            found[ACCELERATION][0],
            table.values[thermometer] if thermometer else None,
            np.array(numbers) if numbers else table.texts[label] if label else None,
            table.simulated,
            tuple(notes),
        )
    )


def columns_of_bytes(path: Path, frames: StreamDescription, rate_hz: float | None = None) -> Columns:
    """Decode a file of raw bytes into a log's columns; raise `InputError` where there is no triad, or no frame of it.

    Frames that were lost, by the counter, are a gap in time; `rate_hz` stands for the description's rate.
    """
    roles = [role for role in (frames.roles.sensors.values() if frames.roles else ()) if len(role.rates) == len(AXES)]
    if frames.roles is None or len(roles) != 1 or set(roles[0].accelerations) != set(AXES):
        raise InputError(f"{frames.name}: roles: a log needs one sensor of three rates and accelerations X, Y, Z")
    role, frame, decoder = roles[0], frames.roles.frame, StreamDecoder(frames)
    fed = (decoder.feed(read_bytes(path, RECORDING_MB)), decoder.finish())
    parts = [each.frames[frame] for each in fed if len(each.frames.get(frame, ()))]
    if not parts:
        raise InputError(f"{path}: {frames.name} finds no {frame} frame in it; hil frames guess looks what it may be")
    channels = sorted(role.rates, key=lambda name: name[-1])  # GX, GY, GZ, as descriptions of triads call them
    fields = {f"g{axis}_deg_per_hr": role.rates[name] for axis, name in zip("xyz", channels, strict=True)}
    fields |= {f"a{axis.lower()}_g": field for axis, field in role.accelerations.items()}
    fields |= {"temperature_degC": role.temperature} if role.temperature else {}
    values = {name: np.concatenate([part.column(field) for part in parts]) for name, field in fields.items()}
    sequence = np.concatenate([part.sequence for part in parts])
    return Columns(path, {**values, "t_s": sequence / (rate_hz or frames.sample_rate_hz)})


def _names(table: Columns, kind: Kind, given: str | None) -> list[str]:
    sought = _SOUGHT[kind]
    if given is not None:
        names = [name.strip() for name in given.split(",")]
        if len(names) != len(sought.axes):
            raise InputError(f"{sought.option} {given}: {len(sought.axes)} columns are needed, with commas between")
        return names
    bare = {name: _UNIT.sub("", name).strip().lower() for name in {**table.values, **table.texts}}
    found = {name: _AXIS.search(of) for name, of in bare.items() if sought.names.search(of)}
    axes = {name: (axis[1] or axis[2]).upper() if axis else "" for name, axis in found.items()}
    names = sorted((name for name in axes if axes[name] or kind is TIME), key=lambda name: axes[name])
    if tuple(axes[name] for name in names) != sought.axes:
        options = f"{sought.option} COLUMN, or --rate '100 Hz' to count samples" if kind is TIME else sought.option
        raise InputError(
            f"{table.path}: which columns hold the {sought.words} is not clear (by their names: "
            f"{', '.join(names) or 'none'}); give {options}{' X,Y,Z' * (kind is not TIME)}; there are "
            f"{choice([*table.values, *table.texts])}"
        )
    return names


def _in_unit(table: Columns, kind: Kind, names: list[str], scale: str | None) -> tuple[FloatArray, str]:
    """Return columns, (n, k), in the unit of their kind, and in words what was taken; refuse where none is stated."""
    sought = _SOUGHT[kind]
    where, instead = f"{table.path}, columns {', '.join(names)}", f"give {sought.option}-scale, such as {sought.units}"
    for name in names:
        if name in table.texts:
            cells = enumerate(table.texts[name].tolist(), start=2)
            row, text = next((i, cell) for i, cell in cells if not is_number(cell))
            raise InputError(f"{table.path}, row {row}, column {name}: {text!r} is no number")
        if name not in table.values:
            raise InputError(f"{table.path}: there is no column {name}; there are {choice(table.values)}")
    stated = {table.units.get(name) or _unit(name) for name in names}
    text = scale or (stated.pop() if len(stated) == 1 else "")
    if not text:
        raise InputError(f"{where}: what one of them means is not stated, or not the same of all; {instead}")
    with worded(InputError, f"{where}: ", end=f"; {instead}"):
        factor = worth(text, kind)
    if factor == 0.0:
        raise InputError(f"{where}: a unit of {text} is nothing; {instead}")
    words = f"{sought.words}: column{'s' * (len(names) > 1)} {', '.join(names)}, in {text}"
    return np.column_stack([table.values[name] for name in names]) * factor, words


def _unit(name: str) -> str:
    found = _UNIT.search(name)
    return "" if found is None else (found[1] or _SPELT.get(found[2], found[2])).strip()


def _measured(log: Log) -> Log:
    """Leave out the rows that hold no measurement, and say which; refuse a log that holds none."""
    empty = ~np.isfinite(np.column_stack([log.time_s, log.values])).all(axis=1)
    nothing = ~empty & np.all(log.f_g == 0.0, axis=1)
    latest = np.maximum.accumulate(np.where(empty | nothing, -np.inf, log.time_s))
    stands = ~empty & ~nothing & (log.time_s <= np.concatenate([[-np.inf], latest[:-1]]))
    said = []
    for rows, what in (
        (empty, "a cell is empty, or no number"),
        (nothing, "accelerations of exactly zero, which no unit at rest shows"),
        (stands, "the time is not later than in a row before"),
    ):
        if rows.any():
            which = choice(ranges(set(log.row[rows].tolist()), "-").split(", "))
            said.append(f"{plural('row', rows.sum())} {which} left out: {what}")
    if stands.sum() > _STANDS * len(log.row):
        raise InputError(
            f"{log.path}: in {stands.sum()} of {len(log.row)} rows the time is not later than before (the first is "
            f"row {log.row[stands][0]}): no clock of samples; --rate '100 Hz' counts samples instead"
        )
    kept = log.rows(~(empty | nothing | stands))
    if len(kept.row) < _FEW:
        raise InputError(
            f"{log.path}: {counted(len(kept.row), 'row')} of measurements; {'; '.join(said) or 'a log has many'}"
        )
    still = [name for name, column in zip(NAMES, kept.values.T, strict=True) if not np.ptp(column)]
    if still:
        raise InputError(f"{log.path}: {listed(still)}: never changes, so it is not measured, or is the wrong column")
    for gap in np.flatnonzero(kept.begins)[1:2]:
        step_s, number = kept.time_s[gap] - kept.time_s[gap - 1], int(np.count_nonzero(kept.begins)) - 1
        first = f"the first, {step_s:.3g} s, before row {kept.row[gap]}"
        said.append(f"no stretch goes over {counted(number, 'gap')} in time ({first})")
    return replace(kept, time_s=kept.time_s - kept.time_s[0], notes=(*log.notes, *said))
