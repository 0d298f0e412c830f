"""What an effect is: one small class that everything else uses.

The twin simulates with it, the solver solves for it, reconcile searches over it, the report prints it. A model is a sum
of effects. Adding one is a class with a docstring and a line in the catalogue.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Mapping
from dataclasses import dataclass
from typing import ClassVar

from hil.campaign import Conditions, FloatArray, Sensor


@dataclass(frozen=True)
class Parameter:
    """A linear parameter: its name, unit, and the range of sizes that is physically typical (absolute values)."""

    name: str
    unit: str
    typical: tuple[float, float]


@dataclass(frozen=True)
class ShapeParameter:
    """A parameter that enters non-linearly (time constant, hysteresis width, lag) with the grid that is searched."""

    name: str
    unit: str
    grid: tuple[float, ...]


@dataclass(frozen=True)
class Base:
    """The fitted base model at each row: what effects that scale, rotate or tilt the existing terms need.

    `bias` (n, c) deg/hr, `k` (n, c, 3) deg/hr/g, `rates` (n, c) deg/hr including earth rate.
    """

    bias: FloatArray
    k: FloatArray
    rates: FloatArray


class Effect(ABC):
    """A named physical effect on the pickoff rates. Subclasses are stateless; values live in a model."""

    id: ClassVar[str]
    family: ClassVar[str]
    title: ClassVar[str]
    equation: ClassVar[str]
    parameters: ClassVar[tuple[Parameter, ...]]
    shapes: ClassVar[tuple[ShapeParameter, ...]] = ()
    needs: ClassVar[frozenset[str]] = frozenset()  # condition columns without which it cannot be asked about
    signature: ClassVar[str] = ""
    confusable_with: ClassVar[tuple[str, ...]] = ()
    experiment: ClassVar[str] = ""

    def applies_to(self, sensor: Sensor) -> bool:  # noqa: ARG002 (most effects apply to every sensor)
        """Whether the effect can exist in a sensor of this layout."""
        return True

    @abstractmethod
    def columns(self, conditions: Conditions, base: Base | None, shape: Mapping[str, float]) -> FloatArray:
        """Return the partial derivatives of the rates by the parameters, shape (n, c, p).

        `base` is needed by effects that act on the existing terms (scale factor, phase, tilt); `shape` gives a value
        for every shape parameter.
        """
