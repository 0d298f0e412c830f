"""Look at a bench before anything moves: what was looked at, what was found, whether it will do, and what to do if not.

Nothing is written to a device except questions. The chamber is read, never set; the unit is asked who it is, never
indexed. A device that fails is a finding, and the others are still looked at.
"""

import ctypes
import math
import shutil
from collections.abc import Callable, Collection, Iterator, Sequence
from dataclasses import replace
from datetime import UTC, datetime, timedelta
from itertools import chain
from pathlib import Path

from drivers.chambers import CHAMBER_DRIVERS
from drivers.chambers.catalogue import SerialLine
from drivers.chambers.guards import ENDURANCE_WRITES
from drivers.chambers.ramp import steps_of_a_ramp
from drivers.clock import SystemClock
from drivers.errors import DeviceError
from drivers.imu import SampleBlock
from hil.bench.advice import ADVICE, Device, Finding, advice_for, closed_port_advice
from hil.bench.assemble import LiveBench, build_bench, ports_of
from hil.bench.at_rest import at_rest
from hil.bench.decode import wrong_counter
from hil.config import Bench
from hil.config.people import addresses_of, messenger_of
from hil.config.ports import SIMULATED_SCHEME, unit_port
from hil.config.sweep import Sweep, left_hot_or_cold, planned
from hil.errors import InputError
from procedures.collect import join
from procedures.plan import Plan, Step, StepKind, lasting_s
from procedures.words import counted

_LISTEN_S = 2.0
_LISTEN_AGAIN = 3  # times, while the rate is not what it should be: a busy computer is late by a few samples once
_BYTES_PER_SAMPLE = 160.0  # samples in Parquet and raw bytes, compressed; measured on simulated nights, rounded up
_SPARE_BYTES = 200e6
_MOST_OFF_RATE = 0.05
_UNKNOWN_NIGHT_S = 24 * 3600.0  # of samples without a pause, where no sweep says how long
_NIGHTS_PER_YEAR = 365.0
_EARLIEST = datetime(2024, 1, 1, tzinfo=UTC)
"""No night is recorded before this: a clock that says so has lost its battery."""

_TIME_ERROR = 5  # adjtimex(2): the clock is not synchronised to a reliable server
_TIMEX_BYTES = 512  # struct timex is 208 bytes on 64-bit Linux; zeros ask and change nothing


def preflight(sweep: Sweep | None, bench: Bench, folder: Path, done: Collection[str] = ()) -> list[Finding]:
    """Look at everything that can be looked at; `folder` is where the night is, or would be, written.

    Without a sweep, what depends on one (its temperatures, how long it takes) is left out; `done` are the keys of the
    steps that need not be done any more. Raises `InputError` where the bench file's descriptions cannot be used.
    """
    plan = None if sweep is None else planned(sweep, bench)
    left = None if plan is None else [step for step in plan.steps if step.key not in done]
    closed: dict[str, DeviceError] = {}
    ask = None if bench.imu.positioner == "indexing" else lambda *_: None  # nobody is asked: nothing moves here
    with build_bench(bench, ask=ask, unopened=closed.__setitem__) as live:
        return [
            *_ports(live, closed),
            *look_at_devices(live, closed),
            _limits(sweep, live),
            *_wear(plan, sweep, bench),
            _disk(left, live, folder),
            _clock(live),
            *_notified(bench),
            _duration(left, live),
            *([Finding("end", True, end)] if sweep and (end := left_hot_or_cold(sweep, bench)) else []),
        ]


def look_at_devices(live: LiveBench, closed: Collection[str] = ()) -> Iterator[Finding]:
    """Yield what is found of unit, stream and chamber, but for those whose port is one of the `closed`."""
    for name, each in live.each.items():
        if unit_port(name) not in closed:
            whose = f" of {name}" if name else ""
            looked = chain(_guarded(each, "unit", _unit), _guarded(each, "unit", _stream, "stream"))
            yield from (replace(found, subject=f"{found.subject}{whose}") for found in looked)
    if "chamber.port" not in closed:
        yield from _guarded(live, "chamber", _chamber)


