"""Models of a block's noise: what scatters by how much, how values of the base may follow temperature, and priors."""

from collections.abc import Mapping
from dataclasses import dataclass
from functools import cache, cached_property
from itertools import product

import numpy as np

from hil.campaign import BoolArray, Conditions, FloatArray, IntArray
from hil.model.effects.base import Parameter, VarianceEffect
from hil.reconcile.search.chains import Chain
from hil.solve.rows import Block

LEVELS = {0.15: 0.3, 1.0: 0.7}
"""Share of the usual variance in every row's own, with its prior: standard errors leave out what differs by collect."""
CALIBRATIONS = (4.0, 12.0, 36.0, 108.0, 324.0)
"""How far a value of the base follows temperature, in white noises: wide priors of what the data then settle."""
SHAPES = ((1.0, 0.0, 0.0), (0.5, 0.49, 0.01), (0.45, 0.45, 0.1), (0.0, 0.0, 1.0))
"""Shares of a straight line, of a smooth curve, and of what each temperature has for itself."""
FOLLOWS = ((0.0, 0), *product(CALIBRATIONS, range(len(SHAPES))))
"""What one value of the base may do over temperature: how far it follows, and in what shape; stand, first of all."""
SAME_SHAPE = 0.5
"""How probably what several have is of one shape in all of them: values of a sensor, or one effect in its sensors."""
SMOOTH_DEGC = 30.0
"""Over which a smooth curve forgets itself: values of a unit turn two or three times over a sweep, not more."""
Profile = tuple[tuple[float, int], ...]
"""Of every value of the base, how far it follows temperature, and in which of the shapes."""


@dataclass(frozen=True)
class Kind:
    """An effect on the scatter at one shape, as a block of rows shows it: states that make a mean variance of one.

    `unit_deg_per_hr` is the deviation that they had at unit size. It has no `name` where it is more white noise and no
    standard errors state any: that is ordinary noise.
    """

    name: str
    effect: VarianceEffect
    shape: Mapping[str, float]
    chain: Chain
    unit_deg_per_hr: float
    parameter: Parameter


@dataclass(frozen=True)
class Points:
    """Models of a block's noise, (t,) each, and the log prior within what scatters: `amount` (t, v) is of every kind.

    `sort` and `profile` are places in the noise's sorts and profiles.
    """

    sort: IntArray
    amount: FloatArray
    offset: FloatArray
    level: FloatArray
    profile: IntArray
    log_prior: FloatArray

    def __len__(self) -> int:
        return len(self.sort)

    @property
    def sizes(self) -> FloatArray:
        """What each is a model of, whatever the profile: of every kind, of an offset, and the level, (t, v + 2)."""
        return np.column_stack([self.amount, self.offset, self.level])

    @cached_property
    def keys(self) -> list[bytes]:
        """What tells them from others, whatever the profile."""
        return [own.tobytes() for own in self.sizes]

    @property
    def told_by(self) -> list[tuple[bytes, int]]:
        """What tells them from others, with the profile."""
        return list(zip(self.keys, self.profile.tolist(), strict=True))

    def quieter(self, than: int) -> BoolArray:
        """Tell which are as one of them, but for one thing that scatters a quarter as much, or not at all, (t,)."""
        own, sizes = self.sizes[than], self.sizes
        less, other = (sizes == 0.0) | np.isclose(sizes, 0.25 * own, rtol=0.2), sizes != own
        one = (np.count_nonzero(other, axis=1) == 1) & np.all(~other | less, axis=1)
        return np.asarray(one & (self.profile == self.profile[than]))

    def take(self, index: IntArray) -> "Points":
        """Return some of the points."""
        return Points(*(getattr(self, name)[index] for name in self.__dataclass_fields__))

    def beside(self, other: "Points") -> "Points":
        """Return these points and others."""
        return Points(*(np.concatenate([getattr(own, n) for own in (self, other)]) for n in self.__dataclass_fields__))


@cache
def log_profile(profile: Profile) -> float:
    """Log prior of what the values of the base do: some way that is the unit's, of which some of them depart."""
    alone = (1.0 - SAME_SHAPE) / len(FOLLOWS)
    alike = [np.prod([alone + SAME_SHAPE * (own == way) for own in profile]) for way in FOLLOWS]
    return float(np.log(np.mean(alike)))


def values_over_temperature(
    block: Block, conditions: Conditions, order: IntArray
) -> tuple[FloatArray, list[FloatArray]]:
    """Return the base's values anew at each temperature (N, r), and factors (S, S) of every shape over temperature.

    Where nobody knows the temperature, all shapes but the last are one value.
    """
    stations = np.unique(block.station)
    laid = block.at_each_temperature(block.values / np.sqrt(np.mean(block.values**2, axis=0)))[order]
    temperature = conditions.columns.get("temperature_degC")
    known = temperature is not None and bool(np.all(np.isfinite(temperature[block.rows])))
    own = temperature[block.rows] if known and temperature is not None else np.zeros(len(block.y))
    centre = np.array([np.mean(own[block.station == k]) for k in stations])
    mean, spread = float(np.mean(own)), float(own.std())
    line = (centre - mean) / max(spread, 1.0)
    curve = np.exp(-0.5 * (np.subtract.outer(centre, centre) / SMOOTH_DEGC) ** 2)
    of_all = [np.outer(line, line), curve, np.eye(len(stations))]
    return laid, [_root(sum(share * part for share, part in zip(shape, of_all, strict=True))) for shape in SHAPES]


def _root(covariance: FloatArray) -> FloatArray:
    """Return F with FF' a covariance, which may be singular."""
    values, vectors = np.linalg.eigh(covariance)
    return np.asarray(vectors * np.sqrt(np.maximum(values, 0.0)))
