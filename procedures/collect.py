"""A collect: the units stand still at one position, are sampled at once, and each one's samples averaged and judged.

`reduce_collect` is pure: samples in, data and judgement out, so that raw bytes decoded again give the same result.
`take_collects` drives the bench through `Watch`.
"""

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from drivers.chambers import ChamberReading
from drivers.frames.counts import StreamCounts
from drivers.frames.roles import SensorRole
from drivers.imu import SampleBlock
from drivers.imu.samples import FloatArray, finite_mean, means, rate_fields
from drivers.imu.stream import StreamImu
from procedures.averaging import Average, average_series
from procedures.devices import BenchDevices
from procedures.journal_protocol import Outcome, StepResult
from procedures.quality import longest_run, missing_in_gaps, moved, not_measured, same_samples, slope_per_min
from procedures.settings import CollectSettings
from procedures.verdict import Judgement, Verdict, combine
from procedures.watch import UNSEEN_S, Watch
from procedures.words import counted

_INDEX_FIELD = "index_position"  # where a unit that indexes says in every frame where it stands
_EDGE_SAMPLES = 2  # a collect's ends may each cut one sample off
_RATE_TOLERANCE = 0.005  # of the nominal sample rate
_WORTH_AVERAGING = 3
_LEAST_BATCHES = 3  # polls whose means scatter enough to say something about the running mean
_SHORT_LOSS = 0.002  # of the samples: more than this is worth a remark


def join(blocks: Iterable[SampleBlock]) -> SampleBlock:
    """Return consecutive blocks as one; fields that a block lacks are NaN there."""
    blocks = list(blocks)
    filled = [block for block in blocks if len(block)]
    names = list(dict.fromkeys(name for block in filled for name in block.fields))
    fields = {name: np.concatenate([_column(block, name) for block in filled]) for name in names}
    return SampleBlock(
        time_s=np.concatenate([block.time_s for block in filled]) if filled else np.empty(0),
        fields=fields,
        counts=sum((block.counts for block in blocks), StreamCounts()),
        raw=b"".join(block.raw for block in blocks),
        arrival_s=blocks[-1].arrival_s if blocks else 0.0,
    )


def _column(block: SampleBlock, name: str) -> FloatArray:
    return block.fields[name] if name in block.fields else np.full(len(block), np.nan)


# Reduction


def reduce_collect(
    samples: SampleBlock, duration_s: float, imu: StreamImu, settings: CollectSettings
) -> tuple[dict[str, Any], Judgement]:
    """Return data and judgement of a collect's samples; those with a rate that is no finite number are missing."""
    names = [name for channels in imu.sensors.values() for name in channels.rates.values()]
    rates = np.column_stack([_column(samples, name) for name in names])
    good = np.isfinite(rates).all(axis=1)
    fields = {name: values[good] for name, values in samples.fields.items()}
    average = average_series(samples.time_s[good], rates[good])
    kept = _Kept(SampleBlock(samples.time_s[good], fields), imu, settings, average, names)
    n, expected = len(kept.samples), round(duration_s * imu.sample_rate_hz)
    # By the unit's own counter, by gaps in time, and by their number.
    gaps, short = missing_in_gaps(samples.time_s, imu.sample_rate_hz), expected - n if _differs(n, expected) else 0
    missing = max(samples.counts.lost, gaps, short, len(samples) - n)
    data: dict[str, Any] = {
        "duration_s": duration_s,
        "n_samples": n,
        "n_expected": expected,
        "n_missing": missing,
        "sensors": {str(number): kept.sensor(channels) for number, channels in imu.sensors.items()},
        "conditions": kept.means(imu.conditions),
        "counts": dict(vars(samples.counts)),
    }
    judgements = [*_enough(samples, n, expected, missing, imu.sample_rate_hz, settings), *kept.judge()]
    if duration_s > settings.duration_s + UNSEEN_S:
        said = f"it lasted {duration_s:.0f} s instead of {settings.duration_s:.0f}: nobody looked meanwhile"
        judgements.append(Judgement(Verdict.INCONCLUSIVE, said))
    return data, combine(judgements, passed="complete, stationary, no drift that matters")


def _differs(n: int, expected: int) -> bool:
    return abs(expected - n) > max(_EDGE_SAMPLES, _RATE_TOLERANCE * expected)


