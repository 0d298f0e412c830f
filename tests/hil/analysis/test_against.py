"""A campaign against an earlier one: differences with honest uncertainties, and flags as often as chance gives them."""

from __future__ import annotations

import re
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from benchmarks.blind.cases import make_case, write_case
from hil.analysis.against import Comparison
from hil.campaign import Campaign, Collects
from hil.campaign.reader import read_campaign
from hil.cli.app import run as hil
from hil.report.content import gather, good
from hil.report.page import render
from hil.solve import repeats, solve_campaign
from tests.hil.analysis.thermal.nights import rotor_night


@pytest.fixture(scope="module")
def first(tmp_path_factory: pytest.TempPathFactory) -> Campaign:
    """A campaign of 8 temperatures × 3 self-calibrations, each begun when the unit had settled."""
    made = read_campaign(write_case(make_case(7, model="matrix-6-thermal"), tmp_path_factory.mktemp("first") / "c"))
    rows = made.sensors[2].conditions
    settled = {**rows.columns, "temperature_degC": rows.columns["setpoint_degC"] + 8.0}
    return replace(made, sensors={2: replace(made.sensors[2], conditions=replace(rows, columns=settled))})


def changed(campaign: Campaign, **of: float | np.ndarray) -> Campaign:
    """Return the campaign with `add` put on every rate, and rates scaled by nothing else."""
    collects = campaign.sensors[2]
    return replace(
        campaign,
        title="another night",
        sensors={2: Collects(collects.conditions, collects.rates_deg_per_hr + of["add"], collects.rates_se_deg_per_hr)},
    )


def again(campaign: Campaign, rng: np.random.Generator) -> Campaign:
    """Return the campaign measured again: what does not change, with noise of its own of the stated size."""
    return changed(campaign, add=rng.normal(size=campaign.sensors[2].rates_deg_per_hr.shape) * _se(campaign))


def _se(campaign: Campaign) -> np.ndarray:
    return campaign.sensors[2].rates_se_deg_per_hr


def test_a_shift_of_the_bias_is_found_and_nothing_else(first: Campaign) -> None:
    """50 deg/hr on both channels: BA and BB at every temperature, with the right size and sign; GS and MU stay."""
    found = Comparison(changed(first, add=50.0), first)
    assert {each.parameter for each in found.flagged} == {"BA", "BB"}
    assert len(found.flagged) == 2 * 8
    assert [each.difference.value for each in found.flagged] == pytest.approx([50.0] * 16)
    assert Comparison(first, changed(first, add=50.0)).flagged[0].difference.value == pytest.approx(-50.0)


def test_a_campaign_does_not_differ_from_itself(first: Campaign) -> None:
    """48 differences of nothing, none beyond 3 sigma."""
    found = Comparison(first, first)
    assert len(found.differences) == 48
    assert not found.flagged
    assert found.sentence.startswith("0 of 48 differences")
    assert "compared with itself" in found.remarks[0]


@pytest.mark.slow
def test_chance_flags_no_more_than_three_sigma_does(first: Campaign) -> None:
    """Pairs of campaigns that differ by noise alone: 0.27 % of differences or fewer are beyond 3 sigma."""
    rng = np.random.default_rng(5)
    pairs = [Comparison(again(first, rng), again(first, rng)) for _ in range(12)]
    assert not [each for pair in pairs for each in pair.flagged]  # which chance brings in 1 % of pairs
    everything = [each for pair in pairs for each in pair.differences]
    assert len(everything) == 12 * 48
    assert sum(each.flagged for each in everything) <= 5  # 1.6 expected; more than 5 has a chance of 0.6 %
    by = [each.difference for each in everything if each.difference.sd > 0.0]
    times = np.array([3.0 * each.value / each.expanded(3.0) for each in by])
    assert 0.3 < np.std(times) < 1.05  # never narrower than it is, and not so wide that nothing could be found


