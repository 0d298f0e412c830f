"""The devices of a bench by themselves: `hil chamber BENCH read`, `set TEMPERATURE`, `stop`, and `hil simulate`.

Only the chamber's port is opened. A night that runs on the bench holds that port, so `hil chamber` is refused then.
"""

from __future__ import annotations

import sys
from typing import TYPE_CHECKING, Literal

from drivers.errors import CommandRefused, DeviceError
from hil.cli.answer import Answer
from hil.cli.ask import must_agree
from hil.cli.coefficients import quantity
from hil.cli.output import messages, warn
from hil.errors import InputError
from hil.files.document import picked
from hil.files.units import TEMPERATURE

if TYPE_CHECKING:
    from drivers.chambers import Chamber
    from drivers.clock import Clock
    from hil.config import Bench

_READ = "temperature_degC setpoint_degC mode low_limit_degC high_limit_degC alarms"
_LOOK_S = 5.0  # between looks at a ramp that is stepped from here


def chamber(
    bench: str,
    action: Literal["read", "set", "stop"],
    temperature: str | None = None,
    yes: bool = False,
    as_json: bool = False,
) -> int:
    """Read a bench's chamber, set its temperature, or bring it to its safe state; the unit is left alone.

    `set` is refused outside the bench's limits, asks before it drives a real chamber, and reads back. `stop` is the
    bench file's safe state; it never asks, and ends when the air shows it, or with status 5 (NOT SAFE) or 6 (NOT
    KNOWN). What is sent is logged on standard error, with who and when.
    """
    from hil.bench import open_chamber
    from hil.config import load_bench
    from hil.night.log import lines_to, logged
    from hil.records.requests import user
    from procedures.safe_air import Left, watch_air

    on = load_bench(bench)
    if action == "set":
        target = _target(temperature, on)
        if not on.simulated and not yes:
            lasts_s = on.chamber.dead_man
            stays = "stay there" if lasts_s is None else f"stay there for {lasts_s / 60.0:g} min (dead_man)"
            messages().print(f"{on.name}: the chamber on {on.chamber.port} will go to {target:.2f} °C and {stays}.")
            must_agree("Set it?", "not set")
    elif temperature is not None:
        raise InputError(f"{action} takes no temperature, and {temperature!r} was given")
    if action != "read":
        port = on.chamber.port
        if port.startswith(("socket://", "rfc2217://")):  # programs on this machine are kept off an open port
            warn([f"{port}: another computer may be using this chamber, and that cannot be told from here"])
    left = Left()
    with open_chamber(on) as (device, clock):
        commanded = logged(device, lines_to(sys.stderr, clock, user()))
        if action == "set":
            _set(commanded, device, clock, target, on.chamber.port)
        elif action == "stop":
            left = watch_air(device, clock, commanded.safe_state(), on.polling, messages().print)
            messages().print(f"{on.name}: {left}")
        if left.safe:
            document = {
                "schema": "hil.chamber/1",
                "bench": on.name,
                "simulated": on.simulated,
                "action": action,
                "model": device.identify().model,
                **picked(device.read(), _READ),
            }
            Answer(document).show(as_json=as_json)
    return left.exit_status(0)


def _target(given: str | None, bench: Bench) -> float:
    """Return the temperature in °C; raise `InputError` where it is none, or outside the limits."""
    if given is None:
        raise InputError("set needs a temperature, such as: hil chamber BENCH set '-20 degC'")
    value = quantity("set", given.replace("−", "-"), TEMPERATURE, "degC")
    if outside := bench.outside(value):
        raise InputError(f"{outside}; nothing was sent")
    return value


def _set(commanded: Chamber, device: Chamber, clock: Clock, target_degC: float, port: str) -> None:
    """Prepare, set, read back, step a ramp to its end; what could not be confirmed must not stay: it is made safe."""
    from drivers.chambers.ramp import RampedChamber

    commanded.prepare()
    try:
        commanded.set_temperature(target_degC)
    except DeviceError:
        commanded.safe_state()
        raise
    if isinstance(device, RampedChamber) and device.ramping:
        messages().print("the setpoint is stepped from here; stopped early, the chamber stays at the last step")
    while isinstance(device, RampedChamber) and device.ramping:
        clock.sleep(_LOOK_S)
        found = device.read().setpoint_degC
        if found != target_degC:
            raise CommandRefused(f"{port}: somebody set {found:.2f} °C during the ramp; it is left at that")


def simulate(bench: str = "simulated", tcp: bool = False) -> None:
    """Serve a bench's simulated unit and chamber to any client, in real time, until Ctrl-C.

    One JSON line on standard output says where they are.
    """
    from hil.config import load_bench
    from hil.twin.serve import serve_bench

    serve_bench(load_bench(bench), lambda line: print(line, flush=True), tcp=tcp)  # noqa: T201 - for programs
