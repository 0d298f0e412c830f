"""Whole runs that disagree with all others: found, told apart, and left alone where noise or the catalogue does it."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest

from hil.campaign import Campaign
from hil.model.effects.catalogue import effect_by_id
from hil.reconcile import Reconciliation, reconcile
from hil.reconcile.outcome.sentences import summary
from hil.reconcile.outcome.stated import scatter_in_words
from hil.reconcile.scattering import what_scatters
from tests.hil.analysis.thermal.nights import RUN_TO_RUN, rotor_night, scaled
from tests.hil.reconcile.hidden_effects import EIGHT, Rows, base_rates, campaign_of, hidden_campaign, lay_out, noise
from tests.hil.solve.runs_of_a_unit import campaign, with_rates


def layout(temperatures: tuple[float, ...] = (25.0,), runs_each: int = 12, seed: int = 3, **more: object) -> Rows:
    """Twelve runs of four collects at one temperature, unless another night is asked for."""
    return lay_out(np.random.default_rng(seed), temperatures, runs_each, **more)  # type: ignore[arg-type]


def left_out(result: Reconciliation) -> list[tuple[int, str]]:
    """Run and channel of all that was left out as wrong."""
    rows = [row for row in result.rows if "does not agree with the other runs" in row["why"]]
    assert {row["done"] for row in rows} <= {"left out"}
    return sorted((row["run"], channel) for row in rows for channel in row["channels"])


def found(rows: Rows, rates: np.ndarray, model: str = "matrix-6") -> list[tuple[int, str]]:
    """The bad runs of a campaign with these rates."""
    return left_out(reconcile(campaign_of(rows, rates), model, prove=False))


def measured(rows: Rows, seed: int = 4, *, thermal: bool = True) -> np.ndarray:
    """Rates of a plausible unit under the usual noise, (n, 2)."""
    return base_rates(rows, thermal=thermal) + noise(rows, np.random.default_rng(seed))


def changed(
    rows: Rows, rates: np.ndarray, factor: float, runs: tuple[int, ...] = (4, 9), channel: int = 0
) -> np.ndarray:
    """The rates with one channel of some runs multiplied."""
    out = rates.copy()
    out[np.isin(rows.run, runs), channel] *= factor
    return out


@pytest.mark.slow
def test_rates_that_were_clipped_get_no_name() -> None:
    """What a channel cannot show is left out, with how far beyond the model expects it; k2 would explain it as well."""
    rows = layout()
    rates = measured(rows)
    limit = float(np.quantile(rates[:, 1], 0.8))
    beyond = np.flatnonzero(rates[:, 1] > limit)
    rates[beyond, 1] = limit
    campaign = campaign_of(rows, rates)
    result = reconcile(campaign, "matrix-6", prove=False)
    assert (result.verdict, len(result.effects)) == ("none", 0)
    collects = campaign.sensors[2].conditions.collect[beyond].tolist()
    assert sorted(row["collect"] for row in result.outliers) == collects
    assert sorted(n for row in result.rows for n in row["collects"]) == collects
    assert np.isfinite([row["size_deg_per_hr"] for row in result.outliers]).all()


@pytest.mark.slow
@pytest.mark.parametrize("factor", [-1.4, -0.7])
def test_a_run_that_is_turned_and_larger_is_not_called_turned(factor: float) -> None:
    """A sign is turned or not: where the size does not agree, no turning explains the run, and it is left out."""
    rows = layout()
    assert found(rows, changed(rows, measured(rows), factor, (4,))) == [(4, "RA")]


@pytest.mark.slow
@pytest.mark.parametrize("factor", [0.0, 3.6, 0.5])
def test_runs_that_were_written_wrongly_are_found(factor: float) -> None:
    """A dead channel and wrong factors, in two runs of twelve: those and no other. A turned sign is quick, below."""
    rows = layout()
    result = reconcile(campaign_of(rows, changed(rows, measured(rows), factor, channel=1)), "matrix-6", prove=False)
    told = sorted({(row["run"], *row["channels"]) for row in result.rows})
    assert told == [(4, "RB"), (9, "RB")]
    assert factor == 0.0 or left_out(result) == told  # what is 0 at every collect was left out before the search


@pytest.mark.slow
def test_runs_that_are_off_in_no_simple_way_are_found_too() -> None:
    """Every rate of a run is off by something else: its size is that of the change."""
    rows, rates = layout(), measured(layout())
    off = np.array([25.0, -18.0, 12.0, -30.0])
    rates[rows.run == 7, 1] += off
    result = reconcile(campaign_of(rows, rates), "matrix-6", prove=False)
    assert left_out(result) == [(7, "RB")]
    assert result.disagreements[0].size_deg_per_hr == pytest.approx(np.sqrt(np.mean(off**2)), rel=0.2)


@pytest.mark.slow
@pytest.mark.parametrize(("model", "runs_each", "bad"), [("matrix-6", 2, (3,)), ("matrix-6-thermal", 3, (5, 8))])
def test_bad_runs_show_on_a_night_of_three_temperatures(model: str, runs_each: int, bad: tuple[int, ...]) -> None:
    """Also beside a model that lacks temperature, and with a single neighbour at each temperature."""
    rows = layout(EIGHT[1::3], runs_each)
    rates = measured(rows)
    assert found(rows, rates, model) == []
    assert [run for run, _ in found(rows, changed(rows, rates, -3.0, bad), model)] == [*bad]


@pytest.mark.slow
def test_values_that_jump_from_temperature_to_temperature_are_no_bad_runs() -> None:
    """MU of the report at its coldest: far from all others, but the runs at that temperature agree."""
    rows = layout(EIGHT[1::3], 2)
    rates = measured(rows)
    rates[:, 1] += np.where(rows.setpoint < 0.0, 35.0, 0.0) * rows.f[:, 2]
    assert found(rows, rates) == []


def no_noise_but_white(rows: Rows, rng: np.random.Generator) -> np.ndarray:
    """Collect by collect."""
    return 0.9 * rng.normal(size=(len(rows), 2))


def heavy(rows: Rows, rng: np.random.Generator) -> np.ndarray:
    """Student's t with four degrees of freedom, in rows and in runs."""
    return 0.7 * rng.standard_t(4, (len(rows), 2)) + rng.standard_t(4, (rows.run.max() + 1, 2))[rows.run]


