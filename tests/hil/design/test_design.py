"""Sequences of collects: what each is worth, by the numbers of the algebra; and the proposal for a goal."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import yaml
from scipy.spatial.transform import Rotation

from hil.campaign.writer import write_campaign
from hil.cli.app import run
from hil.config import load_bench, load_sweep, parse_bench
from hil.config.bench import Bench
from hil.design.budget.budget import Budget
from hil.design.budget.sources import sources
from hil.design.sequence.proposal import design_document, sweep_text
from hil.design.sequence.search import LONGEST_S, Goal, Proposal, _Weigher, parse_target, propose
from hil.design.sequence.sequences import Worth, scene_of, seen_terms, sequence_worth, sequences
from hil.design.sequence.unit_scatter import UnitScatter, scatter_of_unit
from hil.errors import InputError
from hil.model import load_model
from hil.model.earth import Site
from hil.model.equation import Orientation
from hil.model.forms import default_form
from procedures.plan import make_plan
from procedures.settings import CollectSettings
from tests.hil.solve.runs_of_a_unit import campaign
from tests.hil.solve.test_between_runs import after, visited, visits_again, with_mua


@pytest.fixture(scope="module")
def level() -> Bench:
    """The simulated bench, level, so that the closed forms of §B hold to the digit."""
    document = yaml.safe_load(load_bench("simulated").text)
    document["site"] = {"latitude": "34.6 deg", "heading": "30 deg"}
    return parse_bench(yaml.safe_dump(document), "level.yaml")


def worth_of(bench: Bench, sequence: str, sensor: int = 2) -> Worth:
    """What a sequence written "1-3-2" is worth for a sensor."""
    scene = scene_of(bench, sensor, tuple(sequence.split("-")), CollectSettings())
    found = sequence_worth(scene, default_form(scene.conditions))
    assert found is not None
    return found


# physics.md §B.5: standard errors of (B, GS, MU) per axis for unit noise, then degrees of freedom of both channels.
WORTHS = {
    "1-2-3": (0.71, 0.71, 1.22, 0),
    "1-3-2": (0.71, 0.71, 1.22, 0),
    "1-3-2-3-1": (0.61, 0.61, 0.94, 4),
    "1-3-2-2-3-1": (0.50, 0.50, 0.87, 6),
    "1-2-3-4": (0.50, 0.71, 0.71, 2),
    "1-2-3-4-4-3-2-1": (0.35, 0.50, 0.50, 10),
}


@pytest.mark.parametrize("sequence", WORTHS)
def test_white_noise_gives_the_published_standard_errors(level: Bench, sequence: str) -> None:
    """To two digits as published, for both channels."""
    found = worth_of(level, sequence)
    bias, gs, mu, residuals = WORTHS[sequence]
    expected = {"BA": bias, "BB": bias, "GSA": gs, "GSB": gs, "MUA": mu, "MUB": mu}
    for name, value in expected.items():
        assert found.white[name] == pytest.approx(value, abs=0.0071), name
    assert found.residuals == residuals


@pytest.mark.parametrize(
    ("sequence", "ba", "gsa", "mub"),
    [
        ("1-2-3", -0.5, 0.5, 1.5),
        ("1-3-2", 0.0, 1.0, 0.0),
        ("1-2-3-4", 0.0, 0.5, -0.5),
        ("1-3-2-3-1", 0.0, 0.0, 0.0),
        ("1-3-2-2-3-1", 0.0, 0.0, 0.0),
        ("1-2-3-4-4-3-2-1", 0.0, 0.0, 0.0),
    ],
)
def test_a_drift_enters_as_published(level: Bench, sequence: str, ba: float, gsa: float, mub: float) -> None:
    """Per collect: the published order three times as strongly into MU as into the bias, palindromes nowhere."""
    drift = worth_of(level, sequence).drift
    assert (drift["BA"], drift["GSA"], drift["MUB"]) == pytest.approx((ba, gsa, mub), abs=1e-9)
    assert (drift["BB"], drift["GSB"], drift["MUA"]) == pytest.approx((ba, -gsa, -mub), abs=1e-9)


def test_the_condition_number_is_one_and_root_two(level: Bench) -> None:
    """§B.1: 2.414 for the published collects at 1 g."""
    assert worth_of(level, "1-2-3").condition_number == pytest.approx(1.0 + np.sqrt(2.0))


def poses(index_deg: list[float], roll_deg: list[float], headings_deg: list[float]) -> tuple[np.ndarray, np.ndarray]:
    """Accelerations and earth rates along the sensor's axes at every index angle, IMU roll and heading."""
    f, w = [], []
    for heading in headings_deg:
        site = Site(34.6, heading)
        for roll in roll_deg:
            turn = Rotation.from_euler("z", roll, degrees=True).as_matrix()  # about bench axis 3, under the index axis
            for theta in index_deg:
                axes = Orientation.from_rotation_about_2("", theta).axes @ turn.T
                f.append(axes @ site.gravity_g())
                w.append(axes @ site.earth_rate_deg_per_hr())
    return np.array(f), np.array(w)


