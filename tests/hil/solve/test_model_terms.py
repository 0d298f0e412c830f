"""Solving beside a model file: its named terms are taken off, the rest is solved for."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from benchmarks.blind.cases import make_case, write_case
from hil.campaign import Campaign
from hil.campaign.reader import read_campaign
from hil.campaign.writer import write_campaign
from hil.cli.coefficients import budget
from hil.config import load_bench, load_sweep
from hil.design.visibility.document import campaign_document, sweep_document, visibility_text
from hil.design.visibility.map import NoiseLevel
from hil.errors import InputError
from hil.model import Model, load_model
from hil.model.curve import Constant
from hil.reconcile.search.problem import fitted_sensors
from hil.solve import repeats, solve_campaign
from hil.solve.beside_terms import beside, solve_beside
from tests.hil.audit.folders import FOLDERS
from tests.hil.reconcile.hidden_effects import base_rates, campaign_of, lay_out

MODEL_FILE = """
schema: hil.model/1
title: with a term
form: matrix-6
sensors:
  2:
    BA: {unit: deg/hr, value: 0}
    BB: {unit: deg/hr, value: 0}
    GSA: {unit: deg/hr/g, value: 0}
    GSB: {unit: deg/hr/g, value: 0}
    MUA: {unit: deg/hr/g, value: 0}
    MUB: {unit: deg/hr/g, value: 0}
terms: []
"""


@pytest.fixture
def campaign(tmp_path: Path) -> Campaign:
    """A campaign in which the spin-axis drift is what it is."""
    return read_campaign(write_case(make_case(3, model="matrix-6"), tmp_path / "campaign"))


def model(tmp_path: Path, terms: str, form: str = "matrix-6") -> Model:
    """Write a model file with `terms` and read it."""
    path = tmp_path / "model.yaml"
    path.write_text(MODEL_FILE.replace("terms: []", terms).replace("form: matrix-6", f"form: {form}"))
    return load_model(path)


def test_a_named_bias_is_taken_off_the_bias(campaign: Campaign, tmp_path: Path) -> None:
    """A k2 term of +3 deg/hr/g² along A in both channels: Collects 1 and 2 lose 3, and so does the bias."""
    term = "terms:\n  - effect: k2\n    sensor: 2\n    parameters: {kAA_A: {unit: deg/hr/g^2, value: 3}}\n"
    found = solve_beside(beside(campaign, model(tmp_path, term)), model(tmp_path, term))
    plain = solve_campaign(campaign, "matrix-6")
    f_a = campaign.sensors[2].conditions.f_g[0, 0]
    for ours, theirs in zip(found, plain, strict=True):
        ba, before = ours.parameters["BA"].value, theirs.parameters["BA"].value
        assert ba is not None
        assert before is not None
        assert ba == pytest.approx(before - 3.0 * f_a**2, abs=0.01)
        assert ours.model == "with a term with k2"
        assert any("k2 as model with a term has it" in text for text in ours.assumed)


def test_without_terms_a_model_file_is_its_form(campaign: Campaign, tmp_path: Path) -> None:
    """Values of the base are solved for, not taken from the file."""
    found = solve_beside(campaign, model(tmp_path, "terms: []"))
    for ours, theirs in zip(found, solve_campaign(campaign, "matrix-6"), strict=True):
        assert ours.parameters == theirs.parameters
        assert np.array_equal(ours.covariance, theirs.covariance)


def test_terms_without_values_are_refused(campaign: Campaign, tmp_path: Path) -> None:
    """A term on a sensor for which the file has no base values cannot be taken off."""
    term = "terms:\n  - effect: k2\n    parameters: {kAA_A: {unit: deg/hr/g^2, value: 3}}\n"
    bare = model(tmp_path, term).model_copy(update={"sensors": {}})
    with pytest.raises(InputError, match="no values for sensor 2"):
        solve_beside(beside(campaign, bare), bare)


def test_the_campaign_is_not_changed(campaign: Campaign, tmp_path: Path) -> None:
    """Taking terms off makes new rates and leaves the measured ones."""
    before = campaign.sensors[2].rates_deg_per_hr.copy()
    term = "terms:\n  - effect: k2\n    sensor: 2\n    parameters: {kAA_A: {unit: deg/hr/g^2, value: 3}}\n"
    solve_beside(beside(campaign, model(tmp_path, term)), model(tmp_path, term))
    assert np.array_equal(campaign.sensors[2].rates_deg_per_hr, before)


def test_a_term_that_follows_temperature_takes_what_stands_in_for_it(tmp_path: Path) -> None:
    """As reconcile took it that found the term; the campaign keeps the thermometers that it has."""
    one = FOLDERS["no thermometer of its own"]()
    term = "terms:\n  - effect: bias_T\n    sensor: 2\n    parameters: {b1_A: {unit: deg/hr/degC, value: 2}}\n"
    chamber = one.sensors[2].conditions.columns["chamber_degC"]
    for ours, theirs in zip(
        solve_beside(beside(one, model(tmp_path, term)), model(tmp_path, term)),
        solve_campaign(one, "matrix-6"),
        strict=True,
    ):
        at = chamber[one.sensors[2].conditions.run == ours.run].mean()
        ba, before = ours.parameters["BA"].value, theirs.parameters["BA"].value
        assert ba is not None
        assert before is not None
        assert ba == pytest.approx(before - 2.0 * (at - 25.0), abs=0.5)
    assert "temperature_degC" not in one.sensors[2].conditions.columns


def test_a_term_is_taken_off_where_the_rates_belong(tmp_path: Path) -> None:
    """Exchanged labels are mended afterwards: what the term makes at the one label had gone to the other."""
    rows = lay_out(np.random.default_rng(1), (0.0, 20.0, 40.0), 3)
    parameters = "parameters: {a: {unit: 1/degC, value: 0.02}}"
    known = model(tmp_path, f"terms:\n  - effect: GS_gain\n    sensor: 2\n    {parameters}\n")
    known = known.model_copy(
        update={"sensors": {2: {n: Constant(unit=c.unit, value=50.0) for n, c in known.sensors[2].items()}}}
    )
    one = campaign_of(rows, base_rates(rows, thermal=False) + np.random.default_rng(2).normal(0.0, 0.3, (len(rows), 2)))
    filed = one.sensors[2]
    rates = filed.rates_deg_per_hr + known.rates(filed.conditions) - known.base_for(filed.conditions).rates
    swapped = rates.copy()
    swapped[[4, 5]] = rates[[5, 4]]
    told = []
    for each in (rates, swapped):
        made = replace(one, sensors={2: replace(filed, rates_deg_per_hr=each)})
        told.append([of.parameters["GSA"].value for of in solve_campaign(beside(made, known), known.form)])
    assert told[1] == pytest.approx(told[0])


NOISE = """terms: []
noise:
  2:
    angle_random_walk: {unit: deg/sqrt(hr), value: 0.2}
    run_to_run: {BA: {unit: deg/hr, value: 10}, MUB: {unit: deg/hr/g, value: 4}}
