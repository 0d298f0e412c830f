"""A log of rates and accelerations as arrays in the project's units, and in words what was taken for what.

    log = read_log(Path("poses.csv"), Wanted(gyro_scale="0.0076 deg/s", accelerometer_scale="0.122 mg"))
    log.rates_deg_per_hr, log.f_g, log.notes

A column is recognised by its name, its unit by what the name says in brackets or at its end; an option wins over both.
Nothing is guessed: where two columns could be meant, or no unit is stated, the log is refused with the option to give.
Rows that hold no measurement (empty cells, accelerations of exactly zero, times that do not go on) are left out, and
told with their numbers.
"""

import re
from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path

import numpy as np

from drivers.frames.decoder import StreamDecoder
from drivers.frames.description import StreamDescription
from drivers.given_file import RECORDING_MB, read_bytes
from hil.campaign import BoolArray, FloatArray, IntArray, TextArray
from hil.errors import InputError
from hil.files.columns import Columns, read_columns
from hil.files.units import ACCELERATION, FREQUENCY, RATE, TIME, Kind, to_number, worth
from procedures.words import choice, listed, numbered

AXES = ("X", "Y", "Z")
_SPELT = {
    RATE: {"deg_per_hr": "deg/hr", "deg_per_s": "deg/s", "dps": "deg/s", "rad_per_s": "rad/s", "rads": "rad/s"},
    ACCELERATION: {"m_per_s2": "m/s^2", "mps2": "m/s^2", "ms2": "m/s^2", "mg": "mg", "g": "g"},
    TIME: {"s": "s", "ms": "ms", "us": "us", "ns": "ns"},
}
"""Units as names of columns end in them, by what they measure."""
_BRACKETS = re.compile(r"\s*[\[(]([^\])]*)[\])]\s*$")
_NAMED = {
    RATE: re.compile(r"gyr|omega|angular|rate|^[gw]_?[xyz]$"),
    ACCELERATION: re.compile(r"acc|specific_?force|^[af]_?[xyz]$"),
    TIME: re.compile(r"^(t|time|time_?stamp|seconds)$"),
}
_AXIS = re.compile(r"^([xyz])_?(?=acc|gyr)|([xyz])$")
_LABELS = re.compile(r"^(label|position|pose|orientation)$", re.IGNORECASE)
_CELSIUS = ("degC", "°C", "C", "Celsius", "degree_Celsius")
_OPTIONS = {RATE: "--gyro", ACCELERATION: "--accelerometer", TIME: "--time"}
_WORDS = {RATE: "the rates", ACCELERATION: "the accelerations"}
_EXAMPLES = {RATE: "deg/s, rad/s or '0.0076 deg/s'", ACCELERATION: "g, m/s^2 or '0.122 mg'", TIME: "s, ms or '25 us'"}
_STANDS = 0.05  # of the rows: more times than these that do not go on are no clock's
_GAP, _GAP_S = 1.5, 0.1  # intervals, and s: nobody moves a unit in less, and its neighbours would show it
_FEW = 100  # samples, of which no pose could be made


@dataclass(frozen=True)
class Wanted:
    """What a user said of a log, as text; None where the log itself is asked.

    `gyro` and `accelerometer` name three columns each, X, Y, Z, with commas; a scale is the unit of a column, with a
    factor for counts; `rate` is samples per second.
    """

    gyro: str | None = None
    accelerometer: str | None = None
    time: str | None = None
    labels: str | None = None
    gyro_scale: str | None = None
    accelerometer_scale: str | None = None
    time_scale: str | None = None
    rate: str | None = None


