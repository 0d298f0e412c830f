"""What to do about what is wrong with a bench: for the technician who stands in front of it, one sentence or two.

advice_for(error, bench, "chamber")
"""

from typing import Literal

from drivers.errors import (
    CommandRefused,
    DeviceError,
    DeviceTimeout,
    ProtocolError,
    SensorFault,
    TransportError,
    WrongDevice,
)
from hil.config import Bench

Device = Literal["unit", "chamber"]

_GUIDES: dict[Device, str] = {"unit": "hil docs wire-an-imu", "chamber": "hil docs wire-a-chamber"}
_PARITY = {"N": "none", "E": "even", "O": "odd"}


def line_words(bench: Bench, device: Device, baud: int) -> str:
    """Return port and line settings as the panel or the data sheet has to agree: `/dev/ttyUSB1, 9600 baud 8E1`."""
    port = bench.imu.port if device == "unit" else bench.chamber.port
    if port.startswith(("socket://", "sim://")):
        return port
    if device == "unit":
        return f"{port}, {baud} baud 8N1"
    line = bench.chamber.line
    return f"{port}, {line.baud} baud {line.data_bits}{line.parity}1"


def advice_for(error: DeviceError, bench: Bench, device: Device) -> str:
    """Return what to do about `error`, which came from `device`."""
    if "no simulation section" in str(error):
        return "copy the simulation section from the bench file that is being simulated, or connect the real device"
    advice = _unit_advice(error) if device == "unit" else _chamber_advice(error, bench)
    return f"{advice} ({_GUIDES[device]})"


def closed_port_advice(port: str) -> str:
    """Return what to do about a port that does not open."""
    if port.startswith(("socket://", "rfc2217://")):
        return (
            "ping the address; see that the device server is powered and serves that port number, and that nobody else "
            "is connected to it: most of them take one client"
        )
    return (
        "plug the adapter in, see which port it becomes (ls /dev/serial/by-id), write that path in the bench file, and "
        "close every other program that has it open"
    )


def _unit_advice(error: DeviceError) -> str:
    if isinstance(error, WrongDevice):
        return "connect the unit that the bench file names under unit, or correct model and serial there"
    if isinstance(error, TransportError):
        return "see that the cable sits and the adapter is powered; where it is on a hub, try another socket"
    if isinstance(error, DeviceTimeout) and "nothing arrived" in str(error):
        return (
            "see that the unit is powered and streams by itself; swap the receive pair (RS-422: A and B); check that "
            "imu.port is the unit's port and not the chamber's"
        )
    if isinstance(error, DeviceTimeout | ProtocolError):
        return (
            "compare imu.baud with the unit's setting, and imu.description with what the unit is: bytes without one "
            "good frame are nearly always the wrong baud rate"
        )
    return "switch the unit off and on, wait until it streams, and check again"


def _chamber_advice(error: DeviceError, bench: Bench) -> str:
    section = bench.chamber
    if isinstance(error, WrongDevice):
        if "°F" in str(error) or "unit" in str(error):
            return (
                "set the display and the communication unit to °C at the chamber's panel; where the panel does show °C "
                "and the controller cannot tell, write celsius_confirmed: true under chamber"
            )
        return "see that the cable leads to this chamber, or correct chamber.model and chamber.driver in the bench file"
    if isinstance(error, SensorFault):
        return "look at the temperature on the chamber's own panel; where that is wrong too its sensor needs service"
    if isinstance(error, CommandRefused):
        return "see that the panel is in remote (computer, online) operation, is not locked, and shows no alarm"
    if isinstance(error, TransportError):
        return closed_port_advice(section.port)
    if section.port.startswith(("socket://", "rfc2217://")):
        return f"see that the controller's network interface is on and speaks what driver {section.driver} speaks"
    line = section.line
    return (
        f"set the panel to {line.baud} baud, {line.data_bits} data bits, parity {_PARITY[line.parity]}, or write what "
        f"it shows under chamber; see that remote operation is on and the address agrees; a straight cable where a "
        "crossed one is needed (pins 2 and 3) is silent like this"
    )