def test_few_runs_widen_the_uncertainty_of_what_scatters(first: Campaign) -> None:
    """A bias that changes by 10 deg/hr from run to run is not known to the collects' noise."""
    run = first.sensors[2].conditions.run
    jumps = np.random.default_rng(3).normal(scale=10.0, size=run.max() + 1)[run][:, None]
    quiet = next(each for each in Comparison(first, first).differences if each.parameter == "BA").difference
    loud = [each for each in Comparison(changed(first, add=jumps), first).differences if each.parameter == "BA"]
    assert np.median([each.difference.sd for each in loud]) > 3 * quiet.sd
    assert np.median([each.difference.expanded(3.0) / each.difference.sd for each in loud]) > 3.2  # 16 and more degrees
    assert not [each for each in loud if each.flagged]


@pytest.mark.slow
def test_single_runs_scatter_as_the_repeats_of_the_other_night_show() -> None:
    """One run at each temperature beside three, whichever is the later: as rare as three sigma, where MU reseats."""
    rng, curves = np.random.default_rng(8), {"MUA": lambda t: 0.2 * t}
    marked, every = 0, 0
    for _ in range(6):
        single, repeated = (rotor_night(rng, curves, temperatures_degC=(0.0, 30.0, 60.0), runs=n) for n in (1, 3))
        for found in (Comparison(single, repeated), Comparison(repeated, single)):
            marked, every = marked + len(found.flagged), every + len(found.differences)
            assert "neither repeats" not in found.sentence
    assert (every, marked) == (6 * 2 * 18, 0)
    alone = Comparison(single, rotor_night(rng, curves, temperatures_degC=(0.0, 30.0, 60.0), runs=1))
    assert alone.sentence.endswith("and beside it whatever changes from run to run, which neither repeats")


def test_rows_that_are_means_of_runs_have_the_scatter_of_these_in_their_errors() -> None:
    """A printed table beside a night of repeats takes no scatter from it; and no ± of it lacks that."""
    rng = np.random.default_rng(8)
    single, repeated = (rotor_night(rng, {}, temperatures_degC=(0.0, 30.0), runs=n) for n in (1, 3))
    printed = replace(single, rebuilt=True)
    shown = repeats(printed, solve_campaign(printed))[2]
    assert shown.sentences() == [
        "each row is a mean of runs: by what these scattered is in its standard error, and so in every ±"
    ]
    alone, table = (Comparison(one, repeated).differences[0].difference.sd for one in (single, printed))
    assert table < 0.8 * alone
    unstated = replace(printed.sensors[2], rates_se_deg_per_hr=np.full_like(single.sensors[2].rates_deg_per_hr, np.nan))
    bare = replace(printed, sensors={2: unstated})
    assert not repeats(bare, solve_campaign(bare))[2].scatter_included


def test_what_cannot_be_compared_is_said(first: Campaign) -> None:
    """A temperature that only one of them has, a sensor that the other lacks, units that are not the same."""
    conditions = first.sensors[2].conditions
    column = next(n for n in ("setpoint_degC", "chamber_degC", "temperature_degC") if n in conditions.columns)
    hotter = replace(conditions, columns={**conditions.columns, column: conditions.columns[column] + 500.0})
    moved = replace(first, sensors={2: replace(first.sensors[2], conditions=hotter)})
    one, other = ({"model": "MFS", "serial": serial} for serial in ("1", "2"))
    found = Comparison(replace(moved, identity=one), replace(first, identity=other))
    assert not found.differences
    assert found.sentence.startswith("nothing can be compared")
    assert re.search("”: at .* °C the earlier campaign has no such temperature$", found.sentence)
    assert sum("has no such temperature" in each for each in found.remarks) == 8
    assert any("two units, MFS 1 now and MFS 2 before" in each for each in found.remarks)
    other = replace(first, sensors={5: first.sensors[2]})
    assert "The earlier campaign has no sensor 2." in Comparison(first, other).remarks


