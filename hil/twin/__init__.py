"""The simulated unit: physics behind the bytes that the simulated devices speak."""

from hil.twin.unit import SimulatedUnit, Truth

__all__ = ["SimulatedUnit", "Truth"]