C1_TO_C4 = [-90.0, 90.0, 0.0, 180.0]
EIGHT = [45.0 * i for i in range(8)]
QUARTERS = [0.0, 90.0, 180.0, 270.0]


@pytest.mark.parametrize(
    ("positions", "expected"),
    [
        (([-90.0, 90.0, 0.0], [0.0], [30.0]), (3, 3, 3)),
        ((C1_TO_C4, [0.0], [30.0]), (3, 4, 4)),
        ((EIGHT, [0.0], [30.0]), (3, 5, 5)),
        ((C1_TO_C4, [0.0], [30.0, 120.0]), (3, 4, 7)),
        ((C1_TO_C4, QUARTERS, [30.0]), (4, 6, 9)),
        ((EIGHT, [45.0 * i for i in range(8)], [30.0]), (4, 9, 12)),
    ],
    ids=["C1-C3", "C1-C4", "8 positions", "C1-C4 at 2 headings", "C1-C4 at 4 rolls", "8 x 8"],
)
def test_what_richer_sequences_can_see_is_as_published(
    positions: tuple[list[float], list[float], list[float]], expected: tuple[int, int, int]
) -> None:
    """§B.5: of 4 linear, 10 with squares, 13 with scale factor and misalignments. A new heading brings the scale."""
    assert seen_terms(*poses(*positions)) == expected


def test_a_fourth_collect_tells_mu_from_what_is_even(level: Bench) -> None:
    """Three collects cannot, however often; four can."""
    assert not worth_of(level, "1-3-2-2-3-1").tells_even_terms
    assert worth_of(level, "1-2-3-4").tells_even_terms


def test_a_second_heading_is_positions_of_the_bench_file(level: Bench) -> None:
    """Turned about the vertical, the four positions again: scale factor and misalignments come into sight."""
    document = yaml.safe_load(level.text)
    document["sensors"] = {2: document["sensors"][2]}
    orientations = document["sensors"][2]["orientations"]
    orientations |= {f"{n}h": {"from": str(n), "rotate": "90 deg", "about": 1} for n in "1234"}
    bench = parse_bench(yaml.safe_dump(document), "two-headings.yaml")
    assert worth_of(bench, "1-2-3-4").terms == (3, 4, 4)
    assert worth_of(bench, "1-2-3-4-1h-2h-3h-4h").terms == (3, 4, 7)


def test_every_order_and_palindrome_is_a_candidate_once() -> None:
    """An order and its reverse count as one; nothing comes twice."""
    found = list(sequences(("1", "2", "3", "4")))
    assert len(found) == len(set(found)) == 120
    for sequence in WORTHS:
        assert tuple(sequence.split("-")) in found


@pytest.fixture(scope="module")
def sweep() -> Any:
    """The published sweep."""
    return load_sweep("rd-gc-86-1")


RECOMMENDED = Goal({"MU": 0.5}, drift_immune=True, residuals=2, tells_even_terms=True)


@pytest.fixture(scope="module")
def recommended(sweep: Any) -> Proposal:
    """What is proposed for MU to 0.5, drift-immune, with residuals, told from g²."""
    return propose(sweep, load_bench("simulated"), RECOMMENDED)