@dataclass(frozen=True)
class Log:
    """n samples of a triad, in order: times (n,), rates and accelerations (n, 3), and of each its `row` in the file.

    `temperature_degC` (n,) and `labels` (n,) are None where the log has none. `notes` say what was taken for what, and
    what was left out. `begins`, (n,), is true where a sample does not follow on the one before it.
    """

    path: Path
    row: IntArray
    time_s: FloatArray
    rates_deg_per_hr: FloatArray
    f_g: FloatArray
    temperature_degC: FloatArray | None = None
    labels: TextArray | None = None
    simulated: bool = False
    channels: Sequence[str] = ("GX", "GY", "GZ")
    notes: tuple[str, ...] = ()

    @cached_property
    def interval_s(self) -> float:
        """The usual step from sample to sample."""
        return float(np.median(np.diff(self.time_s)))

    @property
    def begins(self) -> BoolArray:
        """Where a sample does not follow on the one before it, (n,)."""
        return np.asarray(np.diff(self.time_s, prepend=-np.inf) > max(_GAP_S, _GAP * self.interval_s))

    @property
    def values(self) -> FloatArray:
        """Rates, deg/hr, and accelerations, g, of every sample, (n, 6)."""
        return np.hstack([self.rates_deg_per_hr, self.f_g])

    @property
    def names(self) -> tuple[str, ...]:
        """What those six are called."""
        return (*self.channels, *(f"accelerometer {axis}" for axis in AXES))


def read_log(path: Path, wanted: Wanted, frames: StreamDescription | None = None) -> Log:
    """Read a table, or raw bytes by the description `frames`; raise `InputError` saying what is missing."""
    return _cleaned(_of_bytes(path, wanted, frames) if frames is not None else _of_table(read_columns(path), wanted))


def _of_table(table: Columns, wanted: Wanted) -> Log:
    gyro, rates, gyro_unit = _triple(table, RATE, wanted.gyro, wanted.gyro_scale)
    accelerometer, f_g, unit = _triple(table, ACCELERATION, wanted.accelerometer, wanted.accelerometer_scale)
    notes = [
        f"rates: columns {', '.join(gyro)}, in {gyro_unit}",
        f"accelerations: columns {', '.join(accelerometer)}, in {unit}",
    ]
    if wanted.rate is not None:
        time_s = np.arange(len(rates)) / _rate_hz(wanted.rate)
    else:
        names = [wanted.time] if wanted.time else [name for name in table.values if _is_named(name, TIME)]
        if len(names) != 1:
            found = f"columns {listed(names)} could be the time" if names else "no column is called time"
            raise InputError(f"{table.path}: {found}; give --time COLUMN, or --rate '100 Hz' where there is none")
        values, unit = _in_unit(table, names, TIME, wanted.time_scale)
        time_s = values[:, 0]
        notes.append(f"times: column {names[0]}, in {unit}")
    thermometers = [name for name in table.values if re.search("temp", name, re.I) and _unit(table, name) in _CELSIUS]
    labels = [name for name in {**table.texts, **table.values} if name == wanted.labels or _LABELS.match(name)]
    if wanted.labels is not None and wanted.labels not in labels:
        raise InputError(f"{table.path}: --labels: there is no column {wanted.labels}")
    notes += [f"temperatures: column {name}" for name in thermometers[:1]]
    notes += [f"labels of positions: column {name}" for name in labels[:1]]
    return Log(
        table.path,
        np.arange(len(rates)) + 2,
        time_s,
        rates,
        f_g,
        table.values[thermometers[0]] if thermometers else None,
        _as_labels(table, wanted.labels or labels[0]) if labels else None,
        table.simulated,
        notes=tuple(notes),
    )