"""


def _once(*, stated: float | None) -> Campaign:
    """Return two runs of all four positions, each at a temperature of its own."""
    rows = lay_out(np.random.default_rng(1), (0.0, 30.0), 1)
    return campaign_of(rows, base_rates(rows, thermal=False), stated=stated)


def test_where_rates_have_no_errors_a_models_white_noise_is_theirs(tmp_path: Path) -> None:
    """0.2 deg/√hr over a minute, for every command; errors that a campaign states stand."""
    one, known = _once(stated=None), model(tmp_path, NOISE)
    expected = pytest.approx(0.2 * np.sqrt(60.0))
    assert beside(one, known).sensors[2].rates_se_deg_per_hr == expected
    assert fitted_sensors(one, known)[2].collects.rates_se_deg_per_hr == expected
    assert beside(_once(stated=0.7), known).sensors[2].rates_se_deg_per_hr == pytest.approx(0.7)


@pytest.mark.slow
def test_where_nothing_was_repeated_a_models_scatter_is_in_each_of_its_errors(tmp_path: Path) -> None:
    """In the ± of hil solve, in words, and in what hil visibility reckons with, planned or measured."""
    known = model(tmp_path, NOISE)
    one = beside(_once(stated=0.7), known)
    shown = repeats(one, solutions := solve_beside(one, known))[2]
    told = shown.of_run(solutions[0])
    assert told["BA"].sd == pytest.approx(np.hypot(10.0, solutions[0].parameters["BA"].se), rel=1e-3)
    assert told["GSA"].sd < 1.0
    said = "each ± has what the model states to scatter from run to run: BA by 10 deg/hr; MUB by 4 deg/hr/g"
    assert shown.sentences()[0].endswith(said)
    assert f"noise as the file of model {known.full_title} states it" in solutions[0].assumed
    planned = _planned(known)["sensors"]["2"]  # type: ignore[index]
    for noise in (campaign_document(_once(stated=0.7), known, ())["noise"], planned["noise"]):
        assert (noise["run_bias_deg_per_hr"], noise["source"]) == (pytest.approx(np.sqrt(50.0)), "the model")  # type: ignore[index]


@pytest.mark.slow
def test_what_a_model_does_not_state_of_noise_is_assumed_as_before(tmp_path: Path) -> None:
    """A scatter of MU alone made every bias seem to be the same in each run; and nobody was told whose noise it is."""
    known = model(tmp_path, "noise: {2: {run_to_run: {MUA: {unit: deg/hr/g, value: 4}}}}\n")
    for told in (campaign_document(_once(stated=0.7), known, ()), _planned(known)):
        noise = told["sensors"]["2"]["noise"]  # type: ignore[index]
        assert noise["run_bias_deg_per_hr"] == NoiseLevel().run_bias_deg_per_hr
        assert noise["run_mu_deg_per_hr_per_g"] == pytest.approx(np.sqrt(8.0))
        assert noise["source"] == "MU by the model, the bias assumed"
        assert told["noise_of"] == known.full_title
        assert f"neither state nor show is as the file of model {known.full_title} states it" in visibility_text(told)


def _planned(known: Model) -> dict[str, object]:
    return sweep_document(load_sweep("quick"), load_bench("simulated"), known)


def test_what_changes_from_collect_to_collect_is_in_a_runs_errors(tmp_path: Path) -> None:
    """As reconcile judges a run beside the model: residuals that its noise explains are no fault of the run."""
    one = _once(stated=0.7)
    loud = model(tmp_path, NOISE + "    collect_to_collect: {BA: {unit: deg/hr, value: 5}}\n")
    moved = one.sensors[2].rates_deg_per_hr + np.outer([4.0, 4.0, -4.0, -4.0] * 2, [1.0, 0.0])
    one = replace(one, sensors={2: replace(one.sensors[2], rates_deg_per_hr=moved)})
    assert all(each.exceeds_errors for each in solve_campaign(one))
    assert not any(each.exceeds_errors for each in solve_beside(beside(one, loud), loud))
    # And in none of them once more, as from run to run.
    assert beside(one, loud).run_scatter[2]["BA"] == pytest.approx(10.0)
    both = ", ".join(f"{name}: {{unit: deg/hr, value: 5}}" for name in ("BA", "BB"))
    planned = [
        sweep_document(load_sweep("recommended"), load_bench("simulated"), model(tmp_path, f"noise: {{2: {of}}}\n"))
        for of in ("{}", f"{{collect_to_collect: {{{both}}}}}")
    ]
    # Also of three collects, of which values of a run take all.
    three = replace(one, sensors={2: one.sensors[2].rows(np.isin(np.arange(8) % 4, (0, 1, 2)))})
    np.testing.assert_allclose(beside(three, loud).sensors[2].rates_se_deg_per_hr[:, 0], np.hypot(0.7, 5.0), rtol=1e-6)
    assert beside(three, loud).run_scatter[2]["BA"] == pytest.approx(10.0)
    quiet, noisy = (each["sensors"]["2"]["noise"]["collect_deg_per_hr"] for each in planned)  # type: ignore[index]
    assert noisy == pytest.approx(np.hypot(quiet, 5.0), rel=1e-3)


def test_budget_states_a_run_as_solve_does_beside_the_same_model(tmp_path: Path) -> None:
    """With the noise of the model: it said "as hil solve states it" and left that out."""
    one, known = beside(_once(stated=0.7), model(tmp_path, NOISE)), tmp_path / "model.yaml"
    write_campaign(_once(stated=0.7), tmp_path / "campaign")
    told = budget(str(tmp_path / "campaign"), model=str(known), draws=100).document["sensors"]["2"]
    (own,) = (each for each in solve_beside(one, load_model(known)) if each.run == told["run"])
    expected = {name: each.sd for name, each in repeats(one, solve_campaign(one))[2].of_run(own).items()}
    assert told["as_solved"]["BA"] > 10.0
    assert told["as_solved"] == pytest.approx(expected)
