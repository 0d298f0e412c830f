"""The report: what it must show, from a night and from a folder that somebody else wrote."""

from __future__ import annotations

import re
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from yaml import safe_dump, safe_load

from benchmarks.blind.cases import Case, make_case, write_case
from benchmarks.blind.night import Design
from hil.campaign.reader import read_campaign
from hil.config.sweep import PUBLISHED
from hil.reconcile.outcome.sentences import what_to_do
from hil.reconcile.result import Solved
from hil.reconcile.workflow import reconcile
from hil.report.content import gather, headline, to_do
from hil.report.page import render
from hil.solve.temperatures import runs_by_temperature
from procedures.verdict import Judgement, Verdict
from tests.hil.solve.runs_of_a_unit import campaign


@pytest.fixture(scope="module")
def case() -> Case:
    """A campaign of 8 temperatures × 3 self-calibrations."""
    return make_case(7, model="matrix-6-thermal")


@pytest.fixture
def folder(case: Case, tmp_path: Path) -> Path:
    """That campaign as a folder."""
    return write_case(case, tmp_path / "campaign")


@pytest.mark.slow
def test_the_table_has_the_means_and_the_scatter(case: Case, folder: Path) -> None:
    """Table 1's layout: mean, its uncertainty, and the scatter over the three self-calibrations at each temperature."""
    content = gather(read_campaign(folder), vocabulary=PUBLISHED)
    sensor = content.sensors[0]
    assert [len(repeat.runs) for repeat in sensor.shown.means] == [2, *[3] * 7]  # in the first the unit had not settled
    assert [repeat.temperature_degC for repeat in sensor.shown.means] == pytest.approx(
        case.night.design.temperatures_degC
    )
    rates = case.rates[(case.night.run > 3) & (case.night.run <= 6)].reshape(3, 3, 2)
    w2 = case.night.w[0, 1]
    bias_b = (rates[:, 0, 1] + rates[:, 1, 1]) / 2 - w2
    gsa = np.array([solution.parameters["GSA"].value for solution in sensor.solutions[3:6]])
    bias_b = bias_b - gsa * case.night.g[1]  # eq. (10)
    at = sensor.shown.means[1]
    assert (at.values["BB"].value, at.scatter["BB"]) == pytest.approx((np.mean(bias_b), np.std(bias_b, ddof=1)))
    page = render(content)
    assert f"{np.mean(bias_b):.2f}" in page
    assert f"σ {np.std(bias_b, ddof=1):.2f}" in page
    assert f"±{at.values['BB'].sd:.2f}" in page


def test_the_contractors_bias_is_off_by_mu(folder: Path) -> None:
    """BA_C - BA = MUB (G1 + G3²/G1) + MUA G2 G3/G1, run by run: the story of the report, in its own numbers."""
    sensor = gather(read_campaign(folder), vocabulary=PUBLISHED).sensors[0]
    g2, g3 = Design().tilt_rad
    g1 = np.sqrt(1 - g2**2 - g3**2)
    for solution in sensor.solutions:
        matrix = {name: each.value for name, each in solution.parameters.items()}
        expected = matrix["MUB"] * (g1 + g3**2 / g1) + matrix["MUA"] * g2 * g3 / g1
        assert sensor.contractor[solution.run].parameters["BA"].value - matrix["BA"] == pytest.approx(expected)


def test_the_page_stands_alone_and_says_that_it_is_simulated(folder: Path) -> None:
    """No network, no script; the mark of simulation; figures for bias and both drifts per g; what was assumed."""
    page = render(gather(read_campaign(folder)))
    addresses = re.findall(r"""(?:src|href|url)\s*[=(]\s*["']?(?!#)([^"')\s>]+)""", page)
    assert addresses == []
    assert "<script" not in page
    assert "SIMULATED: no device was measured" in page
    assert page.count("<svg") == 3
    assert "isotropic rotor" in page
    assert "cannot contradict the model" in page


@pytest.mark.slow
def test_a_title_cannot_inject_markup(folder: Path) -> None:
    """Text from a file is text in the page."""
    header = folder / "campaign.yaml"
    header.write_text(header.read_text().replace("sealed case", "<script>alert(1)</script>"))
    page = render(gather(read_campaign(folder)))
    assert "<script" not in page
    assert "&lt;script&gt;" in page


