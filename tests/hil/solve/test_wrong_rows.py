"""What is wrong with rows is mended or left out before anything is solved, and says so."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from hil.analysis.thermal.document import thermal_document
from hil.analysis.thermal.fit import fit_thermal
from hil.campaign import Campaign, Collects
from hil.campaign.plausibility import judged_by_its_records
from hil.solve import repeats, solve_campaign
from hil.solve.omissions import in_words, otherwise, what_is_wrong
from hil.solve.whitened import Whitened
from hil.solve.wrong_rows import LEFT_OUT, MENDED, pooled, treated, wrong_rows
from procedures.verdict import Judgement, Verdict
from tests.hil.audit.folders import FOLDERS
from tests.hil.solve.runs_of_a_unit import campaign, with_rates


def made(name: str) -> Campaign:
    """Return one of the small campaigns."""
    return FOLDERS[name]()


def test_exchanged_labels_are_put_right_and_the_run_still_fails() -> None:
    """The rates are those of the sound campaign; the verdict asks for the file to be corrected."""
    wrong = wrong_rows(made("labels exchanged"))[2]
    np.testing.assert_array_equal(wrong.collects.rates_deg_per_hr, made("good").sensors[2].rates_deg_per_hr)
    (row,) = wrong.rows
    assert (row.run, row.collects, row.done) == (5, (13, 14), MENDED)
    solved = {each.run: each for each in solve_campaign(made("labels exchanged"))}
    sound = {each.run: each for each in solve_campaign(made("good"))}
    assert solved[5].parameters == sound[5].parameters
    assert (solved[5].verdict, sound[5].verdict) == (Verdict.FAIL, Verdict.PASS)


@pytest.mark.parametrize(
    ("row", "channel", "words"), [(14, 0, "; or MUB of run 5 is another"), (14, 1, "; or MUA of run 5"), (12, 0, "")]
)
def test_what_is_left_out_may_be_what_shows_of_its_run_nowhere_else(row: int, channel: int, words: str) -> None:
    """Of Collects 1-2-3 the third alone tells MU: a rate that is wrong there and another MU are one and the same."""
    one = made("good")
    rates = one.sensors[2].rates_deg_per_hr.copy()
    rates[row, channel] += 100.0
    (wrong,) = wrong_rows(with_rates(one, rates))[2].rows
    assert (wrong.run, wrong.done) == (5, LEFT_OUT)
    assert words in wrong.why
    assert ("of run 5" in wrong.why) is bool(words)


def test_a_run_that_fails_by_its_records_is_in_no_mean_and_no_search() -> None:
    """Unless no other is left."""
    one = made("good")
    failed = {run: Judgement(Verdict.FAIL, "frames were lost") for run in (3, 4)}
    assert set(one.sensors[2].conditions.run) - set(
        pooled(replace(one, verdicts=failed)).sensors[2].conditions.run
    ) == {3, 4}
    assert "sensor 2: runs 3–4 FAILed" in in_words(what_is_wrong(replace(one, verdicts=failed)))[0]
    every = dict.fromkeys(range(1, 13), failed[3])
    assert len(pooled(replace(one, verdicts=every)).sensors[2]) == len(one.sensors[2])


def test_one_rate_far_off_is_left_out_and_the_other_channel_is_kept() -> None:
    """RB of collect 15: MUA is then not seen in this run, and MUB is what it was."""
    campaign = made("one rate far off")
    (row,) = wrong_rows(campaign)[2].rows
    assert (row.collects, row.channels, row.done) == ((15,), ("RB",), LEFT_OUT)
    rates = treated(campaign).sensors[2].rates_deg_per_hr
    assert np.argwhere(np.isnan(rates)).tolist() == [[14, 1]]
    assert in_words(what_is_wrong(campaign))[0].startswith("left out: sensor 2, run 5: collect 15")
    solved = {each.run: each for each in solve_campaign(campaign)}
    assert solved[5].parameters["MUA"].value is None
    assert solved[5].verdict is Verdict.INCONCLUSIVE


def test_of_a_collect_that_is_far_off_in_one_channel_the_other_must_be_near() -> None:
    """Ten times the usual scatter makes a collect wrong; of one that is wrong, four are enough to distrust a rate."""
    good = made("good")
    rates = good.sensors[2].rates_deg_per_hr.copy()
    rates[14] += [7.0, 300.0]
    (row,) = wrong_rows(with_rates(good, rates))[2].rows
    assert row.channels == ("RA", "RB")


def test_what_a_search_does_otherwise_is_said_by_channel() -> None:
    """In both directions; and nothing where the two agree."""
    one = made("one rate far off")
    quick = what_is_wrong(one)["rows"]
    both = [{**quick[0], "channels": ["RA", "RB"]}]
    assert otherwise(one, quick, one) == []
    assert [each.split(" by ")[0] for each in otherwise(one, both, one)] == [
        "sensor 2, RA: collect 15: used as measured"
    ]
    assert [each.split(" by ")[0] for each in otherwise(one, [], one)] == [
        "sensor 2, RB: collect 15: left out or mended"
    ]


def test_in_a_log_of_many_poses_the_one_that_all_others_contradict_is_left_out() -> None:
    """Collect 17 of 24; the parameters are those of the sound log within its errors, and the run is no PASS."""
    (row,) = wrong_rows(made("poses, one wrong"))[1].rows
    assert (row.collects, row.channels, row.done) == ((17,), ("GX", "GY", "GZ"), LEFT_OUT)
    (mended,), (sound,) = solve_campaign(made("poses, one wrong")), solve_campaign(made("poses"))
    for name, each in mended.parameters.items():
        assert each.value == pytest.approx(sound.parameters[name].value, abs=4.0)
    assert (mended.verdict, sound.verdict) == (Verdict.MARGINAL, Verdict.PASS)
    assert "collect 17" in mended.reason


@pytest.mark.slow
def test_sound_logs_lose_a_row_in_one_of_a_hundred() -> None:
    """Of normal noise, whatever its size, hardly any pose is left out."""
    poses = made("poses")
    rows = poses.sensors[1]
    lost = 0
    for seed in range(50):
        rng = np.random.default_rng(seed)
        rates = rows.rates_deg_per_hr + rng.normal(0.0, 40.0, rows.rates_deg_per_hr.shape)
        lost += bool(wrong_rows(with_rates(poses, rates, 1))[1].rows)
    assert lost <= 1


def test_a_channel_in_another_unit_is_no_pass() -> None:
    """In deg/s all of it is next to nothing: less than what the earth rate alone moves it by; a still unit's is not."""
    good = made("good")
    rates = good.sensors[2].rates_deg_per_hr.copy()
    rates[:, 0] /= 3600.0
    still = judged_by_its_records(with_rates(good, rates))
    (words,) = still.warnings
    assert "RA moves by" in words
    assert words.endswith("is it in deg/hr?")
    assert {str(s.verdict) for s in solve_campaign(still) if s.sensor == 2} == {"FAIL"}
    assert judged_by_its_records(good).contradicted == {}


