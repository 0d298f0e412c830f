"""What is known of several sensors before the data: a name of the one speaks for the other's, and not for any shape."""

from __future__ import annotations

from dataclasses import dataclass, field
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from hil.model.effects.prior import COMMON, SHARED
from hil.reconcile.search.points import SAME_SHAPE
from hil.reconcile.search.together import log_prior

ODDS = -5.0


@dataclass
class Asked:
    """A sensor that may have a step of `places` shapes, and what changes nothing of a name that has one shape."""

    places: int
    common: bool = False
    terms: list[Any] = field(default_factory=list)

    def __post_init__(self) -> None:
        effect = SimpleNamespace(common_to_sensors=self.common)
        for name, many in (("step", self.places), ("constant", 1)):
            for place in range(many):
                candidate = SimpleNamespace(form="constant", shape={"from_run": float(place)}, effect=effect)
                self.terms.append(SimpleNamespace(shared=name, is_mistake=False, candidate=candidate))

    def priced(self, chosen: tuple[int, ...]) -> list[float]:
        """The same odds of each."""
        return [ODDS] * len(chosen)


def prior(first: tuple[int, ...], second: tuple[int, ...], **asked: Any) -> float:
    """Log prior odds of one set in each of two sensors."""
    searches: Any = {1: Asked(10, **asked), 2: Asked(10, **asked)}
    return float(log_prior(searches, {1: [(), first], 2: [(), second]})[-1, -1])


def test_a_step_of_one_sensor_says_hardly_where_the_other_steps() -> None:
    """Any place in the other cost as much as the place of the first: the likeliest of ten by chance was shared."""
    alone, same, elsewhere = prior((3,), ()), prior((3,), (3,)), prior((3,), (7,))
    assert alone == pytest.approx(ODDS + np.log(SHARED * (1.0 - SHARED)))
    assert same - alone == pytest.approx(np.log(SHARED / (1.0 - SHARED)) + np.log(SAME_SHAPE + (1.0 - SAME_SHAPE) / 10))
    assert elsewhere - same == pytest.approx(-np.log(1.0 + 10 * SAME_SHAPE / (1.0 - SAME_SHAPE)))
    assert prior((7,), (3,)) == elsewhere


def test_what_has_one_shape_is_shared_as_before() -> None:
    """A name without a shape costs nothing for it; a second step of one sensor costs what it costs by itself."""
    assert prior((10,), (10,)) == pytest.approx(ODDS + 2.0 * np.log(SHARED))
    assert prior((10,), (10,), common=True) == pytest.approx(ODDS + 2.0 * np.log(COMMON))
    assert prior((3, 5), (3,)) == pytest.approx(prior((3,), (3,)) + ODDS)
    assert prior((3,), (10,)) == pytest.approx(prior((3,), ()) + prior((), (10,)))
    assert prior((), ()) == 0.0


def test_of_three_sensors_each_pays_for_a_shape_of_its_own() -> None:
    """Beside the first that has it."""
    searches: Any = {n: Asked(4) for n in (1, 2, 3)}
    every = log_prior(searches, {n: [(), (0,), (1,)] for n in (1, 2, 3)})
    assert every.shape == (3, 3, 3)
    assert every[0, 1, 2] - every[0, 1, 1] == pytest.approx(-np.log(1.0 + 4 * SAME_SHAPE / (1.0 - SAME_SHAPE)))
    assert every[1, 2, 2] == pytest.approx(every[1, 1, 1] + 2.0 * (every[1, 1, 2] - every[1, 1, 1]))
