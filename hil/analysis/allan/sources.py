"""Where a series comes from: a night, a campaign folder, a Parquet or CSV table, a plain column file, a NumPy archive.

    read_recording(Path("night-014"), channel="RA", sensor=2)                  # every collect, a stretch each
    read_recording(Path("static.csv"), channel="gx", rate_hz=100.0, unit="rad/s")

Rates become deg/hr. Tables that this project wrote say their unit and their times; others are told.
"""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np

from hil.campaign import Campaign, FloatArray
from hil.errors import InputError, worded
from hil.files.columns import Columns, read_columns
from hil.files.units import RATE, worth
from hil.records.export import open_source
from hil.solve.both_sensors import moving_together
from hil.solve.temperatures import runs_by_temperature
from procedures.quality import longest_run
from procedures.words import choice, counted

_TIMES = ("t_s", "time_s")
_PROJECT_UNIT = "deg/hr"
_GAP = 1.5  # a step longer than this many intervals is a gap
_UNEVEN = 0.05  # more steps than this far from the interval: not sampled evenly
_MOST = 1000
_STUCK = 50
_JUMP = 20.0  # times the usual step from sample to sample
_POSSIBLE_DEG_PER_HR = 1e10  # three million degrees per second


def read_recording(
    source: Path,
    *,
    channel: str | None = None,
    sensor: int | None = None,
    collect: int | None = None,
    rate_hz: float | None = None,
    unit: str | None = None,
) -> Recording:
    """Read one channel of a recorded or imported series.

    `source` is a night's or a campaign's folder (all collects of the channel, or one), or a file. `unit` may carry a
    factor, such as "0.05 deg/s" for counts. Raises `InputError` saying what is missing: channel, rate or unit.
    """
    if source.is_dir():
        return _of_folder(source, channel, sensor, collect)
    if collect is not None:
        raise InputError(f"{source}: --collect is for a night's or a campaign's folder, and this is a file")
    return _of_table(read_columns(source), channel, rate_hz, unit)


def _of_folder(folder: Path, channel: str | None, sensor: int | None, collect: int | None) -> Recording:
    campaign = open_source(folder)
    number, name = _choose_channel(folder, campaign, channel, sensor)
    own = [int(each) for each in campaign.sensors[number].conditions.collect if int(each) in campaign.recorded]
    if not own:
        raise InputError(f"{folder}: no series of sensor {number} was kept")
    if collect is not None and collect not in own:
        raise InputError(f"{folder}: sensor {number} has no series of collect {collect}; there are {choice(own)}")
    place = list(campaign.sensors[number].conditions.sensor.channels).index(name)
    pieces: list[FloatArray] = []
    interval_s = 0.0
    for each in own if collect is None else [collect]:
        if (series := campaign.samples(each)) is not None:
            title = f"{folder}, collect {each}"
            interval_s = interval_s or series.block_s or sampling_interval(title, series.t_s)
            rates = series.rates_deg_per_hr[:, place]
            pieces += cut(title, rates, interval_s, series.t_s)
    which = "all collects" if collect is None else f"collect {collect}"
    together = "collects at different temperatures are taken together"
    several = len(runs_by_temperature(campaign.sensors[number].conditions)) > 1
    notes = (together,) * (collect is None and len(own) > 1 and several)
    notes += tuple(f"{each}; no collect shows it by itself" for each in moving_together(campaign))
    title = f"{folder.name}, {which}, sensor {number}, {name}"
    return Recording(title, pieces, interval_s, simulated=campaign.simulated, notes=notes)


def _choose_channel(folder: Path, campaign: Campaign, channel: str | None, sensor: int | None) -> tuple[int, str]:
    if sensor is not None and sensor not in campaign.sensors:
        raise InputError(f"{folder}: there is no sensor {sensor}; there are {choice(campaign.sensors)}")
    numbers = [sensor] if sensor is not None else list(campaign.sensors)
    every = [(number, name) for number in numbers for name in campaign.sensors[number].conditions.sensor.channels]
    found = [each for each in every if channel in (None, each[1])]
    if len(found) == 1:
        return found[0]
    what = "there is no such channel" if not found else "choose one with --channel and --sensor"
    raise InputError(f"{folder}: {what}; there are {', '.join(f'{name} of sensor {n}' for n, name in every)}")


def _of_table(table: Columns, channel: str | None, rate_hz: float | None, unit: str | None) -> Recording:
    times = next((name for name in _TIMES if name in table.values), None)
    names = [name for name in table.values if name != times]
    rates = [name for name in names if name.endswith("_deg_per_hr")] or names
    if channel is None and len(rates) == 1:
        channel = rates[0]
    if not rates:
        raise InputError(f"{table.path}: it has no column of numbers")
    if channel is None:
        raise InputError(f"{table.path}: choose a column with --channel; there are {', '.join(names)}")
    if channel not in names:
        raise InputError(f"{table.path}: there is no column {channel}; there are {', '.join(names)}")
    title = f"{table.path.name}, {channel}"
    stated = table.units.get(channel) or (_PROJECT_UNIT if channel.endswith("_deg_per_hr") else None)
    factor = _factor(f"{table.path}, column {channel}", unit, stated)
    values = table.values[channel] * factor
    if times is None:
        if rate_hz is None:
            raise InputError(f"{table.path}: it has no column {' or '.join(_TIMES)}; give the sample rate with --rate")
        return Recording(title, cut(title, values, 1.0 / rate_hz), 1.0 / rate_hz, simulated=table.simulated)
    time_s = table.values[times]
    interval_s = sampling_interval(title, time_s)
    if rate_hz is not None and abs(rate_hz * interval_s - 1.0) > 0.01:
        raise InputError(
            f"{table.path}: its times are {interval_s:g} s apart ({1 / interval_s:.6g} Hz), --rate says "
            f"{rate_hz:g} Hz; leave --rate out or correct it"
        )
    return Recording(title, cut(title, values, interval_s, time_s), interval_s, simulated=table.simulated)


