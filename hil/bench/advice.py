"""What looking at a bench finds, and what to do about what is wrong: for the technician who stands in front of it."""

import shlex
from dataclasses import dataclass
from typing import Literal

from drivers.errors import DeviceError, DeviceTimeout, TransportError, WrongDevice
from drivers.strict_yaml import packaged
from hil.config import Bench

Device = Literal["unit", "chamber"]

_GUIDES: dict[Device, str] = {"unit": "hil docs wire-an-imu", "chamber": "hil docs wire-a-chamber"}
ADVICE = packaged("hil.bench", "advice.yaml")
_PARITY = {"N": "none", "E": "even", "O": "odd"}


@dataclass(frozen=True)
class Finding:
    """What was looked at, whether it is `good` for a night to begin, and what to do (`advice`) if anything."""

    subject: str
    good: bool
    message: str
    advice: str = ""


def advice_for(error: DeviceError, bench: Bench, device: Device) -> str:
    """Return what to do about `error`, which came from `device`."""
    section, said, words = bench.chamber, ADVICE[device], str(error)
    if "no simulation section" in words:
        return str(ADVICE["simulated"])
    kinds = [kind.__name__ for kind in type(error).__mro__]
    if device == "chamber" and isinstance(error, TransportError):
        advice = closed_port_advice(str(error), section.port, bench)
    elif device == "chamber" and isinstance(error, WrongDevice) and ("°F" in words or "unit" in words):
        advice = said["unit"]
    elif device == "unit" and isinstance(error, DeviceTimeout) and "nothing arrived" in words:
        advice = said["nothing arrived"]
    else:
        advice = next((said[kind] for kind in kinds if kind in said), said.get(_way(section.port), ""))
    return f"{advice.format(section=section, parity=_PARITY[section.line.parity])} ({_GUIDES[device]})".lstrip()


def closed_port_advice(words: str, port: str, bench: Bench) -> str:
    """Return what to do about a port that does not open, where the error does not say it itself in its `words`."""
    said = ADVICE["closed_port"]
    if bench.simulated and "no such port" in words:
        return str(ADVICE["no_simulation"]).format(bench=shlex.quote(bench.source or bench.name))
    return str(next((said[each] for each in said if each in words), said.get(_way(port), "")))


def _way(port: str) -> str:
    return "network" if port.startswith(("socket://", "rfc2217://")) else "line"
