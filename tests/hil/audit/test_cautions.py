"""What is to be known of every ± is said by all who print it."""

from __future__ import annotations

import numpy as np
import pytest

from hil.analysis.thermal.fit import fit_thermal
from hil.config import load_bench
from hil.design.budget.document import Asked, budget_document
from hil.design.budget.scenes import measured_scenes
from hil.design.sequence.unit_scatter import scatter_of_unit
from hil.design.visibility.document import campaign_document, visibility_text
from hil.reconcile import reconcile
from hil.reconcile.scattering import what_scatters
from hil.solve import repeats, solve_campaign
from tests.hil.solve.runs_of_a_unit import campaign, up_and_down, with_column, with_rates
from tests.hil.solve.test_between_runs import after, visits_again, with_mua
from tests.hil.solve.test_what_differs import noisy_in_the_cold


@pytest.mark.slow
@pytest.mark.usefixtures("searched_once")
def test_that_no_one_uncertainty_holds_at_each_temperature_is_said_by_all() -> None:
    """The bias of each run at the coldest is another by tens of deg/hr, elsewhere it hardly differs."""
    one = campaign(12, 4, seed=3, scatter=0.5)
    cold = one.sensors[2].conditions.run <= 4
    away = np.repeat([25.0, -30.0, 15.0, -10.0], np.sum(cold) // 4)
    rates = one.sensors[2].rates_deg_per_hr.copy()
    rates[cold, 0] += away
    made = with_rates(one, rates)
    shown, scenes = repeats(made, solve_campaign(made)), measured_scenes(made, load_bench("simulated"), {})
    (said,) = shown[2].uneven_in_words
    assert said.startswith("BA (most at")
    assert said in shown[2].sentences()
    budget = budget_document(scenes, "t", Asked(draws=100), observed=shown)["sensors"]["2"]
    assert said in budget["as_solved_for"]
    assert said in visibility_text(campaign_document(made, changes=()))
    assert f"sensor 2: {said}" in fit_thermal(made).sensors[2].notes
    assert any(line.endswith(said) for line in what_scatters(made).sentences())
    assert any(note.endswith(said) for note in reconcile(made, "matrix-6", prove=False).notes)


def test_that_noise_is_larger_at_one_temperature_is_said_by_all() -> None:
    """By whoever pools a ± over all temperatures, whether what shows it is residuals or what runs differ by."""
    made = noisy_in_the_cold(4.0, 1)
    shown, scenes = repeats(made, solve_campaign(made)), measured_scenes(made, load_bench("simulated"), {})
    every = [each for each in shown[2].uneven_in_words if each.startswith("averages of ")]
    assert every
    assert all(said.endswith("their standard errors at -20.0 °C: no one ± holds at each") for said in every)
    assert {*every} < {*shown[2].sentences()}
    assert len({*shown[2].cautions}) == len(shown[2].cautions)
    assert {*every} <= {
        *budget_document(scenes, "t", Asked(draws=100), observed=shown)["sensors"]["2"]["as_solved_for"]
    }
    assert {f"sensor 2: {said}" for said in every} <= {*fit_thermal(made).sensors[2].notes}
    assert {*every} <= {*scatter_of_unit(made)[2].said}


@pytest.mark.slow
def test_what_visits_differ_by_is_said_by_all_whose_uncertainties_hold_it() -> None:
    """The way to 25 °C moves the bias by 40 deg/hr: hil thermal, which takes that off, says so in its own words."""
    one = up_and_down(0)
    of, rates = one.sensors[2].conditions, one.sensors[2].rates_deg_per_hr.copy()
    rates[:, 0] += 20.0 * (of.columns["setpoint_degC"] == 25.0) * np.where(of.run <= 5, 1.0, -1.0)
    made = with_rates(one, rates)
    shown, scenes = repeats(made, solve_campaign(made)), measured_scenes(made, load_bench("simulated"), {})
    (said,) = shown[2].visits_in_words
    assert said in shown[2].sentences()
    assert said in budget_document(scenes, "t", Asked(draws=100), observed=shown)["sensors"]["2"]["as_solved_for"]
    assert any("which the means and ± of hil solve hold" in note for note in fit_thermal(made).sensors[2].notes)


@pytest.mark.slow
@pytest.mark.usefixtures("searched_once")
@pytest.mark.parametrize("recorded", [True, False])
def test_what_explains_that_runs_differ_is_said_by_all_who_take_it_for_scatter(recorded: bool) -> None:
    """MUA jumps in the middle of the night; where the supply did, too, MUA follows it, and no run is judged by that."""
    one = visits_again()
    of = one.sensors[2].conditions
    made = with_mua(with_column(one, supply_V=28.0 + (of.run > 6)) if recorded else one, after(6, 25.0))
    solutions = solve_campaign(made)
    shown, scenes = repeats(made, solutions), measured_scenes(made, load_bench("simulated"), {})
    (said,) = shown[2].document()["explained"]
    assert said.startswith("MUA follows supply_V" if recorded else "MUA jumps by +2")
    assert (said in shown[2].sentences(), any(said in each.reason for each in solutions)) == (recorded, not recorded)
    assert said in budget_document(scenes, "t", Asked(draws=100), observed=shown)["sensors"]["2"]["as_solved_for"]
    assert said in visibility_text(campaign_document(made, changes=()))
    assert f"sensor 2: {said}" in fit_thermal(made).sensors[2].notes