def _guarded(
    live: LiveBench, device: Device, look: Callable[[LiveBench], Iterator[Finding]], subject: str = ""
) -> Iterator[Finding]:
    """Turn a device's failure into a finding, so that the other devices are still looked at."""
    try:
        yield from look(live)
    except DeviceError as error:
        yield Finding(subject or device, False, str(error), advice_for(error, live.bench, device))


def _ports(live: LiveBench, closed: dict[str, DeviceError]) -> Iterator[Finding]:
    for key, url in ports_of(live.bench):
        if key in closed:
            yield Finding(key, False, (words := str(closed[key])), closed_port_advice(words, url, live.bench))
        elif url.startswith(SIMULATED_SCHEME):
            yield Finding(key, True, f"{url}: simulated in this process")
        else:
            units = {unit_port(name): each.bench for name, each in live.each.items()}
            line = live.bench.chamber.line
            if key in units:
                line = SerialLine(units[key].imu.baud or units[key].frames.baudrate)
            # As the panel or the data sheet has to agree.
            said = "" if url.startswith("socket://") else f", {line.baud} baud {line.data_bits}{line.parity}1"
            yield Finding(key, True, f"{url}{said}: opened")


def _unit(live: LiveBench) -> Iterator[Finding]:
    found = live.devices.imu.identify()
    live.devices.refuse_undeclared_simulation(*vars(found).values())
    told = " ".join(part for part in (found.model, found.serial, found.firmware) if part)
    yield Finding("unit", True, told or "a unit that does not say who it is")


def _stream(live: LiveBench) -> Iterator[Finding]:
    """Listen: frames must be whole, all of them, as many as is said, or listen on: a late look is wrong by no more."""
    imu, clock = live.devices.imu, live.devices.clock
    imu.discard()
    begins_s, blocks = clock.now(), list[SampleBlock]()
    enough, listened_s, rate_hz = False, 0.0, 0.0
    for times in range(1, _LISTEN_AGAIN + 1):
        while listened_s < times * _LISTEN_S:
            clock.sleep(0.1)
            blocks.append(imu.read_block())
            listened_s = clock.now() - begins_s
        rate_hz = sum(map(len, blocks)) / listened_s
        enough = abs(rate_hz - imu.sample_rate_hz) <= max(_MOST_OFF_RATE * imu.sample_rate_hz, 2.0 / listened_s)
        if enough or not any(map(len, blocks)):
            break
    heard = join(blocks)
    samples, counts = len(heard), heard.counts
    bad = counts.bad_checksum + counts.bad_delimiter + counts.lost
    rate = f"{rate_hz:.1f} Hz, {imu.sample_rate_hz:g} expected"
    told = f"{counted(samples, 'sample')} in {listened_s:.0f} s ({rate}), {bad} bad or lost"
    miscounted = "; ".join(wrong_counter(live.bench.frames, heard.raw, rate_hz)) if samples else ""
    wrong = "silent" if not samples else "damaged" if bad else "" if enough else "other rate"
    yield Finding("stream", enough and not bad, told, miscounted or ADVICE["stream"].get(wrong, ""))
    if samples:
        yield from at_rest(live, heard)
        yield from _unit_temperature(live, heard)
    if live.bench.imu.positioner == "indexing":
        position = live.devices.positioner.position()
        told, advice = f"the unit lies in position {position}", ""
        if position is None:
            told = "the unit moves, or does not know its position"
            advice = "the first move of the night finds it; where it stays like this, look at the unit's index"
        yield Finding("index", True, told, advice)


