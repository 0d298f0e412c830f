"""What a unit shows at rest, in words, beside what it should: other units, dead channels, axes turned round.

At rest a rate is bias, acceleration sensitivity and at most 15.04 deg/hr of earth rate. The description of its frames
may state from the data sheet how large that gets and how noisy it is (`drivers.frames.roles.AtRest`); what is far off
is compared with what it would be in other units, and the nearest is named.
"""

from collections.abc import Iterator, Mapping

import numpy as np

from drivers.frames.roles import AtRest, SensorRole
from drivers.imu import SampleBlock
from drivers.imu.samples import FloatArray
from hil.bench.advice import Finding
from hil.bench.assemble import LiveBench
from hil.campaign.data import EARTH_RATE_DEG_PER_HR
from procedures.collect import shown_g
from procedures.quality import same_samples
from procedures.words import listed

_MOST_BIAS_DEG_PER_HR = 36_000.0  # 10 deg/s: no gyro that is calibrated on a bench rests at more
_NOISE_OFF = 6.0  # times what the data sheet states: filters make less of it, a floor that shakes more
_NEAREST = 0.7  # of a natural logarithm: within a factor of two of what the data sheet states
_SATURATED = 0.99
_LEAST_SAMPLES = 10


def at_rest(live: LiveBench, samples: SampleBlock) -> Iterator[Finding]:
    """Yield what is seen of the bench's sensors in `samples` of a unit that lies still, and what contradicts it."""
    imu = live.devices.imu
    everything: dict[str, FloatArray] = {}
    for number, channels in ((n, imu.sensors[n]) for n in sorted(imu.sensors.keys() & live.bench.sensors.keys())):
        values = {name: samples.fields[field] for name, field in channels.rates.items() if field in samples.fields}
        values = {name: rates[np.isfinite(rates)] for name, rates in values.items()}
        if any(len(rates) < _LEAST_SAMPLES for rates in values.values()):
            continue
        everything |= {f"sensor {number} {name}": rates for name, rates in values.items()}
        rests = {name: (float(rates.mean()), float(rates.std())) for name, rates in values.items()}
        wrong: dict[str, list[str]] = {}
        for name, (mean, sd) in rests.items():
            if problem := _contradiction(mean, sd, channels.at_rest, imu.sample_rate_hz):
                wrong.setdefault(problem, []).append(name)
        problems = "; ".join(f"{listed(names)}: {problem}" for problem, names in wrong.items())
        advice = f"{problems}. See scale and unit of the rates in the frame description" if wrong else ""
        yield Finding(f"sensor {number} at rest", not wrong, _seen(channels, rests, samples), advice)
    for one, other in same_samples(everything):
        advice = "one of them is not measured: see the fields of the rates in the frame description"
        yield Finding("rates", False, f"{one} and {other} show the very same samples", advice)
    yield from _pose(live, samples)


def _seen(channels: SensorRole, rests: Mapping[str, tuple[float, float]], samples: SampleBlock) -> str:
    told = [", ".join(f"{name} {mean:+.4g} (scatter {sd:.2g})" for name, (mean, sd) in rests.items()) + " deg/hr"]
    told.append(f"the earth rate is at most {EARTH_RATE_DEG_PER_HR:.2f}")
    shown = {axis: samples.fields[field] for axis, field in channels.accelerations.items() if field in samples.fields}
    if shown:
        told.append("accelerations " + ", ".join(f"{axis} {np.nanmean(v):+.3f}" for axis, v in shown.items()) + " g")
    return "; ".join(told)


def _contradiction(mean: float, sd: float, stated: AtRest, sample_rate_hz: float) -> str:
    """Return in words what a channel's mean and scatter from sample to sample, deg/hr, contradict, or nothing."""
    limit = stated.full_scale_deg_per_hr
    if limit is not None and abs(mean) > _SATURATED * limit:
        return f"saturated, at {mean:g} deg/hr of {limit:g}"
    if sd == 0.0:
        return f"at {mean:g} deg/hr without any noise: not being measured"
    bias, walk = stated.bias_deg_per_hr or _MOST_BIAS_DEG_PER_HR, stated.angle_random_walk_deg_per_root_hr
    noise = None if walk is None else 60.0 * walk * np.sqrt(sample_rate_hz)

    def quiet(factor: float) -> bool:
        return noise is None or noise / _NOISE_OFF <= sd / factor <= noise * _NOISE_OFF

    slips = [(1.0, ""), *_slips(sample_rate_hz)]
    slips = [each for each in slips if quiet(each[0]) and abs(mean / each[0]) <= bias + EARTH_RATE_DEG_PER_HR]
    if slips and slips[0][0] == 1.0:
        return ""
    if noise is not None:
        off, unit = min(((abs(np.log(sd / factor / noise)), unit) for factor, unit in slips), default=(np.inf, ""))
        if off < _NEAREST:
            return f"about {sd / noise:.1g} times what a unit at rest shows: {unit}?"
        if not quiet(1.0):
            return f"scatter about {sd / noise:.1g} times what the description states: counts without their scale?"
    elif slips:
        return f"more than can be at rest ({bias:g} deg/hr): {' or '.join(unit for _, unit in slips)}?"
    return f"more than the description says a unit at rest shows ({bias:g} deg/hr)"


def _slips(sample_rate_hz: float) -> list[tuple[float, str]]:
    """Return by how much a rate comes out too large where its unit is mistaken, and for what."""
    degree = float(np.rad2deg(1.0))
    return [
        (1.0 / degree, "is it sent in rad/s and read as deg/s"),
        (degree, "is it sent in deg/s and read as rad/s"),
        (3600.0, "is it sent in deg/hr and read as deg/s"),
        (1.0 / 3600.0, "is it sent in deg/s and read as deg/hr"),
        (1.0 / sample_rate_hz, "is it sent as an angle per sample and read as one per second"),
        (sample_rate_hz, "is it sent per second and read as an angle per sample"),
        (1.0 / (3600.0 * degree), "is it sent in rad/s and read as deg/hr"),
    ]


def _pose(live: LiveBench, samples: SampleBlock) -> Iterator[Finding]:
    """Say how the unit lies by its accelerometers, and NOT where that contradicts what is known of it."""
    devices = live.devices
    shown = shown_g(devices.imu, samples)
    if devices.poses is None or not any(shown.values()):
        yield Finding("pose", True, "the stream has no accelerations", "the pose of the unit cannot be checked")
        return
    told = devices.positioner.position() if live.bench.imu.positioner == "indexing" else None
    fits = [label for label in devices.poses.poses if not devices.poses.contradiction(label, shown)]
    if told is not None and told in devices.poses.poses and told not in fits:
        contradicted = devices.poses.contradiction(told, shown)
        yield Finding("pose", False, contradicted, "see how the unit is mounted and indexed")
    elif fits:
        yield Finding("pose", True, f"the unit lies as in position {' or '.join(fits)}")
    else:
        first = next(iter(devices.poses.poses))
        by_hand = live.bench.imu.positioner == "operator"
        advice = "lay it as in one of its positions and check again: then this says whether its axes are as described"
        yield Finding("pose", by_hand, f"as in no position ({devices.poses.contradiction(first, shown)})", advice)
