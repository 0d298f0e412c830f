"""The budget before a night, from its files, and after it, from what was measured; and from the command line."""

from __future__ import annotations

import io
import json
import os
from contextlib import redirect_stderr, redirect_stdout
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import yaml

from benchmarks.blind.cases import make_case, write_case
from benchmarks.blind.night import Design
from hil.campaign import Campaign
from hil.campaign.reader import read_campaign
from hil.cli.app import run
from hil.cli.told import lines_of
from hil.config import load_bench, load_sweep, parse_bench
from hil.config.sweep import parse_sweep
from hil.design.budget.budget import budgets_of_means
from hil.design.budget.document import Asked, budget_document
from hil.design.budget.scenes import measured_scenes, planned_scenes
from hil.errors import InputError
from hil.solve import repeats, solve_campaign
from tests.hil.audit.folders import written
from tests.hil.solve.runs_of_a_unit import repeated

FEW = Asked(draws=2000)


def cli(*arguments: object) -> tuple[int, str, str]:
    """Carry out one command: status, standard output, standard error."""
    out, err = io.StringIO(), io.StringIO()
    with redirect_stdout(out), redirect_stderr(err):
        status = run([str(each) for each in arguments])
    return status, out.getvalue(), err.getvalue()


@pytest.fixture(scope="module")
def campaign(tmp_path_factory: pytest.TempPathFactory) -> Campaign:
    """A measured campaign of the report's collects: two temperatures, four runs each, nothing wrong."""
    case = make_case(5, (), 0.0, design=Design(temperatures_degC=(0.0, 40.0), runs_per_temperature=4))
    return read_campaign(write_case(case, tmp_path_factory.mktemp("case") / "campaign"))


@pytest.mark.slow
def test_before_a_night_sizes_come_from_the_files_and_say_so() -> None:
    """What the bench file gives is named with its key, the rest as a default; the soak's limit is the sweep's."""
    shipped = load_bench("simulated")
    document = yaml.safe_load(shipped.text)
    document["uncertainties"] = {"heading": "2 deg", "tilt": "1 mrad"}
    bench = parse_bench(yaml.safe_dump(document), "my-bench.yaml")
    sensor = budget_document(planned_scenes(load_sweep("rd-gc-86-1"), bench), "t", FEW)["sensors"]["2"]
    by_id = {each["id"]: each for each in sensor["sources"]}
    assert by_id["heading"]["size"] == 2.0
    assert by_id["heading"]["origin"] == "simulated: uncertainties.heading"
    assert by_id["tilt"]["size"] == pytest.approx(0.0573, abs=1e-4)
    assert by_id["latitude"]["origin"] == "default of uncertainties.latitude"
    assert by_id["soak"]["size"] == pytest.approx(0.05 / np.sqrt(3))
    assert "unit_slope" in by_id["soak"]["origin"]
    assert sensor["agrees"] is True
    assert [each["run"] for each in sensor["runs"]] == list(range(1, 25))
    twice = planned_scenes(load_sweep("rd-gc-86-1"), shipped)
    small = budget_document(twice, "t", FEW)["sensors"]["2"]["sources"]
    before, after = (
        next(e for e in x if e["id"] == "heading")["parameters"]["MUB"] for x in (small, sensor["sources"])
    )
    assert after["analytic"] == pytest.approx(4.0 * before["analytic"], rel=0.05)


def test_a_collect_too_short_to_average_anything_is_refused() -> None:
    """A slip of the pen in the sweep: the file and the key are named."""
    sweep = yaml.safe_load(load_sweep("rd-gc-86-1").text)
    sweep["collect"]["duration"] = "1e-320 s"
    with pytest.raises(InputError, match="averages no noise"):
        planned_scenes(parse_sweep(yaml.safe_dump(sweep), "slip.yaml"), load_bench("simulated"))


def test_the_default_noise_is_that_of_the_reports_quiet_cells() -> None:
    """0.12 deg/sqrt(hr) over 60 s is 0.93 deg/hr: a bias of 0.66, a MU of 1.14."""
    noise = budget_document(planned_scenes(load_sweep("rd-gc-86-1"), load_bench("simulated")), "t", FEW)["sensors"]["2"]
    parameters = noise["sources"][0]["parameters"]
    assert parameters["BA"]["analytic"] == pytest.approx(0.93 / np.sqrt(2), abs=0.005)
    assert parameters["MUB"]["analytic"] == pytest.approx(0.93 * np.sqrt(1.5), abs=0.005)


