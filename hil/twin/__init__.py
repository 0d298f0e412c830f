"""The simulated unit: physics behind the bytes that the simulated devices speak."""

from hil.twin.unit import SimulatedUnit

__all__ = ["SimulatedUnit"]
