"""Two collects of one run that carry each other's labels: found, put right, and shown as they were and as they are."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
import pytest

from hil.campaign import Campaign, Collects, Conditions
from hil.model import Model
from hil.model.curve import Polynomial
from hil.reconcile import Reconciliation, reconcile
from hil.reconcile.outcome.page import page
from hil.reconcile.outcome.sentences import summary, what_to_do
from hil.reconcile.rivals import CERTAIN
from hil.reconcile.scattering import what_scatters
from hil.solve.omissions import otherwise
from hil.solve.wrong_rows import MENDED, USED, wrong_rows
from tests.hil.analysis.thermal.nights import rotor_night
from tests.hil.reconcile.hidden_effects import TRIAD, Hidden, both, hidden_campaign
from tests.hil.solve.runs_of_a_unit import campaign
from tests.hil.solve.test_explained import of_two_sensors


def exchanged(campaign: Campaign, *pairs: tuple[int, int]) -> Campaign:
    """Return the campaign with the rates of pairs of collects, by their numbers from 1, in each other's place."""
    (number, collects), *_ = campaign.sensors.items()
    rates = collects.rates_deg_per_hr.copy()
    for pair in pairs:
        rows = [collect - 1 for collect in pair]
        rates[rows] = rates[rows[::-1]]
    return replace(campaign, sensors={number: replace(collects, rates_deg_per_hr=rates)})


def found(campaign: Campaign, model: Model | str = "matrix-6-thermal", **how: object) -> Reconciliation:
    """Reconcile, by default with the model that has everything."""
    return reconcile(campaign, model, **how)  # type: ignore[arg-type]


def swaps(result: Reconciliation) -> list[float]:
    """Runs in which labels were exchanged."""
    return sorted(effect.shape["run"] for effect in result.effects if effect.id == "swap")


ALIKE = 0.1
"""The run with the exchange predicts little of the others, and the others it, at the noise as it is estimated."""
# Of statistics over seeds the first is quick.
SEEDS = [0, pytest.param(1, marks=pytest.mark.slow)]


@pytest.fixture(scope="module")
def right_labels() -> Reconciliation:
    """The night in which labels are exchanged below, as it is without that."""
    return found(hidden_campaign(4))


@pytest.fixture(scope="module")
def swap_alone() -> Reconciliation:
    """A night in which nothing is missing, collects 21 and 22 (run 6, positions 1 and 2) in each other's place."""
    return found(exchanged(hidden_campaign(4), (21, 22)))


@pytest.fixture(scope="module")
def swap_beside_supply() -> Reconciliation:
    """The same labels exchanged, and a supply effect in the unit."""
    supply: Hidden = lambda rows: both(rows.supply - 28.0, 16.0, -15.0)  # noqa: E731
    return found(exchanged(hidden_campaign(7, supply), (21, 22)))


@pytest.mark.slow
def test_the_gap_before_is_that_of_the_labels_in_the_file(swap_alone: Reconciliation) -> None:
    """Raw and standardised: much before, noise after."""
    gap = swap_alone.gap
    assert gap.before > 3.0 * gap.after
    assert gap.after == pytest.approx(gap.noise_floor, rel=0.3)
    assert gap.standardised_before > 5.0 * gap.standardised_after
    assert gap.improved_p_value < 1e-3


@pytest.mark.slow
def test_the_gap_after_is_that_of_a_file_with_the_right_labels(
    swap_alone: Reconciliation, right_labels: Reconciliation
) -> None:
    """What is left once the labels are put right is what a campaign without the mistake leaves."""
    clean = right_labels.gap
    assert swap_alone.gap.after == pytest.approx(clean.after, rel=ALIKE)
    assert swap_alone.gap.standardised_after == pytest.approx(clean.standardised_after, rel=ALIKE)


@pytest.mark.slow
def test_noise_alone_does_not_exchange_labels(swap_alone: Reconciliation) -> None:
    """The chance of the exchange counts: the search over the mended rates found nothing, nor a rate that is wrong."""
    assert swap_alone.verdict == "named"
    assert [effect.id for effect in swap_alone.effects] == ["swap"]
    assert swaps(swap_alone) == [6.0]
    assert swap_alone.outliers == []
    assert 0.0 < swap_alone.p_value < 1e-3
    assert all(place.q_value < 1e-3 for place in swap_alone.disagreements)


