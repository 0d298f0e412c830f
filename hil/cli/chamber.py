"""The devices of a bench by themselves: `hil chamber BENCH read`, `set TEMPERATURE`, `stop`, and `hil simulate`.

Only the chamber's port is opened. A night that runs on the bench holds that port, so `hil chamber` is refused then.
"""

from __future__ import annotations

import sys
from enum import StrEnum
from typing import TYPE_CHECKING, Annotated, Any

from typer import Argument, Option

from drivers.errors import CommandRefused, DeviceError
from hil.cli.answer import Answer, told
from hil.cli.ask import must_agree
from hil.cli.coefficients import quantity
from hil.cli.output import JsonFlag, messages, warn
from hil.errors import InputError
from hil.files.document import picked
from hil.files.units import TEMPERATURE

if TYPE_CHECKING:
    from hil.bench import LiveChamber
    from hil.config import Bench

_READ = "temperature_degC setpoint_degC mode low_limit_degC high_limit_degC alarms"
_LOOK_S = 5.0  # between looks at a ramp that is stepped from here


class Action(StrEnum):
    """What `hil chamber` can do."""

    READ = "read"
    SET = "set"
    STOP = "stop"


def chamber(
    bench: Annotated[str, Argument(help="A bench file, or the name of one that ships.")],
    action: Annotated[Action, Argument(help="What to do.")],
    temperature: Annotated[str | None, Argument(help="For set: -20 degC, 68 degF; a bare number is °C.")] = None,
    yes: Annotated[bool, Option("--yes", help="Do not ask before the chamber is set.")] = False,
    as_json: JsonFlag = False,
) -> int:
    """Read a bench's chamber, set its temperature, or bring it to its safe state; the unit is left alone.

    `set` is refused outside the bench's limits, asks before it drives a real chamber, and reads back. `stop` is the
    bench file's safe state; it never asks, and ends when the air shows it, or with status 5 (NOT SAFE) or 6 (NOT
    KNOWN). What is sent is logged on standard error, with who and when.
    """
    from hil.bench import open_chamber
    from hil.config import load_bench
    from procedures.safe_air import Left, watch_air

    on = load_bench(bench)
    if action is Action.SET:
        target = _target(temperature, on)
        _ask(on, target, yes=yes)
    elif temperature is not None:
        raise InputError(f"{action.value} takes no temperature, and {temperature!r} was given")
    if action is not Action.READ:
        port = on.chamber.port
        if port.startswith(("socket://", "rfc2217://")):  # programs on this machine are kept off an open port
            warn([f"{port}: another computer may be using this chamber, and that cannot be told from here"])
    left = Left()
    with open_chamber(on) as live:
        if action is Action.SET:
            _set(live, target)
        elif action is Action.STOP:
            safe = _logged(live).safe_state()
            left = watch_air(live.chamber, live.clock, safe, on.polling, messages().print)
            messages().print(f"{on.name}: {left}")
        if left.safe:
            document = {
                "schema": "hil.chamber/1",
                "bench": on.name,
                "simulated": on.simulated,
                "action": action.value,
                "model": live.chamber.identify().model,
                **picked(live.chamber.read(), _READ),
            }
            Answer(document, told(document)).show(as_json=as_json)
    return left.exit_status(0)


def _target(given: str | None, bench: Bench) -> float:
    """Return the temperature in °C; raise `InputError` where it is none, or outside the limits."""
    from hil.files.columns import is_number

    if given is None:
        raise InputError("set needs a temperature, such as: hil chamber BENCH set '-20 degC'")
    plain = given.replace("−", "-")
    value = quantity("set", f"{plain} degC" if is_number(plain) else plain, TEMPERATURE)
    if outside := bench.outside(value):
        raise InputError(f"{outside}; nothing was sent")
    return value


def _ask(bench: Bench, target_degC: float, *, yes: bool) -> None:
    """Ask whoever sits there before a real chamber is driven."""
    if bench.simulated or yes:
        return
    dead_man = bench.chamber.dead_man
    stays = "stay there" if dead_man is None else f"stay there for {dead_man / 60.0:g} min (dead_man)"
    messages().print(f"{bench.name}: the chamber on {bench.chamber.port} will go to {target_degC:.2f} °C and {stays}.")
    must_agree("Set it?", "not set")


def _logged(live: LiveChamber) -> Any:
    from hil.night.log import lines_to, logged
    from hil.records.requests import user

    return logged(live.chamber, lines_to(sys.stderr, live.clock, user()))


def _set(live: LiveChamber, target_degC: float) -> None:
    """Prepare, set, read back, step a ramp to its end; what could not be confirmed must not stay: it is made safe."""
    from drivers.chambers.ramp import RampedChamber

    chamber = _logged(live)
    chamber.prepare()
    try:
        chamber.set_temperature(target_degC)
    except DeviceError:
        chamber.safe_state()
        raise
    ramped = live.chamber
    if not isinstance(ramped, RampedChamber):
        return
    if ramped.ramping:
        messages().print("the setpoint is stepped from here; stopped early, the chamber stays at the last step")
    while ramped.ramping:
        live.clock.sleep(_LOOK_S)
        found = ramped.read().setpoint_degC
        if found != target_degC:
            raise CommandRefused(
                f"{live.bench.chamber.port}: somebody set {found:.2f} °C during the ramp; it is left at that"
            )


def simulate(
    bench: Annotated[
        str, Argument(help="A bench file with a simulation section, or the name of one that ships.")
    ] = "simulated",
    tcp: Annotated[bool, Option("--tcp", help="TCP ports on this machine instead of pseudo-terminals.")] = False,
) -> None:
    """Serve a bench's simulated unit and chamber to any client, in real time, until Ctrl-C.

    One JSON line on standard output says where they are.
    """
    from hil.config import load_bench
    from hil.twin.serve import serve_bench

    serve_bench(load_bench(bench), lambda line: print(line, flush=True), tcp=tcp)  # noqa: T201 - for programs