def test_a_collect_that_hides_behind_the_offsets_of_whole_runs_is_left_out() -> None:
    """Biases that change by 6 deg/hr: one rate off by 20 is no more than that, but not beside the rest of its run."""
    one = campaign(24, 3, seed=3, scatter=6.0)
    off = one.sensors[2].rates_deg_per_hr.copy()
    off[33, 0] += 20.0
    (row,) = wrong_rows(with_rates(one, off))[2].rows
    assert (row.run, row.collects, row.channels, row.done) == (12, (34,), ("RA",), LEFT_OUT)
    assert wrong_rows(one)[2].rows == ()


def test_labels_are_exchanged_where_only_one_of_the_two_stands_out() -> None:
    """The other is off by less than ten times the scatter, and fits where the first one stands."""
    one = campaign(24, 3, seed=3, scatter=9.0)
    rates = one.sensors[2].rates_deg_per_hr.copy()
    rates[[30, 31]] = rates[[31, 30]]
    found = wrong_rows(with_rates(one, rates))[2]
    assert [(row.collects, row.done) for row in found.rows] == [((31, 32), MENDED)]


def test_runs_that_fail_by_their_records_accuse_no_other() -> None:
    """Two of three runs have their labels exchanged: the third is right, and solve and thermal have one mean of it."""
    one = campaign(12, 3, seed=11, scatter=2.0)
    rates = one.sensors[2].rates_deg_per_hr.copy()
    rates[[9, 10]], rates[[12, 13]] = rates[[10, 9]], rates[[13, 12]]
    two = judged_by_its_records(with_rates(one, rates))
    assert {run for run, _ in two.contradicted} == {4, 5}
    found = what_is_wrong(two)
    assert [(row["collects"], row["done"]) for row in found["rows"]] == [([10, 11], MENDED), ([13, 14], MENDED)]
    (solved,) = (m for m in repeats(two, solve_campaign(two))[2].means if m.temperature_degC == 0.0)
    assert solved.runs == (4, 5, 6)
    assert solved.values["GSA"].value == pytest.approx(58.0, abs=1.5)
    values = thermal_document(fit_thermal(two))["sensors"][0]["parameters"]["GSA"]["values"]
    assert solved.values["GSA"].value == pytest.approx(values[1]["value"])


