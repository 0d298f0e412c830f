"""Look at a bench before anything moves: each finding says what was looked at, what was found, and whether it will do.

Nothing is written to a device except questions. The chamber is read, never set; the unit is asked who it is, never
indexed.
"""

from __future__ import annotations

import shutil
from collections.abc import Callable, Iterator, Sequence
from dataclasses import asdict, dataclass
from datetime import timedelta
from pathlib import Path
from typing import Any

from drivers.errors import DeviceError
from drivers.imu import StreamCounts
from hil.bench import LiveBench, build_bench
from hil.config import Bench, Sweep
from procedures.plan import Plan, make_plan

_LISTEN_S = 2.0
_BYTES_PER_SAMPLE = 160.0  # samples in Parquet and raw bytes, compressed; measured on simulated nights, rounded up
_SPARE_BYTES = 200e6
_MOST_LOST = 0.001
_MOST_OFF_RATE = 0.05


@dataclass(frozen=True)
class Finding:
    """One thing that was looked at. `good` is False where a night must not begin like this."""

    subject: str
    good: bool
    message: str


def preflight(sweep: Sweep, bench: Bench, folder: Path) -> Sequence[Finding]:
    """Look at everything that can be looked at; `folder` is where the night would be written.

    Raises `InputError` for a port that does not exist and `DeviceError` for one that cannot be opened: then there is
    nothing to look at.
    """
    plan = make_plan(sweep.procedure())
    with build_bench(bench, ask=None if bench.imu.positioner == "indexing" else _nobody) as live:
        return [
            *_guarded("unit", lambda: _unit(live)),
            *_guarded("stream", lambda: _stream(live)),
            *_guarded("chamber", lambda: _chamber(live, sweep)),
            _disk(plan, live, folder),
            _duration(plan, live),
        ]


def _nobody(question: str, timeout_s: float) -> None:
    """Nobody is asked: nothing moves here."""


def check_document(findings: Sequence[Finding], *, simulated: bool) -> dict[str, Any]:
    """Return the findings as `hil check --json` prints them (schema hil.check/1)."""
    return {
        "schema": "hil.check/1",
        "good": all(finding.good for finding in findings),
        "simulated": simulated,
        "findings": [asdict(finding) for finding in findings],
    }


def _guarded(subject: str, look: Callable[[], Iterator[Finding]]) -> Iterator[Finding]:
    """Turn a device's failure into a finding, so that the other devices are still looked at."""
    try:
        yield from look()
    except DeviceError as error:
        yield Finding(subject, False, str(error))


def _unit(live: LiveBench) -> Iterator[Finding]:
    found = live.devices.imu.identify()
    told = " ".join(part for part in (found.model, found.serial, found.firmware) if part)
    yield Finding("unit", True, told or "a unit that does not say who it is")


def _stream(live: LiveBench) -> Iterator[Finding]:
    """Listen for two seconds: frames must be whole, and as many as the bench file says."""
    imu, clock = live.devices.imu, live.devices.clock
    imu.discard()
    begins_s, samples, counts = clock.now(), 0, StreamCounts()
    while clock.now() - begins_s < _LISTEN_S:
        clock.sleep(0.1)
        block = imu.read_block()
        samples += len(block)
        counts += block.counts
    rate_hz = samples / (clock.now() - begins_s)
    bad = counts.bad_checksum + counts.bad_delimiter + counts.lost
    told = (
        f"{samples} samples in {_LISTEN_S:g} s ({rate_hz:.1f} Hz, {imu.sample_rate_hz:g} expected), {bad} bad or lost"
    )
    enough = abs(rate_hz - imu.sample_rate_hz) <= max(_MOST_OFF_RATE * imu.sample_rate_hz, 2.0 / _LISTEN_S)
    yield Finding("stream", enough and bad <= _MOST_LOST * max(samples, 1), told)


def _chamber(live: LiveBench, sweep: Sweep) -> Iterator[Finding]:
    chamber = live.devices.chamber
    identity, reading = chamber.identify(), chamber.read()
    alarms = f", alarms: {', '.join(reading.alarms)}" if reading.alarms else ""
    yield Finding(
        "chamber",
        not reading.alarms,
        f"{identity.model}, speaks {identity.unit}, {reading.mode}, now {reading.temperature_degC:.1f} °C{alarms}",
    )
    coldest, hottest = min(sweep.temperatures), max(sweep.temperatures)
    limits = chamber.limits
    yield Finding(
        "limits",
        limits.low_degC <= coldest and hottest <= limits.high_degC,
        f"the sweep asks for {coldest:.1f} … {hottest:.1f} °C, the bench allows {limits.low_degC:g} … "
        f"{limits.high_degC:g} °C",
    )


def _disk(plan: Plan, live: LiveBench, folder: Path) -> Finding:
    collects_s = sum(step.duration_s for step in plan.steps if step.position is not None)
    needed = _SPARE_BYTES + collects_s * live.devices.imu.sample_rate_hz * _BYTES_PER_SAMPLE
    free = shutil.disk_usage(folder).free
    return Finding("disk", free > needed, f"{free / 1e9:.1f} GB free in {folder}, {needed / 1e9:.1f} GB wanted")


def _duration(plan: Plan, live: LiveBench) -> Finding:
    ends = live.devices.clock.utc() + timedelta(seconds=plan.total_s)
    hours, minutes = divmod(round(plan.total_s / 60.0), 60)
    simulated = " (simulated time)" if live.simulated else ""
    when = f"{ends:%Y-%m-%d %H:%M} UTC" if live.simulated else f"{ends.astimezone():%a %d %b %H:%M}"
    return Finding("duration", True, f"{hours} h {minutes:02d} min; begun now, it ends {when}{simulated}")
