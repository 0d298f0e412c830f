"""Whole runs that disagree with all others: found, told apart, and left alone where noise or the catalogue does it."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest

from hil.campaign import Campaign
from hil.model import load_model
from hil.model.effects.catalogue import BASE_EFFECTS, EFFECTS
from hil.reconcile import reconcile
from hil.reconcile.bad_data.runs import BadRun, bad_runs, rows_of
from hil.reconcile.outcome.page import summary
from hil.reconcile.search.problem import pose
from tests.hil.reconcile.hidden_effects import EIGHT, Rows, base_rates, campaign_of, lay_out, noise

DRAWS = 100


def layout(temperatures: tuple[float, ...] = (25.0,), runs_each: int = 12, seed: int = 3, **more: object) -> Rows:
    """Twelve runs of four collects at one temperature, unless another night is asked for."""
    return lay_out(np.random.default_rng(seed), temperatures, runs_each, **more)  # type: ignore[arg-type]


def found(rows: Rows, rates: np.ndarray, model: str = "matrix-6") -> list[BadRun]:
    """The bad runs of a campaign with these rates; where there are any, the whole catalogue beside them."""
    campaign = campaign_of(rows, rates)
    if not bad_runs(campaign, pose(campaign, load_model(model), ()).blocks, ()):
        return []
    problem = pose(campaign, load_model(model), (*BASE_EFFECTS, *EFFECTS))
    return bad_runs(campaign, problem.blocks, problem.candidates)


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


WRONGS = {-1.0: "sign", 0.0: "dead", 3.6: "factor", 0.5: "factor"}
# Quick: each change in one channel, by turns.
CASES = [
    pytest.param(factor, channel, marks=() if place % 2 == channel else pytest.mark.slow)
    for place, factor in enumerate(WRONGS)
    for channel in (0, 1)
]


@pytest.mark.parametrize(("factor", "channel"), CASES)
def test_runs_that_were_written_wrongly_are_found_and_recognised(factor: float, channel: int) -> None:
    """Two runs of twelve, one channel: those and no other, with the factor."""
    rows = layout()
    bad = found(rows, changed(rows, measured(rows), factor, channel=channel))
    kind = WRONGS[factor]
    assert [(b.run, b.channel, b.kind) for b in bad] == [(4, channel, kind), (9, channel, kind)]
    assert all(abs(b.factor - factor) < 0.15 for b in bad)
    assert all(b.usual < 2.0 and b.size > 10.0 * b.usual for b in bad)


def test_runs_that_are_off_in_no_simple_way_are_found_too() -> None:
    """Every rate of a run is off by something else: nothing is recognised, and the size is that of the change."""
    rows, rates = layout(), measured(layout())
    off = np.array([25.0, -18.0, 12.0, -30.0])
    rates[rows.run == 7, 1] += off
    (bad,) = found(rows, rates)
    assert (bad.run, bad.channel, bad.kind) == (7, 1, "")
    assert bad.size == pytest.approx(np.sqrt(np.mean(off**2)), rel=0.15)


@pytest.mark.parametrize("model", ["matrix-6", "matrix-6-thermal"])
@pytest.mark.parametrize("runs_each", [2, 3])
def test_bad_runs_show_on_a_night_of_eight_temperatures(model: str, runs_each: int) -> None:
    """Also beside a model that lacks temperature, and with a single neighbour at each temperature."""
    rows = layout(EIGHT, runs_each)
    rates = measured(rows)
    assert found(rows, rates, model) == []
    assert [b.run for b in found(rows, changed(rows, rates, -1.0, (5, 12)), model)] == [5, 12]


def test_values_that_jump_from_temperature_to_temperature_are_no_bad_runs() -> None:
    """MU of the report at its coldest: far from all others, but the runs at that temperature agree."""
    rows = layout(EIGHT, 2)
    rates = measured(rows)
    rates[:, 1] += np.where(rows.setpoint < -20.0, 35.0, 0.0) * rows.f[:, 2]
    assert found(rows, rates) == []


def test_a_run_alone_at_its_temperature_is_not_judged() -> None:
    """The others have neighbours; what differs in this one may be the temperature."""
    rows = layout(EIGHT, 2)
    rates = measured(rows)
    rates[rows.run == 7] = np.nan
    rates[:, 1] += np.where(rows.run == 8, 60.0, 0.0) * rows.f[:, 2]
    campaign = campaign_of(rows, rates)
    assert bad_runs(campaign, pose(campaign, load_model("matrix-6"), ()).blocks, ()) == []


def test_one_run_at_each_temperature_is_not_judged() -> None:
    """What differs may be the temperature."""
    rows = layout(tuple(np.linspace(-30.0, 60.0, 12)), 1)
    assert found(rows, changed(rows, measured(rows), -1.0)) == []


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


@pytest.mark.parametrize("kind", [noise, no_noise_but_white, heavy, walk, reseating, power_cycle, jump, glitch])
@pytest.mark.parametrize("nights", [3, pytest.param(20, marks=pytest.mark.slow)])
def test_noise_and_what_has_a_name_are_no_bad_runs(
    kind: Callable[[Rows, np.random.Generator], np.ndarray], nights: int
) -> None:
    """So many nights of each, of eight to twenty-four runs."""
    for seed in range(nights):
        rows = layout((25.0,), (8, 12, 24)[seed % 3], seed)
        assert found(rows, base_rates(rows) + kind(rows, np.random.default_rng(seed))) == []


def test_a_large_effect_that_acts_in_one_run_is_the_searchs_to_find() -> None:
    """Vibration that was strong once: what of the catalogue explains a run is not called unlike the catalogue."""
    rows = layout()
    strength = np.where(rows.run == 8, np.array([0.5, 0.9, 0.3, 0.7])[rows.order], 0.2)
    rates = measured(rows)
    rates += 300.0 * strength[:, None] ** 2
    campaign = campaign_of(rows, rates)
    collects = campaign.sensors[2]
    conditions = replace(collects.conditions, columns={**collects.conditions.columns, "vibration_rms_g": strength})
    campaign = replace(campaign, sensors={2: replace(collects, conditions=conditions)})
    assert {b.run for b in found(rows, rates)} == {8}  # where the vibration was not recorded
    problem = pose(campaign, load_model("matrix-6"), (*BASE_EFFECTS, *EFFECTS))
    assert bad_runs(campaign, problem.blocks, problem.candidates) == []


@pytest.mark.parametrize("runs", [(2, 4, 6, 8), tuple(range(1, 7))])
def test_more_than_a_quarter_are_not_a_few_bad_runs(runs: tuple[int, ...]) -> None:
    """Four of twelve are as likely right as wrong: a claim about the others would be one about them."""
    rows = layout()
    assert found(rows, changed(rows, measured(rows), -1.0, runs)) == []


def test_fewer_than_eight_runs_are_not_judged() -> None:
    """What is usual cannot be told from so few."""
    rows = layout((25.0,), 7)
    assert found(rows, changed(rows, measured(rows), -1.0, (4,))) == []


def test_rates_without_noise_have_no_bad_runs_of_rounding() -> None:
    """What is usual is then zero, and rounding would be far from it."""
    rows = layout()
    rates = base_rates(rows)
    assert found(rows, rates) == []
    assert found(rows, np.round(rates, 2)) == []


def flipped(runs: tuple[int, ...] = (4, 9)) -> tuple[Campaign, Rows]:
    """A campaign of which two runs have one channel's sign turned."""
    rows = layout()
    return campaign_of(rows, changed(rows, measured(rows), -1.0, runs)), rows


