"""Campaign folders screened: the units with the fault and no others, whoever shares the work."""

from __future__ import annotations

import csv
import json
import re
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from hil.campaign import Campaign
from hil.campaign.reader import read_campaign
from hil.campaign.writer import write_campaign
from hil.cli.app import run
from hil.errors import InputError
from hil.reconcile.campaigns import Screened, ScreenedUnit, screen_folders
from hil.reconcile.fleet import Asked, Screen, SharedFinding, UnitFinding
from hil.reconcile.outcome.fleet import fleet_csv, fleet_document, fleet_page, fleet_sentences
from hil.reconcile.proof.places import false_discovery
from hil.records.folders import pieces_in
from hil.solve.omissions import what_is_wrong
from procedures.verdict import Judgement, Verdict
from tests.hil.reconcile.fleet_units import MODEL, SHORT, unit
from tests.hil.reconcile.hidden_effects import base_rates, both, campaign_of, lay_out, noise


@pytest.mark.slow
def test_the_faulty_units_are_called_and_the_others_go_on(screened: Screened) -> None:
    """By name; what cannot be screened is told with its reason; another layout is a group of its own."""
    document = fleet_document(screened)
    assert {each["folder"][-3:] for each in document["units"] if each["worth"]} == {"u03", "u09"}
    assert document["effects"] == [{"id": "supply", "count": 2, "certain": 2, "serials": ["A003", "A009"]}]
    assert len(document["units"]) == 16
    assert {each["layout_number"] for each in document["units"]} == {1, 2, 3}
    told = {Path(each["folder"]).name: each["reason"] for each in document["not_screened"]}
    assert told.keys() == {"u99", "x-broken"}
    assert re.search(r"the very rates of .*u03: a copy", told["u99"])
    assert told["x-broken"] == "campaign.yaml, key schema: it is 'nonsense'; this program reads hil.campaign/1"
    p_values = np.array([each["p_value"] for each in document["units"]])
    assert [each["q_value"] for each in document["units"]] == false_discovery(p_values).tolist()  # of all layouts
    json.dumps(document, allow_nan=False)
    rows = list(csv.DictReader(fleet_csv(screened).splitlines()))
    assert len(rows) == 16
    assert {row["serial"] for row in rows if row["worth"] == "True"} == {"A003", "A009"}
    page = fleet_page(screened)
    assert re.search(r"<h2 id=\"verdict\">2 of 16 units deserve a full hil reconcile", page)
    assert re.findall(r'aria-label="([^"]+)"', page) == [
        "Units by effect: supply 2",
        "Log odds that anything is missing from each unit, by date",
        "Log odds that anything is missing from each unit, by serial number",
    ]
    assert "x-broken" in page
    quiet = page[page.index("Units of which none is called") :]
    assert [f"u{number:02d}, A{number:03d}<" in quiet for number in (2, 3, 4)] == [True, False, True]
    some = [replace(each, simulated=place < 2) for place, each in enumerate(screened.units)]
    assert "SIMULATED: 2 of 16 were not measured" in fleet_page(replace(screened, units=some))
    one = Screened(
        "", [replace(each, layout=1) for each in screened.units if "u03" in each.folder or not each.worth], [], {}
    )
    assert next(fleet_sentences(one)).startswith("1 of 15 units deserves a full hil reconcile")


@pytest.mark.slow
def test_one_unit_with_a_noisy_channel_is_asked_at_every_noise() -> None:
    """Of few units a few points of the noise are too few: 0.1 deg/hr/degC of both biases was no finding."""
    made = campaign_of(SHORT, 0.0 * base_rates(SHORT))
    rows = made.sensors[2]
    errors = rows.rates_se_deg_per_hr * [1.0, 5.0]
    rates = np.random.default_rng(1).normal(size=errors.shape) * errors + 0.1 * SHORT.temperature[:, None]
    one = replace(made, sensors={2: replace(rows, rates_deg_per_hr=rates)})
    (found,) = Screen.of(one, "matrix-6").units([one])
    assert (found.leader, found.q_value < 0.01) == ("bias_T", True)