@pytest.mark.slow
def test_the_picture_shows_the_two_collects_before_and_nothing_after(swap_alone: Reconciliation) -> None:
    """The largest residuals before are those of run 6 at positions 1 and 2; after, no row stands out."""
    rows = swap_alone.picture["rows"]
    largest = sorted(rows, key=lambda row: -abs(row["held_before"]))[:4]
    assert {(row["run"], row["position"]) for row in largest[:2]} == {(6, "1"), (6, "2")}
    assert min(abs(row["held_before"] / row["noise_after"]) for row in largest[:2]) > 8.0
    assert max(abs(row["held_after"] / row["noise_after"]) for row in rows) < 4.5


@pytest.mark.slow
def test_the_labels_are_to_be_corrected_and_the_model_stays(swap_alone: Reconciliation) -> None:
    """One sentence says which collects of the file; model.yaml is the model that went in, but for its noise."""
    (note,) = [note for note in swap_alone.notes if "collects.csv" in note]
    assert "run 6: collects 21–22, at positions 1 and 2, look exchanged" in note
    assert swap_alone.model_after.model_copy(update={"noise": {}, "version": 1}) == swap_alone.input_model


@pytest.mark.slow
def test_what_confirms_exchanged_labels_is_no_collect(swap_alone: Reconciliation) -> None:
    """Look at the log of that run, where no accelerometer tells: the result says so, and so does the page."""
    experiment = swap_alone.next_experiment
    assert experiment is not None
    assert ": look at the log of run 6; no further collect" in experiment["why"]
    (row,) = swap_alone.rows
    assert "(exchange their rates, or their position, f and w: no accelerometer tells which)" in row["why"]
    assert (experiment["collects"], experiment["power"], experiment["impossible"]) == ([], None, False)
    text = page(swap_alone)
    assert experiment["why"] in text
    assert f"C{experiment['why'][1:]}." in summary(swap_alone)
    assert "With the record put right the gap" in text
    assert "Nothing is missing from the model" in text
    assert "is missing from matrix-6-thermal" not in text


@pytest.mark.slow
def test_an_effect_beside_the_exchange_is_judged_by_what_it_mends_itself(swap_beside_supply: Reconciliation) -> None:
    """The gap of the result counts the labels too; that of the term in the model is its own."""
    result = swap_beside_supply
    assert sorted(effect.id for effect in result.effects) == ["supply", "swap"]
    assert result.gap.after < 0.7 * result.gap.before
    own = result.model_after.terms[0].added
    assert own["gap_after_deg_per_hr"] < own["gap_before_deg_per_hr"] < 0.8 * result.gap.before
    assert own["gap_after_deg_per_hr"] == pytest.approx(result.gap.after, abs=1e-3)
    assert "With the record put right and what was found in the model the gap" in page(result)


@pytest.mark.slow
@pytest.mark.parametrize(("seed", "pair"), [(0, (1, 2)), (3, (1, 3))])
def test_the_sound_one_of_three_runs_is_not_accused_for_the_others_exchanges(seed: int, pair: tuple[int, int]) -> None:
    """With values at each temperature one exchange explains three runs as well as two, but no gyro changes so with it.

    The model that comes of it finds the same and nothing else.
    """
    campaign = hidden_campaign(seed, temperatures=(-10.0, 23.0, 50.0), runs_each=3, positions=("1", "2", "3"))
    runs = sorted(np.random.default_rng(seed).choice([4, 5, 6], 2, replace=False).tolist())
    both = exchanged(campaign, *((3 * run - 3 + pair[0], 3 * run - 3 + pair[1]) for run in runs))
    result = found(both, prove=False)
    assert swaps(result) == runs
    assert [row["done"] for row in result.rows] == [MENDED, MENDED]
    again = found(both, result.model_after, prove=False)
    assert sorted(effect.id for effect in again.effects) == ["swap", "swap"]
    assert again.rows == result.rows


@pytest.mark.parametrize(
    ("seed", "searched"), [(0, False), *(pytest.param(seed, True, marks=pytest.mark.slow) for seed in (0, 3))]
)
def test_other_temperatures_tell_which_of_three_runs_are_wrong(seed: int, *, searched: bool) -> None:
    """In what MU scatters by two exchanges hide, but whoever exchanged labels once did so again."""
    campaign = hidden_campaign(seed, temperatures=(-10.0, 23.0, 50.0), runs_each=3, positions=("1", "2", "3"))
    wrong = exchanged(campaign, (13, 15), (16, 18))
    mended = [(5, MENDED), (6, MENDED)]
    assert sorted((row.run, row.done) for row in wrong_rows(wrong)[2].rows) == mended
    assert not searched or [(row["run"], row["done"]) for row in found(wrong, prove=False).rows] == mended