def _unit_temperature(live: LiveBench, block: SampleBlock) -> Iterator[Finding]:
    """Say what the unit's own thermometers show, and whether an interlock would end the night at once."""
    sensors = live.devices.imu.sensors
    shown = {
        f"sensor {number}": float(block.fields[channels.temperature][-1])
        for number, channels in sensors.items()
        if number in live.bench.sensors and channels.temperature is not None and channels.temperature in block.fields
    }
    if not shown:
        yield Finding("unit temperature", True, "the stream has none", "a soak is judged by the chamber's air alone")
        return
    rules = live.bench.interlocks
    good = all(rules.unit_low_degC <= value <= rules.unit_high_degC for value in shown.values())
    told = ", ".join(f"{name} {value:.1f} °C" for name, value in shown.items())
    yield Finding("unit temperature", good, told, "" if good else ADVICE["unit temperature"].format(rules=rules))


def _chamber(live: LiveBench) -> Iterator[Finding]:
    chamber, margin = live.devices.chamber, live.bench.interlocks.chamber_margin_degC
    identity, reading, limits = chamber.identify(), chamber.read(), chamber.limits
    live.devices.refuse_undeclared_simulation(identity.model)
    inside = limits.low_degC - margin <= reading.temperature_degC <= limits.high_degC + margin
    told = f"{identity.model}, speaks {identity.unit}, {reading.mode}, now {reading.temperature_degC:.1f} °C"
    yield Finding("chamber", inside, told, "" if inside else ADVICE["air"].format(limits=limits))
    running, advice = reading.mode == "RUN", ""
    if running:
        advice = "a program is running: end it at the chamber's panel"
    elif not limits.low_degC <= reading.setpoint_degC <= limits.high_degC:
        advice = "somebody left a setpoint outside the bench's limits; the night does not drive to it, it sets its own"
    yield Finding("mode", not running, f"{reading.mode}, setpoint {reading.setpoint_degC:.1f} °C", advice)
    advice = "clear the cause, then acknowledge it at the chamber's panel; nothing here acknowledges an alarm"
    yield Finding("alarms", not reading.alarms, ", ".join(reading.alarms) or "none", advice if reading.alarms else "")
    low, high, advice = reading.low_limit_degC, reading.high_limit_degC, ""
    told = f"the controller's own are {low:g} … {high:g} °C now; a night sets them anew"
    if not (math.isfinite(low) and math.isfinite(high)):
        told = "the controller has none that can be set from here"
        advice = "set the chamber's own temperature limiter by hand, and test it: the software cannot"
    yield Finding("native limits", True, told, advice)
    yield _left_alone(live.bench)


def _left_alone(bench: Bench) -> Finding:
    """Say what the chamber does when this computer dies."""
    given, armed = bench.chamber.dead_man, bench.chamber.night_dead_man
    if armed is not None:
        told = f"its own timer stops the chamber {armed / 60.0:g} min after nobody looks any more"
        advice = "" if given else "armed where it has the option; dead_man: 3 h under chamber insists on it"
        return Finding("left alone", True, told if given else f"{told}, where it has one", advice)
    if CHAMBER_DRIVERS[bench.chamber.driver].dead_man:
        advice = "let its own timer stop it: dead_man: 3 h under chamber"
    else:
        advice = "see that its own over-temperature cut-out is set and tested"
    return Finding("left alone", True, "the chamber goes on at its setpoint when this computer dies", advice)


def _limits(sweep: Sweep | None, live: LiveBench) -> Finding:
    limits = live.devices.chamber.limits
    allowed = f"the bench allows {limits.low_degC:g} … {limits.high_degC:g} °C"
    if sweep is None:
        return Finding("limits", True, allowed)
    coldest, hottest = min(sweep.temperatures), max(sweep.temperatures)  # within them, or it would not be a sweep here
    return Finding("limits", True, f"the sweep asks for {coldest:.1f} … {hottest:.1f} °C, {allowed}")