@pytest.mark.slow
def test_the_proposal_meets_its_goal_and_is_the_shortest_that_does(sweep: Any, recommended: Proposal) -> None:
    """Met in both sensors; and a minute less would not do, which is said with what more time would buy."""
    assert recommended.missing == ()
    assert recommended.with_more_time is None
    for number, worth in recommended.best.worth.items():
        assert worth.immune(["MUA", "MUB"])
        assert worth.residuals >= 2
        assert worth.tells_even_terms
        assert max(recommended.best.total[number][name] for name in ("MUA", "MUB")) <= 0.5
    hurried = replace(RECOMMENDED, time_s=recommended.best.time_s - 60.0)
    shorter = propose(sweep, load_bench("simulated"), hurried)
    assert shorter.missing != ()
    assert shorter.best.time_s <= recommended.best.time_s - 60.0
    assert shorter.with_more_time == recommended.best


@pytest.mark.slow
def test_longer_collects_and_repeats_are_weighed_as_the_whole_budget_would(sweep: Any) -> None:
    """The proposal's uncertainty is the error budget's of that very sequence and duration, not a scaled guess of it."""
    bench = load_bench("simulated")
    best = propose(sweep, bench, Goal({"MU": 0.3}, sensors=(2,))).best
    assert best.duration_s != sweep.collect.duration_s
    collect = replace(sweep.collect, duration_s=best.duration_s)
    model = load_model("rd-gc-86-1-truth")
    scene = scene_of(bench, 2, best.positions, collect, float(np.median(sweep.temperatures)), model)
    slope = sweep.restabilisation.unit_slope_degC_per_min / np.sqrt(3.0)
    given = sources(bench.uncertainties, "", slope, "", "")
    total = Budget(scene, given, default_form(scene.conditions), draws=100).total(best.repeats)
    np.testing.assert_allclose(list(best.total[2].values()), total, rtol=1e-9)


@pytest.mark.slow
def test_without_a_goal_the_free_improvement_is_proposed(sweep: Any) -> None:
    """No longer than the published sweep, and the drift is out of MU: 1-3-2."""
    found = propose(sweep, load_bench("simulated"), Goal({}, sensors=(2,)))
    assert found.best.sequence == "1-3-2"
    assert found.best.time_s == found.compared[0].time_s == pytest.approx(make_plan(sweep.procedure()).total_s)
    assert [each.sequence for each in found.compared][:3] == ["1-2-3", "1-3-2", "1-3-2-3-1"]


@pytest.mark.slow
def test_a_goal_out_of_reach_is_said_to_be_missed_and_by_how_much(sweep: Any) -> None:
    """A unit whose MU scatters by 4 from run to run is not known to 0.5 by any sequence in the time."""
    goal = Goal({"MU": 0.5}, time_s=24 * 3600.0, scatter={"MU": 4.0}, sensors=(2,))
    found = propose(sweep, load_bench("simulated"), goal)
    assert len(found.missing) == 2
    assert "instead of 0.5" in found.missing[0]
    assert found.best.time_s <= 24 * 3600.0
    assert found.best.total[2]["MUB"] > 4.0 / np.sqrt(found.best.repeats)


@pytest.mark.slow
def test_a_unit_that_scatters_is_repeated_as_often_as_the_goal_takes(sweep: Any) -> None:
    """More than sixteen times for a quarter of 4, and no longer than that takes; in less time it is what more buys."""
    bench, goal = load_bench("simulated"), Goal({"MU": 1.0}, scatter={"MU": 4.0}, sensors=(2,))
    found = propose(sweep, bench, goal)
    assert found.missing == ()
    assert 16 < found.best.repeats < 30
    assert found.best.duration_s == 60.0  # what scatters from run to run no longer collect averages
    hurried = propose(sweep, bench, replace(goal, time_s=found.best.time_s / 2.0))
    assert hurried.missing
    assert hurried.with_more_time == found.best
    endless = propose(sweep, bench, replace(goal, scatter={"MU": 400.0}))
    assert endless.missing
    assert endless.with_more_time is None
    assert endless.best.time_s <= LONGEST_S
    assert 0.9 < hurried.best.time_s / (found.best.time_s / 2.0) <= 1.0