def walk(rows: Rows, rng: np.random.Generator) -> np.ndarray:
    """A random walk over the runs, bias and MU."""
    steps = rng.normal(size=(2, rows.run.max() + 1, 2)).cumsum(axis=1)[:, rows.run]
    return no_noise_but_white(rows, rng) + steps[0] + steps[1] * rows.f[:, 2:]


def reseating(rows: Rows, rng: np.random.Generator) -> np.ndarray:
    """MU differs from run to run."""
    return noise(rows, rng) + 3.0 * rng.normal(size=(rows.run.max() + 1, 2))[rows.run] * rows.f[:, 2:]


def power_cycle(rows: Rows, rng: np.random.Generator) -> np.ndarray:
    """The last three runs after another power-on: a bias of their own."""
    return noise(rows, rng) + 40.0 * (rows.run > rows.run.max() - 3)[:, None]


def jump(rows: Rows, rng: np.random.Generator) -> np.ndarray:
    """A bias that comes back after one run."""
    return noise(rows, rng) + 60.0 * (rows.run == 6)[:, None]


def glitch(rows: Rows, rng: np.random.Generator) -> np.ndarray:
    """One row."""
    return noise(rows, rng) + 90.0 * (np.arange(len(rows)) == 21)[:, None]


@pytest.mark.slow
@pytest.mark.parametrize("kind", [heavy, walk, reseating, power_cycle, jump, glitch])
def test_noise_and_what_has_a_name_are_no_bad_runs(kind: Callable[[Rows, np.random.Generator], np.ndarray]) -> None:
    """Two nights of each, of eight and of twenty-four runs."""
    for seed, runs in enumerate((8, 24)):
        rows = layout((25.0,), runs, seed)
        assert found(rows, base_rates(rows) + kind(rows, np.random.default_rng(seed))) == []


@pytest.mark.slow
def test_a_large_effect_that_acts_in_one_run_is_the_searchs_to_find() -> None:
    """Vibration that was strong once: what of the catalogue explains a run is not called unlike the catalogue."""
    rows = layout()
    strength = np.where(rows.run == 8, np.array([0.5, 0.9, 0.3, 0.7])[rows.order], 0.2)
    rates = measured(rows) + 300.0 * strength[:, None] ** 2
    campaign = campaign_of(rows, rates)
    collects = campaign.sensors[2]
    conditions = replace(collects.conditions, columns={**collects.conditions.columns, "vibration_rms_g": strength})
    campaign = replace(campaign, sensors={2: replace(collects, conditions=conditions)})
    assert {run for run, _ in found(rows, rates)} == {8}  # where the vibration was not recorded
    assert left_out(reconcile(campaign, "matrix-6", prove=False)) == []