def test_after_a_night_noise_and_parameters_are_the_measured_ones(campaign: Campaign) -> None:
    """The collects' own standard errors, this run's own GS and MU, and beside it what was seen to scatter."""
    bench = load_bench("simulated")
    shown = repeats(campaign, solve_campaign(campaign))
    document = budget_document(measured_scenes(campaign, bench, shown), "t", FEW, observed=shown)
    sensor = document["sensors"]["2"]
    assert sensor["acting_on"] == "as solved from this run"
    assert sensor["sources"][0]["origin"] == "measured standard errors"
    rows = campaign.sensors[2]
    measured = rows.rates_se_deg_per_hr[rows.conditions.run == sensor["run"]]
    assert sensor["sources"][0]["parameters"]["MUB"]["analytic"] == pytest.approx(
        np.sqrt(measured[2, 0] ** 2 + 0.25 * (measured[0, 0] ** 2 + measured[1, 0] ** 2)), rel=0.02
    )
    seen = sensor["observed_run_to_run"]["GSA"]
    assert seen["degrees_of_freedom"] == 6
    assert seen["sd"] > 0.0
    assert set(sensor["run_to_run"]) == set(sensor["observed_run_to_run"])
    (solved,) = (each for each in shown[2].means if sensor["run"] in each.runs)
    for name, mean in sensor["mean_of_repeats"].items():
        assert sensor["mean_as_solved"][name] == solved.values[name].sd
        assert mean >= max(sensor["run_to_run"][name] / np.sqrt(len(solved.runs)), solved.values[name].sd) * (
            1 - 1e-9
        ), name


@pytest.mark.slow
def test_of_a_collect_with_one_rate_left_out_the_other_counts_as_in_solve(campaign: Campaign) -> None:
    """The noise of each value is what `hil solve` states of it, and of those that it cannot tell there is none."""
    rows = campaign.sensors[2]
    rates = rows.rates_deg_per_hr.copy()
    rates[3, 1] += 200.0
    wrong = replace(campaign, sensors={2: replace(rows, rates_deg_per_hr=rates)})
    (solved,) = (each for each in solve_campaign(wrong) if each.run == rows.conditions.run[3])
    asked = replace(FEW, run=solved.run)
    sensor = budget_document(measured_scenes(wrong, load_bench("simulated"), {}), "t", asked)["sensors"]["2"]
    assert {each.se is None for each in solved.parameters.values()} == {True, False}
    for name, each in solved.parameters.items():
        noise = sensor["sources"][0]["parameters"][name]["analytic"]
        assert noise == (None if each.se is None else pytest.approx(each.se)), name


def test_collects_are_told_in_the_order_in_which_they_were_taken(campaign: Campaign) -> None:
    """Rows may stand in any: a file from the last to the first had "collects 3-2-1"."""
    rows = campaign.sensors[2]
    backwards = replace(campaign, sensors={2: rows.rows(np.arange(len(rows.conditions))[::-1])})
    told = [
        budget_document(measured_scenes(of, load_bench("simulated"), {}), "t", FEW)["sensors"]["2"]["positions"]
        for of in (campaign, backwards)
    ]
    assert told == [["1", "2", "3"]] * 2


def test_a_mean_is_of_the_runs_that_tell_its_parameter(tmp_path: Path) -> None:
    """Of three runs one tells no MUA: its mean is of two, in the document, in words, and in each source's part."""
    campaign = read_campaign(folder := written("one rate far off", tmp_path / "campaign"))
    shown = repeats(campaign, solve_campaign(campaign))
    scenes = measured_scenes(campaign, load_bench("simulated"), shown)[2]
    (each,) = (of for of in budgets_of_means(scenes, shown[2]) if 5 in of.mean.runs)
    told = {name: value.runs for name, value in each.mean.values.items()}
    assert {*told.values()} == {2, 3}
    noise = each.budget.shares[0]
    assert each.shares[noise.source.title] == pytest.approx(noise.analytic / np.sqrt([*told.values()]))
    lines = cli("budget", folder, "--run", 4, "--draws", 100)[1].splitlines()
    (counts,) = (line.split()[-6:] for line in lines if line.startswith("runs at its temperature that tell it"))
    assert counts == [str(count) for count in told.values()]
    assert [line.partition(", ")[2][:24] for line in lines if line.startswith("mean of 2 or 3 runs, ")] == [
        "as hil solve states it  ",
        "no less than all sources",
    ]


