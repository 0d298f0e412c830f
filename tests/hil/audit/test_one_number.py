"""One question, one answer: what scatters, and by how much, is one number wherever somebody asks for it."""

from __future__ import annotations

import re
from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from hil.analysis.thermal.fit import fit_thermal
from hil.campaign import Campaign, Collects
from hil.campaign.reader import read_campaign
from hil.campaign.writer import write_campaign
from hil.cli.app import run
from hil.config import load_bench, load_sweep
from hil.design.budget.document import Asked, budget_document
from hil.design.budget.scenes import measured_scenes
from hil.design.conditions import planned_conditions
from hil.design.sequence.sequences import scene_of, sequence_worth
from hil.design.visibility.document import campaign_document, sweep_document, visibility_text
from hil.errors import InputError
from hil.model import built_in_model
from hil.model.curve import Constant
from hil.model.forms import default_form
from hil.model.stated_noise import SensorNoise
from hil.reconcile import reconcile
from hil.reconcile.fleet import Screen
from hil.reconcile.outcome.sentences import what_to_do
from hil.reconcile.outcome.stated import scatter_in_words
from hil.reconcile.scattering import what_scatters
from hil.solve import repeats, solve_campaign
from hil.solve.beside_terms import solve_beside
from procedures.plan import make_plan
from tests.hil.audit.folders import FOLDERS, _changed, written
from tests.hil.reconcile.hidden_effects import hidden_campaign
from tests.hil.solve.runs_of_a_unit import campaign, repeated, with_rates


@pytest.mark.slow
@pytest.mark.usefixtures("searched_once")
def test_the_channel_whose_standard_errors_do_not_hold_is_named() -> None:
    """By repeats as by the search, and about as much; the other is not blamed."""
    one = FOLDERS["one channel noisy"]()
    shown = repeats(one, solve_campaign(one))
    (said,) = shown[2].noise_in_words
    found = re.match(r"standard errors of RB are ([\d.]+) times too small", said)
    assert found is not None
    weighed = what_scatters(one)
    assert f"sensor 2: {said}" in weighed.sentences()
    assert f"sensor 2: {said}" in reconcile(one, "matrix-6").notes
    (noisy,) = scatter_in_words(weighed.answer.noise)
    assert noisy.startswith("sensor 2, RB: ")
    by_search = re.search(r"scatter ([\d.]+) times", noisy)
    assert by_search is not None
    assert float(found[1]) == pytest.approx(float(by_search[1]), rel=0.2)
    seen: Any = campaign_document(one, changes=())["sensors"]
    bench, sizes = load_bench("simulated"), seen["2"]["noise"]["channels_deg_per_hr"]
    (stated,) = {*one.sensors[2].rates_se_deg_per_hr.ravel().tolist()}
    assert [*sizes.values()] == pytest.approx(stated * shown[2].noise_times)
    assert sizes["RB"] == pytest.approx(float(by_search[1]) * stated, rel=0.2)
    asked = Asked(draws=100)
    budget = budget_document(measured_scenes(one, bench, shown), "t", asked, observed=shown)["sensors"]["2"]
    assert f"(RA 1 and RB {found[1]})" in budget["sources"][0]["origin"]
    assert budget["noise_deg_per_hr"] == pytest.approx(np.sqrt(np.mean(np.square([*sizes.values()]))))
    noise = {name: each["analytic"] for name, each in budget["sources"][0]["parameters"].items()}
    assert noise["BB"] == pytest.approx(float(found[1]) * noise["BA"], rel=0.1)


