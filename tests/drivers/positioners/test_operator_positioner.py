"""The positioner that is a person: believed only once they confirm, in time."""

from __future__ import annotations

from collections.abc import Callable

import pytest

from drivers.clock import VirtualClock
from drivers.errors import CommandRefused, DeviceError, DeviceTimeout
from drivers.positioners.positioner import OperatorPositioner, Positioner


def _operator(clock: VirtualClock, answer: bool | None, after_s: float) -> tuple[Callable[..., bool | None], list[str]]:
    questions: list[str] = []

    def ask(question: str, timeout_s: float) -> bool | None:
        questions.append(question)
        clock.sleep(min(after_s, timeout_s) if answer is None else after_s)
        return answer

    return ask, questions


def test_a_confirmed_position_is_known() -> None:
    """The operator is told where and how, and confirms."""
    clock = VirtualClock()
    ask, questions = _operator(clock, answer=True, after_s=40.0)
    positioner: Positioner = OperatorPositioner(ask, clock, instructions={"3": "connector towards the door"})
    assert positioner.position() is None
    positioner.move_to("3", timeout_s=600.0)
    assert positioner.position() == "3"
    assert questions == ["Bring the unit to position 3 (connector towards the door) and confirm when it lies still."]


@pytest.mark.parametrize(
    ("answer", "after_s", "error"),
    [(False, 5.0, CommandRefused), (None, 700.0, DeviceTimeout), (True, 601.0, DeviceTimeout)],
)
def test_without_a_confirmation_in_time_the_position_is_unknown(
    answer: bool | None, after_s: float, error: type[DeviceError]
) -> None:
    """Refused, unanswered, or confirmed too late: also the position it had before is not known any more."""
    clock = VirtualClock()
    answers = iter([(True, 1.0), (answer, after_s)])

    def ask(question: str, timeout_s: float) -> bool | None:
        said, waited_s = next(answers)
        clock.sleep(waited_s)
        return said

    positioner = OperatorPositioner(ask, clock)
    positioner.move_to("1", timeout_s=600.0)
    with pytest.raises(error, match="position 2"):
        positioner.move_to("2", timeout_s=600.0)
    assert positioner.position() is None


def test_a_position_that_the_bench_does_not_have_is_not_asked_for() -> None:
    """The operator is not sent somewhere that has no instructions."""
    clock = VirtualClock()
    ask, questions = _operator(clock, answer=True, after_s=1.0)
    with pytest.raises(DeviceError, match="no position 4; its operator knows 1, 3"):
        OperatorPositioner(ask, clock, instructions={"1": "", "3": ""}).move_to("4", timeout_s=60.0)
    assert questions == []


def test_the_same_position_is_asked_for_anew() -> None:
    """Seating the unit again is the point of asking again."""
    clock = VirtualClock()
    ask, questions = _operator(clock, answer=True, after_s=1.0)
    positioner = OperatorPositioner(ask, clock)
    for _ in range(2):
        positioner.move_to("1", timeout_s=60.0)
    assert len(questions) == 2


def test_an_interrupted_question_leaves_the_position_unknown() -> None:
    """Whoever presses Ctrl-C half-way may have moved the unit already."""
    clock = VirtualClock()
    answers = iter([True])

    def ask(question: str, timeout_s: float) -> bool | None:
        try:
            return next(answers)
        except StopIteration:
            raise KeyboardInterrupt from None

    positioner = OperatorPositioner(ask, clock)
    positioner.move_to("1", timeout_s=60.0)
    with pytest.raises(KeyboardInterrupt):
        positioner.move_to("2", timeout_s=60.0)
    assert positioner.position() is None