def test_each_sensor_has_the_scatter_that_its_own_repeats_showed(sweep: Any) -> None:
    """One scatters by 9 and the other by nothing; what is said in words is of both, and counts before a night's."""
    bench = load_bench("simulated")

    def mua(**goal: Any) -> list[float]:
        weigher = _Weigher(sweep, bench, Goal({}, **goal), (1, 2))
        total = weigher.weigh(weigher.kind(("1", "2", "3")), 60.0, 3).total
        return [total[number]["MUA"] for number in (1, 2)]

    quiet, own = mua(), mua(shown={1: UnitScatter({"MUA": 0.0}), 2: UnitScatter({"MUA": 9.0})})
    assert own == [quiet[0], pytest.approx(np.hypot(quiet[1], 9.0 / np.sqrt(3.0)))]
    assert mua(scatter={"MU": 1.0}, shown={2: UnitScatter({"MUA": 9.0})}) == mua(scatter={"MU": 1.0})


@pytest.mark.parametrize("per_hr", [3.0, 0.0])
def test_more_time_does_not_help_where_the_unit_ages(sweep: Any, per_hr: float) -> None:
    """Repeats that follow time are not independent: 528 h were proposed to average what grows in them."""
    one = campaign(15, 3, seed=34, scatter=0.5)
    rows = one.sensors[2]
    aged = rows.rates_deg_per_hr + per_hr * rows.conditions.start_s[:, None] / 3600.0
    own = scatter_of_unit(replace(one, sensors={2: replace(rows, rates_deg_per_hr=aged)}))[2]
    assert own.lasting == (("BA", "BB") if per_hr else ())
    goal = Goal({"B": 0.5}, sensors=(2,), shown={2: own})
    found = propose(sweep, load_bench("simulated"), goal)
    assert found.with_more_time is None
    if per_hr:
        assert found.missing
        assert found.best.repeats == sweep.self_calibrations_per_temperature
        assert found.best.duration_s == 60.0
    else:
        assert not found.missing


def test_what_the_way_to_a_temperature_does_no_repeat_averages() -> None:
    """Visits of one run each, up and down: neither run of a temperature is a repeat of the other."""
    made = visited([0, 1, 2, 3, 4, 5, 4, 3, 2, 1, 0], scatter=0.3)
    rows = made.sensors[2]
    back = np.where(rows.conditions.run > 6, 12.0, 0.0)[:, None] * [1.0, -1.0]
    own = scatter_of_unit(replace(made, sensors={2: replace(rows, rates_deg_per_hr=rows.rates_deg_per_hr + back)}))[2]
    assert {"BA", "BB"} <= {*own.lasting}


@pytest.mark.slow
def test_of_what_misses_a_goal_the_nearest_is_proposed(sweep: Any) -> None:
    """A thousand residuals are out of reach: the sequence with the most of them, not the shortest with none."""
    found = propose(sweep, load_bench("simulated"), Goal({}, residuals=1000, sensors=(2,)))
    assert found.missing == ("sensor 2: 10 residuals instead of 1000",)
    assert len(found.best.positions) == 8


def test_a_triad_of_six_poses_keeps_its_whole_model(tmp_path: Path) -> None:
    """A shorter sequence is no excuse for a smaller model: what is proposed still gives bias and all nine of G."""
    path = tmp_path / "six.yaml"
    poses = "[x-up, x-down, y-up, y-down, z-up, z-down]"
    path.write_text(f"title: six\ntemperatures: [0 degC]\nself_calibrations_per_temperature: 1\npositions: {poses}\n")
    found = propose(load_sweep(path), load_bench("espec-stim300-example"), Goal({"B": 1.0, "G": 2.0}))
    assert found.missing == ()
    assert len(set(found.best.positions)) >= 4
    assert list(found.best.total[1])[:4] == ["BX", "BY", "BZ", "GXX"]
    assert found.compared[0].sequence == "x-up, x-down, y-up, y-down, z-up, z-down"


def test_what_cannot_be_is_refused_in_a_sentence(sweep: Any) -> None:
    """An unknown parameter or sensor, too little time, and targets that are none."""
    bench = load_bench("simulated")
    for name in ("GXX", "GYZ", "GX"):  # of a triad, which is no parameter of this bench: what has it is said
        with pytest.raises(
            InputError, match=f"; {name} is told by hil design triad-six-positions --bench espec-stim300-example$"
        ):
            propose(sweep, bench, Goal({name: 0.5}))
    with pytest.raises(InputError, match=r"there is no parameter MUX.*for several$"):
        propose(sweep, bench, Goal({"MUX": 1.0}))
    with pytest.raises(InputError, match="has no sensor 3"):
        propose(sweep, bench, Goal({}, sensors=(3,)))
    with pytest.raises(InputError, match="allow more time"):
        propose(sweep, bench, Goal({}, time_s=3600.0))
    assert parse_target("MU 0.5 deg/hr/g") == parse_target("MU 0.5 deg/hr") == ("MU", 0.5)
    for text in ("MU", "MU 0.5", "0.5 deg/hr", "MU 3 kg", "MU -1 deg/hr", "MU 1e-300 deg/hr"):
        with pytest.raises(InputError, match="no target"):
            parse_target(text)


