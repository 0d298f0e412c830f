"""Ordinary noise is no finding, but the model that is written states it: what is asked with it has nothing to add."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from hil.campaign import Campaign, Collects
from hil.model import Model, load_model, save_model
from hil.model.curve import Constant, Curve, Polynomial, Table
from hil.model.forms import bias_names, default_form
from hil.model.stated_noise import SensorNoise
from hil.reconcile import Reconciliation, reconcile
from hil.reconcile.outcome.page import page
from hil.reconcile.outcome.sentences import values_off, what_to_do
from hil.reconcile.outcome.stated import stated_in_words, with_ordinary
from hil.reconcile.result import Solved
from hil.reconcile.scattering import what_scatters
from hil.solve.beside_terms import beside
from hil.solve.identifiability import orthonormal, project_out
from tests.hil.analysis.thermal.nights import rotor_night
from tests.hil.model.effect_conditions import triad_poses
from tests.hil.reconcile.hidden_effects import Rows, base_rates, campaign_of, hidden_campaign, lay_out, noise
from tests.hil.solve.runs_of_a_unit import campaign, with_rates

STATED, OFFSET = 0.9, 4.0
BIASES = ("BA", "BB")


def laid(seed: int = 7) -> tuple[Campaign, Rows]:
    """Return a night whose averages scatter by 2.0 deg/hr where their errors say 0.9, and by 4 from run to run."""
    rng = np.random.default_rng(seed)
    rows = lay_out(rng, runs_each=3)
    e = noise(rows, rng, sigma=2.0, run_bias=0.0) + OFFSET * rng.normal(size=(rows.run.max() + 1, 2))[rows.run]
    return campaign_of(rows, base_rates(rows) + e, stated=STATED), rows


@pytest.fixture(scope="module")
def found() -> Reconciliation:
    """What is said of that night; made once for this file."""
    return reconcile(laid()[0], "matrix-6-thermal")


@pytest.mark.slow
def test_ordinary_noise_is_in_the_model_though_nothing_is_named(found: Reconciliation) -> None:
    """From collect to collect what the standard errors leave, from run to run an offset, about as large as they are."""
    assert found.verdict == "none"
    stated = found.model_after.noise[2]
    for sizes, truth in ((stated.collect_to_collect, np.sqrt(2.0**2 - STATED**2)), (stated.run_to_run, OFFSET)):
        assert set(sizes) == set(BIASES)
        for curve in sizes.values():
            assert isinstance(curve, Constant)
            assert curve.se is not None
            assert abs(curve.value - truth) < 2.5 * curve.se
    rows = laid()[0].sensors[2].conditions  # and what shows inside the collects, at each temperature
    white = STATED * np.sqrt(rows.duration_s[0] / 3600.0)
    assert stated.angle_random_walk.at(rows.columns["temperature_degC"]) == pytest.approx(white)
    assert found.model_after.model_copy(update={"noise": {}, "version": 1}) == found.input_model
    assert found.model_after.version == 2
    (said,) = (note for note in found.notes if note.startswith("the noise of model.yaml states"))
    assert "deg/hr from collect to collect" in said
    text = page(found)
    assert "only its noise says more" in text
    assert "standard errors: repeats and residuals show others" in text
    assert "No further collect is called for by this result." in text
    fails = page(replace(found, left=replace(found.left, beyond_errors=[3])))
    assert "State the standard errors that repeats" in fails
    assert "These collects, once more." in fails


@pytest.mark.slow
def test_what_is_asked_with_it_has_nothing_to_add(found: Reconciliation, tmp_path: Path) -> None:
    """The same night with the model as written, and read again: none, no more noise, no gap under its floor."""
    save_model(found.model_after, tmp_path / "model.yaml")
    again = reconcile(laid()[0], load_model(tmp_path / "model.yaml"))
    assert again.verdict == "none"
    assert again.model_after == again.input_model
    assert not again.left.errors  # what is stated is all there
    assert again.gap.after >= again.gap.noise_floor
    assert all(each["observed_deg_per_hr"] < 1.3 * each["explained_deg_per_hr"] for each in again.noise)


@pytest.mark.slow
def test_by_whose_noise_nobody_has_to_act_is_said(found: Reconciliation) -> None:
    """By that of the model that was read: what hil solve does not pass without it stands beside what needs nobody."""
    passed = replace(found, input_model=found.model_after, left=Solved(), solved=Solved({"FAIL": {2: [1]}}), noise=[])
    said = "That is by the noise that the model states; hil solve without --model does not pass run 1 (FAIL)."
    assert what_to_do(passed)[1].startswith(f"Nobody has to act. {said}")
    assert said not in what_to_do(replace(passed, input_model=found.input_model))[1]


@pytest.mark.slow
def test_offsets_however_large_are_offsets() -> None:
    """Sixty times the noise of a collect, anew in every run: what was tried ended at eleven, and the rest was jumps."""
    rng = np.random.default_rng(5)
    rows = lay_out(rng, runs_each=3)
    e = noise(rows, rng, sigma=STATED, run_bias=0.0) + 55.0 * rng.normal(size=(rows.run.max() + 1, 2))[rows.run]
    result = reconcile(campaign_of(rows, base_rates(rows) + e, stated=STATED), "matrix-6-thermal")
    assert result.effects == []
    for curve in result.model_after.noise[2].run_to_run.values():
        assert isinstance(curve, Constant)
        assert curve.se is not None
        assert abs(curve.value - 55.0) < 2.5 * curve.se < 40.0


@pytest.mark.slow
@pytest.mark.usefixtures("searched_once")
def test_what_probably_moves_averages_and_is_not_called_missing_scatters_nothing() -> None:
    """A slope of the bias is as large whether or not anybody asks to be surer of it before it is named."""
    one = campaign(8, 4, seed=2, scatter=2.0)
    rows = one.sensors[2].conditions
    warmer = np.sign(rows.columns["temperature_degC"] - rows.columns["temperature_degC"].mean())
    made = with_rates(one, one.sensors[2].rates_deg_per_hr + 4.0 * warmer[:, None])
    named, unnamed = (reconcile(made, "matrix-6", alpha=alpha, prove=False) for alpha in (0.05, 1e-9))
    assert [each.id for each in named.effects] == ["bias_T"]
    assert unnamed.effects == []
    for sure, unsure in zip(named.noise, unnamed.noise, strict=True):
        assert unsure["under"] == sure["under"] == "matrix-6 + bias_T"
        assert unsure["run_offset_deg_per_hr"] == pytest.approx(sure["run_offset_deg_per_hr"])


def test_what_repeats_differ_by_scatters_until_it_has_a_name() -> None:
    """A warm-up that was no finding had left no noise, in a page that said "nothing but noise"; its repeats show it."""
    rows = lay_out(np.random.default_rng(1), (20.0,), 4)
    warming = 14.0 * np.exp(-(rows.start_s - rows.start_s.min()) / 1500.0)
    rates = base_rates(rows, thermal=False) + warming[:, None] * [1.0, -0.6]
    made = campaign_of(rows, rates + np.random.default_rng(2).normal(0.0, 0.9, rates.shape))
    named, unnamed = (reconcile(made, "matrix-6", alpha=alpha, prove=False) for alpha in (0.3, 1e-9))
    assert len(named.effects) == 1
    assert unnamed.effects == []
    for sure, unsure in zip(named.noise, unnamed.noise, strict=True):
        assert unsure["under"] == "matrix-6"
        assert unsure["run_offset_deg_per_hr"] > 2.0 > sure["run_offset_deg_per_hr"]


@pytest.mark.slow
def test_standard_errors_that_are_right_need_no_more() -> None:
    """Where averages scatter as stated the model that is written is the one that was read."""
    rng = np.random.default_rng(3)
    rows = lay_out(rng)
    white = campaign_of(rows, base_rates(rows) + noise(rows, rng, run_bias=0.0), stated=STATED)
    result = reconcile(white, "matrix-6-thermal", prove=False)
    assert result.model_after == result.input_model
    assert "Nothing was added to the model." in page(result)


@pytest.mark.slow
def test_a_channel_of_which_residuals_say_more_is_stated_to_scatter_more() -> None:
    """A trust in standard errors that a search begins with hides nothing that `hil solve` is sure of."""
    poses = triad_poses(every_column=False)
    form = default_form(poses)
    shape = len(poses), len(poses.sensor.channels)
    basis = orthonormal(form.columns(poses).reshape(shape[0] * shape[1], -1), 1e-6)
    left = project_out(basis, np.random.default_rng(1).normal(size=basis.shape[0])[:, None]).reshape(shape)
    left /= np.sqrt(np.sum(left**2, axis=0) / (basis.shape[0] - basis.shape[1]) * shape[1])
    seen = Collects(poses, poses.w_channels_deg_per_hr + 2.0 * left * [1.0, 1.5, 1.0], np.full(shape, 2.0))
    one = Campaign("triad", "", {poses.sensor.number: seen})
    result = reconcile(one, form.name, prove=False)
    (stated,) = result.model_after.noise.values()
    assert [*stated.collect_to_collect] == [[*bias_names(poses.sensor)][1]]
    assert all(result.left.shown[n].noise_times.tolist() == pytest.approx([1.0, 1.5, 1.0]) for n in one.sensors)


@pytest.mark.slow
@pytest.mark.parametrize(("seed", "channel"), [(21, "RB"), (37, "RA")])
def test_an_offset_that_is_within_chance_for_hil_solve_is_in_no_model(seed: int, channel: str) -> None:
    """None is at 2 to 4 %: it had been stated at 5, in one of ten channels that have none."""
    one = campaign(9, 3, seed=seed, scatter=0.4)
    result = reconcile(one, "matrix-6", prove=False)
    (seen,) = (each for each in result.noise if each["channel"] == channel)
    assert (seen["run_offset_deg_per_hr"] > 0.5, seen["run_offset_se_deg_per_hr"]) == (True, None)
    assert not result.left.shown[2].by_noise.certain.any()
    assert result.model_after.noise[2].run_to_run == {}


@pytest.mark.slow
def test_where_few_runs_cannot_tell_an_offset_from_scatter_each_has_its_part() -> None:
    """All of it had been written as scatter from collect to collect, beside an offset that may be most of it."""
    one = campaign(4, 2, seed=0, scatter=0.0)
    rates = one.sensors[2].rates_deg_per_hr
    result = reconcile(
        with_rates(one, rates + np.random.default_rng(0).normal(0.0, 3.0, rates.shape)), "matrix-6", prove=False
    )
    (seen, _), noise = result.noise, result.model_after.noise[2]
    assert seen["run_offset_se_deg_per_hr"] > 0.4 * seen["run_offset_deg_per_hr"]  # nobody knows it
    offset, scatter = noise.run_to_run["BA"].at([0.0])[0], noise.collect_to_collect["BA"].at([0.0])[0]
    assert min(offset, scatter) > 2.0
    assert np.hypot(offset, scatter) == pytest.approx(
        np.sqrt(seen["observed_deg_per_hr"] ** 2 - seen["explained_deg_per_hr"] ** 2), rel=0.05
    )


@pytest.mark.parametrize(
    "curve",
    [
        Constant(unit="deg/hr", value=3.0, se=0.3),
        Polynomial(unit="deg/hr", polynomial=(3.0,), reference_degC=0.0, se=(0.3,)),
        Table(unit="deg/hr", table={"temperature_degC": [-90.0, 90.0], "value": [3.0, 3.0], "se": [0.3, 0.3]}),
        Constant(unit="deg/hr", value=0.0),
        None,
    ],
)
def test_what_was_stated_grows_in_square(curve: Curve | None) -> None:
    """4 deg/hr beside 3 that are stated are 5, in the form in which they were stated; beside none they are 4."""
    rows = hidden_campaign(1).sensors[2].conditions
    sizes = {} if curve is None else {"BA": curve}
    model = Model(schema="hil.model/1", title="unit", form="matrix-6", noise={2: SensorNoise(run_to_run=sizes)})
    seen = {"run_offset_deg_per_hr": 4.0, "run_offset_se_deg_per_hr": 0.4}
    seen |= {"stated_deg_per_hr": 0.9, "collect_to_collect_deg_per_hr": 1.0, "collect_to_collect_se_deg_per_hr": None}
    grown = with_ordinary(model, [{"sensor": 2, "channel": "RA", **seen}], {2: rows}).noise[2]
    there = curve is not None and curve.at([0.0])[0] > 0.0
    assert grown.run_to_run["BA"].at([0.0]) == pytest.approx([5.0 if there else 4.0])
    assert type(grown.run_to_run["BA"]) is (type(curve) if there else Constant)
    assert not grown.collect_to_collect
    if there:
        own = grown.run_to_run["BA"]
        assert np.max(own.table.se or () if isinstance(own, Table) else own.se) == pytest.approx(0.5)


@pytest.mark.slow
@pytest.mark.parametrize("stated", [None, STATED])
def test_noise_that_rises_in_the_cold_is_a_finding_only_beside_standard_errors(stated: float | None) -> None:
    """Where none are stated nobody said what it is there: it had been named, by one command and not by another."""
    rng = np.random.default_rng(4)
    rows = lay_out(rng)
    e = noise(rows, rng, sigma=STATED, run_bias=0.0) * np.where(rows.temperature < 0.0, 2.0, 1.0)[:, None]
    one = campaign_of(rows, base_rates(rows, thermal=False) + e, stated=stated)
    found, result = what_scatters(one), reconcile(one, "matrix-6", prove=False)
    assert found.named == (() if stated is None else ("hash",))
    assert [effect.id for effect in result.effects] == [*found.named]
    assert ("hash" in found.answer.scatters_by) is (stated is not None)


@pytest.mark.slow
@pytest.mark.usefixtures("searched_once")
def test_what_these_repeats_cannot_tell_is_said_by_both_in_one_sentence() -> None:
    """A walk as probable as none: `hil scatter` had said so of runs that `hil reconcile` had done with."""
    rng = np.random.default_rng(0)
    rows = lay_out(rng)
    e = noise(rows, rng, sigma=STATED, run_bias=2.0, rho=0.5)
    one = campaign_of(rows, base_rates(rows, thermal=False) + e, stated=STATED)
    untold, result = what_scatters(one).answer.untold, reconcile(one, "matrix-6", prove=False)
    assert untold.startswith("these repeats cannot tell what scatters: ")
    assert "Rate random walk (" in untold
    assert result.verdict == "none"
    assert untold in result.notes


@pytest.mark.slow
@pytest.mark.usefixtures("searched_once")
def test_what_single_runs_differ_by_may_be_temperature_and_is_in_no_error_that_is_stated() -> None:
    """One run at each of two temperatures: nobody can tell, both commands say so, and what to measure."""
    one = campaign(2, 1, scatter=0.0)
    result, told = reconcile(one, "matrix-6", prove=False), what_scatters(one).sentences()
    (said,) = (each for each in told if "followed temperature" in each)
    assert said in result.notes
    assert not any("an offset of each run" in each for each in told)
    kind, act = what_to_do(result)
    assert (result.verdict, kind) == ("none", "none")
    assert "First see to a second run at a temperature that has one: RA of sensor 2 and RB of sensor 2 may" in act
    assert "Nobody has to act" not in act
    assert "the noise of model.yaml has it" in act
    assert "± of hil solve" not in act
    again = what_to_do(reconcile(one, result.model_after, prove=False))[1]
    assert "First see to a second run at a temperature that has one: RA of sensor 2 and RB of sensor 2 may" in again


@pytest.mark.slow
def test_of_rates_without_errors_what_collects_scatter_by_is_the_white_noise_of_the_model() -> None:
    """Not beside a white noise that the twin assumes; and with it hil solve and the search have the errors of rates."""
    rng = np.random.default_rng(3)
    rows = lay_out(rng, (20.0, 50.0), 3)
    one = campaign_of(rows, base_rates(rows, thermal=False) + noise(rows, rng, run_bias=0.0), stated=None)
    result = reconcile(one, "matrix-6", prove=False)
    known = result.model_after
    assert [note for note in result.notes if "the white noise of model.yaml is what collects scatter by" in note]
    assert not known.noise[2].collect_to_collect
    errors = beside(one, known).sensors[2].rates_se_deg_per_hr
    assert np.allclose(errors, errors[0, 0])
    assert errors[0, 0] == pytest.approx(0.9, rel=0.2)
    again = reconcile(one, known, prove=False)
    assert again.model_after == again.input_model
    assert [each["stated_deg_per_hr"] for each in again.noise] == pytest.approx([errors[0, 0]] * 2)


@pytest.mark.slow
def test_what_a_channel_scatters_by_holds_what_moves_some_of_its_collects() -> None:
    """MU differs by 4 from run to run: of three collects one shows it, and all of it is in the channel's scatter."""
    rng = np.random.default_rng(3)
    rows = lay_out(rng, runs_each=3, positions=("1", "2", "3"))
    own = noise(rows, rng, run_bias=0.0) + 4.0 * rng.normal(size=(rows.run.max() + 1, 2))[rows.run] * rows.f[:, 2:]
    channels = reconcile(campaign_of(rows, base_rates(rows) + own), "matrix-6-thermal", prove=False).noise
    for channel, truth in zip(channels, np.sqrt(np.mean(own**2, axis=0)), strict=True):
        assert channel["observed_deg_per_hr"] == pytest.approx(truth, rel=0.15)
        assert channel["observed_deg_per_hr"] > channel["scatter"][0]["deg_per_hr"]


