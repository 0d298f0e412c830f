"""MU that steps has a name of its own, as a bias that steps has; and G of a triad that is another in each run."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from hil.campaign import Campaign, Collects, Conditions, Sensor
from hil.model.effects.catalogue import effect_by_id
from hil.model.effects.noise import AxialDriftJump, Jump
from hil.model.effects.thermal import AxialHysteresis
from hil.reconcile import reconcile
from hil.reconcile.proof.experiment import next_experiment
from tests.hil.reconcile.hidden_effects import base_rates, campaign_of, lay_out


def stepped(seed: int, runs: int, before: int, size: float, *, of_mu: bool) -> Campaign:
    """Runs at one temperature; after so many of them MUA, deg/hr/g, or BA, deg/hr, is another."""
    rng = np.random.default_rng(seed)
    rows = lay_out(rng, (20.0,), runs)
    after = size * (rows.run > before)
    moved = np.stack([np.zeros(len(rows)), -rows.f[:, 2]] if of_mu else [np.ones(len(rows)), np.zeros(len(rows))], 1)
    rates = base_rates(rows, thermal=False) + after[:, None] * moved
    return campaign_of(rows, rates + rng.normal(0.0, 0.9, rates.shape))


@pytest.mark.parametrize("seed", [1, 2])
@pytest.mark.parametrize(("of_mu", "name", "value"), [(True, "MU_jump", "JMUA"), (False, "jump", "J_A")])
def test_of_two_runs_after_a_step_it_is_told_what_stepped(seed: int, of_mu: bool, name: str, value: str) -> None:
    """Two of five runs with another MU were said to scatter from run to run, at 100 %."""
    result = reconcile(stepped(seed, 5, 3, 15.0, of_mu=of_mu), "matrix-6", prove=False)
    (effect,) = result.effects
    assert (effect.id, effect.probability > 0.9) == (name, True)
    (size,) = (of for of in effect.parameters if of["name"] == value)
    assert abs(size["value"] - 15.0) < 4.0 * size["se"] < 8.0


def test_mu_that_steps_before_any_collect_felt_it_is_no_step() -> None:
    """Beside a model without MU that would be MU itself, from the first run's third collect on."""
    sensors = stepped(1, 3, 1, 0.0, of_mu=True).sensors[2]
    conditions = sensors.conditions
    first = np.flatnonzero(np.abs(conditions.f_g[:, 2]) > 0.1)[0]
    places = [each for each in AxialDriftJump().shape_grid(conditions) if each["from_run"] == 1.0]
    assert all(each["from_collect"] > first for each in places)
    assert len(AxialDriftJump().shape_grid(conditions)) < len(Jump().shape_grid(conditions))


def test_of_few_runs_none_is_asked_about_alone() -> None:
    """Of eight nobody can tell one whose MU is another from MU that differs from run to run; of nine it is asked."""
    alone = [
        {shape["from_run"] for shape in AxialDriftJump().shape_grid(made.sensors[2].conditions) if shape["runs_held"]}
        for made in (stepped(1, 8, 1, 0.0, of_mu=True), stepped(1, 9, 1, 0.0, of_mu=True))
    ]
    assert alone == [set(), {float(run) for run in range(1, 10)}]


@pytest.mark.parametrize("seed", range(3))
def test_mu_that_is_another_in_every_run_does_not_jump(seed: int) -> None:
    """Ten draws around one value: no step."""
    rng = np.random.default_rng(seed)
    rows = lay_out(rng, (20.0,), 10)
    mu = 4.0 * rng.normal(size=(11, 2))[rows.run]
    rates = base_rates(rows, thermal=False) + rows.f[:, 2:] * mu
    result = reconcile(campaign_of(rows, rates + rng.normal(0.0, 0.9, rates.shape)), "matrix-6", prove=False)
    assert [effect.id for effect in result.effects] == ["MU_rr"]


@pytest.mark.slow
@pytest.mark.parametrize("seed", [1, 2])
def test_mu_of_one_run_alone_has_its_name_and_size(seed: int) -> None:
    """It was a run that agrees with no other, and was left out, where a bias alone in its run had its name."""
    rng = np.random.default_rng(seed)
    rows = lay_out(rng, (0.0, 20.0, 40.0, 60.0), 3)
    rates = base_rates(rows, thermal=False) + rng.normal(0.0, 0.9, (len(rows), 2))
    rates[:, 1] -= 15.0 * rows.f[:, 2] * (rows.run == 5)
    result = reconcile(campaign_of(rows, rates), "matrix-6", prove=False)
    (effect,) = result.effects
    assert (effect.id, effect.shape["from_run"], effect.shape["runs_held"]) == ("MU_jump", 5.0, 1.0)
    (size,) = (of for of in effect.parameters if of["name"] == "JMUA")
    assert abs(size["value"] - 15.0) < 4.0 * size["se"] < 8.0
    own = {each["run"]: each["after"] for each in result.values if each["name"] == "MUA"}
    assert own[5] - own[6] == pytest.approx(size["value"])  # where it acts, too, not at the coldest and warmest alone


