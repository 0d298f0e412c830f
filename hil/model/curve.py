"""A number that may depend on temperature: constant, polynomial, or a table interpolated without overshoot.

    >>> Constant(unit="deg/hr", value=22.08).at([20.0])
    array([22.08])
    >>> Polynomial(unit="deg/hr", polynomial=(10.0, 0.85), reference_degC=25.0).at([35.0])
    array([18.5])
    >>> Table(unit="deg/hr", table={"temperature_degC": [0.0, 20.0], "value": [1.0, 3.0]}).at([-10.0, 10.0])
    array([1., 2.])

Tables are monotone piecewise cubics (PCHIP), because a polynomial through Table 1 of RD-GC-86-1 does not fit it and
swings between the plateaus. Outside its table a curve keeps the end value: extrapolated cubics are no knowledge.

A curve that was fitted to measurements says where they were made, `valid_degC`, and refuses to be asked outside.
"""

from __future__ import annotations

from abc import abstractmethod
from functools import cached_property
from typing import TYPE_CHECKING, Annotated, Any, ClassVar, Self

import numpy as np
from numpy.typing import ArrayLike
from pydantic import Discriminator, Field, FiniteFloat, NonNegativeFloat, Tag, model_validator

from hil.campaign import FloatArray
from hil.errors import InputError
from hil.files.strict import Section

if TYPE_CHECKING:
    from scipy.interpolate import PchipInterpolator

BEYOND_DEGC = 1.0
"""How far outside its range a fitted curve still answers: setpoints and thermometers repeat no better."""


class _Curve(Section):
    """What every curve has: its unit, and (for a fitted one) the lowest and highest temperature measured."""

    unit: str
    valid_degC: tuple[FiniteFloat, FiniteFloat] | None = None

    @model_validator(mode="after")
    def _range_rises(self) -> Self:
        if self.valid_degC is not None and self.valid_degC[0] > self.valid_degC[1]:
            raise ValueError("valid_degC must give the lowest temperature first")
        return self

    def at(self, temperature_degC: ArrayLike) -> FloatArray:
        """Return the value at each temperature, shape (n,); raise `InputError` outside the range of measurement."""
        temperatures = np.asarray(temperature_degC, dtype=np.float64)
        low, high = self.valid_degC or (-np.inf, np.inf)
        outside = temperatures[(temperatures < low - BEYOND_DEGC) | (temperatures > high + BEYOND_DEGC)]
        if outside.size:
            raise InputError(
                f"{outside[0]:.4g} °C is outside {low:g} to {high:g} °C, where this curve ({self.unit}) was measured; "
                "it is not extrapolated"
            )
        return np.asarray(self._at(temperatures))

    @abstractmethod
    def _at(self, temperature_degC: FloatArray) -> ArrayLike:
        """Return the value at each temperature, (n,), all of them in the range of measurement."""


class Constant(_Curve):
    """The same value at every temperature, with its standard error where one is known."""

    value: FiniteFloat
    se: NonNegativeFloat | None = None
    depends_on_temperature: ClassVar[bool] = False

    def _at(self, temperature_degC: FloatArray) -> ArrayLike:
        return np.full(temperature_degC.shape, self.value)

    def scaled(self, factor: float) -> Constant:
        """Return `factor` times the curve, its error too."""
        return self.model_copy(update={"value": factor * self.value, "se": self.se and factor * self.se})

    def slope_at(self, temperature_degC: ArrayLike) -> FloatArray:
        """Return the derivative by temperature, shape (n,), per °C: zero."""
        return np.zeros(np.shape(temperature_degC))


