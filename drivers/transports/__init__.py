"""Bytes, lines and Modbus frames with deadlines."""

from drivers.transports.serial_port import open_port
from drivers.transports.transport import Transport

__all__ = ["Transport", "open_port"]