@pytest.mark.slow
def test_the_recommended_sweep_is_what_the_command_proposes(sweep: Any, recommended: Proposal) -> None:
    """It ships beside the published one, and its own head says how it was made: the same command still gives it."""
    shipped, proposal = load_sweep("recommended"), recommended
    again = yaml.safe_load(sweep_text(proposal, sweep, "hil design"))
    assert shipped.positions == tuple(again["positions"])
    assert shipped.collect.duration_s == proposal.best.duration_s
    assert shipped.self_calibrations_per_temperature == proposal.best.repeats
    assert shipped.temperatures == sweep.temperatures
    assert shipped.restabilisation == sweep.restabilisation
    document = design_document(proposal, RECOMMENDED, sweep, load_bench("simulated"))
    assert document["met"] is True
    assert json.loads(json.dumps(document, allow_nan=False)) == document


@pytest.mark.slow
def test_the_sweep_that_is_written_is_accepted_by_the_plan(tmp_path: Path, capsys: Any) -> None:
    """From the command line: proposal, file, plan; and a file that is there stays as it is."""
    out = tmp_path / "my.yaml"
    assert (
        run(["design", "quick", "--goal", "MU 40 deg/hr", "--even-terms", "--sensor", "2", "--out", str(out), "--json"])
        == 0
    )
    told = json.loads(capsys.readouterr().out)
    assert told["schema"] == "hil.design/1"
    assert run(["plan", str(out), "--bench", "simulated", "--json"]) == 0
    planned = json.loads(capsys.readouterr().out)
    collects = [step["position"] for step in planned["steps"] if step["kind"] == "collect"]
    assert collects == told["proposed"]["positions"]
    assert planned["total_s"] == pytest.approx(told["proposed"]["total_s"])
    before = out.read_text()
    assert run(["design", "quick", "--out", str(out)]) == 2
    assert "exists already" in capsys.readouterr().err
    assert out.read_text() == before
    assert run(["design", "quick", "--sensor", "2"]) == 0
    assert "proposed: 1-3-2" in (said := capsys.readouterr().out)
    assert "no uncertainty was asked for (--goal): of the shortest nights" in said
    assert not any("was asked for" in text for text in told["said"])


def test_a_folder_in_the_place_of_a_sweep_is_told_its_own(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """A technician who has a night asks with it, as every other command is asked."""
    assert run(["design", str(tmp_path)]) == 2
    said = capsys.readouterr().err
    assert "a folder is no sweep; if it is a night or a campaign" in said
    assert f"--scatter {tmp_path}" in said


@pytest.mark.slow
def test_a_folder_without_repeats_says_nothing_of_scatter(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """Refused, where zero would be taken; one with repeats is taken."""
    for per_temperature, status in ((1, 2), (3, 0)):
        folder = tmp_path / str(per_temperature)
        write_campaign(campaign(6, per_temperature, seed=34, scatter=2.0), folder)
        asked = ["design", "quick", "--sensor", "2", "--scatter", str(folder), "--out", f"{folder}.yaml"]
        assert run(asked) == status
    assert "nothing was repeated there" in capsys.readouterr().err


@pytest.mark.slow
def test_what_explains_the_scatter_of_a_folder_is_said(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """An MU that jumped in that night is taken for scatter, and that is no secret."""
    write_campaign(with_mua(visits_again(), after(6, 25.0)), tmp_path / "jumps")
    asked = ["design", "quick", "--sensor", "2", "--scatter", str(tmp_path / "jumps")]
    assert run(asked) == 0
    assert "sensor 2: MUA jumps by +2" in capsys.readouterr().err
    of_a_triad = ["design", "triad-six-positions", "--bench", "espec-stim300-example", *asked[4:]]
    assert run(of_a_triad) == 0
    assert "sensor 2: is not on bench" in capsys.readouterr().err
