"""Nothing missing: none. Faulty rows are reported, real logs not over-claimed, and a result can be applied."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from hil.analysis.published.table import read_published_table
from hil.campaign import Campaign, Collects, Conditions, FloatArray
from hil.campaign.reader import read_campaign
from hil.errors import InputError
from hil.model import load_model
from hil.reconcile import Reconciliation, reconcile, write_result
from hil.reconcile.fleet import Screen, SharedFinding
from hil.reconcile.scattering import what_scatters
from tests.hil.reconcile.hidden_effects import TRIAD, base_rates, both, campaign_of, hidden_campaign, lay_out, noise
from tests.hil.solve.runs_of_a_unit import campaign as ordinary

FEW = {"temperatures": (-25.0, 0.0, 25.0, 50.0), "runs_each": 2}


def with_rates(campaign: Campaign, rates: np.ndarray) -> Campaign:
    """Return the campaign with other rates."""
    collects = campaign.sensors[2]
    return replace(campaign, sensors={2: Collects(collects.conditions, rates, collects.rates_se_deg_per_hr)})


def null_campaign(kind: str, seed: int) -> Campaign:
    """Pure noise of one kind about a base that the model has."""
    rng = np.random.default_rng(seed)
    rows = lay_out(rng)
    if kind == "white":
        e = noise(rows, rng, run_bias=0.0)
    elif kind == "heavy tails":
        e = noise(rows, rng, sigma=0.0) + 0.9 / np.sqrt(2.0) * rng.standard_t(4, (len(rows), 2))
    elif kind == "random walk":
        e = noise(rows, rng, run_bias=0.0) + np.cumsum(0.8 * rng.normal(size=(rows.run.max() + 1, 2)), 0)[rows.run]
    elif kind == "MU from run to run":
        e = noise(rows, rng) + (2.0 * rng.normal(size=(rows.run.max() + 1, 2)))[rows.run] * rows.f[:, 2:3]
    elif kind.startswith("cold"):
        e = noise(rows, rng) * np.where(rows.temperature < 0.0, 3.0, 1.0)[:, None]
    else:
        e = noise(rows, rng)
    return campaign_of(rows, base_rates(rows) + e, stated=None if kind.endswith("unstated") else 0.9)


def on_the_mean(result: Reconciliation) -> list[str]:
    """Names of what moves averages: that a scatter is found which the noise really has is no false alarm."""
    return [effect.id for effect in result.effects if effect.acts_on == "mean" and effect.kind == "named"]


KINDS = ("runs correlated", "heavy tails", "random walk", "MU from run to run", "cold", "cold, unstated")


@pytest.mark.slow
def test_where_nothing_is_added_no_gap_shrinks() -> None:
    """A supply effect too small to be found: folds that would add it do not make the model better that stands."""
    few = hidden_campaign(0, lambda rows: both(rows.supply - 28.0, 1.5, -1.5), thermal=False, **FEW)
    result = reconcile(few, "matrix-6", alpha=0.01)
    assert result.verdict == "none"
    assert result.gap.after == result.gap.before


@pytest.mark.slow
@pytest.mark.parametrize("kind", ["white", *KINDS])
def test_nothing_missing_is_called_none_or_at_least_nothing_that_moves_averages(kind: str) -> None:
    """One campaign of each kind of noise at a level of 1 %; `benchmarks.blind.score --only nulls` asks hundreds.

    A random walk, MU that differs from run to run and noise that rises in the cold are effects on the scatter: they may
    be found, and MU and the cold must be, where standard errors say what noise is. No average moves.
    """
    result = reconcile(null_campaign(kind, 0), "matrix-6-thermal", alpha=0.01, prove=False)
    assert on_the_mean(result) == []
    if kind in SCATTERS:
        assert SCATTERS[kind] in {effect.id for effect in result.effects}
        named = [effect for effect in result.effects if (effect.id, effect.kind) == UNLIKE]
        assert bool(named) == (kind == "MU from run to run")
        assert all(0.0 <= rival.overlap < 0.95 for effect in named for rival in effect.confusable_with)
    else:
        assert (result.verdict, result.disagreements) == ("none", [])


SCATTERS = {"MU from run to run": "MU_rr", "cold": "hash"}
"""Noise that has a name: an effect on the scatter."""
UNLIKE = ("MU_rr", "named")  # which no other effect resembles


@pytest.mark.slow
def test_a_walk_is_found_and_not_told_from_a_bias_that_wanders_for_longer_than_the_night() -> None:
    """What is the same to these collects is listed as the same, and the name withheld."""
    rng = np.random.default_rng(3)
    rows = lay_out(rng, (23.0,), runs_each=16)
    walk = np.cumsum(3.0 * rng.normal(size=(rows.run.max() + 1, 2)), 0)[rows.run]
    rates = base_rates(rows) + noise(rows, rng, run_bias=0.0) + walk
    result = reconcile(campaign_of(rows, rates), "matrix-6", prove=False)
    (found,) = result.effects
    same = {rival.id for rival in found.confusable_with if rival.overlap > 0.95}
    assert {found.id, *same} == {"rrw", "markov"}
    assert found.kind == "ambiguous"


@pytest.mark.slow
@pytest.mark.parametrize(("runs", "scatter"), [(2, 2.0), (3, 4.0)])
def test_two_runs_that_differ_by_an_ordinary_offset_lack_nothing(runs: int, scatter: float) -> None:
    """Nobody can tell how much such a unit differs from run to run; that it may is known before."""
    results = [reconcile(ordinary(runs, runs, seed, scatter=scatter), "matrix-6", prove=False) for seed in range(6)]
    assert [each.verdict for each in results].count("none") >= 5


@pytest.mark.slow
def test_eight_runs_are_enough_to_be_cautious() -> None:
    """Eight runs at one temperature, three collects, nothing missing: none, and only noise is added to the model."""
    campaign = hidden_campaign(3, thermal=False, temperatures=(23.0,), runs_each=8, positions=("1", "2", "3"))
    result = reconcile(campaign, "matrix-6")
    assert result.verdict == "none"
    assert result.model_after.model_copy(update={"noise": {}, "version": 1}) == result.input_model
    assert result.effects == []
    assert result.next_experiment is None


@pytest.mark.slow
def test_a_lost_third_of_the_collects_neither_hides_nor_invents() -> None:
    """30 % of the rates missing: the supply effect is still named, and without it there is none."""
    for hidden, expected in ((None, "none"), (lambda r: both(r.supply - 28.0, 12.0, -11.0), "named")):
        campaign = hidden_campaign(11, hidden)
        rates = campaign.sensors[2].rates_deg_per_hr.copy()
        rates[np.random.default_rng(1).random(rates.shape) < 0.3] = np.nan
        result = reconcile(with_rates(campaign, rates), "matrix-6-thermal", prove=False)
        assert result.verdict == expected


@pytest.mark.slow
def test_a_glitch_is_an_outlier_and_not_an_effect() -> None:
    """One rate off by 40 deg/hr: left out and reported with its row; the verdict stays none."""
    campaign = hidden_campaign(5)
    rates = campaign.sensors[2].rates_deg_per_hr.copy()
    rates[17, 1] += 40.0
    result = reconcile(with_rates(campaign, rates), "matrix-6-thermal", prove=False)
    assert result.verdict == "none"
    assert [(o["collect"], o["channel"]) for o in result.outliers] == [(18, "RB")]
    assert result.outliers[0]["size_deg_per_hr"] == pytest.approx(40.0, abs=6.0)


@pytest.mark.slow
def test_a_wrong_stated_error_does_not_make_a_finding() -> None:
    """Standard errors in the file a fifth of the truth: still none."""
    rng = np.random.default_rng(8)
    rows = lay_out(rng)
    campaign = campaign_of(rows, base_rates(rows) + noise(rows, rng), stated=0.18)
    assert reconcile(campaign, "matrix-6-thermal", prove=False).verdict == "none"


@pytest.mark.slow
def test_applying_the_improved_model_finds_nothing_more(tmp_path: Path) -> None:
    """model.yaml holds the named term with value, error and origin; as the model it leaves nothing to find."""
    campaign = hidden_campaign(7, lambda r: both(r.f[:, 2], -20.0, -14.0), thermal=False, mu=False, **FEW)
    first = reconcile(campaign, "collins-4")
    write_result(first, tmp_path)
    document = json.loads((tmp_path / "reconciliation.json").read_text())
    assert document["schema"] == "hil.reconciliation/1"
    assert document["verdict"] == "named"
    assert document["gap"]["after"] < document["gap"]["before"]
    page = (tmp_path / "reconciliation.html").read_text()
    assert "MU_real" in page
    assert "SIMULATED" in page
    assert "<script" not in page
    improved = load_model(tmp_path / "model.yaml")
    assert [term.effect for term in improved.terms] == ["MU_real"]
    assert improved.terms[0].added["gap_after_deg_per_hr"] < improved.terms[0].added["gap_before_deg_per_hr"]
    predicted = improved.rates(campaign.sensors[2].conditions)
    assert np.sqrt(np.mean((predicted - campaign.sensors[2].rates_deg_per_hr) ** 2)) < 2.5
    again = reconcile(campaign, improved)
    assert again.verdict == "none"
    assert again.as_it_stands is not None
    assert again.as_it_stands["rms_deg_per_hr"] < 2.5


@pytest.mark.slow
def test_a_triad_with_g_sensitivity_is_named_and_one_without_is_not() -> None:
    """24 hand-placed poses of a MEMS triad, one run: a G that is not symmetric, against a constant bias."""
    for size, expected in ((60.0, "named"), (0.0, "none")):
        rng = np.random.default_rng(2)
        f = rng.normal(size=(24, 3))
        f /= np.linalg.norm(f, axis=1, keepdims=True)
        g = size * np.array([[1.0, 0.4, -0.6], [-0.3, 0.8, 0.2], [0.5, -0.7, 0.9]])
        rates = np.array([1300.0, -2100.0, -1200.0]) + f @ g.T + 20.0 * rng.normal(size=(24, 3))
        poses = np.array([f"pose-{k:02d}" for k in range(1, 25)])
        known = Conditions(
            TRIAD,
            np.arange(1, 25),
            np.ones(24, dtype=np.int64),
            poses,
            10.0 * np.arange(24),
            np.full(24, 2.0),
            f,
            np.zeros((24, 3)),
        )
        campaign = Campaign("triad", "test", {1: Collects(known, rates, np.full((24, 3), 20.0))})
        result = reconcile(campaign, "constant")
        assert result.verdict == expected
        assert [effect.id for effect in result.effects] == (["g_sensitivity"] if size else [])


REAL = ("mpu9150-unit0", "mpu9150-unit1", "mpu9150-unit2", "mpu-24-poses")


@pytest.mark.parametrize(
    ("unit", "model"),
    [
        pytest.param(unit, model, marks=() if (unit, model) == (REAL[0], "constant") else pytest.mark.slow)
        for unit in REAL
        for model in ("constant", "triad-12")
    ],
)
def test_real_triads_are_not_over_claimed(reference_data: Path, unit: str, model: str) -> None:
    """Weak or no acceleration sensitivity in real logs: no confident name, but of the earth that turns under them."""
    result = reconcile(read_campaign(reference_data / "campaigns" / unit), model, prove=False)
    assert result.verdict in {"none", "ambiguous"}
    assert all(effect.probability < 0.8 for effect in result.effects if effect.id != "earth")


def fleet(count: int, size: float, every: int, *, seed: int = 0) -> list[Campaign]:
    """Units that were measured in the same way, a supply effect in each `every`-th of them."""
    rows = lay_out(np.random.default_rng(0))
    effect = both(rows.supply - 28.0, size, -size)
    noises = [noise(rows, np.random.default_rng(seed + i)) for i in range(count)]
    return [campaign_of(rows, base_rates(rows) + n + (i % every == 0) * effect) for i, n in enumerate(noises)]


@pytest.mark.slow
def test_a_screen_finds_the_units_with_the_fault_and_no_others() -> None:
    """Sixty units, six with a supply effect: most of those six, by name; a bound misses some."""
    units = fleet(60, 14.0, 10)
    findings = Screen.of(units, "matrix-6-thermal").units(units)
    found = {i for i, f in enumerate(findings) if f.q_value < 0.05}
    assert found <= set(range(0, 60, 10))
    assert len(found) >= 4
    assert {findings[i].leader for i in range(0, 60, 10)} == {"supply"}


@pytest.mark.slow
def test_units_without_a_fault_are_left_alone_one_by_one_and_together() -> None:
    """A fleet with nothing missing: no more small p-values than stated (Ville's bound is a bound), none discovered."""
    units = fleet(80, 0.0, 1, seed=900)
    screen = Screen.of(units, "matrix-6-thermal")
    weighed = screen.weigh([screen.rates(each) for each in units])
    findings = screen.asked.findings(weighed)
    p_values = np.array([finding.p_value for finding in findings])
    assert np.mean(p_values < 0.2) < 0.26
    assert np.mean(p_values < 0.05) < 0.09
    assert min(finding.q_value for finding in findings) > 0.05
    assert together(screen, weighed).p_value > 0.05


def together(screen: Screen, weighed: FloatArray) -> SharedFinding:
    """What u units share, by what is weighed of each, (n, u)."""
    return screen.asked.in_common(screen.asked.mixed(weighed)[None], weighed.shape[1])


@pytest.mark.slow
def test_one_odd_unit_is_no_fault_of_a_fleet() -> None:
    """It is called by itself; of two it may be."""
    units = fleet(12, 0.0, 1)
    screen = Screen.of(units, "matrix-6-thermal")
    weighed = screen.weigh([screen.rates(each) for each in (*units[:11], *fleet(2, 40.0, 1, seed=100))])
    one, two = weighed[:, :12], np.delete(weighed, 10, axis=1)
    assert [each.q_value < 0.05 for each in screen.asked.findings(two)] == [False] * 10 + [True] * 2
    assert together(screen, one).p_value > 0.05
    assert together(screen, two).p_value < 0.001


@pytest.mark.slow
def test_what_no_unit_shows_alone_the_fleet_shows_together() -> None:
    """A supply effect in all of forty units, too small to be found in most of them: shared, by name."""
    units = fleet(40, 5.0, 1)
    screen = Screen.of(units, "matrix-6-thermal")
    weighed = screen.weigh([screen.rates(each) for each in units])
    assert sum(finding.q_value < 0.05 for finding in screen.asked.findings(weighed)) < 10
    shared = together(screen, weighed)
    assert shared.name == "supply"
    assert shared.p_value < 0.001


@pytest.mark.slow
def test_a_screen_refuses_another_layout() -> None:
    """Fewer temperatures, or as many collects in another order: the columns would be the wrong ones."""
    units = fleet(2, 0.0, 1)
    screen = Screen.of(units[0], "matrix-6-thermal")
    for other in (hidden_campaign(1, temperatures=(20.0,)), hidden_campaign(1, positions=("2", "1", "3", "4"))):
        with pytest.raises(InputError, match="laid out otherwise"):
            screen.units([other])
    with pytest.raises(InputError, match="at least one unit"):
        Screen.of([], "matrix-6-thermal")


def test_a_level_outside_its_range_is_refused() -> None:
    """A false-alarm rate of zero or above one half is no rate."""
    with pytest.raises(InputError, match="false-alarm rate"):
        reconcile(hidden_campaign(1, **FEW), "matrix-6", alpha=0.0)


@pytest.mark.slow
def test_what_is_not_surely_wrong_is_left_out_of_nothing() -> None:
    """Of Table 1, one row for each temperature, a row or a run in the place of what no effect describes is no cause."""
    assert what_scatters(read_published_table(Path("rd-gc-86-1-table-1"))).answer.rows == []