def _enough(
    samples: SampleBlock, n: int, expected: int, missing: int, sample_rate_hz: float, settings: CollectSettings
) -> Iterable[Judgement]:
    """Judge the number of samples: spread from end to end they show another rate; else few are a stream that ended."""
    fraction = max(1.0 - missing / expected, 0.0) if expected else 0.0
    counts = samples.counts
    bad = counts.bad_checksum + counts.bad_delimiter
    sends_hz = len(samples) / expected * sample_rate_hz if expected else 0.0
    gaps = bad or counts.lost or missing_in_gaps(samples.time_s, sends_hz)
    few_or_many = not settings.minimum_fraction <= n / max(expected, 1) <= 1.0 / settings.minimum_fraction
    as_described = n > 0 and not _differs(n, 1 + round(sample_rate_hz * float(np.ptp(samples.time_s))))
    even = n == len(samples) > _WORTH_AVERAGING and not gaps and not (few_or_many and as_described)
    if _differs(n, expected) and (n > expected or even):
        yield Judgement(
            Verdict.INCONCLUSIVE if few_or_many else Verdict.MARGINAL,
            f"{n} of {expected} expected samples: the unit sends at {sends_hz:.4g} Hz, the description says "
            f"{sample_rate_hz:g}; write its rate under imu.rate",
        )
    elif n < _WORTH_AVERAGING or fraction < settings.minimum_fraction:
        yield Judgement(
            Verdict.INCONCLUSIVE,
            f"{missing} of {expected} samples are missing ({bad} frames damaged, {counts.lost} lost); "
            f"at least {settings.minimum_fraction:.0%} are needed",
        )
    elif missing > _SHORT_LOSS * expected:
        yield Judgement(Verdict.MARGINAL, f"{missing} of {expected} samples are missing")
    if counts.duplicate > _SHORT_LOSS * expected:
        twice = f"{counted(counts.duplicate, 'frame')} that came twice, by the counter, counted once"
        yield Judgement(Verdict.MARGINAL, f"{twice}: the unit or its line repeats")


@dataclass(frozen=True)
class _Kept:
    """The good samples of a collect, reduced sensor by sensor. `rates` names the rates in the order of `average`."""

    samples: SampleBlock
    imu: StreamImu
    settings: CollectSettings
    average: Average
    rates: Sequence[str]

    def sensor(self, channels: SensorRole) -> dict[str, Any]:
        temperature, slope = channels.temperature, None
        if temperature is not None:
            slope = slope_per_min(self.samples.time_s, _column(self.samples, temperature))
        return {
            "rates": {channel: self._rate(self.rates.index(name)) for channel, name in channels.rates.items()},
            "accelerations": self.means(channels.accelerations),
            "temperature_degC": self._mean(temperature),
            "dTdt_degC_per_min": slope,
            "conditions": self.means(channels.conditions),
        }

    def means(self, fields: Mapping[str, str]) -> dict[str, float | None]:
        return {what: self._mean(name) for what, name in fields.items()}

    def _mean(self, name: str | None) -> float | None:
        mean, n = finite_mean(_column(self.samples, name)) if name is not None else (0.0, 0)
        return mean if n else None

    def _rate(self, i: int) -> dict[str, float | None]:
        """Return one channel's average, as JSON can hold it (None where not known)."""
        average = self.average
        values = {
            "mean_deg_per_hr": average.mean[i],
            "se_deg_per_hr": average.se[i],
            "drift_deg_per_hr_per_min": 60.0 * average.slope_per_s[i],
            "drift_se_deg_per_hr_per_min": 60.0 * average.slope_se_per_s[i],
            "half_difference_deg_per_hr": average.half_difference[i],
            "half_difference_se_deg_per_hr": average.half_difference_se[i],
            "sd_deg_per_hr": average.sd[i],
            "se_inflation": average.inflation[i],
        }
        return {name: float(value) if np.isfinite(value) else None for name, value in values.items()}

    def judge(self) -> Iterable[Judgement]:
        samples, rate_hz, limit_g = self.samples, self.imu.sample_rate_hz, self.settings.motion_limit_g
        if _INDEX_FIELD in samples.fields and longest_run(samples.fields[_INDEX_FIELD]) < len(samples):
            yield Judgement(Verdict.FAIL, "the unit left its index position during the collect")
        sensors = self.imu.sensors.items()
        rates = {f"sensor {n} {channel}": name for n, each in sensors for channel, name in each.rates.items()}
        for one, other in same_samples({where: _column(samples, name) for where, name in rates.items()}):
            yield Judgement(Verdict.FAIL, f"{one} and {other} show the very same samples: one of them is not measured")
        for number, channels in sensors:
            if channels.accelerations:
                table = np.column_stack([_column(samples, name) for name in channels.accelerations.values()])
                largest_g, too_much = moved(table[np.isfinite(table).all(axis=1)], rate_hz, limit_g)
                if too_much:
                    said = f"sensor {number} moved: {largest_g:.4f} g, {limit_g:.4f} g is allowed"
                    yield Judgement(Verdict.FAIL, said)
            for channel, name in channels.rates.items():
                where = f"sensor {number} {channel}"
                found = not_measured(_column(samples, name), self.settings.frozen_s * rate_hz)
                if found is not None:
                    yield Judgement(found.verdict, f"{where} {found.reason}")
                yield from self._drift(where, self.rates.index(name))

    def _drift(self, where: str, i: int) -> Iterable[Judgement]:
        """Judge a channel's slope: it must be significant before its size counts. Half the limit is worth a look."""
        slope, se = 60.0 * self.average.slope_per_s[i], 60.0 * self.average.slope_se_per_s[i]
        if not np.isfinite(slope + se) or abs(slope) < self.settings.drift_sigmas * se:
            return
        limit = self.settings.drift_limit_deg_per_hr_per_min
        text = f"{where} drifts by {slope:+.2f} ± {se:.2f} deg/hr per minute, the limit is {limit:g}"
        if abs(slope) > 0.5 * limit:
            yield Judgement(Verdict.FAIL if abs(slope) > limit else Verdict.MARGINAL, text)


