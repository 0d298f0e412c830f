"""A drift, a jump and neither are told apart; where they cannot be, that is said."""

from __future__ import annotations

from collections import Counter
from typing import Any, cast

import numpy as np
import pytest

from hil.archive.history import _due, _next
from hil.archive.page import sentences
from hil.archive.trend import (
    Fit,
    Trend,
    at_one_temperature,
    control_limits,
    differs,
    predicted,
    trend,
)
from hil.config.limits import Limits, ParameterLimits
from hil.solve.uncertain import Uncertain


def found(count: int, what: str, size: float, scatter: float = 1.0, draws: int = 200) -> Counter[str]:
    """Count what is found in `draws` lives; `scatter` is the true one, 1 what is stated."""
    rng, months = np.random.default_rng(7), 3.0 * np.arange(count)
    shape = {
        "drift": months / months[-1],
        "jump": months >= months[count // 2],
        "back": abs(np.arange(count) - 5.5) < 2,
        "none": 0.0 * months,
    }[what]
    lives = size * shape + rng.normal(0.0, scatter, (draws, count))
    return Counter(trend(months, life, np.ones(count)).word for life in lives)


@pytest.mark.parametrize("scatter", [1.0, 3.0])
@pytest.mark.parametrize(
    "count", [4, 6, pytest.param(5, marks=pytest.mark.slow), pytest.param(12, marks=pytest.mark.slow)]
)
def test_hardly_anything_is_found_where_nothing_is(count: int, scatter: float) -> None:
    """At most three in a hundred, also where calibrations scatter three times as much as stated."""
    of_each = found(count, "none", 0.0, scatter)
    assert of_each["nothing shown"] + of_each["scatters beyond its ±"] >= 194


def test_one_calibration_far_off_is_not_nothing() -> None:
    """No step, for the next is where it was, and no constant: that it scatters is said."""
    off = np.where(np.arange(8) == 3, 20.0, np.random.default_rng(2).normal(size=8))
    assert trend(np.arange(8.0), off, np.ones(8)).word == "scatters beyond its ±"
    assert found(8, "none", 0.0)["scatters beyond its ±"] == 0


@pytest.mark.slow
def test_what_is_there_is_named_and_its_rival_hardly_ever() -> None:
    """Of eight calibrations an eight-fold scatter; a jump is no drift, and a drift no jump."""
    drift, jump = found(12, "drift", 8.0), found(12, "jump", 8.0)
    assert drift["drift"] > 180
    assert jump["jump"] > 170
    assert drift["jump"] + jump["drift"] <= 2
    assert found(12, "back", 8.0)["jump and back"] > 170


def test_intervals_hold_the_truth_as_often_as_they_say() -> None:
    """The slope's 95 % interval, where the stated deviations are a third of the true ones."""
    rng, months = np.random.default_rng(8), 3.0 * np.arange(8)
    lives = 0.5 * months + rng.normal(0.0, 3.0, (600, 8))
    slopes = [Fit(months, life, np.ones(8), line=True).of(1) for life in lives]
    held = np.mean([abs(each.value - 0.5) < each.half_width for each in slopes])
    assert 0.92 < held < 0.985


def test_few_calibrations_tell_nothing() -> None:
    """Of three there is a line and no finding, of two nothing; nor without standard deviations, nor on one day."""
    three = np.arange(3.0)
    assert trend(three, three, np.ones(3)).word == "cannot tell"
    assert trend(three, three, np.ones(3)).per_month is not None
    assert trend(three[:2], three[:2], np.ones(2)).per_month is None
    assert trend(np.arange(9.0), np.arange(9.0), np.full(9, np.nan)).word == "cannot tell"
    of_one_day = trend(np.zeros(9), np.arange(9.0), np.ones(9))
    assert (of_one_day.word, of_one_day.per_month) == ("cannot tell", None)


def test_control_limits_are_passed_by_chance_as_three_sigma_are() -> None:
    """Of eight earlier values and of thirty: the next one of the same unit."""
    rng = np.random.default_rng(9)
    for count in (8, 30):
        lives = rng.normal(0.0, 2.0, (4000, count + 1))
        outside = 0
        for life in lives:
            limits = control_limits(life[:-1], np.full(count, 0.1), 0.1)
            assert limits is not None
            outside += abs(life[-1] - limits.value) > limits.expanded(3.0)
        assert outside / len(lives) < 0.008
    assert control_limits(np.zeros(2), np.ones(2), 1.0) is None


def test_of_three_values_as_near_as_they_say_control_limits_are_no_wider_than_needed() -> None:
    """Nine of their standard deviations, not the twenty-two of two degrees of freedom; chance hardly passes them."""
    rng, sd, outside, wide = np.random.default_rng(9), np.ones(3), 0, []
    for life in rng.normal(0.0, 1.0, (1000, 4)):
        limits = control_limits(life[:-1], sd, 1.0, 20.0)
        assert limits is not None
        wide.append(limits.expanded(3.0))
        outside += abs(life[-1] - limits.value) > wide[-1]
    assert np.median(wide) < 9.0
    assert outside <= 3


def test_a_calibration_that_is_hardly_known_moves_no_control_limit() -> None:
    """One of eight, fifty off and as unsure: the next is judged as by the seven; one that is unsure is not outside."""
    life = np.random.default_rng(10).normal(0.0, 1.0, 8)
    sd, known = np.where(np.arange(8) == 3, 50.0, 1.0), np.arange(8) != 3
    life[3] += 50.0
    poor, seven = control_limits(life, sd, 1.0), control_limits(life[known], sd[known], 1.0)
    unsure, unstated = control_limits(life, sd, 50.0), control_limits(life[known], np.full(7, np.nan), np.nan)
    assert poor is not None
    assert seven is not None
    assert unsure is not None
    assert unstated is not None
    assert (poor.value, poor.sd) == pytest.approx((seven.value, seven.sd), abs=0.1)
    assert unsure.sd > 50.0
    assert unstated.value == pytest.approx(np.mean(life[known]))
    assert 0.3 < unstated.sd < 3.0
    at = {f"unit/{k}": (float(value), float(error)) for k, (value, error) in enumerate(zip(life, sd, strict=True))}
    together = Trend("jump", Fit(np.arange(8.0), life, sd, line=False, step=4), None, poor)
    assert not differs({20.0: at, 40.0: {name: of for name, of in at.items() if name != "unit/3"}}, [*at], together)


def test_a_prediction_widens_with_time() -> None:
    """So the day on which a limit is reached comes earlier than the line alone would say."""
    months = np.arange(6.0)
    fit = Fit(months, 0.5 * months, np.full(6, 0.3), line=True)
    value, wide = predicted(fit, np.array([5.0, 20.0]), months, 2.0)
    assert value == pytest.approx([2.5, 10.0])
    assert wide[1] > 3.0 * wide[0]


@pytest.mark.parametrize(("used", "said"), [(1, False), (2, True), (3, True), (4, False)])
def test_few_calibrations_are_said_to_be_few(used: int, said: bool) -> None:
    """Two are compared by `hil report --against`, which may find what no trend of so few can tell."""
    calibration = {"used": True, "changed_since_the_last": [], "began_utc": "2026-03-01"}
    document = {"parameters": [], "campaigns": [calibration] * used, "next_calibration": {"due": None, "why": ""}}
    assert any("hil report --against" in line for line in sentences(document)) is said


def test_a_jump_that_came_back_is_said_with_both_its_places() -> None:
    """And at one temperature it is none where nothing was measured before it or after it."""
    months, values = np.arange(12.0), 20.0 * (abs(np.arange(12) - 5.5) < 2)
    values[::2] += 0.3
    found = trend(months, values, np.ones(12))
    assert (found.word, found.step, found.back) == ("jump and back", 4, 8)
    assert [at_one_temperature(found, 4.0, 8.0, months[own], values[own], np.ones(12)[own]).step for own in (
        np.s_[:], np.s_[:4], np.s_[2:])] == [4, 0, 2]  # fmt: skip
    jump = {
        "value": 20.0,
        "low": 19.0,
        "high": 21.0,
        "unit": "deg/hr",
        "between": ["a", "b"],
        "back_between": ["c", "d"],
    }
    parameter = {"sensor": 2, "parameter": "BA", "unit": "deg/hr", "jump": jump, "differs_between_temperatures": False}
    document = {"parameters": [parameter], "campaigns": [], "next_calibration": {"due": None, "why": ""}}
    assert "between a and b and back between c and d, alike" in next(sentences(document))


def test_what_is_beyond_its_limit_now_is_due_before_what_only_may_be() -> None:
    """A unit that is out of spec is not said to be "not certainly within" by a parameter that comes first by name."""
    limits, months = ParameterLimits(low=0.0, high=22.0), np.arange(6.0)

    def due(value: float, uncertainty: float, newest: float | None = None) -> dict[str, Any]:
        line = Trend("", Fit(months, np.full(6, value), np.full(6, uncertainty), line=False))
        own = Uncertain(value if newest is None else newest, uncertainty, np.inf, 3, "deg/hr")
        return {"temperature_degC": 10.0, **_due(line, months, limits, 2.0, own)}

    parameters = [
        {"sensor": 1, "parameter": "MUB", "temperatures": [due(21.9, 3.0)]},
        {"sensor": 2, "parameter": "BA", "temperatures": [due(36.4, 0.3), due(40.0, 0.3), due(11.0, 0.3)]},
    ]
    day, why = _next(parameters, cast(Limits, limits), "2026-06-01", judged=True)
    assert (day, why) == ("2026-06-01", "sensor 2, BA at 10.0 °C is beyond its limit now, and 1 more are")
    day, why = _next(parameters[:1], cast(Limits, limits), "2026-06-01", judged=True)
    assert why == "sensor 1, MUB at 10.0 °C is not certainly within its limits even now"
    parameters[0]["temperatures"] = [due(10.0, 0.3, 23.0)]  # the others held it within; by itself it is out of spec
    day, why = _next(parameters[:1], cast(Limits, limits), "2026-06-01", judged=True)
    assert (day, why) == ("2026-06-01", "sensor 1, MUB at 10.0 °C is beyond its limit now")
