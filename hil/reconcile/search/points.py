"""Models of a block's noise: what scatters by how much, and how probable that is before the data."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from hil.campaign import BoolArray, FloatArray, IntArray
from hil.model.effects.base import Parameter, VarianceEffect
from hil.reconcile.search.chains import Chain

LEVELS = {0.15: 0.3, 1.0: 0.7}
"""Share of the usual variance in every row's own, with its prior: standard errors leave out what differs by collect."""


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

    def take(self, index: IntArray) -> Points:
        """Return some of the points."""
        return Points(*(getattr(self, name)[index] for name in self.__dataclass_fields__))

    def beside(self, other: Points) -> Points:
        """Return these points and others."""
        return Points(*(np.concatenate([getattr(own, n) for own in (self, other)]) for n in self.__dataclass_fields__))