@pytest.mark.slow
def test_rates_without_noise_have_no_bad_runs_of_rounding() -> None:
    """What is usual is then zero, and rounding would be far from it."""
    rows = layout()
    assert found(rows, base_rates(rows)) == []
    assert found(rows, np.round(base_rates(rows), 2)) == []


def spoiled(runs: tuple[int, ...] = (4, 9)) -> tuple[Campaign, Rows]:
    """A campaign of which some runs have one channel's sign turned and another gain: nothing can be put right."""
    rows = layout()
    return campaign_of(rows, changed(rows, measured(rows, 5), -3.0, runs)), rows


@pytest.mark.slow
def test_the_whole_result_says_which_runs_and_what_to_do() -> None:
    """Verdict, finding, places, note, advice and the page's first words; the model stays as it was."""
    campaign, _ = spoiled()
    result = reconcile(campaign, "matrix-6")
    assert result.verdict == "empirical"
    (effect,) = result.effects
    assert (effect.id, effect.kind) == ("empirical: runs 4, 9", "empirical")
    assert left_out(result) == [(4, "RA"), (9, "RA")]
    assert result.next_experiment is not None
    assert "runs 4, 9" in result.next_experiment["why"]
    assert len([note for note in result.notes if "left out: sensor 2, runs 4, 9: RA does not agree" in note]) == 1
    assert result.gap.noise_floor < 3.0
    assert result.gap.after < 3.0
    assert max(channel["observed_deg_per_hr"] for channel in result.noise) < 3.0
    assert result.model_after.model_copy(update={"noise": {}, "version": 1}) == result.input_model
    assert summary(result)[0].startswith("Runs 4, 9 do not agree")
    assert "in the model" not in " ".join(summary(result))


@pytest.mark.slow
def test_the_rest_is_judged_without_the_bad_runs() -> None:
    """A missing effect beside a spoiled run keeps its name."""
    campaign, rows = spoiled((4,))
    collects = campaign.sensors[2]
    extra = 30.0 * (rows.supply - 28.0)[:, None] * np.where(rows.run == 4, np.array([[-1.0], [1.0]]), 1.0).T
    campaign = replace(campaign, sensors={2: replace(collects, rates_deg_per_hr=collects.rates_deg_per_hr + extra)})
    result = reconcile(campaign, "matrix-6", prove=False)
    assert [effect.id for effect in result.effects] == ["empirical: run 4", "supply"]
    assert result.verdict == "empirical"


@pytest.mark.slow
def test_a_jump_keeps_its_name() -> None:
    """A bias that steps in one run has a name, however large."""
    rows = layout()
    campaign = campaign_of(rows, base_rates(rows) + jump(rows, np.random.default_rng(1)))
    result = reconcile(campaign, "matrix-6", prove=False)
    assert [effect.id for effect in result.effects] == ["jump"]


def test_what_the_model_explains_is_no_surprise() -> None:
    """Five times the standard errors, where the model states nothing; nothing to be said where it states as much."""
    channel = {"sensor": 2, "channel": "RB", "stated_deg_per_hr": 1.0, "observed_deg_per_hr": 5.0, "under": "matrix-6"}
    channel |= {"run_offset_deg_per_hr": 5.0, "run_offset_se_deg_per_hr": 1.0, "scatter": []}
    channel |= dict.fromkeys(("collect_to_collect_deg_per_hr", "collect_to_collect_se_deg_per_hr"))
    (told,) = scatter_in_words([{**channel, "explained_deg_per_hr": 1.0}])
    assert "5 times as much as their standard errors say" in told
    (told,) = scatter_in_words([{**channel, "explained_deg_per_hr": 2.5}])
    assert "2 times as much as their standard errors and the model say" in told
    assert scatter_in_words([{**channel, "explained_deg_per_hr": 4.0}]) == []
    assert scatter_in_words([{**channel, "explained_deg_per_hr": 1.0, "run_offset_se_deg_per_hr": None}]) == []
    for seed in range(3):  # of two sound runs, which tell next to nothing of what runs scatter by
        few = what_scatters(campaign(2, 2, seed, scatter=0.0)).answer.noise
        assert scatter_in_words(few) == []
        assert all(each["observed_deg_per_hr"] < 1.4 * each["stated_deg_per_hr"] for each in few)