# On the bench


@dataclass
class Times:
    """When, in campaign seconds, what the collect's conditions count from took place; None where not known."""

    power_on_s: float | None
    setpoint_s: float | None = None
    index_s: float | None = None


def take_collects(
    watch: Watch,
    units: Mapping[str, BenchDevices],
    settings: CollectSettings,
    position: str,
    times: Times,
    soaked: Mapping[str, Sequence[Judgement]],
) -> Mapping[str, StepResult]:
    """Settle, sample and reduce a collect of each of `units`, at once, at the position where they stand.

    FAILED, with its samples, where it gives no usable mean. A unit that is set aside meanwhile is missing in it; of one
    that does not lie as it should, by its accelerations at the end of settling, no sample is taken. A position that is
    not confirmed before and after, or that accelerations over the collect contradict, is a FAIL. A verdict is never
    better than that of the soak before (`soaked`, by unit); `samples_verdict` is the collect's own. Raises as a poll.
    """
    before = {name: devices.positioner.position() for name, devices in units.items()}
    taken, watch.note = dict[str, StepResult](), "settling"
    if settings.settle_s > 0.0:
        last = _settled(watch, units, settings.settle_s)
        found = {name: _pose(devices, position, last[name]) for name, devices in units.items() if name in last}
        fail = Verdict.FAIL.value
        taken.update(
            (name, StepResult(Outcome.FAILED, lies, {"verdict": fail, "wrong_pose": lies}))
            for name, lies in found.items()
            if lies
        )
        units = {name: units[name] for name in found if name not in taken}
    if not units:
        return taken
    watch.note = "sampling"
    watch.forget_stream(units)
    start_s = watch.now_s
    blocks, readings, end_s = _sample(watch, units, start_s + settings.duration_s)
    offset_s = (started_s := watch.campaign_s(start_s)) - start_s
    of_all = {
        "position": position,
        "start_s": started_s,
        "chamber_degC": float(np.mean([each.temperature_degC for each in readings])) if readings else None,
        "setpoint_degC": readings[-1].setpoint_degC if readings else watch.commanded_degC,
        **{f"time_since_{what}": None if s is None else started_s - s for what, s in vars(times).items()},
    }
    for name, devices in units.items():
        if name not in watch.units:
            continue
        samples = join(blocks[name])
        # Before the reduction: what is averaged is what is recorded, so that it can be computed again to the digit.
        samples = replace(samples, time_s=samples.time_s + offset_s, arrival_s=samples.arrival_s + offset_s)
        data, judgement = reduce_collect(samples, end_s - start_s, devices.imu, settings)
        after, lies = devices.positioner.position(), _pose(devices, position, samples)
        contradicted = [Judgement(Verdict.FAIL, lies)] if lies else []
        own = combine([*contradicted, judgement, *_confirmed(position, before[name], after)], passed=judgement.reason)
        whole = combine([own, *soaked[name]], passed=own.reason)
        data |= {**of_all, "verdict": whole.verdict.value, "reason": whole.reason, "samples_verdict": own.verdict.value}
        outcome = Outcome.DONE if data["n_samples"] >= _WORTH_AVERAGING else Outcome.FAILED
        taken[name] = StepResult(outcome, whole.reason, data, samples)
    return taken


