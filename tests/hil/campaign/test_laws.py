"""Every record of a collect is held against the others: what contradicts them fails its run, with its row."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from benchmarks.blind.cases import make_case, write_case
from benchmarks.blind.night import Design
from benchmarks.blind.physics import CATALOGUE
from hil.campaign import Campaign, Collects, Conditions, FloatArray, Sensor
from hil.campaign.laws import digit
from hil.campaign.plausibility import clipped, judged_by_its_records, unclipped
from hil.campaign.reader import read_campaign
from hil.campaign.writer import write_campaign
from procedures.verdict import Verdict
from tests.hil.audit.folders import FOLDERS
from tests.hil.solve.runs_of_a_unit import with_rates

RUN = np.repeat([1, 2, 3], 3)
AIR = np.repeat([20.0, 20.0, 60.0], 3)
START_S = 3600.0 * RUN + 120.0 * np.tile([0, 1, 2], 3)


def campaign(**changes: FloatArray) -> Campaign:
    """Return two sensors of one unit in three runs of three collects, with every record; `changes` are of sensor 2."""
    f_g = np.tile([[-1.0, 0.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, 1.0]], (3, 1))
    columns = {
        "n_samples": np.full(9, 1200.0),
        "temperature_degC": AIR + 5.0 + np.tile([0.0, 0.1, 0.2], 3),
        "case_degC": AIR + 1.0,
        "chamber_degC": AIR + 0.2,
        "setpoint_degC": AIR,
        "dTdt_degC_per_min": np.full(9, 0.05),
        "time_since_power_on_s": START_S - 600.0,
        "time_since_setpoint_s": np.where(RUN == 3, START_S - 8000.0, START_S - 100.0),
        "time_since_index_s": np.full(9, 60.0),
        "supply_V": np.full(9, 28.0),
        "spin_period_us": np.full(9, 1e4),
    }
    sensors = {}
    for number in (1, 2):
        changed = changes if number == 2 else {}
        conditions = Conditions(
            Sensor(number, ("A", "B", "S"), {"RA": "A", "RB": "B"}),
            2 * np.arange(9) + number,
            RUN,
            np.tile(["1", "2", "3"], 3),
            changed.get("start_s", START_S),
            changed.get("duration_s", np.full(9, 60.0)),
            f_g,
            np.zeros((9, 3)),
            columns | {name: values for name, values in changed.items() if name in columns},
        )
        rates = changed.get("rates", 10.0 * f_g[:, :2] + np.outer(np.arange(9.0), [1.0, 2.0]) + number / 8.0)
        sensors[number] = Collects(conditions, rates, changed.get("errors", np.full((9, 2), 0.7)))
    return Campaign("made", "", sensors)


def shown(name: str) -> FloatArray:
    """Return what sensor 2 shows where nothing is wrong."""
    c = campaign().sensors[2].conditions
    return np.array({"start_s": c.start_s, "duration_s": c.duration_s, **c.columns}[name], dtype=np.float64)


def with_one(name: str, row: int, change: Callable[[float], float]) -> dict[str, FloatArray]:
    """Return the column with one cell changed."""
    values = shown(name)
    values[row] = change(values[row])
    return {name: values}


def test_what_agrees_is_left_alone() -> None:
    """Neither is a time that was written by intention, nor a power cut, nor a column that is not there."""
    for changes in (
        {},
        {"time_since_setpoint_s": np.full(9, 3600.0)},
        {
            "case_degC": AIR - 15.0,
            "dTdt_degC_per_min": np.full(9, 0.5),
            "temperature_degC": AIR + np.tile([-0.5, 0.5, 1.5], 3),
        },
        {"time_since_power_on_s": START_S - 3500.0 * RUN},
    ):
        assert judged_by_its_records(campaign(**changes)).warnings == ()
    bare = campaign()
    for number, rows in bare.sensors.items():
        rows = replace(rows, conditions=replace(rows.conditions, columns={}))
        assert judged_by_its_records(replace(bare, sensors={number: rows})).warnings == ()


@pytest.mark.parametrize(
    ("name", "change", "words"),
    [
        ("temperature_degC", lambda _: -10.0, "by the air around the unit"),
        ("temperature_degC", lambda v: v + 11.0, "by the thermometer of sensor 1, in the same unit"),
        ("temperature_degC", lambda v: v - 3.0, "by dTdt_degC_per_min and the collect before it"),
        ("dTdt_degC_per_min", lambda _: 9.0, "by dTdt_degC_per_min and the collect before it"),
        ("case_degC", lambda v: v + 30.0, "by the thermometer of the sensor"),
        ("case_degC", lambda v: v - 6.0, "by the air around the unit"),
        ("chamber_degC", lambda v: v - 11.0, "by its setpoint"),
        ("setpoint_degC", lambda _: 60.0, "by its setpoint"),
        ("duration_s", lambda _: 600.0, "by the collect before it"),
        ("start_s", lambda v: v - 120.0, "by the collect before it"),
        ("n_samples", lambda _: 700.0, "n_samples per second is 11.667, where 16 to 25 belongs"),
        ("supply_V", lambda _: 5.0, "by what is usual in its run"),
        ("spin_period_us", lambda _: 9000.0, "by what is usual in its run"),
        (
            "time_since_power_on_s",
            lambda _: 5.0,
            "time_since_power_on_s is 5, where 6630 to 6810 belongs by the collect",
        ),
        ("time_since_setpoint_s", lambda v: v + 4000.0, "by the collect before it"),
        ("time_since_index_s", lambda _: 4000.0, "time_since_index_s is 4000, where"),
    ],
)
def test_a_record_that_the_others_contradict_fails_its_run(
    name: str, change: Callable[[float], float], words: str
) -> None:
    """One cell of one sensor, in the second collect of run 2."""
    judged = judged_by_its_records(campaign(**with_one(name, 4, change)))
    failed = {key: each.verdict for key, each in judged.contradicted.items()}
    assert failed.pop((2, 2)) is Verdict.FAIL
    assert not failed  # sensor 1 is not accused of what is wrong with its neighbour
    assert words in " ".join(judged.warnings)
    assert all("sensor 2: " in each or "by the thermometer of sensor 2" in each for each in judged.warnings)


@pytest.mark.parametrize("row", range(1, 8))
@pytest.mark.parametrize("off_s", [-2000.0, 2000.0])
def test_of_times_that_contradict_each_other_the_one_is_wrong_that_alone_does(row: int, off_s: float) -> None:
    """Not the next one, which agrees with all others; of two alone nobody can tell which it is."""
    judged = judged_by_its_records(campaign(**with_one("time_since_power_on_s", row, lambda v: v + off_s)))
    assert list(judged.contradicted) == [(int(RUN[row]), 2)]
    assert f"collect {2 * row + 2}: " in judged.contradicted[int(RUN[row]), 2].reason
    two = campaign(**with_one("time_since_power_on_s", 3, lambda v: v - 2000.0)).sensors[2].rows(np.array([3, 6]))
    assert sorted(judged_by_its_records(replace(campaign(), sensors={2: two})).contradicted) == [(2, 2), (3, 2)]


def test_a_whole_run_whose_times_contradict_the_others_fails_and_no_other() -> None:
    """A soak that is written too short in each of its collects; one that was commanded anew is none."""
    values = shown("time_since_power_on_s") - np.where(RUN == 2, 2000.0, 0.0)
    assert list(judged_by_its_records(campaign(time_since_power_on_s=values)).contradicted) == [(2, 2)]


HERE = np.tile([[-2.0, 10.0, -6.0], [-2.0, 10.0, 6.0], [6.0, 10.0, -2.0]], (3, 1))
TURNED = np.where(RUN[:, None] == 2, HERE * [-1.0, -1.0, 1.0], HERE)  # run 2 at another heading


@pytest.mark.parametrize(
    ("w", "row", "factor", "failed"),
    [
        (HERE, 4, [1, 1, 1], []),
        (HERE, 4, [1, -1, 1], [2]),
        (TURNED, 0, [1, 1, 1], []),
        (TURNED, 0, [1, 1, 0], [1]),
        (HERE, 1, [2, 2, 2], [1]),
    ],
)
def test_one_collect_alone_has_no_other_earth_rate(
    w: FloatArray, row: int, factor: list[int], failed: list[int]
) -> None:
    """Than the others at its position; a run at a heading of its own may, but none faster than the Earth turns."""
    made = campaign()
    conditions = made.sensors[2].conditions
    changed = np.where(np.arange(9)[:, None] == row, w * factor, w)
    rows = replace(made.sensors[2], conditions=replace(conditions, w_deg_per_hr=changed))
    judged = judged_by_its_records(replace(made, sensors={2: rows}))
    assert list(judged.contradicted) == [(run, 2) for run in failed]


def test_a_run_without_an_earth_rate_is_contradicted_by_the_others() -> None:
    """0 where it is unknown: in all rows, but not in one run of a site where the others have it."""
    made, up = campaign(), 15.041067 * np.sin(np.deg2rad(34.6))
    w = up * made.sensors[2].conditions.f_g
    for factor, failed in ((1.0, []), (RUN[:, None] != 2, [(2, 2)]), (0.0, [])):
        rows = replace(made.sensors[2], conditions=replace(made.sensors[2].conditions, w_deg_per_hr=w * factor))
        judged = judged_by_its_records(replace(made, sensors={2: rows}, site={"latitude_deg": 34.6}))
        assert list(judged.contradicted) == failed


def test_a_run_is_taken_in_one_go() -> None:
    """The second collects of two runs at one temperature exchanged: another run lies between what is called one."""
    made = campaign()
    run = RUN.copy()
    run[[1, 4]] = run[[4, 1]]
    rows = replace(made.sensors[2], conditions=replace(made.sensors[2].conditions, run=run))
    judged = judged_by_its_records(replace(made, sensors={2: rows}))
    assert sorted(judged.contradicted) == [(1, 2), (2, 2)]
    assert "the number of parts of its run is 3, where at most 1 belongs" in judged.contradicted[1, 2].reason


@pytest.mark.parametrize(("size", "turned"), [(50.0, [6, 7]), (50.0, [0, 1]), (50.0, [0, 1, 2, 3]), (5.0, [])])
def test_a_sign_that_turns_for_good_is_contradicted_by_the_other_runs(size: float, turned: list[int]) -> None:
    """Every run of that temperature agrees with its neighbours; where changes are of noise's size, nothing is said.

    Of four against four nobody can tell which are right.
    """
    made, runs = campaign(), 8
    part = np.tile(np.arange(3), runs)
    one = made.sensors[2].rows(part)
    rates = np.array([-1.0, 1.0, 0.1])[part, None] * [size, 20.0] + np.random.default_rng(4).normal(0.0, 0.7, (24, 2))
    rates[np.isin(np.repeat(np.arange(runs), 3), turned or [6, 7]), 0] *= -1.0
    run, start_s = np.repeat(np.arange(runs), 3), 3600.0 * np.repeat(np.arange(runs), 3) + 120.0 * part
    conditions = replace(one.conditions, run=run, start_s=start_s, collect=np.arange(24), columns={})
    rows = Collects(conditions, rates, one.rates_se_deg_per_hr)
    judged = judged_by_its_records(replace(made, sensors={2: rows}))
    doubted = range(runs) if len(turned) == runs / 2 else turned
    assert list(judged.contradicted) == [(each, 2) for each in doubted]
    assert (
        "RA goes up from position to position where it goes down in the other runs" in str(judged.warnings)
    ) is bool(turned)


def test_f_that_is_not_that_of_its_position_fails() -> None:
    """With no accelerometers to contradict it."""
    made = campaign()
    conditions = made.sensors[2].conditions
    f_g = np.where(np.arange(9)[:, None] == 4, -conditions.f_g, conditions.f_g)
    rows = replace(made.sensors[2], conditions=replace(conditions, f_g=f_g))
    judged = judged_by_its_records(replace(made, sensors={2: rows}))
    assert {key: each.verdict for key, each in judged.contradicted.items()} == {(2, 2): Verdict.FAIL}
    assert "the distance of f, g, from the usual, is 2, where at most 0.1 belongs" in judged.contradicted[2, 2].reason


@pytest.mark.parametrize(("digits", "said"), [(9, True), (1, False)])
def test_rates_that_stand_in_two_places_were_copied(digits: int, said: bool) -> None:
    """One collect's in another, unless they are rounded so far that two may agree; one channel's in another, always."""
    rates = np.round(np.random.default_rng(2).normal(0.0, 5.0, (9, 2)), digits)
    rates[7] = rates[1]
    judged = judged_by_its_records(campaign(rates=rates))
    assert judged.warnings == (
        ("collects 4, 16: sensor 2: show the very same rates: one was copied from another",) if said else ()
    )
    rates[:, 1], rates[7] = rates[:, 0], 1.0
    judged = judged_by_its_records(campaign(rates=rates))
    assert "RA of sensor 2 and RB of sensor 2 show the very same rates" in judged.warnings[0]
    three = FOLDERS["poses"]()  # of three channels that are one it is said once, not of each pair
    (said,) = judged_by_its_records(with_rates(three, three.sensors[1].rates_deg_per_hr[:, [1, 1, 1]], 1)).warnings
    assert "GX of sensor 1, GY of sensor 1 and GZ of sensor 1 show the very same rates" in said
    assert sorted({run for run, _ in judged.contradicted}) == [1, 2, 3]


@pytest.mark.parametrize(("digits", "side", "said"), [(6, -1.0, True), (6, 1.0, True), (-1, 1.0, False)])
def test_averages_that_pile_up_on_the_last_value_are_clipped(digits: int, side: float, said: bool) -> None:
    """Three of nine stand at the limit: their runs fail. Of rates in steps of ten as many agree anywhere."""
    rates = np.outer(np.array([3.1, -7.4, 41.0, 12.9, -8.8, 42.3, 2.2, -6.1, 40.2]), [side, 1.0])
    rates[:, 0] = side * np.minimum(side * rates[:, 0], 40.0) if said else rates[:, 0]
    judged = judged_by_its_records(campaign(rates=np.round(rates, digits)))
    words = [each for each in judged.warnings if "clipped" in each]
    assert bool(words) == said
    assert (unclipped(judged.sensors[2]) is judged.sensors[2]) != said  # what is as it was is not judged again
    if said:
        limit = f"{side * 40.0:g}"
        assert words == [f"collects 6, 12, 18: sensor 2: RA goes no further than {limit} deg/hr: it is clipped"]
        assert {key for key, found in judged.contradicted.items() if found.verdict is Verdict.FAIL} == {
            (1, 2), (2, 2), (3, 2),
        }  # fmt: skip
        left = unclipped(judged.sensors[2]).rates_deg_per_hr
        assert np.isnan(left[[2, 5, 8], 0]).all()
        assert np.isnan(left).sum() == 3


@pytest.mark.parametrize(("digits", "said"), [(4, True), (-1, False)])
def test_a_collect_that_is_exactly_0_in_all_channels_was_not_measured(digits: int, said: bool) -> None:
    """Its run fails, and the zeros are no rates. Written in steps of ten, small rates are 0 together by chance."""
    rates = np.random.default_rng(5).normal(0.0, 20.0, (9, 2)).round(digits)
    rates[4] = 0.0
    judged = judged_by_its_records(campaign(rates=rates))
    words = "sensor 2: every rate is exactly 0: nothing was measured; a missing collect is an empty cell"
    assert [each.partition(": ")[2] for each in judged.warnings if "exactly 0" in each] == [words] * said
    assert [run for run, _ in judged.contradicted] == [2] * said
    assert np.isnan(unclipped(judged.sensors[2]).rates_deg_per_hr).all(axis=1).tolist() == [
        said and k == 4 for k in range(9)
    ]


@pytest.mark.parametrize("scale", [1.0, -1.0])
def test_the_last_digit_of_a_number_is_that_of_its_negative(scale: float) -> None:
    """Whole numbers are written in ones, whatever their sign."""
    assert digit(scale * np.array([0.0, 10.0, 40.0])) == 1.0
    assert digit(scale * np.array([0.25, 7.5])) == 0.01


@pytest.mark.parametrize(("low", "found"), [([-9.0, -9.0, -8.0], [4]), ([-9.0, -9.0, -9.0], [3, 4])])
def test_both_limits_of_a_channel_are_seen(low: list[float], found: list[int]) -> None:
    """However often the other one is reached."""
    rates = np.stack([[9.0, 9.0, 9.0, 9.0, 2.0, 1.0, *low], np.arange(9.0) ** 2], axis=1)
    assert [rows.sum() for _, rows, _ in clipped(campaign(rates=rates).sensors[2])] == found


def test_an_error_that_is_far_too_small_weighs_nothing() -> None:
    """It would carry the whole solution of its run."""
    errors = np.full((9, 2), 0.7)
    errors[4, 1] = 0.01
    judged = judged_by_its_records(campaign(errors=errors))
    assert list(judged.contradicted) == [(2, 2)]
    assert "the standard error of RB is 0.01, where at least 0.07 belongs" in judged.contradicted[2, 2].reason


@pytest.mark.parametrize(
    ("counted", "old", "new", "said"),
    [
        ("20", "", "", ""),
        ("20", ",7320,60,", ",7320,1,", "duration_s is 1, where 28.5 to 89.5 belongs"),
        (
            "20",
            ",14.25,8.25,0.7,",
            ",14.25,8.25,0.0002,",
            "the standard error of RA is 0.0002, where 0.03628 to 8.7072",
        ),
        ("20", ",14.25,8.25,0.7,", ",14.25,8.25,20,", "the standard error of RA is 20, where 0.03628 to 8.7072"),
        ("19", "", "", "n_samples is 1200, where 1139 "),
        ("20", ",14.25,", ",14.250003,", "RA is 14.250003, where 14.24999"),
        ("", ",14.25,", ",14.85,", ""),
        ("", ",14.25,", ",15.25,", "RA is 15.25, where 13."),
    ],
)
def test_an_average_that_its_own_samples_do_not_give_fails(
    tmp_path: Path, counted: str, old: str, new: str, said: str
) -> None:
    """Exactly where the series counts all its samples; else by what rows of unequal weight, or missing ones, can do."""
    write_campaign(campaign(), tmp_path / "campaign")
    series = tmp_path / "campaign" / "series"
    series.mkdir()
    noise = np.random.default_rng(1).normal(0.0, 5.0, (60, 2))
    noise -= noise.mean(axis=0)
    lines = [f"{t},{14.25 + a:.9f},{8.25 + b:.9f},{counted}" for t, (a, b) in enumerate(noise)]
    (series / "0010.csv").write_text("\n".join(["t_s,RA_deg_per_hr,RB_deg_per_hr,n_samples", *lines]))
    table = tmp_path / "campaign" / "collects.csv"
    head, *rows = table.read_text().splitlines()
    table.write_text("\n".join([head, *(row.replace(old, new) if row.startswith("10,") else row for row in rows)]))
    judged = read_campaign(tmp_path / "campaign")
    assert list(judged.contradicted) == ([(2, 2)] if said else [])
    assert ("in series" in " ".join(judged.warnings)) is bool(said)
    assert f"collect 10: sensor 2: {said}" in " ".join(judged.warnings) or not said


DESIGNS: tuple[dict[str, Any], ...] = (
    {"power_cycles": 4},
    {"missing": 0.2, "jitter": 0.3},
    {"restabilisation_s": 0.0},
    {"restabilisation_s": 300.0, "runs_per_temperature": 8},
    {"collect_s": 600.0, "positions": ("1", "2", "3", "4")},
    {"rest_s": 7200.0, "headings_deg": (30.0, 120.0)},
)


@pytest.mark.parametrize("design", DESIGNS, ids=lambda design: " ".join(design))
@pytest.mark.parametrize("seeds", [1, pytest.param(20, marks=pytest.mark.slow)])
def test_no_law_speaks_of_a_sound_night(tmp_path: Path, design: dict[str, Any], seeds: int) -> None:
    """Nights of another simulator, each with another hidden effect: power cuts, missing collects, no soak at all."""
    effects = sorted(CATALOGUE)
    for seed in range(seeds):
        hidden = effects[(seed + len(design) * 7) % len(effects)]
        case = make_case(seed, (hidden,), 1.0, model="matrix-6", design=Design(**design))
        warnings = read_campaign(write_case(case, tmp_path / str(seed))).warnings
        assert [each for each in warnings if "no gyro shows as much" not in each] == []  # some effects have no bound


def test_a_clock_that_stands_still_accuses_no_other_column() -> None:
    """No instant is known by it: of times since an instant it was said that -90 to 75 s belong there."""
    judged = judged_by_its_records(campaign(start_s=np.full(9, START_S[0])))
    told = " ".join(judged.warnings)
    assert "start_s stands still at " in told
    assert "time_since" not in told