class Polynomial(_Curve):
    """Σ c_k (T − T0)^k, the coefficient of the lowest power first."""

    polynomial: tuple[FiniteFloat, ...] = Field(min_length=1)
    reference_degC: FiniteFloat
    se: tuple[NonNegativeFloat, ...] | None = None

    @model_validator(mode="after")
    def _one_error_per_coefficient(self) -> Polynomial:
        if self.se is not None and len(self.se) != len(self.polynomial):
            raise ValueError("se must have one entry per coefficient of polynomial")
        return self

    @property
    def depends_on_temperature(self) -> bool:
        """True where a power of temperature has a coefficient."""
        return len(self.polynomial) > 1

    def _at(self, temperature_degC: FloatArray) -> ArrayLike:
        return np.polynomial.polynomial.polyval(temperature_degC - self.reference_degC, self.polynomial)

    def scaled(self, factor: float) -> Polynomial:
        """Return `factor` times the curve, its errors too."""
        return self.model_copy(
            update={"polynomial": _times(self.polynomial, factor), "se": self.se and _times(self.se, factor)}
        )

    def slope_at(self, temperature_degC: ArrayLike) -> FloatArray:
        """Return the derivative by temperature, shape (n,), per °C."""
        derivative = np.polynomial.polynomial.polyder(np.asarray(self.polynomial))
        offset = np.asarray(temperature_degC, dtype=np.float64) - self.reference_degC
        return np.asarray(np.polynomial.polynomial.polyval(offset, derivative))


class TableRows(Section):
    """Temperatures, strictly rising, and the value at each."""

    temperature_degC: tuple[FiniteFloat, ...] = Field(min_length=2)
    value: tuple[FiniteFloat, ...]
    se: tuple[NonNegativeFloat, ...] | None = None

    @model_validator(mode="after")
    def _columns_agree(self) -> TableRows:
        if len(self.value) != len(self.temperature_degC):
            raise ValueError("value must have as many entries as temperature_degC")
        if self.se is not None and len(self.se) != len(self.value):
            raise ValueError("se must have as many entries as value")
        if np.any(np.diff(self.temperature_degC) <= 0.0):
            raise ValueError("temperature_degC must rise strictly")
        return self


class Table(_Curve):
    """A PCHIP curve through tabulated values; the end values hold outside the table."""

    table: TableRows
    depends_on_temperature: ClassVar[bool] = True

    @cached_property
    def _curve(self) -> PchipInterpolator:
        from scipy.interpolate import PchipInterpolator  # imported late: it is slow, and only a table needs it

        return PchipInterpolator(self.table.temperature_degC, self.table.value)

    def _at(self, temperature_degC: FloatArray) -> ArrayLike:
        low, high = self.table.temperature_degC[0], self.table.temperature_degC[-1]
        return np.asarray(self._curve(np.clip(temperature_degC, low, high)))

    def scaled(self, factor: float) -> Table:
        """Return `factor` times the curve, its errors too."""
        rows = self.table
        changes = {"value": _times(rows.value, factor), "se": rows.se and _times(rows.se, factor)}
        return Table(unit=self.unit, valid_degC=self.valid_degC, table=rows.model_copy(update=changes))

    def slope_at(self, temperature_degC: ArrayLike) -> FloatArray:
        """Return the derivative by temperature, shape (n,), per °C; zero outside the table."""
        temperatures = np.asarray(temperature_degC, dtype=np.float64)
        low, high = self.table.temperature_degC[0], self.table.temperature_degC[-1]
        inside = (temperatures >= low) & (temperatures <= high)
        return np.where(inside, self._curve(np.clip(temperatures, low, high), 1), 0.0)


def _times(values: tuple[float, ...], factor: float) -> tuple[float, ...]:
    return tuple(factor * value for value in values)


def _kind(entry: Any) -> str | None:
    if isinstance(entry, Constant | Polynomial | Table):
        return type(entry).__name__
    if not isinstance(entry, dict):
        return None
    kinds = {"table": "Table", "polynomial": "Polynomial", "value": "Constant"}
    return next((kind for key, kind in kinds.items() if key in entry), None)


Curve = Annotated[
    Annotated[Constant, Tag("Constant")] | Annotated[Polynomial, Tag("Polynomial")] | Annotated[Table, Tag("Table")],
    Discriminator(
        _kind, custom_error_type="curve", custom_error_message="give one of value, polynomial or table, with its unit"
    ),
]
"""What a model file writes for a parameter; which of the three it is shows in its keys."""