@pytest.mark.slow
def test_noise_that_residuals_show_is_that_of_a_collect_beside_offsets_too() -> None:
    """Runs differ by ten times that, and MU more: visibility and the model that is written have the noise alike."""
    rng = np.random.default_rng(4)
    one = repeated(12, 4, (0, 1, 2, 0, 1, 2))
    rows = one.sensors[2]
    of_runs = rng.normal(0.0, 8.0, (12, 2))[rows.conditions.run - 1]
    made = with_rates(one, rows.rates_deg_per_hr + of_runs + rng.normal(0.0, 1.0, (len(rows.conditions), 1)) * [0, 1])
    seen: Any = campaign_document(made, changes=())["sensors"]
    (quiet, noisy), said = what_scatters(made).answer.noise, seen["2"]["noise"]["channels_deg_per_hr"]
    assert said["RB"] > 1.1 * said["RA"]
    for each in (quiet, noisy):
        assert each["run_offset_se_deg_per_hr"] is not None
        collect = np.hypot(each["explained_deg_per_hr"], each["collect_to_collect_deg_per_hr"])
        assert collect == pytest.approx(said[each["channel"]], rel=1e-6)
    assert noisy["collect_to_collect_se_deg_per_hr"] is not None


@pytest.mark.slow
def test_each_sensor_of_a_unit_is_compared_in_its_own_form() -> None:
    """What a rotor sensor does is no finding beside the form of a triad; a model of one kind screens neither."""
    one = FOLDERS["a rotor sensor and a triad"]()
    found = what_scatters(one)
    assert {each["sensor"]: each["under"] for each in found.answer.noise} == {1: "triad-12", 2: "matrix-6"}
    assert found.moves == ()
    for ask in (reconcile, Screen.of):
        with pytest.raises(InputError, match="sensor 1: it is not a two-channel rotor sensor"):
            ask(one, "matrix-6")


@pytest.mark.slow
def test_what_is_taken_for_scatter_is_said_to_be_however_probable_it_is() -> None:
    """And what moves the mean instead: hil reconcile writes the walk into the model, and says that it may be ageing."""
    found = what_scatters(FOLDERS["after a pause"]())
    said = found.sentences()
    assert (found.named, [size.effect.id for size in found.sizes]) == ((), ["rrw"])
    either = r"either something moves the mean, Ageing of the bias \(\d+ %\)"
    assert re.match(rf"{either}, or averages scatter, Rate random walk \(\d+ %\)", said[0])
    assert not any("no name" in line for line in said)  # white noise is beside the one as beside the other


@pytest.mark.slow
@pytest.mark.parametrize("order", ["1-3-2", "1-2-3", "1-2-3-2-1"])
def test_what_a_drift_spoils_is_the_same_before_and_after_a_night(order: str) -> None:
    """Of each sensor: `design` and `visibility` of the sweep, `visibility` of a campaign that has no repeats yet."""
    bench, published = load_bench("simulated"), load_sweep("rd-gc-86-1")
    sweep = published.model_copy(update={"positions": tuple(order.split("-")), "self_calibrations_per_temperature": 1})
    conditions = planned_conditions(make_plan(sweep.procedure()), bench)
    typical = float(bench.uncertainties.of_collects(conditions[2])[0, 0])
    rng = np.random.default_rng(0)
    rates = {number: rng.normal(0.0, typical, (len(own), 2)) for number, own in conditions.items()}
    rows = {n: Collects(own, rates[n], np.full_like(rates[n], typical)) for n, own in conditions.items()}
    maps: list[Any] = [sweep_document(sweep, bench), campaign_document(Campaign("night", "", rows), changes=())]
    assert [of["noise_level"]["collect_deg_per_hr"] for of in maps] == [typical, typical]
    before, after = ({n: _moved_by(of, "drift") for n, of in each["sensors"].items()} for each in maps)
    assert after == before
    for number, own in conditions.items():
        worth = sequence_worth(scene_of(bench, number, sweep.positions, sweep.procedure().collect), default_form(own))
        assert worth is not None
        spoiled = {name for name in worth.drift if not worth.immune([name])}
        assert bool(before[str(number)]) == bool(spoiled)
        assert {name.partition("_")[0] for name in before[str(number)]} <= spoiled


def _moved_by(of_sensor: Mapping[str, Any], effect: str) -> dict[str, float]:
    return {each["id"]: each["leaks"] for each in of_sensor["effects"]}[effect]