def _of_bytes(path: Path, wanted: Wanted, frames: StreamDescription) -> Log:
    roles = [role for role in (frames.roles.sensors.values() if frames.roles else ()) if len(role.rates) == len(AXES)]
    if frames.roles is None or len(roles) != 1 or set(roles[0].accelerations) != set(AXES):
        raise InputError(f"{frames.name}: roles: a log needs one sensor of three rates and accelerations X, Y, Z")
    role, decoder = roles[0], StreamDecoder(frames)
    fed, rest = decoder.feed(read_bytes(path, RECORDING_MB)), decoder.finish()
    parts = [each.frames[frames.roles.frame] for each in (fed, rest) if len(each.frames.get(frames.roles.frame, ()))]
    if not parts:
        raise InputError(f"{path}: {frames.name} finds no {frames.roles.frame} frame in it; hil frames guess looks")
    fields = {name: np.concatenate([part.column(name) for part in parts]) for name in parts[0].columns}
    sequence = np.concatenate([part.sequence for part in parts])
    rate_hz = frames.sample_rate_hz if wanted.rate is None else _rate_hz(wanted.rate)
    channels = sorted(role.rates, key=lambda name: name[-1])  # GX, GY, GZ, as descriptions of triads call them
    counts = fed.counts + rest.counts
    return Log(
        path,
        sequence,
        sequence / rate_hz,
        np.column_stack([fields[role.rates[name]] for name in channels]),
        np.column_stack([fields[role.accelerations[axis]] for axis in AXES]),
        None if role.temperature is None else fields[role.temperature],
        channels=channels,
        notes=(f"{frames.name}: {len(sequence)} samples, {counts.lost} lost, {rate_hz:g} per second",),
    )


def _triple(table: Columns, kind: Kind, given: str | None, scale: str | None) -> tuple[list[str], FloatArray, str]:
    """Return the three columns of a kind, X, Y, Z, their values (n, 3) in its unit, and the unit they have."""
    option = _OPTIONS[kind]
    if given is not None:
        names = [name.strip() for name in given.split(",")]
        if len(names) != len(AXES):
            raise InputError(f"{option} {given}: name three columns, those of X, Y and Z, with commas")
    else:
        every = [name for name in {**table.values, **table.texts} if _is_named(name, kind)]
        found = {axis: [name for name in every if _axis(name, kind) == axis] for axis in AXES}
        if any(len(each) != 1 for each in found.values()):
            by_name = ", ".join(every) or "none"
            raise InputError(
                f"{table.path}: which columns hold {_WORDS[kind]} is not clear (by their names: {by_name}); give those "
                f"of X, Y and Z as {option} A,B,C; there are {choice(table.values)}"
            )
        names = [found[axis][0] for axis in AXES]
    values, unit = _in_unit(table, names, kind, scale)
    return names, values, unit


def _in_unit(table: Columns, names: Sequence[str], kind: Kind, scale: str | None) -> tuple[FloatArray, str]:
    """Return columns, (n, k), in the unit of their kind, and the unit that they have; refuse where none is stated."""
    option = f"{_OPTIONS[kind]}-scale"
    for name in names:
        if name in table.texts:
            row = int(np.flatnonzero([not _is_number(cell) for cell in table.texts[name]])[0])
            raise InputError(f"{table.path}, row {row + 2}, column {name}: {table.texts[name][row]!r} is no number")
        if name not in table.values:
            raise InputError(f"{table.path}: there is no column {name}; there are {choice(table.values)}")
    stated = {_unit(table, name, kind) for name in names}
    text = scale or (stated.pop() if len(stated) == 1 else "")
    if not text:
        raise InputError(
            f"{table.path}, columns {', '.join(names)}: what one of them means is not stated (or not the same of all); "
            f"give {option}, such as {_EXAMPLES[kind]}"
        )
    try:
        factor = worth(text, kind)
    except ValueError as error:
        raise InputError(
            f"{table.path}, column {names[0]}: {error}; or give {option}, such as {_EXAMPLES[kind]}"
        ) from None
    if factor == 0.0:
        raise InputError(f"{option} {text}: it must not be zero")
    return np.column_stack([table.values[name] for name in names]) * factor, text


def _split(name: str, kind: Kind | None = None) -> tuple[str, str]:
    """Return a column's name without its unit, in small letters, and the unit as it is stated, or nothing."""
    bracket = _BRACKETS.search(name)
    if bracket is not None:
        return name[: bracket.start()].strip().lower(), bracket[1].strip()
    for spelt, unit in sorted(_SPELT.get(kind, {}).items(), key=lambda each: -len(each[0])) if kind else ():
        if name.lower().endswith(f"_{spelt}"):
            return name[: -len(spelt) - 1].strip().lower(), unit
    return name.strip().lower(), ""


