"""The intervals hold the truth as often as they say, with the noise estimated from each draw."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from hil.analysis.thermal.estimate import Visits, layout_of
from hil.campaign import Collects
from tests.hil.analysis.thermal.nights import RUN_TO_RUN, WHITE, rotor_night, scaled

CURVES = {
    "BA": (20.0, 5.0),
    "BB": (-5.0, 30.0, 0.0, 5.0),
    "GSA": (55.0, 10.0),
    "GSB": (-25.0, -4.0),
    "MUA": (5.0, 10.0, -10.0),
    "MUB": (0.0,),
}


@pytest.mark.parametrize(
    ("draws", "overall", "each"),
    [(20, (0.9, 0.99), (0.7, 1.0)), pytest.param(200, (0.93, 0.97), (0.885, 0.995), marks=pytest.mark.slow)],
    ids=["20 draws", "200 draws"],
)
@pytest.mark.parametrize("run_to_run", [RUN_TO_RUN, {}], ids=["run to run", "white"])
def test_coefficients_are_covered_as_stated(
    run_to_run: dict[str, float], draws: int, overall: tuple[float, float], each: tuple[float, float]
) -> None:
    """On the published night with three runs per temperature: 93-97 % overall, no parameter far off."""
    rng = np.random.default_rng(6)
    curves = {
        name: (lambda t, c=coefficients: np.polynomial.polynomial.polyval(scaled(t), c))
        for name, coefficients in CURVES.items()
    }
    night = rotor_night(rng, curves, run_to_run={}, white=1e-9).sensors[2]
    night = replace(night, rates_se_deg_per_hr=np.full(night.rates_deg_per_hr.shape, WHITE))
    layout, _ = layout_of(2, night, None, 4.0, {})
    rates = night.rates_deg_per_hr + _scatter(rng, draws, layout.columns, night.conditions.run, run_to_run)
    rates += WHITE * rng.standard_normal(rates.shape)
    truth = np.concatenate([_about_the_middle(c, layout.middle_degC, layout.half_degC) for c in CURVES.values()])
    held = np.zeros(len(truth))
    for draw in range(draws):
        drawn = replace(layout, collects=Collects(night.conditions, rates[draw], night.rates_se_deg_per_hr))
        seen = Visits(drawn)
        found = [seen.along(place, len(own) - 1)[0] for place, own in enumerate(CURVES.values())]
        off = np.concatenate([each.values for each in found]) - truth
        held += np.abs(off) <= np.concatenate([each.half_width for each in found])
    share = held / draws
    assert overall[0] <= np.mean(share) <= overall[1]
    assert np.all(share >= each[0]), share
    assert np.all(share <= each[1]), share


def _scatter(
    rng: np.random.Generator, draws: int, columns: np.ndarray, run: np.ndarray, run_to_run: dict[str, float]
) -> np.ndarray:
    """Return what parameters that differ from run to run add to the rates, (draws, n, 2)."""
    sigma = np.array([run_to_run.get(name, 0.0) for name in CURVES])
    changes = sigma * rng.standard_normal((draws, run.max() + 1, 6))
    return np.einsum("ncp,dnp->dnc", columns, changes[:, run])


def _about_the_middle(coefficients: tuple[float, ...], middle_degC: float, half_degC: float) -> np.ndarray:
    inner = np.polynomial.Polynomial([scaled(np.array(middle_degC)), half_degC / 44.85])
    moved = np.polynomial.Polynomial(coefficients)(inner)
    return np.atleast_1d(moved.coef) if isinstance(moved, np.polynomial.Polynomial) else np.array([float(moved)])
