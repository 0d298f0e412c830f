"""A bench file to begin with: six answers put into a template, and read back as any bench file is.

text = new_bench("my-bench", Asked("espec", "/dev/ttyUSB1", "-40 to 85 degC", "stim300", "/dev/ttyUSB0", "59.9 deg"))
"""

import json
import re
from dataclasses import dataclass
from importlib.resources import files
from string import Template

from drivers.chambers import CHAMBER_DRIVERS
from drivers.frames.description import StreamDescription, load_description
from hil.config.bench import parse_bench
from hil.errors import InputError
from hil.files.strict import find_config, near
from hil.files.units import TEMPERATURE, to_number

_POSITIONS = {
    "x-up": "{X: +1, Y: +2, Z: +3}",
    "x-down": "{from: x-up, rotate: 180 deg, about: 2}",
    "y-up": "{X: -2, Y: +1, Z: +3}",
    "y-down": "{X: +2, Y: -1, Z: +3}",
    "z-up": "{X: -3, Y: +2, Z: +1}",
    "z-down": "{X: +3, Y: +2, Z: -1}",
}
_BEYOND_DEGC = 10.0  # of the chamber's limits, for what the unit's own thermometer may show


@dataclass(frozen=True)
class Asked:
    """What only somebody at the bench knows, as it is typed: names, ports, temperatures with their unit."""

    chamber: str
    chamber_port: str
    limits: str
    unit: str
    unit_port: str
    latitude: str
    positioner: str = "operator"


def new_bench(name: str, asked: Asked) -> str:
    """Return the text of a bench file; raise `InputError` where it would be refused, in the words of that."""
    if asked.chamber not in CHAMBER_DRIVERS or asked.chamber == "box":
        allowed = sorted(set(CHAMBER_DRIVERS) - {"box"})
        raise InputError(f"{asked.chamber!r} is no chamber that hil knows{near(asked.chamber, allowed)}")
    description = load_description(find_config("imus", asked.unit))
    low, high = _limits(asked.limits)
    text = Template(files("hil.bench").joinpath("new_bench.yaml").read_text("utf-8")).substitute(
        name=name,
        file=f"{name}.yaml",
        unit=description.name,
        unit_quoted=json.dumps(description.name),
        chamber_title=CHAMBER_DRIVERS[asked.chamber].title,
        latitude=json.dumps(asked.latitude),
        sensors=_sensors(description, asked.unit),
        description=json.dumps(asked.unit),
        imu_port=json.dumps(asked.unit_port),
        positioner=asked.positioner,
        driver=asked.chamber,
        chamber_port=json.dumps(asked.chamber_port),
        low=f"{low:g} degC",
        high=f"{high:g} degC",
        unit_low=f"{low - _BEYOND_DEGC:g} degC",
        unit_high=f"{high + _BEYOND_DEGC:g} degC",
    )
    parse_bench(text, f"{name}.yaml")
    return text


def _limits(text: str) -> tuple[float, float]:
    """Read "-40 to 85 degC", °C; a unit may stand once or twice."""
    low, to, high = text.partition(" to ")
    unit = re.sub(r"[-+.\d\s]", "", high) or "degC"
    if not to:
        raise InputError(f"limits: {text!r} is not a range; write -40 to 85 degC")
    try:
        with_unit = [each if re.search(r"[a-zA-Z]", each) else f"{each} {unit}" for each in (low, high)]
        return to_number(with_unit[0], TEMPERATURE), to_number(with_unit[1], TEMPERATURE)
    except ValueError as error:
        raise InputError(f"limits: {error}") from None


def _sensors(description: StreamDescription, unit: str) -> str:
    """Return the sensors of a triad, whose channels end with their axis; raise `InputError` for another unit."""
    lines = []
    for number, sensor in description.roles.sensors.items() if description.roles else ():
        channels = {axis: name for name in sensor.rates for axis in "XYZ" if name.endswith(axis)}
        if len(channels) < 3:
            raise InputError(f"{unit}: not a triad: copy the bench file simulated, which has such a unit's positions")
        lines += [f"  {number}:", "    axes: [X, Y, Z]"]
        lines += [f"    channels: {{{', '.join(f'{name}: {axis}' for axis, name in channels.items())}}}"]
        lines += ["    orientations:", *(f"      {label}: {lies}" for label, lies in _POSITIONS.items())]
    return "\n".join(lines) + "\n"