def _unit(table: Columns, name: str, kind: Kind | None = None) -> str:
    """Return the unit of a column as its file states it, in names as they are usually shortened."""
    stated = table.units.get(name) or _split(name, kind)[1] or ("degC" if name.endswith("_degC") else "")
    return _SPELT.get(kind, {}).get(stated, stated) if kind else stated


def _is_named(name: str, kind: Kind) -> bool:
    bare = _split(name, kind)[0]
    return bool(_NAMED[kind].search(bare)) and (kind is TIME or _axis(name, kind) is not None)


def _axis(name: str, kind: Kind) -> str | None:
    found = _AXIS.search(_split(name, kind)[0])
    return (found[1] or found[2]).upper() if found else None


def _as_labels(table: Columns, name: str) -> TextArray:
    """Return a column as labels; numbers as people write them."""
    words = table.texts.get(name)
    return np.array([f"{each:g}" for each in table.values[name]]) if words is None else words


def _rate_hz(text: str) -> float:
    try:
        rate_hz = to_number(f"{text} Hz" if _is_number(text) else text, FREQUENCY)
    except ValueError as error:
        raise InputError(f"--rate: {error}") from None
    if rate_hz <= 0.0:
        raise InputError("--rate: the sample rate must be more than 0 Hz")
    return rate_hz


def _cleaned(log: Log) -> Log:
    """Leave out the rows that hold no measurement, and say which."""
    n, at_s = len(log.row), log.time_s
    values = np.column_stack([at_s, log.values])
    empty = ~np.isfinite(values).all(axis=1)
    nothing = ~empty & np.all(log.f_g == 0.0, axis=1)
    latest = np.maximum.accumulate(np.where(empty | nothing, -np.inf, at_s))
    stands = ~empty & ~nothing & (at_s <= np.concatenate([[-np.inf], latest[:-1]]))
    said = [
        f"{numbered('row', log.row[rows].tolist(), to='-')} left out: {what}"
        for rows, what in (
            (empty, "a cell is empty, or no number"),
            (nothing, "accelerations of exactly zero, which no unit at rest shows"),
            (stands, "the time is not later than in a row before"),
        )
        if rows.any()
    ]
    if stands.sum() > _STANDS * n:
        raise InputError(
            f"{log.path}: in {stands.sum()} of {n} rows the time is not later than before (the first is row "
            f"{log.row[stands][0]}): no clock of samples; --rate '100 Hz' counts samples instead"
        )
    keep = ~(empty | nothing | stands)
    if keep.sum() < _FEW:
        raise InputError(f"{log.path}: {keep.sum()} rows hold a measurement; {'; '.join(said) or 'a log has many'}")
    still = [name for name, column in zip(log.names, log.values[keep].T, strict=True) if not np.ptp(column)]
    if still:
        raise InputError(f"{log.path}: {listed(still)}: never changes, so it is not measured, or is the wrong column")
    kept = replace(
        log,
        row=log.row[keep],
        time_s=at_s[keep] - at_s[keep][0],
        rates_deg_per_hr=log.rates_deg_per_hr[keep],
        f_g=log.f_g[keep],
        temperature_degC=None if log.temperature_degC is None else log.temperature_degC[keep],
        labels=None if log.labels is None else log.labels[keep],
    )
    gaps = np.flatnonzero(kept.begins)[1:]
    if len(gaps):
        step_s = kept.time_s[gaps[0]] - kept.time_s[gaps[0] - 1]
        what = f"no stretch goes over one of {len(gaps)} gaps in time (the first, {step_s:.3g} s, before row"
        said.append(f"{what} {kept.row[gaps[0]]})")
    return replace(kept, notes=(*log.notes, *said))


def _is_number(text: str) -> bool:
    try:
        float(text)
    except ValueError:
        return False
    return True