def _wear(plan: Plan | None, sweep: Sweep | None, bench: Bench) -> Iterator[Finding]:
    """Estimate how often the controller's memory is written in this night, and how many such nights it stands."""
    if plan is None or sweep is None:
        return
    setpoints = [step.temperature_degC for step in plan.of_kind(StepKind.SETPOINT) if step.temperature_degC is not None]
    writes, ramp = len(setpoints), bench.chamber.ramp
    if ramp is not None:
        befores = [sweep.start, *setpoints[:-1]]
        spans = [abs(after - before) for before, after in zip(befores, setpoints, strict=True)]
        writes = sum(steps_of_a_ramp(span, ramp) for span in spans)
    nights = ENDURANCE_WRITES / max(writes, 1)
    told = (
        f"at most {writes} setpoint writes in this night; a controller that keeps setpoints in a memory of "
        f"{ENDURANCE_WRITES:,} writes stands {nights:,.0f} such nights"
    ).replace(",", " ")
    advice = "" if nights >= _NIGHTS_PER_YEAR else "use a faster ramp, or a controller that ramps by itself"
    yield Finding("wear", True, told, advice)


def _disk(left: Sequence[Step] | None, live: LiveBench, folder: Path) -> Finding:
    rates_hz = {name: unit.imu.sample_rate_hz for name, unit in live.devices.units.items()}
    samples = _UNKNOWN_NIGHT_S * sum(rates_hz.values())
    if left is not None:
        samples = sum(step.duration_s * rates_hz[step.unit or ""] for step in left if step.position is not None)
    needed = _SPARE_BYTES + samples * _BYTES_PER_SAMPLE
    needed += 1e6 * live.bench.interlocks.disk_low_mb  # with less than that left the night would end
    free = shutil.disk_usage(folder).free
    wanted = "wanted" if left is not None else "wanted for 24 h of samples"
    advice = "" if free > needed else "free some space, or run from a folder on another disk"
    message = f"{free / 1e9:.1f} GB free in {folder}, {needed / 1e9:.1f} GB {wanted}"
    return Finding("disk", free > needed, message, advice)


def _clock(live: LiveBench) -> Finding:
    now = live.devices.clock.utc()
    if live.bench.clock == "virtual":
        return Finding("clock", True, f"virtual, begins {now:%Y-%m-%d %H:%M} UTC")
    told = f"{now:%Y-%m-%d %H:%M:%S} UTC"
    if now < _EARLIEST:
        return Finding("clock", False, f"{told}, which cannot be", "set the computer's date and time (timedatectl)")
    known = synchronised()
    if known is None:
        return Finding("clock", True, f"{told}; whether it is synchronised cannot be told", "compare it with a watch")
    if known:
        return Finding("clock", True, f"{told}, synchronised")
    advice = "records carry this time: compare it with a watch, or switch synchronisation on (timedatectl set-ntp true)"
    return Finding("clock", True, f"{told}, not synchronised", advice)


def synchronised() -> bool | None:
    """Return whether the kernel counts its clock as synchronised, None where it cannot be asked. Changes nothing."""
    try:
        state = ctypes.CDLL(None).adjtimex(ctypes.create_string_buffer(_TIMEX_BYTES))
    except (OSError, AttributeError):  # no such call: not Linux
        return None
    return None if state < 0 else state != _TIME_ERROR


def _notified(bench: Bench) -> Iterator[Finding]:
    """Say NOT where somebody is to be told of the night who could not be."""
    for reference in bench.notify.to if bench.notify else ():
        try:
            for address in (found := addresses_of(reference)):
                messenger_of(address)
            yield Finding("notify", True, f"{reference}: {len(found)} to tell")
        except InputError as error:
            yield Finding("notify", False, f"{reference}: {error}", f"hil notify {bench.source} sends a trial message")


def _duration(left: Sequence[Step] | None, live: LiveBench) -> Finding:
    if left is None:
        return Finding("duration", True, "no sweep was given", "add --sweep SWEEP to see when it would end")
    left_s = lasting_s(left)
    ends = (live.devices.clock.utc() + timedelta(seconds=left_s)).astimezone()
    hours, minutes = divmod(round(left_s / 60.0), 60)
    simulated = "" if isinstance(live.devices.clock, SystemClock) else " (simulated time)"
    when = f"{ends:%a %d %b %Y %H:%M %Z}{simulated}"
    return Finding("duration", True, f"{hours} h {minutes:02d} min; begun now, it ends {when}")
