"""The simulated unit: physics behind the bytes that the simulated devices speak."""

from __future__ import annotations

from hil.twin.unit import SimulatedUnit, Truth

__all__ = ["SimulatedUnit", "Truth"]