@pytest.mark.slow
def test_what_the_records_say_is_wrong_is_in_no_screen(tmp_path: Path) -> None:
    """A run that FAILs, averages at a channel's limit: left out, and said of that unit; so is what is missing."""
    rates = base_rates(SHORT) + noise(SHORT, np.random.default_rng(9))
    made = campaign_of(SHORT, rates)
    rows, away, clipped = made.sensors[2], rates.copy(), rates.copy()
    here = rows.conditions.run == 4
    away[here] += 300.0 * rows.conditions.f_g[here, :2] ** 2
    clipped[:, 0] = np.minimum(rates[:, 0], np.quantile(rates[:, 0], 0.7))
    broken = replace(
        made,
        sensors={2: replace(rows, rates_deg_per_hr=away)},
        verdicts={4: Judgement(Verdict.FAIL, "the stream broke off")},
        missing=["run 99"],
    )
    write_campaign(replace(broken, title="broken"), tmp_path / "broken")
    write_campaign(
        replace(made, title="clipped", sensors={2: replace(rows, rates_deg_per_hr=clipped)}), tmp_path / "clipped"
    )
    found = screen_folders([tmp_path], "matrix-6-thermal")
    told = {each["title"]: each for each in fleet_document(found)["units"]}
    assert {name: each["worth"] for name, each in told.items()} == {"broken": False, "clipped": False}
    assert (told["broken"]["runs_not_used"], told["broken"]["missing"]) == ({"2": [4]}, ["run 99"])
    assert {(*of["channels"], of["done"]) for of in told["clipped"]["rows"]} == {("RA", "left out")}
    said = "\n".join(fleet_sentences(found))
    for words in (
        f"screened all the same: {tmp_path}/clipped (runs 1–12)",
        "broken: missing: run 99\n",
        "broken: sensor 2: run 4 FAILed by what was recorded",
        "clipped: left out: sensor 2, runs 1–12: RA goes no further",
    ):
        assert words in said, said


@pytest.mark.slow
def test_what_is_mended_where_it_is_solved_is_screened_as_it_is_mended(tmp_path: Path) -> None:
    """Channels exchanged in a run look like a jump, labels like a law of G: neither is missing from any model."""
    for i in range(4):
        made = campaign_of(SHORT, base_rates(SHORT) + noise(SHORT, np.random.default_rng(i)))
        rows = made.sensors[2]
        at, rates, columns = np.flatnonzero(rows.conditions.run == 5), rows.rates_deg_per_hr, rows.conditions.columns
        if i == 1:
            rates[at] = rates[at, ::-1]
        if i == 2:  # as the unit lay, by its accelerometers
            rates[at[:2]], f_g = rates[at[1::-1]], rows.conditions.f_g.copy()
            f_g[at[:2]] = f_g[at[1::-1]]
            columns = {**columns, **{f"accelerometer_{axis}_g": f_g[:, k] for k, axis in enumerate("ABS")}}
        rows = replace(rows, rates_deg_per_hr=rates, conditions=replace(rows.conditions, columns=columns))
        write_campaign(replace(made, sensors={2: rows}), tmp_path / f"u{i}")
    units = {
        each["folder"][-2:]: each for each in fleet_document(screen_folders([tmp_path], "matrix-6-thermal"))["units"]
    }
    assert {name: each["worth"] for name, each in units.items()} == dict.fromkeys(("u0", "u1", "u2", "u3"), False)
    for name, each in units.items():
        solved = what_is_wrong(read_campaign(tmp_path / name))
        assert each.get("rows", []) == [row for row in solved["rows"] if row["done"] == "mended"]
    assert [name for name, each in sorted(units.items()) if "rows" in each] == ["u1", "u2"]