@pytest.mark.parametrize(
    ("pairs", "searched"),
    [(((4, 5),), False), (((1, 2), (7, 8)), False), pytest.param(((1, 2), (7, 8)), True, marks=pytest.mark.slow)],
)
def test_of_three_runs_at_one_temperature_either_one_or_the_other_two_are_exchanged(
    pairs: tuple[tuple[int, int], ...], *, searched: bool
) -> None:
    """Nothing else tells: both commands name both, in the same words, and neither moves anything."""
    campaign = hidden_campaign(5, temperatures=(23.4,), runs_each=3, positions=("1", "2", "3"))
    wrong = exchanged(campaign, *pairs)
    (why, *_), done = zip(*((row.why, row.done) for row in wrong_rows(wrong)[2].rows), strict=True)
    assert done == (USED,) * 3
    told = [why]
    if searched:
        result = found(wrong, "matrix-6", prove=False)
        (row,) = result.rows
        assert row["done"] == USED
        assert result.left.not_passed == {"INCONCLUSIVE": [1, 2, 3]}
        assert "hil solve does not pass (hil report says why): runs 1–3 (INCONCLUSIVE)" in what_to_do(result)[1]
        told.append(row["why"])
    one, two, three = (f"collects {of}, at positions 1 and 2, look exchanged" for of in ("4–5", "1–2", "7–8"))
    for said in told:
        assert f"{one}, or both {two}, and {three}; these rates" in said.replace("; or", ", or")


@pytest.mark.slow
def test_exchanges_in_two_runs_are_both_found(right_labels: Reconciliation) -> None:
    """Positions 1 and 2 in run 6, 3 and 4 in run 11: both, by run, and both notes."""
    result = found(exchanged(hidden_campaign(4), (21, 22), (43, 44)))
    assert swaps(result) == [6.0, 11.0]
    assert len([note for note in result.notes if "collects.csv" in note]) == 2
    assert result.next_experiment is not None
    assert "runs 6, 11" in result.next_experiment["why"]
    assert result.gap.after == pytest.approx(right_labels.gap.after, rel=ALIKE)


@pytest.mark.slow
def test_a_position_that_a_run_has_twice_is_not_mistaken_for_its_other_collect() -> None:
    """Position 1 at both ends of every run: the second was exchanged with position 3, and that one is put right."""
    campaign = hidden_campaign(4, positions=("1", "2", "3", "4", "1"))
    result = found(exchanged(campaign, (28, 30)))
    assert swaps(result) == [6.0]
    assert "collects 28, 30, at positions 3 and 1, look exchanged" in " ".join(result.notes)
    assert result.gap.after == pytest.approx(found(campaign).gap.after, rel=ALIKE)


@pytest.mark.slow
def test_a_rate_that_is_missing_in_one_of_the_two_hides_no_exchange() -> None:
    """RB of collect 21 was lost: RA alone shows that the labels are exchanged, and the RB there is goes along."""
    campaign = exchanged(hidden_campaign(4), (21, 22))
    campaign.sensors[2].rates_deg_per_hr[20, 1] = np.nan
    result = found(campaign, prove=False)
    assert swaps(result) == [6.0]
    assert result.outliers == []
    assert max(abs(row["held_after"] / row["noise_after"]) for row in result.picture["rows"]) < 4.5


@pytest.mark.slow
def test_labels_exchanged_in_the_only_run_are_called_that() -> None:
    """Seven collects in four positions say it by themselves; terms that use up all rates do not say it better."""
    one = hidden_campaign(2, temperatures=(25.0,), runs_each=1, positions=tuple("1234321"), thermal=False, quiet=0.5)
    result = found(exchanged(one, (1, 3)), "matrix-6")
    assert swaps(result) == [1.0]
    assert [effect.id for effect in result.effects] == ["swap"]
    assert result.gap.after < 0.1 * result.gap.before