@pytest.mark.slow
def test_what_has_no_budget_is_said_with_what_to_do(tmp_path: Path) -> None:
    """A run that is not there or FAILed, another of two sensors, a parameter that a run does not tell, a folder."""
    for name in ("one rate far off", "clipped", "two plans"):
        written(name, tmp_path / name.replace(" ", "-"))
    told = {
        words: "".join(cli("budget", tmp_path / words.split()[0], *words.split()[1:], "--draws", 100)[1:])
        for words in ("one-rate-far-off --run 5", "one-rate-far-off --run 99", "clipped --run 9", "two-plans --run 9")
    }
    assert (
        "–: what these collects do not tell alone: MUA (hil solve says why, of run 5)"
        in told["one-rate-far-off --run 5"]
    )
    assert "sensor 2: there is no run 99; choose of runs 1–12 with --run" in told["one-rate-far-off --run 99"]
    assert "run 9 FAILed by what was recorded, and has no budget; choose of runs 1–7" in told["clipped --run 9"]
    assert "sensor 1: there is no run 9; choose of runs 1–6" in told["two-plans --run 9"]
    assert "\nsensor 2, run 9 at" in told["two-plans --run 9"]
    assert "name one that it holds: clipped, one-rate-far-off and two-plans" in cli("budget", tmp_path)[2]
    assert "there is no such file or folder" in cli("budget", tmp_path / "mistyped")[2]


def test_the_worst_run_is_the_one_that_solve_knows_worst() -> None:
    """Of rates without standard errors the residuals of all runs tell what noise is: a bench's had stood in."""
    rows = repeated(4, 4, (0, 1, 2, 0), seed=4).sensors[2]
    rates = np.where(np.arange(16)[:, None] == 11, np.nan, rows.rates_deg_per_hr)  # run 3 has three collects
    made = Campaign(
        "t", "", {2: replace(rows, rates_deg_per_hr=rates, rates_se_deg_per_hr=np.full_like(rates, np.nan))}
    )
    shown = repeats(made, solve_campaign(made))
    worst = max(shown[2].of_each, key=lambda run: sum(sd**2 for sd in shown[2].of_each[run].values()))
    asked = Asked(draws=100)
    document = budget_document(measured_scenes(made, load_bench("simulated"), shown), "t", asked, observed=shown)
    sensor = document["sensors"]["2"]
    assert sensor["run"] == worst == 3
    assert sensor["noise_deg_per_hr"] == pytest.approx(float(np.sqrt(np.mean(shown[2].left.deg_per_hr ** 2))))
    assert sensor["sources"][0]["origin"].startswith("residuals of all runs")


def test_a_campaign_of_another_bench_takes_its_axes_from_gravity_and_earth_rate(campaign: Campaign) -> None:
    """With positions that the bench does not know, up, north and east serve; the size of the contributions stays."""
    bench = load_bench("simulated")
    rows = campaign.sensors[2]
    renamed = replace(rows, conditions=replace(rows.conditions, position=np.char.add("p", rows.conditions.position)))
    foreign = replace(campaign, sensors={2: renamed})
    own, other = (
        {
            each["id"]: each["parameters"]
            for each in budget_document(measured_scenes(of, bench, {}), "t", FEW)["sensors"]["2"]["sources"]
        }
        for of in (replace(campaign, sensors={2: rows}), foreign)
    )
    for source in ("heading", "latitude", "index", "gravity", "drift"):
        for name in ("BA", "GSA", "MUB"):
            assert other[source][name]["analytic"] == pytest.approx(own[source][name]["analytic"], abs=2e-4), source
    still = replace(renamed, conditions=replace(renamed.conditions, w_deg_per_hr=np.zeros_like(rows.conditions.f_g)))
    known = budget_document(measured_scenes(replace(campaign, sensors={2: still}), bench, {}), "t", FEW)["sensors"]["2"]
    assert [each["id"] for each in known["sources"]] == ["noise", "instability", "gravity", "drift", "soak"]
    assert "index error of each move" in known["left_out"]


