"""What is one unit's own on a bench: its label, its stream, and the list of those that share a chamber.

benches = of_each(document)         # of a file that lists its units: the bench of each, by serial number
"""

from __future__ import annotations

import re
from typing import Annotated, Any

from pydantic import AfterValidator, BeforeValidator, Field, PositiveInt

from drivers.outside import brought
from hil.config.ports import SIMULATED_SCHEME, ImuPort
from hil.files.strict import NAME, Section, near
from hil.files.units import Hertz

ASK = "ask"
_LISTED = re.compile(rf"[A-Za-z0-9][\w.+-]{{0,{NAME - 1}}}", re.ASCII)
"""What may be that of one of several, whose folder is named by it."""


def labels(value: object) -> object:
    """Return a mapping by text: YAML reads an unquoted 1 as a number, and a position's label is text."""
    return {str(label): entry for label, entry in value.items()} if isinstance(value, dict) else value


class UnitSection(Section):
    """The unit under test as its label says; the controller refuses another one.

    `serial: ask` has whoever begins a night type or scan it, where the unit does not tell its own.
    """

    model: str
    serial: Annotated[str, AfterValidator(str.strip)]


def _positioner(name: str) -> str:
    there = ["indexing", "operator", *brought("hil.positioners")]
    if name not in there:
        raise ValueError(f"{name!r} is not allowed; allowed: {' or '.join(map(repr, there))}")
    return name


class ImuSection(Section):
    """The IMU's port and stream, and who turns the unit. Baud and rate are the description's where they are not given.

    `parameters` are what the description asks for and the stream does not tell (a range, a unit of the rates). `codes`
    are the unit's own numbers for the positions (position "3" is its number 3 where nothing is said), and
    `instructions` tell an operator how the unit lies at each. `positioner_options` are what a positioner that another
    distribution brings is made with.
    """

    description: str
    port: ImuPort
    baud: PositiveInt | None = None
    rate: Annotated[Hertz, Field(gt=0.0, le=100_000.0)] | None = None
    parameters: dict[str, bool | int | float | str] = Field(default_factory=dict)
    positioner: Annotated[str, AfterValidator(_positioner)]
    positioner_options: dict[str, Any] = Field(default_factory=dict)
    codes: Annotated[dict[str, int], BeforeValidator(labels)] = Field(default_factory=dict)
    instructions: Annotated[dict[str, str], BeforeValidator(labels)] = Field(default_factory=dict)


_OF_ALL = ("positioner", "positioner_options")
"""What the units of one chamber cannot have each for itself."""


def of_each(document: dict[str, Any]) -> dict[str, Any]:
    """Return the bench of each unit of a file's list, by serial number: what is the unit's own laid over the rest.

    Raises `ValueError` for a list that names no units, or two alike.
    """
    listed, rest = document["units"], {k: given for k, given in document.items() if k not in ("units", "faults")}
    if "unit" in rest:
        raise ValueError("unit: the bench lists its units; leave this out, or units")
    if not isinstance(listed, list) or not listed or not all(isinstance(entry, dict) for entry in listed):
        raise ValueError('units: a list is needed, such as - {model: MFS-IMU, serial: "0042", port: /dev/ttyUSB0}')
    found: dict[str, Any] = {}
    ports: dict[str, str] = {}
    for place, entry in enumerate(listed):
        serial, port = str(entry.get("serial", "")), str(entry.get("port", ""))
        if not _LISTED.fullmatch(serial) or serial == ASK:
            raise ValueError(
                f"units.{place}.serial: {serial!r}: each unit of a list has a serial number: letters, digits, . _ + -"
            )
        if serial in found:
            raise ValueError(
                f"units.{place}.serial: {serial} stands there twice; two units of one serial number are one"
            )
        if port in ports and not port.startswith(SIMULATED_SCHEME):
            raise ValueError(f"units.{place}.port: {port} is the port of unit {ports[port]} already")
        ports[port] = serial
        found[serial] = _laid_over(rest, entry, place)
    return found


def _laid_over(rest: dict[str, Any], entry: dict[str, Any], place: int) -> dict[str, Any]:
    own = dict(entry)
    unit = {name: own.pop(name) for name in ("model", "serial") if name in own}
    imu = {name: own.pop(name) for name in ImuSection.model_fields if name in own and name not in _OF_ALL}
    sensors, simulation = own.pop("sensors", rest.get("sensors")), own.pop("simulation", {})
    if not isinstance(simulation, dict):
        raise ValueError(f"units.{place}.simulation: must be a mapping, such as {{seed: 7}}")
    if own:
        known = ["model", "serial", "sensors", "simulation", *(n for n in ImuSection.model_fields if n not in _OF_ALL)]
        raise ValueError(f"units.{place}: {next(iter(own))!r} is not known here{near(str(next(iter(own))), known)}")
    bench = {**rest, "unit": unit, "imu": {**(rest.get("imu") or {}), **imu}, "sensors": sensors}
    if isinstance(of_all := rest.get("simulation"), dict):
        seed = of_all.get("seed")  # the first has the bench's; noise of others is their own
        seeded = {"seed": seed + place} if isinstance(seed, int) else {}
        bench["simulation"] = {**of_all, **seeded, **simulation}
    return bench


def where_listed(mistake: str, entry: dict[str, Any], place: int) -> str:
    """Return a mistake in a unit's bench with the key that stands in its entry; as it is where none does."""
    key, _, what = mistake.partition(": ")
    parts = key.removeprefix("imu.").removeprefix("unit.").split(".")
    here: Any = entry
    for part in parts[:-1] or parts:
        here = {str(name): of for name, of in here.items()}.get(part) if isinstance(here, dict) else None
    return mistake if here is None else f"units.{place}.{'.'.join(parts)}: {what} (unit {entry['serial']})"