def test_the_whole_result_says_which_runs_and_what_to_do() -> None:
    """Verdict, finding, places, note, advice and the page's first words; the model stays as it was."""
    campaign, _ = flipped()
    result = reconcile(campaign, "matrix-6")
    assert result.verdict == "empirical"
    (effect,) = result.effects
    assert (effect.id, effect.kind) == ("empirical: runs 4, 9", "empirical")
    assert [p["value"] for p in effect.parameters] == [-1.0, -1.0]
    assert [d.where for d in sorted(result.disagreements, key=lambda d: d.where["runs"])] == [
        {"sensor": 2, "channel": "RA", "runs": [4]},
        {"sensor": 2, "channel": "RA", "runs": [9]},
    ]
    assert result.next_experiment is not None
    assert "runs 4, 9" in result.next_experiment["why"]
    assert any("runs 4, 9" in note and "times -1" in note for note in result.notes)
    assert result.gap.noise_floor < 3.0
    assert result.model_after == result.input_model
    assert summary(result)[0].startswith("Runs 4, 9 do not agree")
    assert "in the model" not in " ".join(summary(result))
    assert result.document()["verdict"] == "empirical"


def test_the_rest_is_judged_without_the_bad_runs() -> None:
    """A missing effect beside a flipped run keeps its name."""
    campaign, rows = flipped((4,))
    collects = campaign.sensors[2]
    extra = 30.0 * (rows.supply - 28.0)[:, None] * np.where(rows.run == 4, np.array([[-1.0], [1.0]]), 1.0).T
    campaign = replace(campaign, sensors={2: replace(collects, rates_deg_per_hr=collects.rates_deg_per_hr + extra)})
    result = reconcile(campaign, "matrix-6", prove=False)
    assert [effect.id for effect in result.effects] == ["empirical: run 4", "supply"]
    assert result.verdict == "empirical"


def test_a_jump_keeps_its_name() -> None:
    """A bias that steps in one run has a name, however large."""
    rows = layout()
    campaign = campaign_of(rows, base_rates(rows) + jump(rows, np.random.default_rng(1)))
    result = reconcile(campaign, "matrix-6", prove=False)
    assert [effect.id for effect in result.effects] == ["jump"]


def test_only_the_channel_that_disagrees_is_left_out() -> None:
    """Every row of the run, and of no other channel."""
    campaign, rows = flipped()
    problem = pose(campaign, load_model("matrix-6"), ())
    left = rows_of(bad_runs(campaign, problem.blocks, ()))
    assert {(o["row"], o["channel"]) for o in left} == {
        (row, 0) for row in np.flatnonzero(np.isin(rows.run, (4, 9))).tolist()
    }