@pytest.mark.slow
@pytest.mark.parametrize(("runs", "left"), [(1, False), (4, True)])
def test_what_changes_from_run_to_run_is_not_known_where_nothing_was_repeated(runs: int, left: bool) -> None:
    """By neither of them, and it is no 0 that scatter states; what single runs leave beside a curve is observed."""
    one = campaign(runs, 1, seed=3, scatter=0.5)
    found = what_scatters(one)
    assert "what changes from run to run is not known" in repeats(one, solve_campaign(one))[2].sentences()[0]
    assert "no run was repeated: what changes from run to run is not known" in found.sentences()[0]
    assert {of["run_offset_deg_per_hr"] for of in found.answer.noise} == {None}
    assert {of["observed_deg_per_hr"] is not None for of in found.answer.noise} == {left}
    assert ("what is observed is" in found.sentences()[0]) is left


@pytest.mark.slow
def test_of_single_runs_whose_noise_is_told_an_offset_beside_a_curve_is_said_to_be_that() -> None:
    """Four collects of a run tell its noise; what runs differ by is what a curve over temperature leaves of them."""
    one, rng = hidden_campaign(7), np.random.default_rng(1)
    (number, rows), *_ = one.sensors.items()
    keep = rows.conditions.run % 2 == 1  # each temperature has two
    single = Collects(rows.conditions.rows(keep), rows.rates_deg_per_hr[keep], rows.rates_se_deg_per_hr[keep])
    off = np.repeat(rng.normal(0.0, 4.0, (keep.sum() // 4, 2)), 4, axis=0)
    single = replace(single, rates_deg_per_hr=single.rates_deg_per_hr + off)
    found = what_scatters(replace(one, sensors={number: single}))
    assert all(of["run_offset_deg_per_hr"] > 1.0 for of in found.answer.noise)
    assert "what is observed is what a smooth model leaves of single runs" in found.sentences()[0]


@pytest.mark.slow
@pytest.mark.parametrize("seed", [11, 13])
def test_an_offset_of_runs_is_as_large_for_the_search_as_for_repeats(seed: int) -> None:
    """Within what eight degrees of freedom tell, and not one of the few sizes that the search's grid has."""
    night = campaign(12, 3, seed=seed, scatter=2.0)
    told = repeats(night, solve_campaign(night))[2].spread.beyond[:2]
    answer = what_scatters(night).answer
    found = [channel["run_offset_deg_per_hr"] for channel in answer.noise]
    assert answer.scatters_by["ordinary"][0] == "white noise and an offset of each run"
    assert found == pytest.approx(told.tolist(), rel=0.45)


@pytest.mark.slow
def test_what_few_repeats_scatter_by_is_within_what_the_search_says_of_its_size() -> None:
    """Two at each of two temperatures: one size of both channels, in an interval that people are told, not ± of it."""
    one = campaign(4, 2, seed=2, scatter=0.3)
    mu = np.random.default_rng(2).normal(0.0, 6.0, (4, 2))
    one = _changed(one, list(range(2, 12, 3)), one.sensors[2].rates_deg_per_hr[2::3] + mu)
    found, spread = what_scatters(one), repeats(one, solve_campaign(one))[2].spread
    (size,) = found.sizes
    assert size.effect.id == "MU_rr"
    assert size.interval["low"] < np.sqrt(np.mean(spread.beyond[4:] ** 2)) < size.interval["high"]
    assert (
        f"{size.value:.3g} deg/hr/g ({size.interval['low']:.2g} … {size.interval['high']:.2g})" in found.sentences()[0]
    )


@pytest.mark.slow
def test_what_averages_scatter_by_is_the_same_whatever_standard_errors_say_of_it() -> None:
    """Right, ten times too large or too small, or none: of the first it had been a fifth more, the next further off."""
    one = campaign(12, 3, seed=3, scatter=0.0)
    rows, seen = one.sensors[2], {}
    for times in (1.0, 10.0, 0.1, np.nan):
        errors = times * rows.rates_se_deg_per_hr
        found = what_scatters(replace(one, sensors={2: replace(rows, rates_se_deg_per_hr=errors)}))
        parts = ("observed_deg_per_hr", "run_offset_deg_per_hr")
        whole, offset = np.array([[channel[part] for channel in found.answer.noise] for part in parts])
        seen[times] = np.sqrt(whole**2 - offset**2)  # an offset of each run is here by chance
    right = seen.pop(1.0)
    assert all(of == pytest.approx(right, rel=0.15) for of in seen.values())


@pytest.mark.slow
@pytest.mark.usefixtures("searched_once")
def test_that_standard_errors_are_too_large_is_said_beside_what_scatters() -> None:
    """By both, in one sentence: `hil scatter` had said nothing of them where an effect has a name."""
    one = FOLDERS["MU of each run"]()
    large = replace(one.sensors[2], rates_se_deg_per_hr=10.0 * one.sensors[2].rates_se_deg_per_hr)
    one = replace(one, sensors={2: large})
    found, noted = what_scatters(one), reconcile(one, "matrix-6").notes
    said = [sentence for sentence in found.sentences() if "times too large" in sentence]
    assert found.named == ("MU_rr",)
    assert said
    assert set(said) <= {*noted}


@pytest.mark.slow
@pytest.mark.parametrize("stated", [True, False])
def test_a_collect_of_one_run_scatters_in_each_channel_as_its_residuals_say(stated: bool) -> None:
    """By scatter, visibility and the budget: with errors that differ, which a search takes for those of the mean."""
    one = FOLDERS["poses"]()
    ((number, rows),) = one.sensors.items()
    rng, shape = np.random.default_rng(2), rows.rates_deg_per_hr.shape
    errors = np.where(np.arange(len(rows.conditions)) % 2, 1.0, 4.0)[:, None] * np.ones(shape)
    noise = rng.normal(0.0, [1.0, 1.0, 1.0 if stated else 30.0], shape) * errors
    errors = errors if stated else np.full(shape, np.nan)
    one = replace(
        one,
        sensors={
            number: replace(
                rows,
                rates_deg_per_hr=rows.conditions.f_g @ np.diag([20.0, 5.0, 9.0]) + noise,
                rates_se_deg_per_hr=errors,
            )
        },
    )
    found = what_scatters(one).answer.noise
    seen: Any = campaign_document(one, changes=())["sensors"]
    sizes = seen[str(number)]["noise"]["channels_deg_per_hr"]
    assert {each["channel"]: each["observed_deg_per_hr"] for each in found} == pytest.approx(sizes)
    assert stated or sizes[found[2]["channel"]] > 5.0 * sizes[found[0]["channel"]]
    shown = repeats(one, solve_campaign(one))
    scenes = measured_scenes(one, load_bench("simulated"), shown)[number]
    assert np.median(scenes[0].scene.noise, axis=0) == pytest.approx([*sizes.values()])


@pytest.mark.slow
def test_beside_a_model_with_terms_visibility_takes_for_noise_what_solve_does() -> None:
    """What the terms make is off the rates for both; it had stood among what residuals exceed their errors by."""
    one = FOLDERS["drift through every run"]()
    model = reconcile(one, "matrix-6", prove=False).model_after
    alone: Any = campaign_document(one, changes=())
    beside: Any = campaign_document(one, model, changes=())
    assert "residuals are in RA" in alone["noise"]["source"]
    assert "residuals" not in beside["noise"]["source"]
    assert beside["taken_off"] == "matrix-6 with drift and bias"
    assert f"terms of {beside['taken_off']} make" in visibility_text(beside)
    assert {each.model for each in solve_beside(one, model)} == {beside["taken_off"]}


def test_what_is_the_same_in_every_run_no_number_of_repeats_averages() -> None:
    """Asked for a hundred, the budget has it whole; two temperatures differ by no more than their own noise."""
    one = FOLDERS["drift through every run"]()
    shown, scenes = repeats(one, solve_campaign(one)), measured_scenes(one, load_bench("simulated"), {})
    asked = Asked(draws=100, repeats=100)
    budget = budget_document(scenes, "t", asked, observed=shown)["sensors"]["2"]
    assert all(sd > 0.99 * budget["as_solved"][name] > 0.0 for name, sd in budget["mean_of_repeats"].items())
    for each in fit_thermal(one).of(2).parameters.values():
        apart = each.values.covariance[0, 0] + each.values.covariance[1, 1] - 2.0 * each.values.covariance[0, 1]
        assert np.sqrt(apart) < 0.2 * each.values.se[0]


@pytest.mark.slow
def test_that_a_model_states_too_much_noise_is_no_fault_of_the_standard_errors_alone() -> None:
    """The file's are right: who is told that they are too large changes them, and not what the model states."""
    one, walk = repeated(12, 3, (0, 1, 2, 1, 0)), Constant(unit="deg/hr", value=6.0)
    stated = {2: SensorNoise(collect_to_collect={"BA": walk, "BB": walk})}
    result = reconcile(one, built_in_model("matrix-6").model_copy(update={"noise": stated}), prove=False)
    told = [each for each in result.notes if "too large" in each]
    said = "sensor 2: with what the model knows and what was found taken off, standard errors of"
    assert [each[: len(said)] for each in told] == [said] * 2
    assert "standard errors, or the noise that the model states: repeats" in what_to_do(result)[1]


@pytest.mark.slow
def test_what_is_said_of_standard_errors_beside_what_was_found_says_so() -> None:
    """GS drifts through the night: hil solve, which knows nothing of it, cannot tell it from noise: no number."""
    one = campaign(8, 4, seed=4, scatter=0.0)
    rows, own = one.sensors[2], one.sensors[2].conditions
    drifts = rows.rates_deg_per_hr + 10.0 * (own.start_s / own.start_s[-1])[:, None] * own.f_g[:, :2]
    small = replace(rows, rates_deg_per_hr=drifts, rates_se_deg_per_hr=0.4 * rows.rates_se_deg_per_hr)
    made = replace(one, sensors={2: small})
    found = what_scatters(made)
    assert "empirical: GS × start_s" in found.moves
    said = [each for each in found.sentences() if "times too small" in each]
    assert all(each.startswith("sensor 2: with what was found taken off, standard errors of R") for each in said)
    times = [repeats(made, solve_campaign(made))[2].times_of["RA"], found.answer.left.shown[2].times_of["RA"]]
    assert times == [1.0, pytest.approx(2.5, rel=0.3)]


@pytest.mark.slow
def test_a_budget_says_why_solve_states_more_than_all_sources(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """What repeats show beyond noise is no source's; errors that are six times too large are no more of it."""
    good = read_campaign(written("good", tmp_path / "good"))
    wide = replace(good.sensors[2], rates_se_deg_per_hr=6.0 * good.sensors[2].rates_se_deg_per_hr)
    write_campaign(replace(good, sensors={2: wide}), tmp_path / "wide")
    for name in ("good", "wide"):
        assert run(["budget", str(tmp_path / name), "--draws", "100"]) == 0
        said = "hil solve states more of BA, BB: errors as large as residuals or repeats show them, be it by chance"
        assert said in capsys.readouterr().out


@pytest.mark.parametrize("more", [0.0, 2.0])
def test_noise_that_nobody_tells_is_what_repeats_show_in_a_budget_as_in_a_map(more: float) -> None:
    """Three collects without errors leave no residual: the bench's usual noise had stood in the budget whatever was."""
    one = campaign(24, 4, seed=3, scatter=0.0)
    rows = one.sensors[2]
    rates = rows.rates_deg_per_hr + np.random.default_rng(1).normal(0.0, more, rows.rates_deg_per_hr.shape)
    one = replace(
        one, sensors={2: replace(rows, rates_deg_per_hr=rates, rates_se_deg_per_hr=np.full_like(rates, np.nan))}
    )
    shown, seen = repeats(one, solve_campaign(one)), campaign_document(one, changes=())
    sizes: Any = seen["sensors"]
    of_collects = [*sizes["2"]["noise"]["channels_deg_per_hr"].values()]
    scenes = measured_scenes(one, load_bench("simulated"), shown)
    budget = budget_document(scenes, "t", Asked(draws=100), observed=shown)["sensors"]["2"]
    assert budget["noise_deg_per_hr"] == pytest.approx(np.sqrt(np.mean(np.square(of_collects))), rel=0.01)
    assert budget["noise_deg_per_hr"] == pytest.approx(np.hypot(0.7, more), rel=0.35)
    assert budget["sources"][0]["origin"].startswith("differences beside bias and MU of all runs")