def test_on_paper_every_page_has_title_and_mark_and_the_title_is_no_style(folder: Path) -> None:
    """In the heads of printed pages the title stands in CSS: whatever it has is escaped there."""
    title = '"; } body { display: none } </style><script>\\'
    header = folder / "campaign.yaml"
    header.write_text(safe_dump({**safe_load(header.read_text()), "title": title}))
    page = render(gather(read_campaign(folder)))
    assert page[: page.index("</head>")].count("</style>") == 1
    style = page[page.index("<style>") : page.index("</style>")]
    heads = re.findall(r'@top-left \{ content: "([^"]*)"; \}', style)
    back = re.sub(r"\\([0-9a-f]+) ", lambda found: chr(int(found[1], 16)), heads[0])
    assert back == title
    assert re.fullmatch(r"(?:[0-9A-Za-z]|\\[0-9a-f]+ )*", heads[0])
    assert '@top-right { content: "SIMULATED: no device was measured";' in style
    assert "counter(page)" in style


def test_numbers_below_zero_have_a_minus(folder: Path) -> None:
    """A screen reader passes over a hyphen, and a line may end after one; ranges and dates keep theirs."""
    page = re.sub(r"<style>.*?</style>|<svg.*?</svg>", "", render(gather(read_campaign(folder))), flags=re.DOTALL)
    words = re.sub(r"<[^>]*>", " ", page)
    assert re.findall(r"(?<=[\s(±])-\d", words) == []
    assert len(re.findall(r"(?<=\s)−\d", words)) > 50
    assert "matrix-6" in words


def test_a_missing_collect_is_inconclusive_in_the_headline(case: Case, folder: Path) -> None:
    """A run without its third collect has no MU: the first line of the report says that something is not conclusive."""
    table = folder / "collects.csv"
    rows = table.read_text().splitlines()
    table.write_text("\n".join(rows[:3] + rows[4:]) + "\n")
    content = gather(read_campaign(folder))
    assert "23 PASS" in headline(content)
    assert "1 INCONCLUSIVE" in headline(content)


def test_what_is_the_same_in_every_run_is_not_to_be_measured_again(folder: Path) -> None:
    """Of residuals that the model leaves hil reconcile is asked, in whatever words they are judged; else one mends.

    So does who measured before the unit had settled: settled it may lack nothing.
    """
    content = gather(read_campaign(folder))
    failed = Judgement(Verdict.FAIL, "in any words")
    moved: dict[str, Any] = {"beside": (failed,)}
    lacks: dict[str, Any] = {"judged": failed, "chi_square": 300.0, "degrees_of_freedom": 8, "settled": True}
    late, both = lacks | {"settled": False}, lacks | {"beside": (replace(failed),)}
    for odd, said in ((moved, "then measure again"), (lacks, "hil reconcile"), (late, "then measure again")):
        sensors = [replace(of, solutions=[replace(e, **odd) for e in of.solutions]) for of in content.sensors]
        do = [each for each in to_do(replace(content, sensors=sensors)) if not each.startswith("Do not use")]
        assert [said in each for each in do] == [True]
    sensors = [replace(of, solutions=[replace(e, **both) for e in of.solutions]) for of in content.sensors]
    assert [each.partition(" ")[0] for each in to_do(replace(content, sensors=sensors))] == ["Do", "Ask", "Mend"]


def test_nobody_is_sent_in_a_circle_and_what_warnings_ask_for_has_to_be_done(reference_data: Path) -> None:
    """A log of which hil reconcile names nothing: by both its ± may be used until it is repeated, and allow for it."""
    campaign = read_campaign(reference_data / "campaigns" / "mpu9150-unit1")
    found = reconcile(campaign, "triad-12", prove=False)
    hence = "repeat these collects, so that it can be told what scatters; until then use the ± "
    said = " ".join(to_do(gather(campaign))), what_to_do(found)[1]
    assert [hence in each.lower() and "which allow for it" in each for each in said] == [True, True]
    sound = replace(found, left=Solved())
    assert any("fill w_* by latitude and heading" in each for each in sound.notes)
    assert what_to_do(sound)[1].startswith("Nobody has to act, but on what the warnings ask for (notes).")
    assert what_to_do(replace(sound, warned=False))[1].startswith("Nobody has to act. ")