def test_where_every_run_fails_that_is_said() -> None:
    """They are all that there is; and what is dead is no measurement."""
    one = campaign(12, 3, seed=2)
    failed = {run: Judgement(Verdict.FAIL, "frames were lost") for run in range(1, 13)}
    told = what_is_wrong(replace(one, verdicts=failed))
    assert told["runs_not_used"] == {}
    assert told["runs_used_though_failed"] == {"2": list(range(1, 13))}
    assert any(words.startswith("sensor 2: every run FAILed") for words in in_words(told))
    rates = one.sensors[2].rates_deg_per_hr.copy()
    rates[12:15], rates[15:18, 1] = 0.0, -3.2174
    dead = judged_by_its_records(with_rates(one, rates))
    assert {run: of.verdict for (run, _), of in dead.contradicted.items()} == {5: Verdict.FAIL, 6: Verdict.FAIL}
    assert "RA: every rate is exactly 0" in dead.contradicted[5, 2].reason
    assert "RB: every rate is exactly -3.2174: nothing was measured" in dead.contradicted[6, 2].reason
    assert not any("clipped" in words for words in dead.warnings)
    assert what_is_wrong(dead)["runs_not_used"] == {"2": [5, 6]}


def test_among_few_runs_it_is_said_what_would_not_be_seen() -> None:
    """Of three runs one rate at position 3 may be tens of standard errors off, for MU is a run's; of many not."""
    few = campaign(3, 3, seed=77, scatter=0.5)
    size = what_is_wrong(few)["rows_seen_from"]["2"]
    assert f"off by less than {size:.2g} deg/hr may not be seen here" in in_words(what_is_wrong(few))[-1]
    for off, seen in ((0.1 * size, False), (1.5 * size, True)):
        rates = few.sensors[2].rates_deg_per_hr.copy()
        rates[5, 1] += off
        assert bool(what_is_wrong(with_rates(few, rates))["rows"]) is seen
    for others in (campaign(24, 3, seed=77, scatter=0.5), campaign(2, 1, seed=5, scatter=1.0)):
        assert "rows_seen_from" not in what_is_wrong(others)  # of two at two temperatures nothing is seen at all
    errors = few.sensors[2].rates_se_deg_per_hr.copy()
    errors[7] = 300.0
    unsure = replace(few, sensors={2: replace(few.sensors[2], rates_se_deg_per_hr=errors)})
    assert what_is_wrong(unsure)["rows_seen_from"]["2"] < 10.0 * size


def test_a_temperature_of_which_no_run_tells_anything_has_no_mean() -> None:
    """Not one without runs, of which a report could make nothing."""
    one = campaign(12, 3, seed=2)
    rates = one.sensors[2].rates_deg_per_hr.copy()
    rates[9:18] = np.nan
    shown = repeats(lost := with_rates(one, rates), solve_campaign(lost))[2]
    assert [mean.temperature_degC for mean in shown.means] == [-20.0, 20.0, 40.0]
    assert all(mean.runs for mean in shown.means)


@pytest.mark.parametrize(("runs", "per_temperature"), [(2, 2), (2, 1)])
def test_runs_that_nothing_is_held_against_must_not_contradict_each_other(runs: int, per_temperature: int) -> None:
    """Of two that differ in what neither a bias nor MU moves neither is a PASS; sound ones are."""
    made = campaign(runs, per_temperature, scatter=3.0)
    rates = made.sensors[2].rates_deg_per_hr.copy()
    rates[[0, 1]] = rates[[1, 0]]
    wrong = with_rates(made, rates)
    assert {each.verdict for each in solve_campaign(made)} == {Verdict.PASS}
    assert [each.verdict for each in solve_campaign(wrong)][:2] == [Verdict.INCONCLUSIVE] * 2
    (first, *_) = what_is_wrong(wrong)["rows"]
    assert first["done"] == "used"
    assert "runs 1–2 contradict each other" in first["why"]


@pytest.mark.slow
@pytest.mark.parametrize("wrong", [0, 1, 2])
def test_of_three_runs_the_one_that_two_contradict_is_no_pass(wrong: int) -> None:
    """A rate off that no neighbour tells: the two that agree are not accused. Labels may be exchanged in those two."""
    one = campaign(3)
    for change in ("exchanged", "turned", "off"):
        rates = one.sensors[2].rates_deg_per_hr.copy()
        own = rates[3 * wrong : 3 * wrong + 3]
        changed = {
            "exchanged": own[[0, 2, 1]],
            "turned": own * [1.0, -1.0],
            "off": own + 20.0 * np.array([[1, 0], [-1, 0], [0, 0]]),
        }
        rates[3 * wrong : 3 * wrong + 3] = changed[change]
        found = solve_campaign(with_rates(one, rates))
        assert [each.verdict is Verdict.PASS for each in found] == [k != wrong and change == "off" for k in range(3)]
    assert {each.verdict for each in solve_campaign(one)} == {Verdict.PASS}