def at_setpoint(campaign: Campaign, runs: tuple[int, ...], own_degC: object) -> Campaign:
    """Return the campaign with what the unit's own thermometer showed in some runs, which were all of one setpoint."""
    rows = campaign.sensors[2].conditions
    own = rows.columns["temperature_degC"].copy()
    own[np.isin(rows.run, runs)] = own_degC
    told = replace(rows, columns={**rows.columns, "temperature_degC": own})
    return replace(campaign, sensors={2: replace(campaign.sensors[2], conditions=told)})


@pytest.mark.slow
def test_a_setpoint_at_which_the_unit_was_at_another_temperature_is_not_compared(first: Campaign) -> None:
    """In either of the two it had not settled, or was elsewhere: it is said, and nothing found."""
    mean = Comparison(first, first).differences[0]
    rows = first.sensors[2].conditions
    runs = tuple(np.unique(rows.run[rows.columns["setpoint_degC"] == mean.temperature_degC]).tolist())
    own = float(rows.columns["temperature_degC"][rows.run == runs[0]][0])
    rising = at_setpoint(first, runs, own - 40.0 + 4.0 * np.arange(np.isin(rows.run, runs).sum()))
    elsewhere = at_setpoint(first, runs, own - 2.5)
    said = f"run{'s' * (len(runs) > 1)} {runs[0]}"
    for now, before, why in (
        (rising, first, said),
        (first, rising, f"the earlier campaign's {said}"),
        (elsewhere, first, f"in the earlier campaign the unit was at {own:.1f} °C"),
    ):
        found = Comparison(changed(now, add=50.0), before)
        assert {each.temperature_degC for each in found.differences}.isdisjoint({mean.temperature_degC})
        assert len(found.flagged) == 2 * 7
        (remark,) = [each for each in found.remarks if why in each]
        assert f"Sensor 2 at {mean.temperature_degC:.1f} °C (as set, unit " in remark
        assert list(found.without) == [(2, mean.temperature_degC)]
        assert f"; not compared is, of sensor 2, what was at {mean.temperature_degC:.0f} °C " in found.sentence
    near = Comparison(changed(at_setpoint(first, runs, own - 1.5), add=50.0), first)
    assert (len(near.flagged), near.without) == (16, {})
    assert "not compared" not in near.sentence


def test_without_any_uncertainty_nothing_is_flagged(first: Campaign) -> None:
    """One run at each temperature and no standard errors: the difference is shown, and that it says nothing."""
    collects = first.sensors[2]
    chosen = collects.rows(np.isin(collects.conditions.run, [1, 4]))
    bare = replace(
        first,
        sensors={
            2: Collects(chosen.conditions, chosen.rates_deg_per_hr, np.full_like(chosen.rates_deg_per_hr, np.nan))
        },
    )
    found = Comparison(changed(bare, add=1e6), bare)
    assert not any(np.isfinite(each.difference.sd) for each in found.differences)
    assert not found.flagged
    assert any("neither standard errors nor repeats" in each for each in found.remarks)


@pytest.mark.slow
def test_the_page_shows_the_comparison_and_marks_what_is_beyond(first: Campaign) -> None:
    """In the verdict's box, what to do about it included; the first in words, and a table with every difference."""
    comparison = Comparison(changed(first, add=50.0), first)
    page = render(gather(changed(first, add=50.0), comparison=comparison))
    assert "16 of 48 differences from" in page[: page.index("<table")]
    assert "16 numbers changed since the earlier campaign: find out why" in page[: page.index("<table")]
    assert "What has changed since the earlier campaign is the unit&#39;s; a measurement is not judged by it" in page
    assert page.count(">BEYOND<") == 16
    listed = page[page.index('id="against"') : page.index('id="differences"')]
    assert len(re.findall(r"<li>sensor 2, [^<]* now and was [^<]* a difference of 50\.\d+ ±", listed)) == 3
    assert first.source in listed
    assert isinstance(comparison, Comparison)