def test_what_cautions_ask_for_is_not_nothing() -> None:
    """The first screen of a sound campaign sends on to them; where there are none, nothing has to be done."""
    content = gather(campaign(12, 3, seed=1, scatter=0.0))
    told = [render(replace(content, campaign=replace(content.campaign, warnings=of))) for of in ((), ("fill w_*",))]
    said = [re.sub(r"<[^>]+>", "", each) for each in told]
    assert ["Nothing has to be done." in each for each in said] == [True, False]
    assert ["Nothing has to be done, but what the cautions ask for: read the cautions" in each for each in said] == [
        False,
        True,
    ]


def test_without_temperatures_all_runs_are_one_group(case: Case, tmp_path: Path) -> None:
    """A folder without any thermometer still has a report."""
    campaign = read_campaign(write_case(case, tmp_path / "bare", with_conditions=False))
    groups = runs_by_temperature(campaign.sensors[2].conditions)
    assert [(temperature, len(runs)) for temperature, runs in groups] == [(None, 24)]
    assert "all runs" in render(gather(campaign))


def test_a_triad_has_a_report_of_its_own(reference_data: Path) -> None:
    """Three channels, hand-placed poses, one run: no MU, no contractor, the twelve parameters instead."""
    page = render(gather(read_campaign(reference_data / "campaigns" / "mpu9150-unit0")))
    assert "GXY" in page
    assert "contractor" not in page


@pytest.mark.slow
def test_every_number_of_the_list_has_its_unit(folder: Path) -> None:
    """The head of the list of self-calibrations names each parameter with its unit."""
    page = render(gather(read_campaign(folder)))
    listed = page[page.index('<table id="runs-sensor-2"') :]
    listed = listed[listed.index("<thead>") :]
    head = re.sub(r"<[^>]+>", " ", listed[: listed.index("</thead>")]).split()
    for name, unit in (("BA", "deg/hr"), ("GSB", "deg/hr/g"), ("MUA", "deg/hr/g")):
        assert head[head.index(name) + 1] == unit


@pytest.mark.slow
def test_the_report_s_own_sensor_comes_first(folder: Path) -> None:
    """The sensor beside which the contractor's solution stands is the published one: it is not to be scrolled for."""
    table = folder / "collects.csv"
    header, *rows = table.read_text().splitlines()
    names = header.split(",")
    others = []
    for number, row in enumerate(rows, start=1001):
        cells = dict(zip(names, row.split(","), strict=True)) | {"collect": str(number), "sensor": "1"}
        for quantity, unit in (("f", "g"), ("w", "deg_per_hr")):  # turned about B: not the report's orientations
            a, s = f"{quantity}_A_{unit}", f"{quantity}_S_{unit}"
            cells[a], cells[s] = cells[s], cells[a]
        others.append(",".join(cells.values()))
    table.write_text("\n".join([header, *rows, *others]) + "\n")
    yaml = folder / "campaign.yaml"
    described = safe_load(yaml.read_text())
    described["sensors"] = {1: described["sensors"][2], **described["sensors"]}
    yaml.write_text(safe_dump(described, sort_keys=False))
    page = render(gather(read_campaign(folder), vocabulary=PUBLISHED))
    assert page.index(">Sensor 2</h2>") < page.index(">Sensor 1</h2>")


@pytest.mark.slow
def test_a_temperature_that_was_visited_twice_is_not_said_to_have_been_visited_once(folder: Path) -> None:
    """A second visit from the other direction is what tells temperature from elapsed time."""
    once = "Each temperature was visited once"
    assert once in render(gather(read_campaign(folder)))
    table = folder / "collects.csv"
    header, *rows = table.read_text().splitlines()
    again = []
    for row in rows[:9]:
        cells = dict(zip(header.split(","), row.split(","), strict=True))
        later = {"collect": 900 + int(cells["collect"]), "run": 90 + int(cells["run"])}
        later |= {name: 2e5 + float(cells[name]) for name in ("start_s", "time_since_power_on_s") if name in cells}
        later |= {name: 0.37 + float(cells[name]) for name in ("RA_deg_per_hr", "RB_deg_per_hr")}
        again.append(",".join(map(str, (cells | later).values())))
    table.write_text("\n".join([header, *rows, *again]) + "\n")
    assert once not in render(gather(read_campaign(folder)))