@pytest.mark.slow
def test_of_two_rows_that_differ_nobody_says_which_is_wrong() -> None:
    """Two runs at one temperature, one rate wrong: whichever is left out, the other is named with it."""
    one = campaign(2, 2, seed=11, scatter=2.0)
    for wrong, partner in ((5, 2), (1, 4)):
        rates = one.sensors[2].rates_deg_per_hr.copy()
        rates[wrong, 0] += 80.0
        (row,) = what_scatters(with_rates(one, rates)).answer.rows
        both = {wrong + 1, partner + 1}
        (left_out,) = row["collects"]
        (other,) = both - {left_out}
        assert f"or collect {other} may be, in its place" in row["why"]
    three = campaign(12, 3, seed=11, scatter=2.0)
    rates = three.sensors[2].rates_deg_per_hr.copy()
    rates[5, 0] += 80.0
    (row,) = what_scatters(with_rates(three, rates)).answer.rows
    assert row["collects"] == [6]
    assert "in its place" not in row["why"]


@pytest.mark.slow
@pytest.mark.parametrize("seed", [3, 6])
def test_a_bad_last_collect_is_left_out_beside_what_is_named(seed: int) -> None:
    """How many rows are wrong was asked of other sets than those of the leading names: of these none was left."""
    one = campaign(12, 3, seed=seed, scatter=1.0)
    rates = one.sensors[2].rates_deg_per_hr.copy()
    rates[35, 0] += 25.0
    found = reconcile(with_rates(one, rates), "matrix-6", prove=False)
    (effect,) = found.effects
    catalogued = effect_by_id("bias_T")  # found by the bias's own columns, and told as what it is called
    assert (effect.id, effect.title, effect.equation) == ("bias_T", catalogued.title, catalogued.equation)
    assert catalogued.signature in effect.physics
    (typical,) = {each["typical"] for each in effect.parameters if each["unit"] == "deg/hr/degC"}
    assert typical == catalogued.parameters[0].typical
    assert [(row["done"], row["collects"]) for row in found.rows] == [("left out", [36])]


@pytest.mark.slow
def test_the_size_of_what_scatters_is_as_uncertain_as_its_runs_make_it() -> None:
    """Of 24 runs of two channels a deviation is known to a tenth, and not to what the search has left of its grid."""
    curves = {"MUA": lambda t: 5.0 + 0.0 * t, "BB": lambda t: 30.0 * scaled(t)}
    night = rotor_night(np.random.default_rng(38), curves)
    (of_mu,) = (e for e in reconcile(night, "collins-4", prove=False).effects if e.id == "MU_rr")
    (size,) = of_mu.parameters
    assert 0.08 < np.log(size["high"] / size["low"]) / 3.92 < 0.15
    assert size["low"] < np.hypot(RUN_TO_RUN["MUA"], RUN_TO_RUN["MUB"]) / np.sqrt(2.0) < size["high"]


@pytest.mark.slow
@pytest.mark.parametrize("seed", [1, 2, 3])
@pytest.mark.parametrize("repeats", [2, 3])
def test_what_changes_from_run_to_run_has_its_name_in_few_runs_too(seed: int, repeats: int) -> None:
    """MU of three runs is no law of whatever else was another in each of them; of two that are alike nothing is."""
    plain = hidden_campaign(seed, temperatures=(23.0,), runs_each=repeats, positions=tuple("1342431"), quiet=0.3)
    rows = plain.sensors[2]
    moved = 4.0 * np.random.default_rng(seed).standard_normal((repeats, 2))[rows.conditions.run - 1]
    reseats = rows.rates_deg_per_hr + moved * rows.conditions.f_g[:, 2:]
    found = reconcile(replace(plain, sensors={2: replace(rows, rates_deg_per_hr=reseats)}), "matrix-6", prove=False)
    assert {effect.id for effect in found.effects} <= {"MU_rr"}
    assert repeats < 3 or found.effects
    assert reconcile(plain, "matrix-6", prove=False).effects == []