@pytest.mark.slow
def test_what_is_solved_without_is_said_of_a_screen_that_uses_it(tmp_path: Path) -> None:
    """By the folder, for titles may be alike; the same collects and words as where the unit is solved."""
    for i in range(3):
        made = campaign_of(SHORT, base_rates(SHORT) + noise(SHORT, np.random.default_rng(i)))
        made.sensors[2].rates_deg_per_hr[7, 1] += 300.0 * (i == 1)
        write_campaign(made, tmp_path / f"u{i}")
    screened = screen_folders([tmp_path], "matrix-6-thermal")
    units = {each["folder"][-2:]: each.get("rows", []) for each in fleet_document(screened)["units"]}
    (solved,) = what_is_wrong(read_campaign(tmp_path / "u1"))["rows"]
    assert solved["done"] == "left out"
    assert units == {
        "u0": [],
        "u1": [{**solved, "done": "used", "why": f"{solved['why']}; hil solve leaves it out"}],
        "u2": [],
    }
    (said,) = [line for line in fleet_sentences(screened) if line.startswith(f"{tmp_path}/u1: used: ")]
    assert f"used: sensor 2, run {solved['run']}: collect 8: RB is +2" in said
    assert said.count("left out") + said.count("leaves it out") == 1


@pytest.mark.slow
def test_the_numbers_do_not_depend_on_who_weighs(fleet: Path, screened: Screened) -> None:
    """By two processes the same document, to the digit; so by the order in which folders are given."""
    alone = fleet_document(screened)
    assert fleet_document(screen_folders([fleet], "matrix-6-thermal", workers=2)) == alone
    pieces = pieces_in([fleet])
    assert pieces_in([fleet / "u03", fleet]) == [(str(fleet / "u03"), -1), *pieces[:3], *pieces[4:]]