def test_values_that_are_off_by_the_noise_that_their_model_states_are_right(tmp_path: Path) -> None:
    """Two runs of a unit whose biases turn on anew, by a model that says so: within a run there is no such noise."""
    values = dict.fromkeys(BIASES, "{value: 0, unit: deg/hr}")
    values |= dict.fromkeys(("GSA", "GSB", "MUA", "MUB"), "{value: 0, unit: deg/hr/g}")
    changes = "{BA: {value: 9, unit: deg/hr}, BB: {value: 9, unit: deg/hr}}"
    told = "".join(f"    {name}: {each}\n" for name, each in values.items())
    text = f"sensors:\n  2:\n{told}noise:\n  2: {{run_to_run: {changes}}}\n"
    path, places = tmp_path / "known.yaml", ("1", "3", "2", "2", "3", "1")
    path.write_text(f"schema: hil.model/1\ntitle: known\nform: matrix-6\n{text}")
    rng, turned_on = np.random.default_rng(0), dict.fromkeys(BIASES, 9.0)
    one = rotor_night(rng, {}, temperatures_degC=(20.0,), runs=2, run_to_run=turned_on, positions=places)
    found = reconcile(one, load_model(path), prove=False)
    assert found.as_it_stands is not None
    assert found.as_it_stands["rms_deg_per_hr"] > 1.5 * found.gap.noise_floor
    assert found.as_it_stands["noise_deg_per_hr"] == pytest.approx(np.hypot(9.0, 0.93))
    assert not values_off(found.as_it_stands, found.gap)


