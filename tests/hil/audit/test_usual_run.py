"""What the usual run and the usual collect scatter by: one of them that is not usual says nothing of the others."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from hil.analysis.thermal.fit import fit_thermal
from hil.campaign import Campaign
from hil.config import load_bench
from hil.design.budget.budget import budgets_of_means
from hil.design.budget.scenes import measured_scenes
from hil.design.visibility.document import campaign_document
from hil.reconcile import reconcile
from hil.reconcile.scattering import what_scatters
from hil.solve import repeats, solve_campaign
from tests.hil.audit.folders import FOLDERS
from tests.hil.solve.runs_of_a_unit import campaign


def test_the_usual_run_is_as_sure_beside_one_that_is_not() -> None:
    """Thermal says of one self-calibration what solve states of nearly all."""
    one = FOLDERS["one standard error huge"]()
    stated, fitted = repeats(one, solve_campaign(one))[2].of_each.values(), fit_thermal(one).sensors[2].parameters
    usual = {name: float(np.median([of[name] for of in stated])) for name in fitted}
    assert {name: each.repeatability for name, each in fitted.items()} == pytest.approx(usual)


def test_a_run_that_does_not_tell_a_parameter_is_not_the_usual_one() -> None:
    """One channel is dead in most runs: what those would scatter by, without any error, was the usual ±, 0."""
    one = campaign(20, 5, seed=2)
    rows = one.sensors[2]
    rates = np.where((rows.conditions.run % 5 > 1)[:, None] & [False, True], np.nan, rows.rates_deg_per_hr)
    dead = replace(one, sensors={2: replace(rows, rates_deg_per_hr=rates)})
    solved = solve_campaign(dead)
    shown, fitted = repeats(dead, solved)[2], fit_thermal(dead).sensors[2].parameters
    for name in ("GSB", "MUA"):
        stated = [shown.of_run(each)[name].sd for each in solved if each.parameters[name].value is not None]
        assert 0 < len(stated) < 10
        assert fitted[name].repeatability == pytest.approx(np.median(stated), rel=0.02)


@pytest.mark.slow
def test_a_run_that_is_hardly_known_moves_no_mean() -> None:
    """Neither what solve, thermal and a certificate state at its temperature, nor what reconcile makes of the noise."""
    one = campaign(12, 3, seed=1, scatter=0.5)
    rows, unsure = one.sensors[2], one.sensors[2].conditions.run == 3
    errors = np.where(unsure[:, None], 141.0, rows.rates_se_deg_per_hr)
    rates = rows.rates_deg_per_hr + np.where(unsure[:, None], [120.0, -90.0], 0.0)
    beside = replace(one, sensors={2: replace(rows, rates_deg_per_hr=rates, rates_se_deg_per_hr=errors)})
    told, seen = [], []
    for made in (replace(one, sensors={2: rows.rows(~unsure)}), beside):
        shown, fitted = repeats(made, solve_campaign(made))[2], fit_thermal(made).sensors[2].parameters
        (certified, *_) = budgets_of_means(measured_scenes(made, load_bench("simulated"), {2: shown})[2], shown)
        values = [(each.value, each.sd) for each in (*shown.means[0].values.values(), *certified.values.values())]
        told.append([*values, *((of.values.values[0], of.values.se[0]) for of in fitted.values())])
        seen.append([each["observed_deg_per_hr"] for each in reconcile(made, "matrix-6", prove=False).noise])
    assert np.abs(np.subtract(*told)).max() < 0.25
    assert seen[1] == pytest.approx(seen[0], rel=0.15)  # where that is within chance a size may be stated or not


def _of_a_collect(one: Campaign) -> list[float]:
    noise, seen = what_scatters(one).answer.noise, campaign_document(one, changes=())["noise_level"]
    assert isinstance(seen, dict)
    by_search = [each[key] for each in noise for key in ("stated_deg_per_hr", "observed_deg_per_hr")]
    return [*by_search, seen["collect_deg_per_hr"], fit_thermal(one).sensors[2].rate_noise_deg_per_hr]


@pytest.mark.slow
def test_one_huge_standard_error_says_nothing_of_what_the_others_scatter_by() -> None:
    """Scatter, visibility and thermal say of a collect what they say where that one is as good as the others."""
    without, beside = FOLDERS["good"](), FOLDERS["one standard error huge"]()
    told = [_of_a_collect(one) for one in (without, beside)]
    assert told[1] == pytest.approx(told[0], rel=0.15)


@pytest.mark.slow
@pytest.mark.parametrize("name", ["good", "drift through every run", "no standard errors", "MU of each run"])
def test_a_collect_scatters_by_as_much_for_thermal_as_for_the_search(name: str) -> None:
    """Also where residuals are many times their errors, and repeats show that this is no noise."""
    one = FOLDERS[name]()
    by_search = [each["observed_deg_per_hr"] for each in what_scatters(one).answer.noise]
    assert fit_thermal(one).sensors[2].rate_noise_deg_per_hr == pytest.approx(np.mean(by_search), rel=0.4)