def test_an_error_of_an_earth_rate_that_is_not_given_is_not_known(campaign: Campaign) -> None:
    """With w of 0, all of the earth rate is in the parameters: an error by heading or latitude of 0 was a promise."""
    rows = campaign.sensors[2]
    for vertical, told in (
        (0.0, "no earth rate is given (w is 0): "),
        (11.7, "the earth rate that is given (w) tells "),
    ):
        w = vertical * rows.conditions.f_g
        nothing = replace(rows, conditions=replace(rows.conditions, w_deg_per_hr=w))
        scenes = measured_scenes(replace(campaign, sensors={2: nothing}), load_bench("simulated"), {})
        known = budget_document(scenes, "t", FEW)["sensors"]["2"]
        assert {"heading", "latitude", "earth_rate"}.isdisjoint(each["id"] for each in known["sources"])
        assert {"tilt", "index"} <= {each["id"] for each in known["sources"]}
        assert [*known["why_left_out"]] == known["left_out"]
        ((title, why),) = {t.partition(",")[0]: why for t, why in known["why_left_out"].items()}.items()
        assert title == "earth rate"
        assert why.startswith(told)


def test_the_soak_is_as_the_thermometer_shows_where_no_slope_was_recorded(campaign: Campaign) -> None:
    """3 °C/min through a run is no soak within the criterion; a thermometer that stands still tells no less than it."""
    rows = campaign.sensors[2]
    warming = 20.0 + 3.0 / 60.0 * rows.conditions.start_s
    still, lost, slope = (np.full(len(warming), value) for value in (20.0, np.nan, 0.5))
    within, shown = (
        (pytest.approx(0.05 / np.sqrt(3.0)), "not measured"),
        (pytest.approx(3.0), "as temperature_degC went"),
    )
    for columns, told in (
        ({}, within),
        ({"temperature_degC": lost}, within),
        ({"temperature_degC": still}, within),
        ({"temperature_degC": warming}, shown),
        ({"temperature_degC": warming, "dTdt_degC_per_min": lost}, shown),
        ({"temperature_degC": warming, "dTdt_degC_per_min": slope}, (pytest.approx(0.5), "as measured")),
    ):
        made = replace(rows, conditions=replace(rows.conditions, columns=columns))
        scenes = measured_scenes(replace(campaign, sensors={2: made}), load_bench("simulated"), {})
        (soak,) = (each for each in scenes[2][0].sources if each.id == "soak")
        assert soak.size == told[0]
        assert soak.origin.startswith(told[1])


def test_from_the_command_line_for_programs_and_for_people(tmp_path: Path) -> None:
    """One document; one screen with both columns; a run that is not there is refused in a sentence."""
    status, out, _ = cli("budget", "quick", "--draws", "500", "--json")
    told: dict[str, Any] = json.loads(out)
    assert status == 0
    assert told["schema"] == "hil.budget/1"
    assert set(told["sensors"]) == {"1", "2"}
    cell = told["sensors"]["2"]["sources"][0]["parameters"]["MUB"]
    assert set(cell) == {"analytic", "monte_carlo", "monte_carlo_error"}
    status, out, _ = cli("budget", "quick", "--draws", "500")
    assert status == 0
    assert "noise of the averages" in out
    assert "all together, one run" in out
    status, out, err = cli("budget", "quick", "--run", "9", "--draws", "500")
    assert (status, out) == (2, "")
    assert "there is no run 9" in err
    assert os.listdir(tmp_path) == []


@pytest.mark.slow
def test_what_is_too_large_for_a_calculation_is_told_with_what_the_draws_have(tmp_path: Path) -> None:
    """Of a triad, whose draws no table has, too: every number that holds instead stands in the text."""
    folder = written("poses", tmp_path / "campaign")
    document: dict[str, Any] = json.loads(cli("budget", folder, "--json")[1])
    (sensor,) = document["sensors"].values()
    source = sensor["sources"][2]
    sensor |= {"agrees": False, "too_large": {source["id"]: ["GXY", "GZX"]}}
    drawn = ", ".join(f"{name} {source['parameters'][name]['monte_carlo']:.2g}" for name in ("GXY", "GZX"))
    told = [line for line in lines_of(document, {}) if isinstance(line, str)]
    assert f"too large for a linear calculation: {source['title']}; Monte Carlo has {drawn}" in told


def test_a_budget_begins_with_the_runs_that_do_not_pass(tmp_path: Path) -> None:
    """Its ± are of runs that hil solve FAILs, too: in the words and under the keys of hil thermal; none of a sweep."""
    status, out, _ = cli("budget", written("labels exchanged", tmp_path), "--draws", 100, "--json")
    assert (status, json.loads(out)["runs_not_solved"]) == (0, {"FAIL": [5]})
    _, said, _ = cli("budget", written("labels exchanged", tmp_path / "again"), "--draws", 100)
    assert "before any of these is used, see to what hil solve does not pass (hil report says why): run 5" in said
    assert "does not pass" not in cli("budget", "quick", "--draws", 100)[1]