@pytest.mark.slow
def test_what_runs_of_one_temperature_do_not_differ_by_is_in_no_error_of_theirs() -> None:
    """Six runs at three temperatures tell no slope for certain: an offset of each run is none where repeats agree."""
    rng = np.random.default_rng(3)
    rows = lay_out(rng, temperatures=(0.0, 23.0, 50.0), positions=("1", "2", "3"))
    slope = np.outer(0.2 * (rows.setpoint - 23.0), [1.0, 0.0])
    rates = base_rates(rows, thermal=False) + slope + noise(rows, rng, run_bias=0.8, rho=0.0)
    (collects,) = campaign_of(rows, rates).sensors.values()
    conditions = replace(collects.conditions, columns={"temperature_degC": rows.setpoint})
    settled = replace(campaign_of(rows, rates), sensors={2: replace(collects, conditions=conditions)})
    found = reconcile(settled, "matrix-6", prove=False)
    act = what_to_do(found)[1]
    assert found.verdict == "none"
    assert "First see to what RA of sensor 2 follows: runs of one temperature differ less (hil thermal)" in act
    assert "± of hil solve" not in act


@pytest.mark.parametrize(("noisy", "se", "white", "beyond"), [(1.5, 0.1, 0.5, 2.0**0.5), (0.51, 0.1, 0.505, None)])
def test_of_unlike_channels_without_errors_the_quietest_has_white_noise(
    noisy: float, se: float, white: float, beyond: float | None
) -> None:
    """The rest of the other is new in every collect: the rms of both had stood for each, in model.yaml alone."""
    rows = hidden_campaign(1).sensors[2].conditions
    model = Model(schema="hil.model/1", title="unit", form="matrix-6")
    none = dict.fromkeys(("stated_deg_per_hr", "run_offset_deg_per_hr", "run_offset_se_deg_per_hr"))
    seen = [
        {"sensor": 2, "channel": c, "under": "matrix-6", "collect_to_collect_deg_per_hr": size, **none}
        | {"collect_to_collect_se_deg_per_hr": se}
        for c, size in (("RA", 0.5), ("RB", noisy))
    ]
    section = with_ordinary(model, seen, {2: rows}).noise[2]
    assert section.white(rows) == pytest.approx(white, rel=1e-3)
    assert {name: each.at([0.0])[0] for name, each in section.collect_to_collect.items()} == (
        {} if beyond is None else {"BB": pytest.approx(beyond, rel=1e-3)}
    )
    words = " ".join(stated_in_words(seen, {}))
    assert [said in words for said in ("RB: 1.41", "of the quietest channel")] == [beyond is not None] * 2
