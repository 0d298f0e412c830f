"""What is missing, or no visit of its own, costs a thermal fit no more than itself, and is named."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from hil.analysis.thermal.document import thermal_document
from hil.analysis.thermal.fit import fit_thermal
from hil.campaign import Campaign, Collects
from hil.errors import InputError
from hil.solve import repeats, solve_campaign
from tests.hil.analysis.thermal.nights import rotor_night, scaled
from tests.hil.solve.runs_of_a_unit import campaign


def one_run(campaign: Campaign) -> Campaign:
    """Return the campaign with all its collects in one run."""
    collects = campaign.sensors[2]
    run = np.ones_like(collects.conditions.run)
    return replace(campaign, sensors={2: replace(collects, conditions=replace(collects.conditions, run=run))})


def refused(campaign: Campaign, change: dict[str, np.ndarray]) -> Campaign:
    """Return the campaign with other condition columns."""
    collects = campaign.sensors[2]
    conditions = replace(collects.conditions, columns=change)
    return replace(campaign, sensors={2: Collects(conditions, collects.rates_deg_per_hr, collects.rates_se_deg_per_hr)})


@pytest.mark.slow
def test_a_temperature_without_every_position_is_left_out_and_named() -> None:
    """Collect 3 never came about at -29.7 °C: MU is not known there."""
    night = rotor_night(np.random.default_rng(10), {"BA": lambda t: 15.0 * scaled(t)})
    collects = night.sensors[2]
    temperature = collects.conditions.columns["temperature_degC"]
    keep = ~((temperature < -25) & (collects.conditions.position == "3"))
    sensor = fit_thermal(replace(night, sensors={2: collects.rows(keep)})).sensors[2]
    assert sensor.layout.range_degC[0] > -20
    assert any("-29.7 °C; left out" in note for note in sensor.notes)


@pytest.mark.slow
def test_one_missing_collect_costs_its_run_and_not_its_temperature() -> None:
    """All positions and temperatures are one system: the other two collects of the run still count."""
    night = rotor_night(np.random.default_rng(11), {"BA": lambda t: 15.0 * scaled(t)})
    kept = replace(night, sensors={2: night.sensors[2].rows(np.arange(72) != 2)})
    assert fit_thermal(kept).sensors[2].layout.range_degC[0] < -29


@pytest.mark.slow
def test_without_repeats_and_standard_errors_the_misfit_is_the_noise() -> None:
    """One run per temperature, nothing stated: the curve is found, its errors are of the right size, and it is said."""
    night = rotor_night(np.random.default_rng(15), {"BB": lambda t: 40.0 * scaled(t)}, runs=1, run_to_run={})
    collects = night.sensors[2]
    silent = replace(collects, rates_se_deg_per_hr=np.full(collects.rates_deg_per_hr.shape, np.nan))
    sensor = fit_thermal(replace(night, sensors={2: silent})).sensors[2]
    assert sensor.parameters["BB"].form == "linear"
    assert sensor.parameters["BB"].coefficients.se[0] == pytest.approx(0.93 / np.sqrt(2 * 8), rel=0.6)
    assert all(each.finding == "constant" for name, each in sensor.parameters.items() if name != "BB")
    assert any("what the curves leave is taken for noise" in note for note in sensor.notes)


@pytest.mark.slow
def test_without_repeats_and_standard_errors_a_slope_is_no_noise_of_its_own_bound() -> None:
    """Of five runs on a line what the line leaves is noise: a slope is found, or bounded by a few times itself."""
    found, of_line, of_flat = 0, [], []
    for seed in range(6):
        made = campaign(5, 1, seed)
        rows = made.sensors[2]
        silent = np.full_like(rows.rates_deg_per_hr, np.nan)
        slope = np.outer(rows.conditions.columns["setpoint_degC"], [0.5, 0.3])
        for bounds, rates in ((of_line, rows.rates_deg_per_hr), (of_flat, rows.rates_deg_per_hr - slope)):
            unstated = replace(rows, rates_deg_per_hr=rates, rates_se_deg_per_hr=silent)
            sensor = fit_thermal(replace(made, sensors={2: unstated})).of(2)
            bounds.append(sensor.parameters["BA"].largest_change)
            found += sensor.parameters["BA"].changes
            assert sensor.rate_noise_deg_per_hr is None
    assert found >= 4, "of six that change by 40 deg/hr, and six that do not"
    assert max(of_line) < 80.0
    assert max(of_flat) < 40.0


@pytest.mark.parametrize("lost", [[2, 5, 8], [0, 4, 8]])
def test_a_temperature_that_no_run_tells_is_left_out_and_its_repeats_are_not(lost: list[int]) -> None:
    """Values and their uncertainty at the others are those of hil solve, to which all repeats tell something."""
    night = rotor_night(np.random.default_rng(12), {})
    rates = night.sensors[2].rates_deg_per_hr.copy()
    rates[lost] = np.nan
    night = replace(night, sensors={2: replace(night.sensors[2], rates_deg_per_hr=rates)})
    means, fit = repeats(night, solve_campaign(night))[2].means[1:], fit_thermal(night).of(2)
    assert "no run tells every parameter at -29.7 °C; left out" in fit.notes[0]
    for name, each in fit.parameters.items():
        assert each.values.values == pytest.approx([mean.values[name].value for mean in means])
        assert each.values.se == pytest.approx([mean.values[name].sd for mean in means])


@pytest.mark.slow
def test_a_run_in_which_the_unit_warmed_up_is_one_visit() -> None:
    """Its parameters stand at the temperature of most of its collects: none is asked of those that it passed."""
    night = rotor_night(np.random.default_rng(12), {})
    with pytest.raises(
        InputError, match="1 temperature at which a run tells every parameter; at least three are needed"
    ):
        fit_thermal(refused(one_run(night), {"temperature_degC": np.linspace(20.0, 48.0, 72)}))
    first = np.tile([-6.0, 0.0, 0.0], 24)  # each run began where the one before it had been
    shown = night.sensors[2].conditions.columns["temperature_degC"]
    fit = fit_thermal(refused(night, {"temperature_degC": shown + first})).of(2)
    assert fit.layout.stations.number.tolist() == fit_thermal(night).of(2).layout.stations.number.tolist()


@pytest.mark.slow
def test_what_stands_in_for_a_thermometer_stands_in_for_a_curve_too() -> None:
    """The setpoint alone; or, in a run in which it was silent, what the unit showed through the same setpoint."""
    night = rotor_night(np.random.default_rng(12), {"BA": lambda t: 15.0 * scaled(t)})
    shown = night.sensors[2].conditions.columns["temperature_degC"]
    setpoint = 5.0 * np.round(shown / 5.0)
    silent = np.where(night.sensors[2].conditions.run == 5, np.nan, shown + 8.0)
    alone = fit_thermal(refused(night, {"setpoint_degC": setpoint}))
    gap = fit_thermal(refused(night, {"setpoint_degC": setpoint, "temperature_degC": silent}))
    for fit, whose, off in ((alone, "setpoint_degC", 0.0), (gap, "temperature_degC", 8.0)):
        (document,) = thermal_document(fit)["sensors"]
        assert document["temperature_of"] == whose
        assert document["range_degC"] == pytest.approx([shown.min() + off, shown.max() + off], abs=2.6)
        assert fit.sensors[2].parameters["BA"].form == "linear"


def test_what_cannot_be_fitted_is_refused() -> None:
    """No temperatures, two temperatures, a model that has a dependence of its own."""
    night = rotor_night(np.random.default_rng(12), {})
    with pytest.raises(InputError, match="lacks the column temperature_degC"):
        fit_thermal(refused(night, {}))
    with pytest.raises(InputError, match="2 temperatures at which a run tells every parameter; at least three"):
        fit_thermal(refused(night, {"temperature_degC": np.repeat([0.0, 20.0], 36)}))
    stuck = {"temperature_degC": np.full(72, 20.0), "setpoint_degC": np.repeat([0.0, 20.0, 40.0], 24)}
    with pytest.raises(InputError, match="°C at every setpoint: look at that column"):
        fit_thermal(refused(night, stuck))
    with pytest.raises(InputError, match="finds the dependence itself"):
        fit_thermal(night, "matrix-6-thermal")
    with pytest.raises(InputError, match="did you mean 'matrix-6'"):
        fit_thermal(night, "matrx-6")
