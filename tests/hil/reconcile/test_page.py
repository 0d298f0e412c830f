"""The page of a finding: told in the order of the question, in words, on a phone, on paper, and dark where asked."""

from __future__ import annotations

import re
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from matplotlib.figure import Figure

from benchmarks.blind.cases import make_case, write_case
from hil.campaign.reader import read_campaign
from hil.files.numbers import rounded
from hil.reconcile import Reconciliation, reconcile
from hil.reconcile.outcome.page import driver_of, page, panels_of, pictures
from hil.reconcile.outcome.sentences import gap_in_words, summary, titled, what_to_do
from hil.reconcile.result import FoundEffect
from hil.reconcile.rivals import Rival
from tests.hil.reconcile.hidden_effects import hidden_campaign


@pytest.fixture(scope="module")
def aged(tmp_path_factory: pytest.TempPathFactory) -> Reconciliation:
    """A unit that ages, by 25 times the noise, compared with a model that does not know it."""
    case = make_case(72, ("ageing",), d=25.0, model="matrix-6")
    return reconcile(read_campaign(write_case(case, tmp_path_factory.mktemp("aged") / "c")), "matrix-6")


def test_no_number_is_written_with_an_e() -> None:
    """A value has as many decimals as its error has two digits; what is tiny shares one power of ten with its error."""
    assert rounded(4.6412, 2.71) == "4.6 ± 2.7"
    assert rounded(-35.5057, 0.044) == "-35.506 ± 0.044"
    assert rounded(-3.94e-16, 2.6e-18) == "(-3.940 ± 0.026) × 10⁻¹⁶"
    assert rounded(0.25, None) == "0.25"


def test_no_legend_lies_on_points(monkeypatch: pytest.MonkeyPatch) -> None:
    """It stands between the title and the axes, and ends where they end."""
    figures: list[Figure] = []
    monkeypatch.setattr("hil.reconcile.outcome.page.inline_svg", lambda figure, _: figures.append(figure))
    row = {
        "sensor": 2,
        "channel": "RA",
        "noise_after": 1.0,
        "held_before": 3.0,
        "held_after": 2.0,
        "run": 1,
        "effect": 0.0,
    }
    panel = [{**row, "position": position} for position in "1234"]
    assert len(list(pictures([panel], "run", "held_before", "before", {}))) == 1
    (axes,) = figures[0].axes
    legend = axes.get_legend()
    assert legend is not None
    extent, inside = legend.get_window_extent(), axes.get_window_extent()
    assert extent.y0 >= inside.y1
    assert extent.x1 <= inside.x1 + 5.0
    assert axes.get_title(loc="left") == "sensor 2, RA, before"