def _factor(where: str, given: str | None, stated: str | None) -> float:
    """Return how many deg/hr one unit of the column is."""
    text = given or stated
    if text is None:
        raise InputError(f"{where}: its unit is not stated; give it with --unit, such as deg/s, rad/s or '0.05 deg/s'")
    if given is not None and stated is not None and given != stated:
        raise InputError(f"{where}: the file states {stated}, --unit says {given}; leave --unit out")
    with worded(InputError, f"{where}: "):
        return worth(text, RATE)


class Recording:
    """One channel's rates, deg/hr, in gap-free `stretches`, (n,) each, of samples `interval_s` apart.

    `notes` say what a reader of the result must know: gaps, what was left out, what looks wrong. Raises `InputError`
    where none of the `pieces` is long enough, the rate never changes, or is larger than any rate can be.
    """

    def __init__(
        self,
        name: str,
        pieces: list[FloatArray],
        interval_s: float,
        *,
        simulated: bool = False,
        notes: Sequence[str] = (),
    ) -> None:
        usable = [piece for piece in pieces if len(piece) >= 4]
        if not usable:
            longest = max((len(piece) for piece in pieces), default=0)
            raise InputError(
                f"{name}: the longest stretch without a gap has {counted(longest, 'sample')}; at least 4 are needed"
            )
        said = list(notes)
        if len(pieces) > 1:
            said.append(f"{len(pieces)} stretches without a gap; differences are taken within each, never across a gap")
        if len(usable) > _MOST:
            usable = sorted(usable, key=len, reverse=True)[:_MOST]
            said.append(f"only the {_MOST} longest stretches are used")
        if all(np.ptp(piece) == 0.0 for piece in usable):
            raise InputError(f"{name}: the rate never changes; this is no measurement of noise")
        largest = max(float(np.abs(piece).max()) for piece in usable)
        if largest > _POSSIBLE_DEG_PER_HR:
            raise InputError(f"{name}: rates up to {largest:.3g} deg/hr; is the unit (--unit) or the column right?")
        said += _jumps(usable, interval_s)
        same = max(longest_run(piece) for piece in usable)
        if same >= _STUCK:
            said.append(f"{same} samples in a row are exactly equal: was the stream stuck, or the file padded?")
        self.name, self.interval_s, self.simulated = name, interval_s, simulated
        self.stretches, self.notes = tuple(usable), tuple(said)

    @property
    def samples(self) -> int:
        """How many samples all stretches have together."""
        return sum(len(each) for each in self.stretches)

    @property
    def longest_s(self) -> float:
        """The length of the longest stretch, s."""
        return max(len(each) for each in self.stretches) * self.interval_s


def cut(name: str, values: FloatArray, interval_s: float, time_s: FloatArray | None = None) -> list[FloatArray]:
    """Return the gap-free stretches of a series, shape (n,), cut at missing values and at gaps in `time_s`.

    Raises `InputError` where the times do not rise or the samples are not evenly spaced.
    """
    good = np.isfinite(values)
    broken = ~good[1:] | ~good[:-1]
    if time_s is not None:
        step = np.diff(time_s)
        if np.any(~np.isfinite(step)) or np.any(step <= 0):
            row = int(np.flatnonzero(~(step > 0))[0]) + 2
            raise InputError(f"{name}: sample {row}: times must be filled and rise from row to row")
        uneven = np.abs(step / interval_s - np.round(step / interval_s)) > 0.25
        if np.mean(uneven) > _UNEVEN:
            raise InputError(
                f"{name}: {np.mean(uneven):.0%} of the samples are not a whole number of intervals ({interval_s:g} s) "
                "apart; an Allan deviation needs evenly spaced samples"
            )
        broken |= step > _GAP * interval_s
    pieces = np.split(values, np.flatnonzero(broken) + 1)
    return [piece for piece in pieces if len(piece) and np.all(np.isfinite(piece))]


def sampling_interval(name: str, time_s: FloatArray) -> float:
    """Return the median step of the times (n,), s. Raises `InputError` where there are fewer than three."""
    if len(time_s) < 3:
        raise InputError(f"{name}: {counted(len(time_s), 'sample')}; an Allan deviation needs more")
    return float(np.median(np.diff(time_s)))


def _jumps(pieces: list[FloatArray], interval_s: float) -> list[str]:
    """Name samples that lie far from the one before: the fit takes a spike or a step for noise."""
    steps = np.concatenate([np.abs(np.diff(piece)) for piece in pieces])
    usual = float(np.median(steps))
    far = int(np.count_nonzero(steps > _JUMP * usual)) if usual > 0.0 else 0
    if not far:
        return []
    first_s = (int(np.argmax(steps > _JUMP * usual)) + 1) * interval_s
    said = (
        f"{counted(far, 'step')} from one sample to the next of more than {_JUMP:g} times the usual one (the first "
        f"{first_s:.6g} s into what was used): spikes or steps are no noise, and the fit takes them for it"
    )
    return [said]
