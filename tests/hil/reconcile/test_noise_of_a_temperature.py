"""One temperature that is noisier than all others: that has a name, and makes no event of the runs that it has."""

from __future__ import annotations

import numpy as np
import pytest

from hil.campaign import Campaign, Conditions
from hil.model.effects.catalogue import variance_effect_by_id
from hil.reconcile import reconcile
from tests.hil.reconcile.hidden_effects import EIGHT, ROTOR, base_rates, campaign_of, lay_out


def noisy(seed: int, temperatures: tuple[float, ...], at: int | None, *, mu_rr: float = 4.0) -> Campaign:
    """Three runs of three collects each; rates at one temperature are off by up to 15 deg/hr, whatever errors say."""
    rng = np.random.default_rng(seed)
    rows = lay_out(rng, temperatures, 3, ("1", "2", "3"))
    rates = base_rates(rows, thermal=False) + 0.9 * rng.normal(size=(len(rows), 2))
    rates += rows.f[:, 2:] * mu_rr * rng.normal(size=(rows.run.max() + 1, 2))[rows.run]
    if at is not None:
        here = rows.setpoint == temperatures[at]
        rates[here] += rng.uniform(-15.0, 15.0, (int(here.sum()), 2))
    return campaign_of(rows, rates)


@pytest.mark.slow
@pytest.mark.parametrize(("at", "seed"), [(0, 1), (3, 2), (7, 3)])
def test_noise_of_one_temperature_is_named_and_nothing_jumps(at: int, seed: int) -> None:
    """In the coldest runs it was retainer noise, too little of it, and a bias that jumps at 99 %."""
    result = reconcile(noisy(seed, EIGHT, at), "matrix-6", prove=False)
    named = {effect.id: effect for effect in result.effects}
    assert {*named} == {"MU_rr", "noise_T"}
    assert named["noise_T"].shape["at_degC"] == pytest.approx(EIGHT[at], abs=0.1)
    (size,) = named["noise_T"].parameters
    assert abs(size["value"] - 15.0 / np.sqrt(3.0) / np.sqrt(60.0)) < 3.0 * size["se"]


@pytest.mark.slow
@pytest.mark.parametrize("seed", range(3))
def test_nights_that_are_as_noisy_everywhere_have_no_such_temperature(seed: int) -> None:
    """MU that is another in each run is all there is."""
    result = reconcile(noisy(seed, EIGHT, None), "matrix-6", prove=False)
    assert [effect.id for effect in result.effects] == ["MU_rr"]


def test_it_is_white_and_at_one_step_of_temperature() -> None:
    """Setpoints tell the steps; without any a thermometer's that are apart, and none where it only creeps."""

    def at(level: list[float], name: str = "setpoint_degC") -> Conditions:
        n = len(level)
        rows = np.arange(n)
        columns = {name: np.array(level)}
        known = np.ones(n, dtype=np.int64), np.array(["1"] * n), 100.0 * rows, np.full(n, 60.0)
        return Conditions(ROTOR, rows, *known, np.zeros((n, 3)), np.zeros((n, 3)), columns)

    effect = variance_effect_by_id("noise_T")
    rows = at([-20.0, -20.5, 40.0, 40.0, float("nan")])
    assert [shape["at_degC"] for shape in effect.shape_grid(rows)] == [-20.2, 40.0]
    covariance = effect.covariance(rows, {"at_degC": 40.0})
    assert np.diag(covariance) == pytest.approx(np.repeat([0.0, 60.0, 0.0], [4, 4, 2]))
    assert np.array_equal(covariance, np.diag(np.diag(covariance)))
    assert len(effect.shape_grid(at([-20.0, 5.0], "temperature_degC"))) == 2
    assert not effect.shape_grid(at(list(np.arange(0.0, 40.0, 2.0)), "temperature_degC"))
    assert not effect.shape_grid(at(list(np.arange(0.0, 90.0, 5.0))))


def test_what_these_temperatures_cannot_tell_apart_has_both_names() -> None:
    """Of one temperature below 5 °C nobody knows whether the cold is noisy, or that setpoint."""
    result = reconcile(noisy(3, (-20.0, 10.0, 40.0), 0, mu_rr=0.0), "matrix-6", prove=False)
    (effect,) = result.effects
    ((other, probability),) = ((rival.id, rival.probability) for rival in effect.confusable_with)
    assert (effect.id, other, effect.kind) == ("hash", "noise_T", "ambiguous")
    assert probability == pytest.approx(effect.probability / 3.0)  # any of three setpoints may be it