def known_unit() -> Model:
    """The unit that is hidden, with values that follow temperature: deg/hr and deg/hr/g over (T − 20 °C)/40."""
    thermal = {
        "BA": (20.0, -6.0, 2.0),
        "BB": (-5.0, 25.0, -4.0),
        "GSA": (60.0, 9.0),
        "GSB": (-25.0, -4.0, 1.0),
        "MUA": (6.0, 9.0, -5.0),
        "MUB": (-9.0, 5.0, 3.0),
    }
    curves = {
        name: Polynomial(
            unit="deg/hr" if name.startswith("B") else "deg/hr/g",
            polynomial=tuple(value / 40.0**power for power, value in enumerate(values)),
            reference_degC=20.0,
        )
        for name, values in thermal.items()
    }
    return Model(schema="hil.model/1", title="known", form="matrix-6", sensors={2: curves})


@pytest.mark.slow
def test_labels_are_put_right_where_values_follow_temperature() -> None:
    """Each of the two has what the other measured, whatever the base is at that temperature: nothing is left out."""
    curves = {"GSA": lambda at: 58.0 + 0.0 * at, "MUA": lambda at: 0.8 * at, "MUB": lambda at: -0.6 * at}
    night = rotor_night(np.random.default_rng(3), curves, run_to_run={"MUA": 4.0, "MUB": 4.0})
    assert [row["done"] for row in what_scatters(exchanged(night, (1, 3))).answer.rows] == ["mended"]


@pytest.mark.slow
def test_labels_are_put_right_beside_values_that_stand() -> None:
    """A model with values that follow temperature: what it knows of a collect belongs to the label, as does the gap."""
    campaign = hidden_campaign(4)
    result, clean = found(exchanged(campaign, (21, 22)), known_unit()), found(campaign, known_unit())
    assert swaps(result) == [6.0]
    assert result.gap.before > 3.0 * result.gap.after
    assert result.gap.after == pytest.approx(clean.gap.after, rel=ALIKE)
    assert result.as_it_stands is not None
    assert clean.as_it_stands is not None
    assert result.as_it_stands["rms_deg_per_hr"] == pytest.approx(clean.as_it_stands["rms_deg_per_hr"], rel=0.01)
    assert not any("not this unit" in note for note in result.notes)
    rates = campaign.sensors[2].rates_deg_per_hr.copy()
    rates[21, 1] += 300.0
    wild = found(replace(campaign, sensors={2: replace(campaign.sensors[2], rates_deg_per_hr=rates)}), known_unit())
    assert wild.as_it_stands is not None  # what is left out is no value of the unit
    assert wild.as_it_stands["rms_deg_per_hr"] == pytest.approx(clean.as_it_stands["rms_deg_per_hr"], rel=0.05)


@pytest.mark.slow
def test_what_grows_in_proportion_does_so_by_the_same_share_whatever_labels_say() -> None:
    """The share was of a GS that had the exchanged collects in it: too large by 16 % in a night that was mended."""
    curves = {"GSA": lambda at: 58.0 + 0.25 * (at - 20.0), "GSB": lambda at: -23.2 - 0.1 * (at - 20.0)}
    night = rotor_night(np.random.default_rng(3), curves, run_to_run={}, white=0.3)
    shares = [
        next(p for effect in found(one, "matrix-6").effects for p in effect.parameters if p["name"] == "a")["value"]
        for one in (night, exchanged(night, (1, 2)))
    ]
    assert shares[1] == pytest.approx(shares[0], rel=0.02)


def triad(rng: np.random.Generator, runs: int, poses: int, collect: float, run: float) -> Campaign:
    """A triad of constant bias: runs of hand-placed poses, noise of each collect and of each run, deg/hr."""
    number = np.repeat(np.arange(1, runs + 1), poses)
    f = np.tile(rng.normal(size=(poses, 3)), (runs, 1))
    f /= np.linalg.norm(f, axis=1, keepdims=True)
    rates = 300.0 * rng.normal(size=3) + collect * rng.normal(size=(len(f), 3))
    rates += run * rng.normal(size=(runs + 1, 3))[number]
    labels = np.array([f"pose-{k % poses + 1:02d}" for k in range(len(f))])
    start = 140.0 * np.arange(len(f)) + 2700.0 * number
    w = 15.0 * f[:, [1, 2, 0]]
    known = Conditions(TRIAD, np.arange(1, len(f) + 1), number, labels, start, np.full(len(f), 60.0), f, w)
    return Campaign("triad", "test", {1: Collects(known, rates + w, np.full(rates.shape, collect))})


def with_glitches(campaign: Campaign, glitches: Sequence[tuple[int, int, float]]) -> Campaign:
    """Return the campaign with so many deg/hr added to a row and channel."""
    collects = campaign.sensors[1]
    rates = collects.rates_deg_per_hr.copy()
    for row, channel, size in glitches:
        rates[row, channel] += size
    return replace(campaign, sensors={1: replace(collects, rates_deg_per_hr=rates)})