@pytest.mark.slow
def test_a_triads_g_that_is_another_in_each_run_is_no_pier_that_turns() -> None:
    """Base motion was said of it at 100 %: no entry had it."""
    rng = np.random.default_rng(1)
    runs, poses = 10, np.vstack([np.eye(3), -np.eye(3)])
    run, f = np.repeat(np.arange(runs) + 1, 6), np.tile(poses, (runs, 1))
    moved = np.einsum("nca,na->nc", 4.0 * rng.normal(size=(runs + 1, 3, 3))[run], f)
    conditions = Conditions(
        Sensor(1, ("X", "Y", "Z"), {"GX": "X", "GY": "Y", "GZ": "Z"}),
        np.arange(len(run)) + 1,
        run,
        np.tile(["1", "2", "3", "4", "5", "6"], runs),
        100.0 * np.arange(len(run)) + 3000.0 * run,
        np.full(len(run), 60.0),
        f,
        np.zeros((len(run), 3)),
        {},
    )
    rates = np.array([10.0, -5.0, 3.0]) + moved + rng.normal(0.0, 0.9, moved.shape)
    result = reconcile(
        Campaign("triad", "", {1: Collects(conditions, rates, np.full(rates.shape, 0.9))}), "triad-12", prove=False
    )
    assert [effect.id for effect in result.effects] == ["G_rr"]
    assert [of["value"] for of in result.effects[0].parameters] == [pytest.approx(4.0, rel=0.4)]


@pytest.mark.slow
def test_mu_that_is_another_on_the_way_back_has_two_names() -> None:
    """A step at the turn, or hysteresis: these collects cannot tell, and a jump was certain."""
    rng = np.random.default_rng(3)
    up = (20.0, 35.0, 50.0, 65.0)
    rows = lay_out(rng, (*up, *up[-2::-1]), 2)
    back = 10.0 * (rows.run > 2 * len(up))
    rates = base_rates(rows, thermal=False) + rng.normal(0.0, 0.9, (len(rows), 2))
    result = reconcile(
        campaign_of(rows, rates + np.stack([back * rows.f[:, 2], np.zeros(len(rows))], 1)), "matrix-6", prove=False
    )
    (effect,) = result.effects
    assert {effect.id, *(rival.id for rival in effect.confusable_with)} >= {"MU_hyst", "MU_jump"}
    assert 0.05 < effect.probability < 0.95
    assert result.verdict == "ambiguous"


def test_mu_is_larger_on_the_heating_branch_by_its_hysteresis() -> None:
    """RA += MUB fS, RB -= MUA fS, by +h once the unit was heated past the half width, by -h on the way back."""
    rows = lay_out(np.random.default_rng(1), (20.0, 40.0, 60.0, 40.0, 20.0), 1, ("3", "4"))
    rows.temperature = rows.setpoint
    conditions = campaign_of(rows, np.zeros((len(rows), 2))).sensors[2].conditions
    columns = AxialHysteresis().columns(conditions, None, {"half_width_degC": 5.0, "from_degC": 20.0})
    side = np.repeat([0.0, 1.0, 1.0, -1.0, -1.0], 2)
    assert columns[:, 1, 0] == pytest.approx(-rows.f[:, 2] * side)
    assert columns[:, 0, 1] == pytest.approx(rows.f[:, 2] * side)
    assert not columns[:, [0, 1], [0, 1]].any()


@pytest.mark.parametrize(("name", "why"), [("jump", "by how runs scatter whether"), ("ageing", "ageing again, or")])
def test_what_happened_once_does_not_come_back_when_it_is_asked(name: str, why: str) -> None:
    """The same collects again show an ageing again; of a step they show whether noise makes one."""
    sensor: Any = SimpleNamespace(collects=stepped(1, 5, 3, 15.0, of_mu=False).sensors[2])
    leader: Any = SimpleNamespace(effect=effect_by_id(name), name=name, shape={"from_run": 4.0, "runs_held": 0.0})
    told = next_experiment((leader, np.zeros(2)), None, None, sensor, 1.0)
    assert told is not None
    assert (told["what"], f"shows {why}" in told["why"]) == ("the same collects again", True)
