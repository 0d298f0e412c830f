"""What is one unit's own on a bench: its label, its stream, how it lies, and the list of those that share a chamber."""

import re
from collections.abc import Mapping
from typing import Annotated, Any

import numpy as np
from pydantic import AfterValidator, BeforeValidator, Field, PositiveInt

from drivers.outside import brought
from hil.campaign import FloatArray
from hil.config.ports import SIMULATED_SCHEME, ImuPort
from hil.errors import worded
from hil.files.strict import NAME, Section, near
from hil.files.units import ANGLE, Hertz, to_number
from hil.model.equation import Orientation

ASK = "ask"
_OF_ALL = ("positioner", "positioner_options")
"""What the units of one chamber cannot have each for itself."""
_FORMS = "{A: -1, B: +2, S: +3}, {from: '3', rotate: -90 deg, about: 2} or {matrix: [[…], […], […]]}"
_LISTED = re.compile(rf"[A-Za-z0-9][\w.+-]{{0,{NAME - 1}}}", re.ASCII)
"""What may be that of one of several, whose folder is named by it."""


def labels(value: object) -> object:
    """Return a mapping by text: YAML reads an unquoted 1 as a number, and a position's label is text."""
    return {str(label): entry for label, entry in value.items()} if isinstance(value, dict) else value


class UnitSection(Section):
    """The unit as its label says, no other is accepted; `serial: ask`: whoever begins a night types or scans it."""

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
    are the unit's own numbers for the positions ("3" is 3 where nothing is said), and `instructions` tell an operator
    how the unit lies at each. `positioner_options` are for a positioner from another distribution.
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


def of_each(document: dict[str, Any]) -> dict[str, Any]:
    """Return each unit's bench by serial number, its own laid over the rest; `ValueError` for none, or two alike."""
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


def build_orientations(given: Mapping[str, Any], axes: tuple[str, str, str]) -> dict[str, Orientation]:
    """Return the orientation at each position: axes, matrix, another's rotated; `ValueError` names what is wrong."""
    built: dict[str, Orientation] = {}
    for label, entry in given.items():
        if not (isinstance(entry, Mapping) and "from" in entry):
            built[label] = _absolute(label, entry, axes)
    for label, entry in given.items():
        if label not in built:
            built[label] = _rotated(label, entry, built)
    return {label: built[label] for label in given}


def _absolute(label: str, entry: object, axes: tuple[str, str, str]) -> Orientation:
    if isinstance(entry, Mapping) and set(entry) == {"matrix"}:
        return Orientation(label, _orthonormal(label, entry["matrix"]))
    if not isinstance(entry, Mapping) or set(entry) != set(axes):
        raise ValueError(f"orientations.{label}: {entry!r} is not an orientation; write it like {_FORMS}")
    directions = []
    for axis in axes:
        text = str(entry[axis]).strip()
        directions.append(text if text[:1] in {"+", "-"} else f"+{text}")
        if directions[-1][1:] not in {"1", "2", "3"} or isinstance(entry[axis], float | bool):
            raise ValueError(
                f"orientations.{label}.{axis}: {entry[axis]!r} is not a signed bench axis, such as -1 or +3"
            )
    try:
        return Orientation.from_signed_axes(label, *directions)
    except ValueError as error:
        raise ValueError(f"orientations.{label}: {', '.join(directions)} must be three different bench axes") from error


def _orthonormal(label: str, matrix: object) -> FloatArray:
    """Accept rows that are orthonormal as far as people write digits, and make them so to the last one."""
    try:
        rows = np.array(matrix, dtype=np.float64)
    except (TypeError, ValueError):
        rows = np.empty(0)
    if rows.shape != (3, 3) or not np.allclose(rows @ rows.T, np.eye(3), atol=2e-3):
        raise ValueError(f"orientations.{label}.matrix: three rows of three numbers, orthonormal, are needed")
    left, _, right = np.linalg.svd(rows)
    return np.asarray(left @ right)


def _rotated(label: str, entry: Mapping[str, Any], known: Mapping[str, Orientation]) -> Orientation:
    if set(entry) != {"from", "rotate", "about"}:
        raise ValueError(f"orientations.{label}: a rotation needs from, rotate and about, such as {_FORMS}")
    start = known.get(str(entry["from"]))
    if start is None:
        raise ValueError(
            f"orientations.{label}.from: {entry['from']!r} is not a position that is given by axes or a matrix"
        )
    if str(entry["about"]) not in {"1", "2", "3"}:
        raise ValueError(f"orientations.{label}.about: {entry['about']!r} is not a bench axis; allowed: 1, 2, 3")
    with worded(ValueError, f"orientations.{label}.rotate: "):
        angle_deg = to_number(entry["rotate"], ANGLE)
    axis = np.eye(3)[int(str(entry["about"])) - 1]
    from scipy.spatial.transform import Rotation  # imported late: it is slow, and few benches need it

    turn = Rotation.from_rotvec(np.deg2rad(angle_deg) * axis).as_matrix()
    return Orientation(label, start.axes @ turn.T)
