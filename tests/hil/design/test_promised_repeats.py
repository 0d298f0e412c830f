"""What a design promises of a unit whose scatter few repeats told, and what it says of a night of weeks."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from hil.campaign.writer import write_campaign
from hil.cli.app import run
from hil.config import load_bench, load_sweep
from hil.design.budget.document import Asked, budget_document
from hil.design.budget.scenes import measured_scenes
from hil.design.sequence.proposal import design_document
from hil.design.sequence.search import Goal, propose
from hil.design.sequence.unit_scatter import scatter_of_unit
from hil.solve import repeats, solve_campaign
from tests.hil.reconcile.hidden_effects import base_rates, campaign_of, lay_out
from tests.hil.solve.runs_of_a_unit import campaign


@pytest.mark.parametrize("runs", [2, 4, 12])
def test_how_large_a_scatter_may_be_holds_however_few_repeats_told_it(runs: int) -> None:
    """Of two runs it may be many times what they showed, of twelve half as much again: 95 % of all are no larger."""
    found = [scatter_of_unit(campaign(runs, runs, seed=seed, scatter=6.0))[2] for seed in range(80)]
    held = [of.at_most[name] >= 6.0 for of in found for name in ("BA", "BB")]
    assert 0.9 <= np.mean(held) <= 1.0
    times = np.median([of.at_most["BA"] / max(of.sizes["BA"], 0.1) for of in found])
    assert {2: 8.0, 4: 2.0, 12: 1.3}[runs] < times < {2: 30.0, 4: 4.0, 12: 2.0}[runs]


@pytest.mark.slow
def test_what_few_repeats_told_is_promised_as_they_told_it(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """Two runs at one temperature had promised an MU to a hundredth; weeks of repeats are said to be weeks."""
    write_campaign(campaign(4, 2, seed=34, scatter=6.0), tmp_path / "two")
    asked = ["design", "--sensor", "2", "--scatter", str(tmp_path / "two"), "--goal", "BA 1 deg/hr"]
    assert run([*asked, "--json"]) == 0
    told = json.loads(capsys.readouterr().out)
    best, most = told["proposed"]["sensors"]["2"]["uncertainty"], told["at_most"]["2"]
    assert most["BA"] > 2.0 * best["BA"]
    assert f"BA ± {most['BA']:.3g} instead of 1" in told["said"][-1]
    assert run(asked) == 0
    assert "   at most  " in capsys.readouterr().out
    sweep, bench = load_sweep("rd-gc-86-1"), load_bench("simulated")
    goal = Goal({"MU": 1.0}, scatter={"MU": 6.0}, sensors=(2,))
    (weeks,) = design_document(propose(sweep, bench, goal), goal, sweep, bench)["said"]
    assert "days, is what it takes for what runs differ by (sensor 2: MUA by 6, MUB by 6;" in weeks
    out_of_reach = replace(goal, scatter={"MU": 400.0})
    (never,) = design_document(propose(sweep, bench, out_of_reach), out_of_reach, sweep, bench)["said"]
    assert "days, are not enough for what runs differ by" in never


def test_what_is_proposed_stands_once_in_the_table(capsys: pytest.CaptureFixture[str]) -> None:
    """1-3-2 is the proposal and a usual variant: the same night had two lines."""
    assert run(["design", "--sensor", "2"]) == 0
    assert sum(" 1-3-2 " in line for line in capsys.readouterr().out.splitlines()) == 1


def test_what_one_run_alone_shows_does_not_last() -> None:
    """MU of one run of nine is another, and comes back: repeats average it; a step that stays they do not."""
    lasting = []
    for after in (np.array([5]), np.arange(5, 10)):
        rng = np.random.default_rng(1)
        rows = lay_out(rng, (20.0,), 9, ("1", "3", "2", "4"))
        rates = base_rates(rows, thermal=False) + rng.normal(0.0, 0.9, (len(rows), 2))
        rates[:, 1] -= 15.0 * rows.f[:, 2] * np.isin(rows.run, after)
        lasting.append("MUA" in scatter_of_unit(campaign_of(rows, rates))[2].lasting)
    assert lasting == [False, True]


def test_what_is_promised_has_the_noise_that_the_unit_shows() -> None:
    """Of a channel ten times as noisy as the bench says a mean was promised as the bench's: design as budget knows."""
    made = campaign(9, 3, seed=5, scatter=0.0)
    rows = made.sensors[2]
    rng, noise = np.random.default_rng(2), np.array([0.5, 9.0])
    rates = rows.rates_deg_per_hr + rng.normal(0.0, 1.0, rows.rates_deg_per_hr.shape) * noise
    stated = np.broadcast_to(noise, rates.shape).copy()
    sweep, bench = load_sweep("rd-gc-86-1"), load_bench("simulated")
    for errors in (stated, np.full_like(stated, np.nan)):
        one = replace(made, sensors={2: replace(rows, rates_deg_per_hr=rates, rates_se_deg_per_hr=errors)})
        of_unit = scatter_of_unit(one)
        assert of_unit[2].noise["RB"] > 4.0 * of_unit[2].noise["RA"]
        goal = Goal({}, sensors=(2,), shown=of_unit)
        proposal = propose(sweep, bench, goal)
        (same,) = (each for each in (proposal.best, *proposal.compared) if each.sequence == "1-2-3")
        known, shown = same.total[2], repeats(one, solve_campaign(one))
        at = budget_document(measured_scenes(one, bench, shown), "t", Asked(draws=100), observed=shown)["sensors"]["2"]
        for name in ("BB", "GSB"):
            assert known[name] == pytest.approx(at["mean_of_repeats"][name], rel=0.15)