@pytest.mark.slow
def test_the_command_compares_two_folders(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """`--against`; and a folder that is none is bad input, with nothing written."""
    for seed in (7, 8):
        write_case(make_case(seed, model="matrix-6-thermal"), tmp_path / f"c{seed}")
    out = tmp_path / "r.html"
    assert hil(["report", str(tmp_path / "c7"), "--out", str(out), "--against", str(tmp_path / "nowhere")]) == 2
    assert not out.exists()
    assert hil(["report", str(tmp_path / "c7"), "--out", str(out), "--against", str(tmp_path / "c8"), "--csv"]) == 0
    assert 'id="differences"' in out.read_text()
    lines = (tmp_path / "r-differences.csv").read_text().splitlines()
    assert len(lines) == 1 + 8 * 6  # a run that had not settled is in no mean, and leaves those that had
    assert '"difference"' in lines[0]
    assert '"temperature_of"' in lines[0]
    said, found = capsys.readouterr().out, Comparison(*(read_campaign(tmp_path / name) for name in ("c7", "c8")))
    assert found.flagged
    assert "\n".join(found.sentences()) in said
    assert found.flagged[0].sentence in found.sentences()


@pytest.mark.parametrize(
    ("change", "words"),
    [
        (lambda rates: rates * [-1.0, 1.0], "the sign of RA looks turned"),
        (lambda rates: rates * [1.0, 1.3], "one cause: RB is 1.3"),
        (lambda rates: rates[:, ::-1], "RA and RB look exchanged"),
        (lambda rates: rates, ""),
        (lambda rates: rates + 80.0, ""),
    ],
)
def test_what_six_equations_cannot_see_the_last_parameters_do(first: Campaign, change, words: str) -> None:
    """A turned sign, another gain, exchanged channels: no residual, but the unit was another before."""
    rates = np.asarray(change(first.sensors[2].rates_deg_per_hr))
    now = replace(
        first, sensors={2: replace(again(first, np.random.default_rng(3)).sensors[2], rates_deg_per_hr=rates)}
    )
    said = [each for each in Comparison(now, first).doubts if "looks" in each or "look " in each]
    assert (words in " ".join(said)) if words else not said


@pytest.mark.slow
def test_channels_exchanged_between_sensors_are_seen(first: Campaign) -> None:
    """The plugs of two sensors: RB of one stands where RB of the other was."""
    rates = first.sensors[2].rates_deg_per_hr
    two = {2: first.sensors[2], 3: replace(first.sensors[2], rates_deg_per_hr=2.0 * rates[:, ::-1] + 5.0)}
    before = replace(first, sensors=two)
    crossed = {n: np.stack([two[n].rates_deg_per_hr[:, 0], two[5 - n].rates_deg_per_hr[:, 1]], 1) for n in two}
    now = replace(first, sensors={n: replace(two[n], rates_deg_per_hr=crossed[n]) for n in two})
    assert [each for each in Comparison(now, before).doubts if "exchanged" in each] == [
        "Sensors 2 and 3: RB and RB look exchanged: crosswise they agree with the earlier rates."
    ]
    assert not Comparison(before, before).doubts


def test_a_site_that_moved_is_no_pass(first: Campaign) -> None:
    """A latitude that is ten degrees off fits six equations; the unit's last campaign says another."""
    here = replace(first, site={"latitude_deg": 44.6, "heading_deg": 30.0})
    before = replace(first, site={"latitude_deg": 34.6, "heading_deg": 31.0})
    found = Comparison(here, before)
    assert [each for each in found.doubts if "latitude is 44.6 deg now and was 34.6" in each] == list(found.doubts)
    verdict, said = good(gather(here, None, found))
    assert verdict == "MARGINAL"
    assert "latitude" in said
    verdict, said = good(gather(here, None, Comparison(here, here)))
    assert verdict == "PASS"
    assert "has changed" not in said
