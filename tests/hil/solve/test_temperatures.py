"""Which runs repeat each other: those at one temperature, and none whose temperature nobody knows."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from hil.campaign import Conditions, Sensor
from hil.campaign.stand_ins import OWN, WIDEST_DEGC
from hil.solve.temperatures import (
    NOT_SETTLED,
    nearest,
    runs_by_temperature,
    runs_by_visit,
    same_temperature,
    told_by,
    unsettled,
)

SENSOR = Sensor(2, ("A", "B", "S"), {"RA": "A", "RB": "B"})


def conditions(columns: dict[str, list[float]]) -> Conditions:
    """Two collects in each run, with the given columns."""
    n = 2 * len(next(iter(columns.values()), [0.0, 0.0, 0.0]))
    return Conditions(
        SENSOR,
        collect=np.arange(1, n + 1),
        run=np.repeat(np.arange(1, n // 2 + 1), 2),
        position=np.array(["1", "2"] * (n // 2)),
        start_s=np.arange(n) * 100.0,
        duration_s=np.full(n, 60.0),
        f_g=np.zeros((n, 3)),
        w_deg_per_hr=np.zeros((n, 3)),
        columns={name: np.repeat(np.array(values), 2) for name, values in columns.items()},
    )


def test_the_setpoint_counts_before_the_units_own_temperature() -> None:
    """Runs at one setpoint are repeats although the unit read a little otherwise; groups come coldest first."""
    found = runs_by_temperature(
        conditions({"setpoint_degC": [40.0, -20.0, 40.0], "temperature_degC": [48.0, -11.0, 46.0]})
    )
    assert found == ((-20.0, (2,)), (40.0, (1, 3)))


def test_what_runs_were_made_at_is_gone_through_once() -> None:
    """Solving, repeats and the search ask of the same collects, a life of them, a dozen times."""
    asked = conditions({"temperature_degC": [20.0, 20.1, 40.0]})
    assert runs_by_temperature(asked) is runs_by_temperature(asked)
    assert asked.of_each_run is asked.of_each_run


def test_two_visits_to_a_temperature_are_two_groups() -> None:
    """They may differ by what the unit went through; where every visit has one run, only the temperature repeats."""
    several = conditions({"temperature_degC": [-10.0, -10.0, 20.0, 20.0, -10.0, -10.0]})
    assert [runs for _, runs in runs_by_visit(several)] == [(1, 2), (3, 4), (5, 6)]
    single = conditions({"temperature_degC": [-10.0, 20.0, -10.0]})
    assert runs_by_visit(single) == runs_by_temperature(single)


def test_a_run_of_unknown_temperature_repeats_no_other() -> None:
    """Each stands alone, without a temperature, and nothing is NaN."""
    found = runs_by_temperature(conditions({"temperature_degC": [20.0, np.nan, 20.2, np.nan]}))
    assert [runs for _, runs in found] == [(1, 3), (2,), (4,)]
    assert [at for at, _ in found][1:] == [None, None]


def test_what_stands_in_for_a_thermometer_that_some_runs_lack_tells_them_all() -> None:
    """The unit's in two runs and the case's in the third are not one temperature's column: it is the case's in all."""
    laid = conditions({"temperature_degC": [20.0, np.nan, 40.0], "case_degC": [20.3, 20.5, 40.2]})
    assert told_by(laid) == "case_degC"
    assert runs_by_temperature(laid) == ((pytest.approx(20.4), (1, 2)), (pytest.approx(40.2), (3,)))


@pytest.mark.parametrize(("lag_degC", "tells"), [(11.0, "temperature_degC"), (2.0, "setpoint_degC")])
def test_setpoints_that_the_unit_did_not_follow_tell_no_temperature(lag_degC: float, tells: str) -> None:
    """Up and down with soaks that are too short: at 20 °C the unit was at 9 and at 31, and no run repeats another."""
    set_to = np.array([-25.0, 0.0, 20.0, 40.0, 60.0, 40.0, 20.0, 0.0, -25.0])
    late = lag_degC * np.array([0.0, -1.0, -1.0, -1.0, -1.0, 1.0, 1.0, 1.0, 1.0])
    laid = conditions({"setpoint_degC": set_to.tolist(), "temperature_degC": (set_to + late).tolist()})
    assert told_by(laid) == tells
    repeat = [runs for _, runs in runs_by_temperature(laid) if len(runs) > 1]
    assert ((3, 7) in repeat) is (tells == "setpoint_degC")


def test_without_any_temperature_all_runs_are_repeats() -> None:
    """There is nothing to tell them apart by."""
    assert runs_by_temperature(conditions({})) == ((None, (1, 2, 3)),)


def collects(columns: dict[str, np.ndarray]) -> Conditions:
    """One collect in a row of the given columns, three collects to a run."""
    n = len(next(iter(columns.values())))
    return Conditions(
        SENSOR,
        collect=np.arange(1, n + 1),
        run=np.arange(n) // 3 + 1,
        position=np.array((["1", "2", "3"] * n)[:n]),
        start_s=np.arange(n) * 100.0,
        duration_s=np.full(n, 60.0),
        f_g=np.zeros((n, 3)),
        w_deg_per_hr=np.zeros((n, 3)),
        columns=columns,
    )


SIX = np.repeat(np.arange(6) * 3.0 + 5.0, 9)  # six setpoints, 3 °C apart, three self-calibrations at each


@pytest.mark.parametrize("step", [1.5, 2.0, 3.0, 5.0, 12.0])
@pytest.mark.parametrize("told", [("setpoint_degC", "temperature_degC"), ("temperature_degC",), ("setpoint_degC",)])
def test_close_setpoints_are_told_apart_with_and_without_their_column(told: tuple[str, ...], step: float) -> None:
    """Six setpoints are six temperatures, for collects and for runs, whatever column says so."""
    setpoint = (SIX - 5.0) * step / 3.0
    own = setpoint + 1.0 + np.random.default_rng(0).normal(0.0, 0.1, len(SIX))
    rows = collects({name: {"setpoint_degC": setpoint, "temperature_degC": own}[name] for name in told})
    assert same_temperature(rows).tolist() == np.repeat(np.arange(6), 9).tolist()
    assert [runs for _, runs in runs_by_temperature(rows)] == [(3 * k + 1, 3 * k + 2, 3 * k + 3) for k in range(6)]


def test_scatter_at_a_setpoint_is_not_taken_for_setpoints() -> None:
    """Gaps of a degree and more within a plateau part nothing where plateaus are ten degrees apart."""
    own = np.repeat([0.0, 10.0, 20.0], 6) + np.tile([-1.6, -1.2, -0.1, 0.5, 0.6, 1.6], 3)
    assert same_temperature(collects({"temperature_degC": own})).tolist() == np.repeat([0, 1, 2], 6).tolist()


def test_a_thermometer_that_repeats_itself_to_the_digit_makes_no_setpoint_of_a_degree() -> None:
    """No scatter at all is no evidence that the next degree is a setpoint, where setpoints are ten degrees apart."""
    own = np.array([20.0, 20.0, 21.1, 30.0, 30.0, 31.1])
    assert same_temperature(collects({"temperature_degC": own})).tolist() == [0, 0, 0, 1, 1, 1]


@pytest.mark.parametrize("rows", [60, 24])
def test_a_slow_ramp_is_cut_and_no_part_is_wider_than_one_temperature_may_be(rows: int) -> None:
    """Without any plateau, neighbours are of one temperature, the ends of the ramp are not, and no part is empty."""
    own = np.linspace(-20.0, 20.0, rows)
    number = same_temperature(collects({"temperature_degC": own}))
    assert number[0] == 0
    assert set(np.diff(number).tolist()) == {0, 1}
    assert max(np.ptp(own[number == k]) for k in range(number.max() + 1)) <= WIDEST_DEGC


def test_a_setpoint_that_the_unit_does_not_stay_by_tells_nothing() -> None:
    """A unit that warms by ten degrees at one setpoint is not at one temperature."""
    own = np.concatenate([np.full(6, 20.0), np.full(6, 30.0)])
    assert same_temperature(collects({"setpoint_degC": np.full(12, 25.0), "temperature_degC": own})).max() == 1


def test_a_unit_that_lags_behind_its_setpoints_is_at_its_setpoints() -> None:
    """Where soaks were too short, a first run is as near to the setpoint before: repeats all the same."""
    setpoint = np.repeat([-10.0, 0.0, 10.0, 20.0], 3)
    own = np.array([4.7, -3.2, -7.0, -5.2, -2.6, -1.2, 3.9, 7.0, 8.7, 13.7, 16.9, 18.6])
    number = same_temperature(collects({"setpoint_degC": setpoint, "temperature_degC": own}))
    assert number.tolist() == np.repeat(range(4), 3).tolist()


def test_one_more_run_renames_no_temperature() -> None:
    """Neither one far from setpoints that are near each other, nor one whose soak was cut short: it was elsewhere."""
    near = {"setpoint_degC": [20.0, 20.0, 21.5], "temperature_degC": [28.0, 28.1, 29.6]}
    far = {"setpoint_degC": [*near["setpoint_degC"], 40.0], "temperature_degC": [*near["temperature_degC"], 48.0]}
    assert runs_by_temperature(conditions(far))[:2] == runs_by_temperature(conditions(near))
    short = {"setpoint_degC": [20.0, 20.0, 20.0], "temperature_degC": [28.0, 28.1, 35.0]}
    assert runs_by_temperature(conditions(short)) == ((20.0, (1, 2)), (None, (3,)))
    assert list(unsettled(conditions(short))) == [3]


def test_of_a_soak_that_goes_on_the_last_run_is_nearest_to_its_end() -> None:
    """The middle one of three is not settled because it is in the middle; nor one in which the unit still cools."""
    cut = {"setpoint_degC": [-30.0] * 3, "temperature_degC": [-18.0, -26.4, -28.9]}
    assert list(unsettled(conditions(cut))) == [1, 2]
    cooling = {"dTdt_degC_per_min": [-1.2, -0.9, -0.3]}
    assert list(unsettled(conditions(cut | cooling))) == [1, 2, 3]


def test_two_runs_with_a_wrong_thermometer_do_not_accuse_the_right_one() -> None:
    """What other setpoints show tells which is off; where none does both are said, unless most are where it was set."""
    alone = {"setpoint_degC": [20.0] * 3, "temperature_degC": [40.0, 40.1, 20.0]}
    assert list(unsettled(conditions(alone))) == [1, 2, 3]
    assert unsettled(conditions(alone))[3] == (
        "setpoint 20 °C: the unit's own thermometer shows 20.0 °C in run 3 and 40.0 °C in runs 1–2: it is off, or "
        f"{NOT_SETTLED}"
    )
    most = {"setpoint_degC": [20.0] * 3, "temperature_degC": [20.0, 20.1, 40.0]}
    assert list(unsettled(conditions(most))) == [3]
    others = {"setpoint_degC": [20.0] * 3 + [40.0] * 3, "temperature_degC": [40.0, 40.1, 20.0, 40.0, 40.0, 39.9]}
    assert list(unsettled(conditions(others))) == [1, 2]
    warm = {"setpoint_degC": [20.0] * 3 + [40.0] * 3, "temperature_degC": [23.0, 33.0, 34.9, 55.0, 55.1, 55.2]}
    assert list(unsettled(conditions(warm))) == [1], "by itself it is 15 °C warmer than its air"


def test_a_thermometer_that_is_off_in_the_second_of_two_passes_is_said_of_both() -> None:
    """At each setpoint either may be right; the runs in which it was, the first, had been called unsettled alone."""
    setpoint = np.tile([0.0, 20.0, 40.0], 2)
    own = setpoint + np.repeat([0.1, 20.1], 3)
    found = unsettled(conditions({"setpoint_degC": setpoint.tolist(), "temperature_degC": own.tolist()}))
    assert sorted(found) == [1, 2, 3, 4, 5, 6]
    assert "shows 0.1 °C in run 1 and 20.1 °C in run 4" in found[1]


def test_the_thermometer_tells_how_fast_a_run_goes_on_where_nobody_recorded_it() -> None:
    """At .4 °C/min no run of one had settled at its setpoint. A jitter, or one wrong reading, is no such line."""
    own = np.concatenate([setpoint - 14.0 + 0.4 * np.arange(4) for setpoint in (0.0, 20.0, 40.0)])
    one = replace(collects({"temperature_degC": own}), run=np.repeat([1, 2, 3], 4), start_s=60.0 * np.arange(12.0))
    at = {"setpoint_degC": np.repeat([0.0, 20.0, 40.0], 4)}
    assert list(unsettled(replace(one, columns={**one.columns, **at}))) == [1, 2, 3]
    assert list(unsettled(replace(one, columns={**one.columns, **at, "dTdt_degC_per_min": np.full(12, 0.02)}))) == []
    assert list(unsettled(one)) == [], "nobody meant it to stand"
    slopes = {"dTdt_degC_per_min": np.repeat([0.3, 7.0, 0.02], 4)}  # of two at one setpoint the second stands still
    near = np.concatenate([6.0 + 0.4 * np.arange(4), np.full(8, 7.0)])
    two = replace(one, columns={OWN: near, "setpoint_degC": np.full(12, 20.0), **slopes})
    assert {run: "up to 0.3 °C/min, at 6.6 °C" in said for run, said in unsettled(two).items()} == {1: True}
    for jitter in ([0.0, 0.2, -0.1, 0.2], [0.0, 0.0, 0.0, 3.0]):
        near = np.repeat([-14.0, 6.0, 26.0], 4) + np.tile(jitter, 3)
        assert list(unsettled(replace(one, columns={"temperature_degC": near, **at}))) == []


def test_the_thermometer_tells_of_a_soak_that_goes_on_whether_or_not_a_setpoint_was_recorded() -> None:
    """A run is meant to be at one temperature; runs at several are none of that, nor is a thermometer that stands."""
    own = np.concatenate([np.linspace(-20.0, -14.0, 4), np.full(4, 23.0), np.linspace(44.0, 50.0, 4)])
    without = collects({"temperature_degC": own})
    run = np.repeat([1, 2, 3], 4)
    without = replace(without, run=run)
    recorded = replace(without, columns={**without.columns, "setpoint_degC": np.repeat([-20.0, 23.0, 50.0], 4)})
    assert list(unsettled(without)) == list(unsettled(recorded)) == [1, 3]
    assert (
        unsettled(without)[1]
        == f"the unit's own thermometer went from -20.0 to -14.0 °C through the run: {NOT_SETTLED}"
    )
    partly = np.where(run == 2, np.nan, recorded.columns["setpoint_degC"])
    assert unsettled(replace(without, columns={**without.columns, "setpoint_degC": partly})) == unsettled(without)


def test_the_chamber_tells_where_nothing_else_does() -> None:
    """Its air is what is known."""
    assert same_temperature(collects({"chamber_degC": np.array([10.0, 40.0, 10.1])})).tolist() == [0, 1, 0]


def test_a_stated_distance_parts_at_just_that() -> None:
    """Who asks for temperatures more than 5 °C apart gets the six setpoints as one slow rise, cut in parts of 5."""
    number = same_temperature(collects({"temperature_degC": SIX}), apart_degC=5.0)
    assert number.max() + 1 == 3
    assert same_temperature(collects({"temperature_degC": SIX}), apart_degC=2.9).max() + 1 == 6


def test_another_campaigns_temperature_is_the_nearest_within_two_degrees() -> None:
    """None where no other is that close, or where one's own is not known."""
    assert nearest(20.0, [18.5, 21.0, 40.0]) == 21.0
    assert nearest(20.0, [17.5, 40.0]) is None
    assert nearest(None, [20.0]) is None


def test_of_two_visits_that_differ_it_is_said_which_runs_showed_what() -> None:
    """On the way up and down the unit lags: it went through nothing in its runs, as was said."""
    lagging = conditions({"temperature_degC": [7.6, 30.0, 12.4], "setpoint_degC": [10.0, 30.0, 10.0]})
    words = " ".join(set(unsettled(lagging).values()))
    assert "shows 7.6 °C in run 1 and 12.4 °C in run 3" in words
    assert "went from" not in words
