"""A bench file to begin with: six answers put into a template, and read back as any bench file is."""

import re
from collections.abc import Mapping

from drivers.chambers import CHAMBER_DRIVERS
from drivers.frames.description import StreamDescription, load_description
from hil.config.bench import parse_bench
from hil.errors import InputError, worded
from hil.files.page import filled
from hil.files.strict import find_config, near
from hil.files.units import TEMPERATURE, to_number

EXAMPLES = {"chamber": "espec", "chamber_port": "/dev/ttyUSB1", "limits": "-40 to 85 degC"}
EXAMPLES |= {"unit": "stim300", "unit_port": "/dev/ttyUSB0", "latitude": "59.9 deg"}
"""What only somebody at the bench knows, as it is typed: names, ports, temperatures with their unit."""


def new_bench(name: str, given: Mapping[str, str]) -> str:
    """Return a bench file's text, with examples for what is not given; `InputError` where it would be refused."""
    asked = EXAMPLES | {key: answer for key, answer in given.items() if answer}
    allowed = sorted(set(CHAMBER_DRIVERS) - {"box"})
    if asked["chamber"] not in allowed:
        raise InputError(f"{asked['chamber']!r} is no chamber that hil knows{near(asked['chamber'], allowed)}")
    description = load_description(find_config("imus", asked["unit"]))
    low, high = _limits(asked["limits"])
    text = filled(
        "hil.bench",
        "new_bench.yaml.j2",
        name=name,
        asked=asked,
        unit=description,
        chamber=CHAMBER_DRIVERS[asked["chamber"]],
        sensors=_triads(description, asked["unit"]),
        low=low,
        high=high,
    )
    parse_bench(text, f"{name}.yaml")
    return text


def _limits(text: str) -> list[float]:
    """Read "-40 to 85 degC", °C; the unit may stand once or twice, and must: a chamber may be one in °F."""
    low, to, high = text.partition(" to ")
    unit = re.sub(r"[-+.\d\s]", "", high)
    if not (to and unit):
        raise InputError(f"limits: {text!r} is not a range with its unit; write -40 to 85 degC")
    typed = [each if re.search(r"[a-zA-Z]", each) else f"{each} {unit}" for each in (low, high)]
    with worded(InputError, "limits: "):
        return [round(to_number(each, TEMPERATURE), 3) for each in typed]


def _triads(description: StreamDescription, unit: str) -> dict[int, dict[str, str]]:
    """Return the channel about each axis, by sensor; raise `InputError` for a unit that is no triad."""
    sensors = {} if description.roles is None else description.roles.sensors
    found = {n: {name[-1]: name for name in of.rates if name[-1] in "XYZ"} for n, of in sensors.items()}
    if not found or any(len(channels) < 3 for channels in found.values()):
        raise InputError(f"{unit}: not a triad: copy the bench file simulated, which has such a unit's positions")
    return found