def _settled(watch: Watch, units: Mapping[str, BenchDevices], seconds: float) -> Mapping[str, SampleBlock]:
    """Wait, and return of each unit what came last: a second of it, or what the last poll brought of that."""
    *_, looks = watch.wait(watch.now_s + seconds)
    newest = {}
    for name in units.keys() & looks.keys():
        block, last = looks[name].block, slice(-max(round(units[name].imu.sample_rate_hz), 1), None)
        fields = {field: values[last] for field, values in block.fields.items()}
        newest[name] = replace(block, time_s=block.time_s[last], fields=fields)
    return newest


def _pose(devices: BenchDevices, position: str, samples: SampleBlock) -> str:
    if devices.poses is None or not len(samples):
        return ""
    return devices.poses.contradiction(position, shown_g(devices.imu, samples))


def shown_g(imu: StreamImu, samples: SampleBlock) -> Mapping[int, Mapping[str, float]]:
    """Return the mean accelerations of samples, g, by sensor and axis, of those that they have."""
    fields = {number: channels.accelerations for number, channels in imu.sensors.items()}
    return {number: {axis: mean for axis, mean, _ in means(samples, of)} for number, of in fields.items()}


def _sample(
    watch: Watch, units: Mapping[str, BenchDevices], until_s: float
) -> tuple[Mapping[str, Sequence[SampleBlock]], Sequence[ChamberReading], float]:
    blocks: dict[str, list[SampleBlock]] = {name: [] for name in units}
    readings: list[ChamberReading] = []
    end_s = watch.now_s
    running = {name: _Running(devices.imu.sensors) for name, devices in units.items()}
    for looks in watch.wait(until_s):
        look = next(iter(looks.values()))
        if look.chamber is not None and look.chamber_fresh:
            readings.append(look.chamber)
        for name in units.keys() & looks.keys():
            block, unit = looks[name].block, watch.units[name]
            blocks[name].append(block)
            unit.rates_deg_per_hr, unit.rates_se_deg_per_hr = running[name].add(block)
        end_s = look.time_s
    if not readings and watch.look is not None and watch.look.chamber is not None:
        readings.append(watch.look.chamber)  # a collect shorter than the chamber's poll interval
    return blocks, readings, end_s


class _Running:
    """Running means of the rates and their standard errors, for onlookers.

    The error is that of a mean of batches, a poll's samples being a batch: honest about noise that is correlated for
    less than a poll, cheap enough to be had at every poll. What a collect records is `average_series`'s.
    """

    def __init__(self, sensors: Mapping[int, SensorRole]) -> None:
        self._fields = rate_fields(sensors)
        # Per channel, over the batches of n samples and mean m: sums of 1, n, n m, n², n² m, n² m².
        self._sums = {label: np.zeros(6) for label in self._fields}

    def add(self, block: SampleBlock) -> tuple[Mapping[str, float], Mapping[str, float]]:
        """Take a block in and return the means so far, and their standard errors from the third batch on."""
        for label, mean, n in means(block, self._fields):
            self._sums[label] += (1, n, n * mean, n * n, n * n * mean, n * n * mean * mean)
        so_far, errors = dict[str, float](), dict[str, float]()
        for label, (batches, count, first, squares, cross, second) in self._sums.items():
            if batches:
                so_far[label] = float(first / count)
            if batches >= _LEAST_BATCHES:
                scatter = second - 2.0 * so_far[label] * cross + so_far[label] ** 2 * squares
                errors[label] = float(np.sqrt(max(scatter, 0.0) * batches / (batches - 1)) / count)
        return so_far, errors


def _confirmed(position: str, before: str | None, after: str | None) -> Iterable[Judgement]:
    for when, where in (("before", before), ("after", after)):
        if where != position:
            stands = "an unknown position" if where is None else f"position {where}"
            yield Judgement(Verdict.FAIL, f"{when} the collect the unit stood at {stands}, not {position}")