@pytest.mark.slow
def test_pictures_run_over_what_most_of_it_follows_and_show_where_something_is(
    aged: Reconciliation, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Of two drivers that are as likely the one that leaves less; channels with nothing are left to their sensor."""
    row = {"noise_after": 1.0, "held_after": 0.0, "effect": 0.0}
    rows = [
        {**row, "sensor": n, "channel": "RA", "run": run, "position": at, "temperature_degC": 10.0 * run}
        | {"held_before": (n == 2) * (20.0 * run + (at == "2"))}
        for n in (1, 2)
        for run in range(6)
        for at in "12"
    ]
    both = replace(aged, follows=[("pose", 1.0), ("temperature", 0.9), ("time", 0.1)])
    assert driver_of(both, rows) == "temperature, °C"
    assert driver_of(replace(both, follows=[("pose", 1.0), ("temperature", 0.4)]), rows) == "position"
    assert [own[0]["sensor"] for own in panels_of(rows)] == [2, 1]
    assert [own[0]["sensor"] for own in panels_of(rows, {(1, "RA")})] == [1]
    assert [own[0]["sensor"] for own in panels_of([{**each, "effect": each["held_before"]} for each in rows])] == [2]
    figures: list[Figure] = []
    monkeypatch.setattr("hil.reconcile.outcome.page.inline_svg", lambda figure, _: figures.append(figure))
    list(pictures(panels_of(rows)[:1], "position", "held_before", "before", {}, curve=True))
    points, curve, *_ = figures[0].axes[0].get_lines()
    for line in (points, curve):  # a position's collects stand side by side, within its own place
        assert (np.diff(line.get_xdata()) > 0.0).all()
        assert np.abs(line.get_xdata()).max() < 0.5


@pytest.mark.slow
def test_whether_the_twin_is_told_apart_stands_on_the_first_line() -> None:
    """Nobody has to act is said of no model whose simulated nights are unlike the measured one; by what is said."""
    result = reconcile(hidden_campaign(7, temperatures=(0.0, 20.0, 40.0)), "matrix-6-thermal", prove=False)
    assert result.verdict == "none"
    parts = {"averages": 0.6, "run_scatter": 1e-5, "series": None, "conditions": 1.0}
    for p_value, kind, first in ((0.3, "none", "Nobody has to act."), (1e-5, "apart", "Do not rely on nights")):
        told = replace(result, twin={"draws": 20, "seed": 1, "after": {"p_value": p_value, "parts": parts}})
        assert what_to_do(told)[0] == kind
        assert what_to_do(told)[1].startswith(first)
    assert "can be told from the measured one by how its averages scatter" in what_to_do(told)[1]


@pytest.mark.slow
def test_the_story_is_told_in_its_order_and_in_words(aged: Reconciliation) -> None:
    """Verdict, what to do, what was found, what was judged; where, what, added, smaller, next; no id without title."""
    text = page(aged)
    body = re.sub(r"<style>.*?</style>|<svg.*?</svg>", "", text, flags=re.DOTALL)
    words = " ".join(re.sub(r"<[^>]+>", " ", body).split())
    order = (
        "named – Use the improved model, model.yaml, from now on.",
        "Something is missing, and it has a name.",
        "is missing from matrix-6",
        "Judged is the model",
        "Where they disagree",
        "What it follows, and what it is called",
        "What the unit's parameters are",
        "How much smaller the gap is",
        "What to measure next",
    )
    places = [words.index(each) for each in order]
    assert places == sorted(places)
    assert re.findall(r"\d\.?\d*e[-+]\d\d", words) == []
    (effect,) = aged.effects
    assert f"{effect.title} ({effect.id})" in words
    assert re.search(r"(larger than|smaller than|within) what is typical", words)
    # The same channels before, with the curve, and after: on one scale, of rows that were held out.
    titles = re.findall(r"<svg [^>]*aria-label=\"(sensor 2, R[AB]), (before|with what was added|after)", text)
    assert [when for _, when in titles[::2]] == ["before", "with what was added", "after"]
    rows = aged.picture["rows"]
    assert max(abs(row["held_before"]) for row in rows) > 2.0 * max(abs(row["held_after"]) for row in rows)


@pytest.mark.slow
def test_it_fits_a_phone_and_paper_and_is_dark_where_its_reader_is(
    aged: Reconciliation, tmp_path: Path, browser: Any
) -> None:
    """390 px wide without scrolling sideways; within the margins of A4, in under six pages; a dark ground."""
    (tmp_path / "page.html").write_text(page(aged))
    tab = browser.new_context(viewport={"width": 390, "height": 844}, color_scheme="dark").new_page()
    tab.goto((tmp_path / "page.html").as_uri())
    tab.evaluate("() => document.querySelectorAll('details').forEach(each => { each.open = true; })")
    assert tab.evaluate("() => document.documentElement.scrollWidth") <= 390
    assert tab.evaluate("() => getComputedStyle(document.body).backgroundColor") == "rgb(14, 18, 22)"
    tab.reload()
    assert len(re.findall(rb"/Type\s*/Page\b", tab.pdf(format="A4"))) < 6
    tab.set_viewport_size({"width": 703, "height": 1000})
    tab.emulate_media(media="print")
    wide = "() => [...document.querySelectorAll('table, svg, p')].filter(e => e.getBoundingClientRect().right > 704)"
    assert tab.evaluate(f"{wide}.length") == 0
    kept = "() => [...document.querySelectorAll('.figures')].map(e => getComputedStyle(e.previousElementSibling))"
    assert tab.evaluate(f"{kept.replace('() => ', '() => (')}).map(e => e.breakAfter)") == ["avoid"] * 3


@pytest.mark.slow
@pytest.mark.parametrize(
    ("odds", "said"),
    [
        ((0.1, 0.02), "physics expects a: by how usual it is at this size, 10 times as probable as any of those"),
        ((0.3, 0.02), "a is not known to be much more usual, at this size"),
        ((5.01, 0.02), "physics expects B's title (b): by how usual it is at this size, 5 times as probable"),
    ],
)
def test_physics_expects_a_name_only_where_it_favours_it_alone(
    aged: Reconciliation, odds: tuple[float, float], said: str
) -> None:
    """By what was known before the data, of every rival that looks the same: a lead that data gave it is none."""
    rivals = [
        Rival(name, 0.2, 0.99, f"{name.upper()}'s title", 0.6, prior) for name, prior in zip("bc", odds, strict=True)
    ]
    first = FoundEffect("a", "A's title", 0.6, "ambiguous", confusable_with=rivals)
    told = summary(replace(aged, verdict="ambiguous", effects=[first]))[0]
    assert "(60 %), or – 20 % – B's title (b), or – 20 % – C's title (c): these" in told
    assert told.endswith(f"these collects cannot tell them apart; {said}.")


@pytest.mark.slow
@pytest.mark.parametrize(
    ("factors", "said"),
    [
        ((1.0, 1.9, 0.6), ": these collects cannot tell them apart;"),
        ((1.0, 1.9, 5e-4), ": these collects cannot tell a and b and c apart;"),
        ((1.0, 0.3, 5e-4), ": these collects cannot tell a and b apart;"),
        ((0.3, 0.1, 5e-4), ", or – 10 % – d."),
    ],
)
def test_what_the_data_exclude_is_not_said_to_be_the_same(
    aged: Reconciliation, factors: tuple[float, ...], said: str
) -> None:
    """Columns that look the same are no more: the headline says of each what the list of rivals says."""
    rivals = [Rival(name, 0.1, 0.999, "", factor, 0.1) for name, factor in zip("bcd", factors, strict=True)]
    first = FoundEffect("a", "A's title", 0.6, "ambiguous", confusable_with=rivals)
    told = summary(replace(aged, verdict="ambiguous", effects=[first]))[0]
    assert said in told
    assert ("cannot tell" in told) == any("cannot tell it" in each.in_words for each in rivals)


@pytest.mark.slow
def test_physics_expects_no_curve(aged: Reconciliation) -> None:
    """What has no name is not expected, however probable; a named rival beside it is judged as if it were not there."""
    curve = Rival("empirical: B × elapsed", 0.3, 0.99, "B follows elapsed", 1.0, 9.0)
    alone = FoundEffect("a", "A's title", 0.6, "ambiguous", confusable_with=[curve])
    told = summary(replace(aged, verdict="ambiguous", effects=[alone]))[0]
    assert "expects" not in told
    assert told.endswith("apart; a is the only one of them that has a name.")
    beside = replace(alone, confusable_with=[curve, Rival("b", 0.1, 0.99, "B's title", 1.0, 0.1)])
    told = summary(replace(aged, verdict="ambiguous", effects=[beside]))[0]
    assert told.endswith("apart; physics expects a: by how usual it is at this size, 10 times as probable.")


@pytest.mark.slow
def test_a_title_beside_an_id_keeps_its_own_words(aged: Reconciliation) -> None:
    """A title may have a word in it that is another effect's id: it is that title's word."""
    rivals = [Rival("drift", 0.2, 0.99, "Linear drift between collects"), Rival("k2", 0.1, 0.99, "g squared")]
    first = FoundEffect("MU_real", "Axial drift (MUA, MUB)", 0.6, "ambiguous", confusable_with=rivals)
    told = titled(replace(aged, effects=[first]), "separates MU_real from k2, not from drift")
    wanted = "separates Axial drift (MUA, MUB) (MU_real) from g squared (k2), not from Linear drift between collects"
    assert told == f"{wanted} (drift)"


@pytest.mark.slow
def test_everything_that_it_surely_follows_is_said(aged: Reconciliation) -> None:
    """Two effects follow two things; where nothing is sure, the likeliest is said with its probability."""
    both = replace(aged, follows=[("time", 0.999), ("run", 0.9), ("supply", 0.4)])
    assert "It follows time (99.9 %) and changes from run to run (90 %)." in summary(both)
    assert "It follows time (60 %)." in summary(replace(aged, follows=[("time", 0.6), ("supply", 0.4)]))
    few = replace(both, follows=[("pose", 0.9)], follows_one_of={"drivers": ["supply", "run"], "probability": 0.96})
    assert "It follows pose (90 %) and changes from run to run or follows supply (96 %)." in summary(few)
    unsure = replace(few, follows=[("supply", 0.5), ("run", 0.46)])
    assert "It changes from run to run or follows supply (96 %)." in summary(unsure)


@pytest.mark.slow
def test_what_no_collect_tells_from_an_effect_is_not_said_to_be_none(aged: Reconciliation) -> None:
    """A curve of 66 % beside a jump that looks the same: "no effect of the catalogue does this" stood above both."""
    jump, other = Rival("jump", 0.34, 1.0, "Jump", 1.0, 0.5), Rival("hyst", 0.02, 0.4, "Play", 1e-6, 1.0)
    for rivals, said in (([jump, other], "Measure what is said below"), ([other], "no effect of the catalogue does")):
        curve = FoundEffect("empirical: B × elapsed", "B follows", 0.66, "empirical", confusable_with=rivals)
        asked = replace(aged, verdict="empirical", effects=[curve], next_experiment={"why": "x"})
        assert said in what_to_do(asked)[1]


@pytest.mark.slow
def test_a_mean_gap_that_hardly_changes_is_no_scatter(aged: Reconciliation) -> None:
    """Values calibrated at each temperature take up most of a law: what it does to averages was called scatter."""
    gap = replace(aged.gap, before=1.18, after=1.28, log_score={"before": -50.0, "after": -49.0})
    for acts_on, said in (("mean", "hardly shows it, 1.18 and 1.28"), ("scatter", "moves no average")):
        found = FoundEffect("a", "A", 0.97, "named", acts_on=acts_on)
        assert said in gap_in_words(replace(aged, verdict="named", effects=[found], gap=gap))[1]