@pytest.mark.parametrize("level", [7.5, 1e10])
def test_a_channel_that_shows_one_round_value_in_every_run_was_not_measured(level: float) -> None:
    """However few digits it has."""
    one = campaign(6)
    rates = one.sensors[2].rates_deg_per_hr.copy()
    rates[:, 1] = level
    assert not any(each.verdict is Verdict.PASS for each in solve_campaign(with_rates(one, rates)))


@pytest.mark.parametrize("runs", [1, 2, 6])
def test_a_channel_that_stands_still_and_so_has_errors_of_nothing_is_left_out(runs: int) -> None:
    """A night writes standard errors of exactly 0 for a rate that never moves: they state nothing."""
    one = campaign(runs)
    rates, errors = (getattr(one.sensors[2], name).copy() for name in ("rates_deg_per_hr", "rates_se_deg_per_hr"))
    rates[:, 0], errors[:, 0] = 0.0, 0.0
    dead = replace(one, sensors={2: replace(one.sensors[2], rates_deg_per_hr=rates, rates_se_deg_per_hr=errors)})
    assert {(row.channels, row.done) for row in wrong_rows(dead)[2].rows} == {(("RA",), LEFT_OUT)}
    assert not any(each.verdict is Verdict.PASS for each in solve_campaign(dead))


def test_rates_that_no_gyro_shows_are_no_measurement() -> None:
    """A thousand times what the poorest is off by: in another unit, or garbage."""
    one = campaign(12, 3, seed=1, scatter=2.0)
    far = judged_by_its_records(with_rates(one, one.sensors[2].rates_deg_per_hr * 1e8))
    assert {each.verdict for each in solve_campaign(far)} == {Verdict.FAIL}
    assert any("no gyro shows as much" in words for words in far.warnings)
    assert not judged_by_its_records(with_rates(one, one.sensors[2].rates_deg_per_hr * 100.0)).contradicted


@pytest.mark.parametrize("seed", range(5))
def test_standard_errors_that_are_too_small_accuse_no_run(seed: int) -> None:
    """By a tenth of what they are every pair of runs differs by ten times them; that is said of them, not of a run."""
    one = campaign(12, 3, seed=seed, scatter=2.0)
    small = replace(one, sensors={2: replace(one.sensors[2], rates_se_deg_per_hr=np.full((36, 2), 0.07))})
    assert what_is_wrong(small)["rows"] == []
    assert "times too small" in " ".join(repeats(small, solve_campaign(small))[2].sentences())


def test_what_is_the_same_of_many_runs_is_said_once() -> None:
    """With the runs; and the sensor is named once."""
    dead = made("dead channel")
    assert (
        in_words(what_is_wrong(dead))[0]
        == "left out: sensor 2, runs 1–12: RB: every rate is exactly 0: nothing was measured"
    )


def test_the_rates_of_each_of_two_sensors_are_whitened_once(monkeypatch: pytest.MonkeyPatch) -> None:
    """For itself, for the other one, and for what nobody would see: it had been done thrice."""
    one, other = (campaign(24, 3, seed=seed).sensors[2] for seed in (1, 2))
    layout = replace(other.conditions.sensor, number=1)
    first = replace(other, conditions=replace(other.conditions, sensor=layout))
    laid, lay = [], Whitened.__init__

    def counted(self: Whitened, collects: Collects, own_bias: frozenset[int] = frozenset()) -> None:
        laid.append(collects)
        lay(self, collects, own_bias)

    monkeypatch.setattr(Whitened, "__init__", counted)
    assert not any(found.rows for found in wrong_rows(Campaign("made", "", {1: first, 2: one})).values())
    assert len(laid) == 2


def test_a_sensor_that_was_not_there_in_some_runs_is_told() -> None:
    """Its means are of fewer runs than the other's, and nothing else would say so."""
    one = campaign(12, 3, seed=2)
    both = replace(one, sensors={1: one.sensors[2], 2: one.sensors[2].rows(one.sensors[2].conditions.run < 9)})
    told = what_is_wrong(both)
    assert told["runs_without_rows"] == {"2": [9, 10, 11, 12]}
    assert "sensor 2: no row of runs 9–12, which another sensor has" in in_words(told)
    assert "runs_without_rows" not in what_is_wrong(replace(both, not_used={2: [9, 10, 11, 12]})), "left out: it had"
