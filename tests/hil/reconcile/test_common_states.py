"""What moves a room moves both sensors, what changes in a unit one: in each alone the two causes look alike."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from hil.campaign import Campaign, FloatArray, Sensor
from hil.model import load_model
from hil.model.effects.catalogue import BASE_EFFECTS, EFFECTS, VARIANCE_EFFECTS, variance_effect_by_id
from hil.reconcile import reconcile
from hil.reconcile.search import likely_noise
from hil.reconcile.search.layout import searches
from hil.reconcile.search.points import Profile
from hil.reconcile.search.problem import pose
from hil.reconcile.search.together import same_states
from tests.hil.reconcile.hidden_effects import ANGLES, Rows, base_rates, campaign_of, lay_out

RUNS = 10


def both_sensors(seed: int, *, room: float = 0.0, gs: float = 0.0, mu: float = 0.0) -> Campaign:
    """Ten runs at one temperature of two sensors, a quarter turn apart, on a pier that turns by `room`, deg/hr.

    GS and MU of each are others in each run, by `gs` and `mu` deg/hr/g, and so are all biases.
    """
    rng = np.random.default_rng(seed)
    rows = lay_out(rng, (20.0,), RUNS)
    hours, theta = rows.start_s / 3600.0, np.deg2rad([ANGLES[label] for label in rows.position])
    turns = np.zeros((len(rows), 3))
    for i in range(len(rows)):
        keep = np.exp(-2.0 * (hours[i] - hours[i - 1])) if i else 0.0
        turns[i] = keep * turns[i - 1] + np.sqrt(1.0 - keep**2) * rng.normal(size=3)
    along = room * (turns[:, 0] * np.sin(theta) + turns[:, 2] * np.cos(theta))
    spin = room * (turns[:, 0] * np.cos(theta) - turns[:, 2] * np.sin(theta))
    sensors = {}
    for number, of_room in ((2, along), (1, spin)):
        own = rows if number == 2 else _a_quarter_further(rows)
        offset, other_gs, other_mu = (size * rng.normal(size=(RUNS + 1, 2))[rows.run] for size in (1.3, gs, mu))
        (a, _, s), (g, h), (m, n) = own.f.T, other_gs.T, other_mu.T
        moved = offset + np.stack([g * a + n * s + of_room, -h * a - m * s + room * turns[:, 1]], 1)
        rates = base_rates(own, thermal=False) + moved + rng.normal(0.0, 0.9, (len(rows), 2))
        (filed,) = campaign_of(own, rates).sensors.values()
        sensor = Sensor(number, ("A", "B", "S"), {"RA": "A", "RB": "B"})
        sensors[number] = replace(filed, conditions=replace(filed.conditions, sensor=sensor))
    return replace(campaign_of(rows, rates), sensors=sensors)


def _a_quarter_further(rows: Rows) -> Rows:
    turned = (np.stack([v[:, 2], v[:, 1], -v[:, 0]], 1) for v in (rows.f, rows.w))
    return replace(rows, **dict(zip(("f", "w"), turned, strict=True)))


@pytest.mark.slow
@pytest.mark.parametrize(("hidden", "is_the_room"), [({"room": 3.0}, True), ({"gs": 3.0, "mu": 3.0}, False)])
def test_a_room_turns_both_sensors(hidden: dict[str, float], is_the_room: bool) -> None:
    """What is the same in both at any time is far likelier then, and far less likely where each has its own."""
    problem = pose(both_sensors(1, **hidden), load_model("matrix-6"), (*BASE_EFFECTS, *EFFECTS))
    found = searches(problem, (), VARIANCE_EFFECTS)
    worth = same_states(found, {1: (), 2: ()}, "base")
    assert (worth > 3.0) is is_the_room
    assert (worth < -3.0) is not is_the_room
    assert same_states(found, {1: (), 2: ()}, "no such effect") == 0.0


def test_two_effects_are_weighed_together_though_a_third_is_likelier_than_either() -> None:
    """A turning pier explains one sensor's rows better than GS or MU alone, and hid that both do."""
    effects = [variance_effect_by_id(name) for name in ("MU_rr", "GS_rr", "base")]
    found = searches(pose(both_sensors(9, gs=5.0, mu=4.0), load_model("matrix-6"), ()), (), effects)
    for search in found.values():
        block = search.blocks[0]
        assert frozenset({"MU_rr", "GS_rr"}) in {block.noise.sorts[sort] for sort in block.points.sort}


@pytest.mark.slow
def test_noises_that_come_later_are_weighed_as_those_that_were_there(monkeypatch: pytest.MonkeyPatch) -> None:
    """What is kept of a profile where the grid grows is what weighing every noise anew gives."""
    effects = [variance_effect_by_id(name) for name in ("MU_rr", "GS_rr", "base")]
    problem = pose(both_sensors(9, gs=5.0, mu=4.0), load_model("matrix-6"), ())

    def anew(rows: likely_noise._Rows, v: int, profile: Profile) -> FloatArray:
        return rows.heights(np.arange(len(rows.grid)), [profile])[v, :, 0]

    kept = searches(problem, (), effects)
    monkeypatch.setattr(likely_noise._Rows, "everywhere", anew)
    for number, search in searches(problem, (), effects).items():
        for block, own in zip(kept[number].blocks, search.blocks, strict=True):
            assert block.points.told_by == own.points.told_by
            np.testing.assert_allclose(block.points.log_prior, own.points.log_prior)


@pytest.mark.slow
def test_gs_that_differs_from_run_to_run_is_no_base_motion() -> None:
    """GS and MU anew in each run were called a pier that turns, at 100 %: one cause for two, in either sensor."""
    result = reconcile(both_sensors(1, gs=5.0, mu=4.0), "matrix-6", prove=False)
    assert {effect.id for effect in result.effects} == {"GS_rr", "MU_rr"}
    sizes = [of["value"] for effect in result.effects if effect.id == "GS_rr" for of in effect.parameters]
    assert sizes == [pytest.approx(5.0, rel=0.5)] * 2


@pytest.mark.slow
def test_a_pier_that_turns_is_found_as_one() -> None:
    """Both sensors tell of one motion."""
    found = {effect.id: effect.kind for effect in reconcile(both_sensors(1, room=3.0), "matrix-6", prove=False).effects}
    assert found["base"] == "named"
    assert not {"GS_rr", "MU_rr"} & found.keys()