@pytest.mark.slow
def test_the_command(fleet: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """One JSON document, a page and a table where they are asked for; bad input is a sentence and nothing written."""
    page, table = tmp_path / "f.html", tmp_path / "f.csv"
    assert run(["fleet", str(fleet / "w-other"), *MODEL, "--json"]) == 0
    said = json.loads(capsys.readouterr().out)
    assert said["schema"] == "hil.fleet/1"
    assert run(["fleet", str(fleet), *MODEL, "--out", str(page), "--csv", str(table)]) == 0
    out, err = capsys.readouterr()
    assert page.read_text().startswith("<!doctype html>")
    assert len(table.read_text().splitlines()) == 17
    assert "2 of 16 units deserve a full hil reconcile" in out
    assert "x-broken" in err
    own = next(each for each in fleet.rglob("collects.csv") if (each.parent / "campaign.yaml").exists())
    for words, message in (
        ([str(fleet), "--csv", str(own)], "collects.csv: is what a campaign's averages stand in"),
        ([str(tmp_path)], "no campaign folder"),
        ([str(fleet), "--out", "page.txt"], "give a name that ends in .html"),
        ([str(fleet), "--model", "nosuch"], "nosuch"),
        ([str(fleet), "--cluster", "nowhere"], "--cluster nowhere: "),
        ([str(fleet / "x-broken")], "'nonsense'"),
        ([str(tmp_path / "nosuch")], "nosuch"),
    ):
        assert run(["fleet", *MODEL, *words]) == 2
        assert message in capsys.readouterr().err


@pytest.mark.slow
def test_many_at_once_is_one_after_the_other() -> None:
    """The log Bayes factors of many units are those of each alone, at every point and at the first few."""
    units = [unit(i, 10.0 * i) for i in range(4)]
    screen = Screen.of(units, "matrix-6-thermal")
    (search,) = screen.found.values()
    rates = [screen.rates(each) for each in units]
    many = search.scan_many([np.column_stack(own) for own in zip(*rates, strict=True)])
    for i, own in enumerate(rates):
        for block, values in zip(search.blocks, own, strict=True):
            block.measure(values / block.unit)
        search.forget()
        assert many[:, i] == pytest.approx(search.scan(()), abs=1e-9)
        assert screen.weigh(rates)[:, i] == pytest.approx(screen.weigh([own])[:, 0], abs=1e-9)


@pytest.mark.slow
def test_false_discoveries_are_what_they_are_said_to_be() -> None:
    """Thirty fleets of twenty units, each with a noise of its own, nothing missing: at most one in twenty calls one."""
    from benchmarks.reconcile_fleet import unit as with_own_noise

    units = [with_own_noise(40_000 + i) for i in range(600)]
    screen = Screen.of(units, "matrix-6-thermal")
    weighed = screen.weigh([screen.rates(each) for each in units])
    calls = [min(f.q_value for f in screen.asked.findings(weighed[:, k : k + 20])) < 0.05 for k in range(0, 600, 20)]
    assert np.mean(calls) <= 0.05
    mixed = [screen.asked.mixed(weighed[:, k : k + 20]) for k in range(0, 600, 20)]
    assert np.mean([screen.asked.in_common(each[None], 20).p_value < 0.05 for each in mixed]) <= 0.05


def test_a_fleet_without_a_campaign_is_refused(tmp_path: Path) -> None:
    """An empty folder, or one of other things."""
    (tmp_path / "notes").mkdir()
    with pytest.raises(InputError, match="no campaign folder"):
        screen_folders([tmp_path], "matrix-6")


def test_an_archive_is_searched_and_a_folder_without_a_campaign_is_told_beside_others(
    fleet: Path, tmp_path: Path
) -> None:
    """What an archive has taken up is what its folder is screened for; nothing that is named is passed over."""
    archive, unit = tmp_path / "archive", fleet / "u03"
    assert run(["archive", str(archive), str(unit)]) == 0
    ((found, _),) = pieces_in([archive])
    assert Path(found).name == "campaign"
    (empty := tmp_path / "empty").mkdir()
    with pytest.raises(InputError, match="empty: no campaign folder"):
        pieces_in([unit, empty])


@pytest.mark.slow
def test_a_unit_that_is_noisier_than_its_fleet_is_not_called_for_that() -> None:
    """Offsets of runs six times as large as the others: by the fleet's noise something is missing, by its own not."""
    from benchmarks.reconcile_fleet import ROWS as WHOLE
    from benchmarks.reconcile_fleet import unit as with_own_noise

    screen = Screen.of([with_own_noise(i) for i in range(10)], "matrix-6-thermal")
    noisy = [noise(WHOLE, np.random.default_rng(seed), rho=0.5, sigma=0.5, run_bias=8.0) for seed in range(4)]
    rates = [screen.rates(campaign_of(WHOLE, base_rates(WHOLE) + each)) for each in noisy]
    of_fleet = screen._by_name([np.column_stack(each) for each in zip(*rates, strict=True)], None)
    assert all(each.p_value < 0.01 for each in screen.asked.findings(of_fleet))
    assert all(each.p_value > 0.2 for each in screen.asked.findings(screen.weigh(rates)))


@pytest.mark.slow(seconds=10)
@pytest.mark.parametrize("temperatures", [8, 2])
def test_values_that_follow_temperature_are_no_finding_by_a_model_of_constants(temperatures: int) -> None:
    """Twenty sound units with values of their own at each of some temperatures: none is called, a supply effect is.

    Their values follow no law, so that nothing is missing from any; `hil reconcile` calibrates such a unit at each.
    """
    rows = lay_out(np.random.default_rng(0), runs_each=3)
    off, (of_each, place) = rows.temperature - rows.setpoint, np.unique(rows.setpoint, return_inverse=True)
    station = place * temperatures // 8
    rows.setpoint = of_each[station * 8 // temperatures]
    rows.temperature = rows.setpoint + 0.1 * off

    def of_unit(seed: int, size: float) -> Campaign:
        rng = np.random.default_rng(seed)
        ba, bb, ga, gb, ma, mb = (
            (rng.normal(m, s, temperatures))[station] for m, s in ((9, 9), (9, 9), (60, 6), (20, 6), (5, 5), (5, 5))
        )
        fa, fb, fs = rows.f.T
        of_a = ba + ga * fa + gb * fb + mb * fs + rows.w[:, 0]
        of_b = bb - gb * fa + ga * fb - ma * fs + rows.w[:, 1]
        effect = both(rows.supply - 28.0, size, -size)
        return campaign_of(rows, np.stack([of_a, of_b], 1) + noise(rows, rng) + effect)

    units = [of_unit(i, 25.0 * (i % 10 == 3)) for i in range(20)]
    screen = Screen.of(units, "matrix-6")
    called = {i: each.leader for i, each in enumerate(screen.units(units)) if each.q_value < 0.05}
    assert called == dict.fromkeys((3, 13), "supply")
    assert screen.asked.follows


@pytest.mark.slow
def test_what_reading_folders_warned_of_is_said_once_of_all(tmp_path: Path) -> None:
    """That there is no earth rate, as every other command says it; what a run FAILs by is said of the run."""
    for i in range(2):
        made = campaign_of(SHORT, base_rates(SHORT) + noise(SHORT, np.random.default_rng(i)))
        conditions = made.sensors[2].conditions
        still = replace(conditions, w_deg_per_hr=np.zeros_like(conditions.w_deg_per_hr))
        if i:
            still = replace(still, f_g=np.where(np.arange(len(still))[:, None] == 2, 1.1, 1.0) * still.f_g)
        write_campaign(replace(made, sensors={2: replace(made.sensors[2], conditions=still)}), tmp_path / f"u{i}")
    found = screen_folders([tmp_path], "matrix-6-thermal")
    told = {each["folder"][-2:]: each for each in fleet_document(found)["units"]}
    *warned, fails = read_campaign(tmp_path / "u1").warnings
    assert fails.startswith("collect 3: ")
    assert told["u1"]["warnings"] == warned
    said = "\n".join(fleet_sentences(found))
    assert len(re.findall(r"u\d and \S+/u\d: warning: collects.csv, sensor 2: w is 0 in every row", said)) == 1
    assert "u1: warning: collects.csv, sensor 2, row 4: |f| is off 1 g" in said


@pytest.mark.parametrize("follows", [True, False])
def test_a_screen_says_beside_which_values_it_asked(follows: bool) -> None:
    """Beside values that follow temperature it finds no law of temperature, and says that a reconcile may."""
    shared = SharedFinding("supply", 0.5, 0.9, 0.01, 0.01, follows)
    found = Screened("matrix-6", [], [(1, shared)], {}, ())
    said = [line for line in fleet_sentences(found) if "beside values of matrix-6 that follow temperature" in line]
    assert len(said) == follows
    other = replace(found, shared=[*found.shared, (2, replace(shared, follows=not follows))])
    (said,) = [line for line in fleet_sentences(other) if "that follow temperature" in line]
    assert said.startswith(f"layout {1 if follows else 2}: screened beside")
    assert fleet_document(found)["shared"][0]["values_follow_temperature"] is follows


def test_what_a_fleet_cannot_tell_from_its_shared_name_is_said_beside_it() -> None:
    """Of two temperatures a hysteresis and a bias that follows temperature are one column in every unit."""
    asked = Asked(["hyst", "bias_T", "supply"], np.log([0.1, 0.09, 0.1]), follows=False, alike={})
    by_name = np.array([[9.0, 8.0, 9.0], [9.0, 8.0, 9.0], [0.0, 0.0, 0.0]])
    shared = asked.in_common(asked.mixed(by_name)[None], 3)
    assert (shared.name, [name for name, _ in shared.rivals]) == ("hyst", ["bias_T"])
    assert shared.share + shared.rivals[0][1] == pytest.approx(1.0, abs=1e-3)
    finding = UnitFinding(0.0, 0.5, 0.5, "hyst", 0.5)
    units = [ScreenedUnit(name, "", name, "", False, (), {}, layout=1, finding=finding) for name in "abc"]
    told = Screened("matrix-6", units, [(1, shared)], {}, ())
    assert any(
        "seem to lack hyst (53 %) or bias_T (47 %), which of them is not certain, p = " in line
        for line in fleet_sentences(told)
    )
    assert [each["id"] for each in fleet_document(told)["shared"][0]["rivals"]] == ["bias_T"]


def test_names_whose_order_is_chance_stand_beside_each_other() -> None:
    """One draw more or less of noise had made hyst or bias_T the name of a unit, and so the order of a fleet."""
    asked = Asked(["hyst", "bias_T", "supply"], np.log([0.1, 0.1, 0.1]), follows=False, alike={})
    by_name = np.array([[9.1, 9.0, 9.0, 2.0], [9.0, 9.1, 9.0, 1.0], [0.0, 0.0, 1.0, 12.0]])
    found = asked.findings(by_name)
    assert [each.names for each in found] == [("bias_T", "hyst")] * 3 + [("supply",)]
    assert found[0].rivals[0][0] == "bias_T"
    units = [
        ScreenedUnit(f"u{i}", "", f"{i}", "", False, (), {}, layout=1, finding=replace(each, q_value=0.01))
        for i, each in enumerate(found)
    ]
    told = Screened("matrix-6", units, [], {}, ())
    lines = [line for line in fleet_sentences(told) if " leads in " in line]
    assert lines == ["bias_T or hyst leads in 3 units, which of them is not certain", "supply leads in 1 unit"]
    assert '<td class="text">bias_T or hyst</td>' in fleet_page(told)
    document = fleet_document(told)
    counted = [(each["id"], each["count"], each["certain"]) for each in document["effects"]]
    assert counted == [("bias_T", 3, 0), ("hyst", 3, 0), ("supply", 1, 1)]
    assert [each["id"] for each in document["units"][1]["rivals"]] == ["hyst"]
    assert document["units"][3]["rivals"] == []


@pytest.mark.parametrize(
    ("serials", "said"), [("ABC", "3 units"), ("AAB", "3 calibrations of 2 units"), ("A", "1 unit")]
)
def test_calibrations_of_one_unit_are_counted_as_what_they_are(serials: str, said: str) -> None:
    """And what one alone has in common with nothing is not told."""
    finding = UnitFinding(0.0, 0.5, 0.5, "supply", 1.0)
    units = [
        ScreenedUnit(f"u{place}", "", serial, "", False, (), {}, layout=1, finding=finding)
        for place, serial in enumerate(serials)
    ]
    shared = SharedFinding("supply", 0.9, 0.001, 1.0, 1.0, False)
    lines = list(fleet_sentences(Screened("matrix-6", units, [(1, shared)], {}, ())))
    few = " by itself; any few of layout 1 do, for what its units share" * (len(serials) > 1)
    assert lines[0] == f"none of {said} deserves a full hil reconcile{few}"
    assert [line for line in lines if "deserve" in line] == lines[:1]
    assert [line for line in lines if line.startswith(f"layout 1: its {said} together")] == lines[1:2] * (
        len(serials) > 1
    )
    assert f"{said} screened" in fleet_page(Screened("matrix-6", units, [], {}, ()))


@pytest.mark.slow
def test_units_without_a_thermometer_are_told_apart_by_what_stands_in_for_it(tmp_path: Path) -> None:
    """Measured at other temperatures of the chamber they have another layout."""
    for number, warmer in enumerate((0.0, 0.0, 20.0)):
        rows = unit(number).sensors[2]
        columns = {n: of for n, of in rows.conditions.columns.items() if not n.endswith("_degC")}
        columns["chamber_degC"] = rows.conditions.columns["temperature_degC"] + warmer
        bare = replace(rows, conditions=replace(rows.conditions, columns=columns))
        write_campaign(replace(unit(number), sensors={2: bare}), tmp_path / f"u{number}")
    assert sorted(each.layout for each in screen_folders([tmp_path], "matrix-6").units) == [1, 1, 2]
