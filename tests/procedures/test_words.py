"""Numbers and durations read as people write them."""

from __future__ import annotations

import pytest

from procedures.words import (
    choice,
    counted,
    duration,
    first_few,
    hours_minutes,
    listed,
    numbered,
    percent,
    ranges,
    spelled,
)


@pytest.mark.parametrize(
    ("numbers", "told"),
    [([4], "4"), ([1, 2], "1–2"), ([7, 3, 1, 2, 2], "1–3, 7"), ([1, 2, 3, 7, 9, 10], "1–3, 7, 9–10"), ([], "")],
)
def test_unbroken_stretches_are_drawn_together(numbers: list[int], told: str) -> None:
    """In any order, each once."""
    assert ranges(numbers) == told


def test_things_are_named_by_their_numbers() -> None:
    """One or several; with a dash of another kind, or each by itself."""
    assert numbered("run", [4]) == "run 4"
    assert numbered("run", [4, 4]) == "run 4"
    assert numbered("run", [5, 4, 9]) == "runs 4–5, 9"
    assert numbered("row", [5, 4, 9], to="-") == "rows 4-5, 9"
    assert numbered("run", [5, 4, 9], to="") == "runs 4, 5, 9"


def test_how_many_there_are() -> None:
    """None and several are plural; small numbers have words."""
    assert [counted(n, "run") for n in (0, 1, 2)] == ["0 runs", "1 run", "2 runs"]
    assert [spelled(n) for n in (0, 6, 12, 13)] == ["no", "six", "twelve", "13"]


def test_names_one_after_another() -> None:
    """A comma between all but the last two."""
    assert [listed("A"), listed("AB"), listed("ABC"), listed([1, 2])] == ["A", "A and B", "A, B and C", "1 and 2"]


def test_nothing_is_left_out_that_is_as_short_as_to_say_so() -> None:
    """One more than the most is shown; of two more, how many."""
    assert [first_few("ABCD"[:n], 2) for n in (1, 2, 3, 4)] == [("A", 0), ("AB", 0), ("ABC", 0), ("AB", 2)]
    assert [listed("ABCD"[:n], 2) for n in (2, 3, 4)] == ["A and B", "A, B and C", "A, B and 2 more"]


def test_a_long_choice_is_cut_short() -> None:
    """Twelve are shown; of more, the first five and the last."""
    assert choice(range(1, 13)) == ", ".join(str(n) for n in range(1, 13))
    assert choice(range(1, 101)) == "1, 2, 3, 4, 5, …, 100"


def test_durations() -> None:
    """What lasts is told in whole minutes, what was calculated to three digits."""
    assert [hours_minutes(s) for s in (45.0, 720.0, 11_100.0)] == ["45 s", "12 min", "3 h 05 min"]
    assert [duration(s) for s in (34.14, 750.0, 11_100.0)] == ["34.1 s", "12.5 min", "3.08 h"]


def test_shares_near_the_ends_have_a_decimal() -> None:
    """Not quite all is not all."""
    assert [percent(x) for x in (0.005, 0.5, 0.995)] == ["0.5 %", "50 %", "99.5 %"]
