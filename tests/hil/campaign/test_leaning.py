"""A position in which the unit lies otherwise than f says is told from the others, whatever a bench allows."""

from __future__ import annotations

import numpy as np
import pytest

from hil.campaign import Collects, Conditions
from hil.campaign.warnings import _leaning
from tests.hil.model.effect_conditions import TRIAD


@pytest.mark.parametrize(
    ("leans_deg", "own_mg", "said"),
    [
        (
            3.0,
            2.0,
            "at position p9 the accelerometers are 54 mg off f, at most others 2 mg: the unit lies there by 3.1°",
        ),
        (0.5, 2.0, ""),  # less than a degree moves hardly a rate
        (3.0, 15.0, ""),  # no more than what these accelerometers are off by anywhere
        (20.0, 2.0, ""),  # another position, which is a contradiction
    ],
)
def test_a_position_that_leans_is_said(leans_deg: float, own_mg: float, said: str) -> None:
    """By what the accelerometers show at most other positions."""
    rng, labels = np.random.default_rng(1), [f"p{k}" for k in range(2, 10)]
    ways = rng.normal(size=(2, len(labels), 3))
    f_g, across = (np.tile(each / np.linalg.norm(each, axis=1)[:, None], (2, 1)) for each in (ways[0], np.cross(*ways)))
    leans = np.deg2rad(leans_deg) * (np.tile(labels, 2) == "p9")[:, None]
    shown = np.cos(leans) * f_g + np.sin(leans) * across + 1e-3 * own_mg * across
    n = np.arange(2 * len(labels))
    columns = {f"accelerometer_{axis}_g": of for axis, of in zip("XYZ", shown.T, strict=True)}
    conditions = Conditions(
        TRIAD, n + 1, 1 + n // len(labels), np.tile(labels, 2), 60.0 * n, np.full(len(n), 60.0), f_g, 0.0 * f_g, columns
    )
    found = [each.partition(" otherwise")[0] for each in _leaning(Collects(conditions, 0.0 * f_g, np.ones_like(f_g)))]
    assert found == [said] * bool(said)
