"""Curves of bounded size: nothing that stood out is lost, and what is sent piece by piece is the whole."""

from __future__ import annotations

import copy
import tracemalloc
from typing import Any

import numpy as np
import pytest

from hil.records.curve import Curve

HOURS_15_S = 15 * 3600


def night(seconds: int = HOURS_15_S) -> tuple[np.ndarray, np.ndarray]:
    """A value a second, with one spike of one second."""
    times = np.arange(seconds, dtype=float)
    values = np.stack([20.0 + np.sin(times / 3000.0), np.full(seconds, -5.0)], axis=1)
    values[seconds // 2, 0] = 99.0
    return times, values


def put_together(known: dict[str, Any] | None, part: dict[str, Any]) -> dict[str, Any]:
    """Do what the page does with a part of a curve."""
    if known is None or part["from"] == 0 or part["width_s"] != known["width_s"]:
        return copy.deepcopy(part)
    for side in ("least", "greatest"):
        for column, values in enumerate(part[side]):
            known[side][column][part["from"] :] = values
    return known


def test_a_spike_of_one_second_is_still_drawn_after_fifteen_hours() -> None:
    """Buckets keep the least and the greatest value, whatever their width."""
    curve = Curve(2)
    curve.add(*night())
    whole = curve.whole()
    assert max(whole["greatest"][0]) == 99.0
    assert whole["width_s"] == 32.0
    assert len(whole["least"][0]) <= 2048
    assert set(whole["least"][1]) == {-5.0}
    times, values = night()
    by_the_hour = Curve(2)
    for hour in range(15):
        by_the_hour.add(times[3600 * hour : 3600 * (hour + 1)], values[3600 * hour : 3600 * (hour + 1)])
    assert by_the_hour.whole() == whole


def test_what_is_sent_piece_by_piece_is_the_whole() -> None:
    """A page that was open all night shows what one shows that was opened at its end."""
    times, values = night(7000)
    curve, known = Curve(2, buckets=512), None
    for first in range(0, 7000, 37):
        curve.add(times[first : first + 37], values[first : first + 37])
        part = curve.changes()
        assert part is not None
        known = put_together(known, part)
    assert known is not None
    whole = curve.whole()
    assert {name: known[name] for name in ("least", "greatest", "start_s", "width_s")} == {
        name: whole[name] for name in ("least", "greatest", "start_s", "width_s")
    }
    assert curve.changes() is None


def test_its_memory_does_not_grow_with_the_night() -> None:
    """Three days cost what an hour costs."""
    tracemalloc.start()
    curve = Curve(5)
    before = tracemalloc.get_traced_memory()[0]
    for day in range(3):
        curve.add(day * 86400.0 + np.arange(0.0, 86400.0), np.zeros((86400, 5)))
    after = tracemalloc.get_traced_memory()[0]
    tracemalloc.stop()
    assert before == pytest.approx(2 * 2048 * 5 * 8, abs=2000)
    assert after - before < 2000
    assert len(curve.whole()["least"][0]) <= 2048


def test_a_gap_stays_empty_and_what_is_not_known_is_null() -> None:
    """While nobody controlled the bench there is nothing to draw."""
    curve = Curve(1)
    curve.add(np.array([0.0, 1.0]), np.array([[1.0], [2.0]]))
    curve.add(np.array([10.0, 11.0]), np.array([[np.nan], [3.0]]))
    assert curve.whole()["least"][0] == [1.0, 2.0, *[None] * 9, 3.0]


def test_its_points_are_the_least_and_the_greatest_of_what_there_was() -> None:
    """In the order of time; one where both are the same, none where there was nothing."""
    curve = Curve(2, buckets=4)
    curve.add(np.array([0.0, 1.0, 7.0]), np.array([[1.0, 5.0], [3.0, 5.0], [2.0, np.nan]]))
    times, values = curve.points()
    assert times.tolist() == [0.0, 0.0, 6.0]
    np.testing.assert_array_equal(values, [[1.0, 5.0], [3.0, 5.0], [2.0, np.nan]])
    assert len(Curve(1).points()[0]) == 0


def test_nothing_new_is_nothing_to_send() -> None:
    """A second without a sample costs nothing."""
    curve = Curve(1)
    curve.add(np.empty(0), np.empty((0, 1)))
    assert curve.changes() is None
    assert curve.whole()["start_s"] is None