@pytest.mark.slow
@pytest.mark.parametrize("seed", SEEDS)
def test_a_glitch_in_one_channel_of_a_triad_is_no_exchange(seed: int) -> None:
    """80 deg/hr in one rate, noise 6 in a collect and 8 from run to run: an outlier, and nothing else."""
    campaign = triad(np.random.default_rng(seed), 6, 24, 6.0, 8.0)
    result = found(with_glitches(campaign, [(40 + 17 * seed, seed % 3, 80.0)]), "constant")
    assert swaps(result) == []
    assert [o["collect"] for o in result.outliers] == [41 + 17 * seed]


@pytest.mark.slow
@pytest.mark.parametrize("seed", SEEDS)
def test_a_bad_collect_of_a_quiet_triad_is_no_exchange(seed: int) -> None:
    """One collect off by tens of deg/hr in all three channels, noise of half a deg/hr: outliers of that collect."""
    rng = np.random.default_rng(seed)
    campaign = triad(rng, 6, 12, 0.5, 0.2)
    result = found(
        with_glitches(campaign, [(31, c, size) for c, size in enumerate(60.0 * rng.normal(size=3))]), "constant"
    )
    assert swaps(result) == []
    assert {o["collect"] for o in result.outliers} == {32}


@pytest.mark.slow  # a bad collect and a glitch that are none are quick, above
def test_many_glitches_are_no_exchanges(monkeypatch: pytest.MonkeyPatch) -> None:
    """Every thirtieth rate is off by as much as ten times the noise: no labels are blamed, nor where rows are many."""
    monkeypatch.setattr("hil.reconcile.search.mistakes.MANY", 30)
    rng = np.random.default_rng(0)
    clean = triad(rng, 6, 12, 6.0, 8.0)
    glitches = [(int(r), int(rng.integers(3)), 60.0 * rng.normal()) for r in rng.choice(72, 8, replace=False)]
    campaign = with_glitches(clean, glitches)
    assert swaps(found(campaign, "constant", prove=False)) == []


@pytest.mark.slow
def test_of_two_runs_that_contradict_each_other_either_may_carry_wrong_labels() -> None:
    """Both exchanges are said, with what each is worth; nothing is mended, and no law of time is made of it."""
    one = exchanged(campaign(2, 2, seed=1), (4, 6))
    result = found(one, "matrix-6", prove=False)
    (swap,) = result.effects
    assert (result.verdict, swap.kind) == ("ambiguous", "ambiguous")
    assert 0.2 < swap.probability < CERTAIN
    assert all(f"collects {pair}, at positions 1 and 3, look exchanged" in swap.equation for pair in ("1, 3", "4, 6"))
    assert {row["done"] for row in result.rows} == {USED}


def test_what_solve_doubts_and_the_search_does_not_is_said_by_its_collects() -> None:
    """A row that may be wrong by the quick form alone is no secret to the reader of scatter."""
    made = campaign(3, 3, seed=3, scatter=1.0)
    rates = made.sensors[2].rates_deg_per_hr.copy()
    rates[4, 0] += 10.0
    wrong = replace(made, sensors={2: replace(made.sensors[2], rates_deg_per_hr=rates)})
    doubted = [row for row in wrong_rows(wrong)[2].rows if row.done == USED]
    assert [row.run for row in doubted] == [2]
    assert any("hil solve doubts" in words and "collect 5" in words for words in otherwise(wrong, (), wrong))
    assert not any("doubts" in words for words in otherwise(wrong, [row.document() for row in doubted], wrong))
    assert not any("doubts" in words for words in otherwise(wrong, (), made))  # what was found explains it


@pytest.mark.slow  # that hil solve does so is quick, in tests/hil/solve/test_labels_in_common.py
def test_labels_are_put_right_in_a_sensor_that_hardly_feels_it_by_what_the_other_shows() -> None:
    """They are a collect's: whoever exchanged them did so for both, and the search had mended one sensor alone."""
    two, run, collects = of_two_sensors(1, (1, 2), 0.1)
    rows = found(two, "matrix-6").rows
    assert [(row["sensor"], row["run"], row["collects"], row["done"]) for row in rows] == [
        (number, run, [*collects], MENDED) for number in (1, 2)
    ]
