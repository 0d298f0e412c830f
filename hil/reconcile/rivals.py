"""Another name for the same data: what the data say of it, how usual it is, and both in words."""

import math
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

from hil.files.document import picked
from hil.reconcile.search.terms import IDENTICAL
from hil.solve.identifiability import SAME_CLASS

CERTAIN = 0.8
"""Probability from which a name is stated as the name, and a driver as what it follows."""
LEAST = 0.01
"""Rivals less probable are not listed, unless they look the same, and shapes add nothing to an interval."""
BEYOND = 3.0
"""Errors from which on what is seen beside what is explained is not chance."""
EXCLUDED = 0.001
"""What is identical in these collects is told apart where the data themselves make one so much less probable."""


@dataclass(frozen=True)
class Rival:
    """Another name for the same data: its probability, and how much of the added effect it can reproduce.

    `bayes_factor` is what the data say of it against the name, `prior_odds` how much more usual it is at the size that
    these data give it. `alone` is how probable it is without a more probable rival, where it may stand beside one.
    `terms` are its places by sensor in the likeliest set that has it. A `likely` cause is in the sensor itself, or as
    usual as the name, and no accident of the order or the heading: identical, it withholds the name. `remedy` is what
    would tell the two apart.
    """

    id: str
    probability: float
    overlap: float
    title: str = ""
    bayes_factor: float | None = None
    prior_odds: float | None = None
    terms: Mapping[int, int] = field(default_factory=dict)
    remedy: str = ""
    likely: bool = True
    alone: float | None = None

    @property
    def share(self) -> float:
        """How probable it is that this stands in the name's place, and no rival that is more probable.

        What looks the same always does, however little is left to it by how usual it is.
        """
        if self.alone is None or (self.untold and self.alone < LEAST):
            return self.probability
        return self.alone

    @property
    def beside(self) -> bool:
        """Whether it mostly stands beside a rival that is more probable."""
        return 2.0 * self.share < self.probability

    @property
    def told(self) -> float:
        """How many times as probable as the name the data make it; once, where nobody can say."""
        return 1.0 if self.bayes_factor is None else self.bayes_factor

    @property
    def alike(self) -> bool:
        """Whether it looks the same in these collects, and the data do not exclude it all the same."""
        return self.overlap > SAME_CLASS and not self.told < EXCLUDED

    @property
    def told_apart(self) -> bool:
        """Whether the data make it much more, or much less, probable than the name."""
        return self.refuted or self.told > 2.0

    @property
    def refuted(self) -> bool:
        """Whether the data make it much less probable than the name."""
        return self.told < 0.5

    @property
    def withholds(self) -> bool:
        """Whether it is as usual, or hardly less probable, and the data do not tell the two apart, or would have it."""
        same = self.alike and not self.refuted and (self.overlap > IDENTICAL or self.told_apart)
        return same and (self.likely or self.probability > 1.0 - CERTAIN)

    @property
    def untold(self) -> bool:
        """Whether it is alike and the data say no more of it than of the name."""
        return self.alike and not self.told_apart

    @property
    def in_words(self) -> str:
        """Say beside what it stands, what the data say of it, and how usual it is, as far as is known."""
        beside = "mostly beside another of these" * self.beside
        if self.prior_odds is None or not math.isfinite(self.told):
            return beside
        more = f"make it {in_times(self.told)} as probable as the first name"
        told = more if self.told_apart else "cannot tell it apart"
        size = "its size and what else it takes" if self.told_apart else "this size"
        said = f"the data {told}; by how usual it is at {size}, {in_times(self.prior_odds)} as probable"
        return f"{beside}, both together: {said}" if beside else said

    def document(self) -> dict[str, Any]:
        """Return the JSON object."""
        return picked(
            self,
            "id probability alone=share overlap title" + " bayes_factor prior_odds" * (self.bayes_factor is not None),
        )


def in_times(ratio: float) -> str:
    """Write a ratio of probabilities, no finer than anybody believes one.

    >>> in_times(0.00002), in_times(5.013), in_times(0.998)
    ('less than 0.0001 times', '5 times', 'just')
    """
    said = "less than 0.0001" if ratio < 1e-4 else f"{ratio:.2g}" if ratio < 100 else "over 100"
    return "just" if said == "1" else f"{said} times"
