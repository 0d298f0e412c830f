"""A port as a bench file writes it: a path, a network address, or a simulated device in this process."""

import re
from typing import Annotated
from urllib.parse import urlsplit

from pydantic import BeforeValidator

SIMULATED_SCHEME = "sim://"
COM_PORT = re.compile(r"(?:\\\\\.\\)?COM\d+", re.IGNORECASE)
"""How Windows calls a serial port: COM3, or \\\\.\\COM12."""
OWN_SCHEME = "own://"
"""A chamber whose driver opens it by itself, through a library of others: own://NAME."""
_SCHEMES = ("sim", "socket", "rfc2217")


def unit_port(unit: str) -> str:
    """Return the key of a unit's port in the bench file; its name is empty where the bench lists none."""
    return f"units.{unit}.port" if unit else "imu.port"


def _port(value: object, name: str) -> str:
    text = str(value)
    if not isinstance(value, str) or not text.strip():
        raise ValueError(
            f"{value!r} is not a port; write /dev/ttyUSB0, socket://host:port, rfc2217://host:port, sim://{name}"
        )
    scheme = text.split("://", 1)[0] if "://" in text else ""
    if name == "chamber" and text.startswith(OWN_SCHEME):
        return text
    if scheme and scheme not in _SCHEMES:
        raise ValueError(f"{text!r}: ports begin with {', '.join(f'{known}://' for known in _SCHEMES)} or are a path")
    if scheme == "sim" and text != f"sim://{name}":
        raise ValueError(f"there is no simulated port {text!r}; the simulated {name} is sim://{name}")
    if scheme in {"socket", "rfc2217"}:
        parts = urlsplit(text)
        try:
            complete = bool(parts.hostname) and parts.port is not None
        except ValueError:
            complete = False
        if not complete:
            raise ValueError(f"{text!r} lacks its host or port number; write {scheme}://host:10001")
    return text


ImuPort = Annotated[str, BeforeValidator(lambda value: _port(value, "imu"))]
ChamberPort = Annotated[str, BeforeValidator(lambda value: _port(value, "chamber"))]
