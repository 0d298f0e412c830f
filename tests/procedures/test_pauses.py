# ruff: noqa: D102 - fakes of Protocols: the Protocols say what each method does
"""Pauses and questions on the bench of fakes: what they hold, what they undo, and what they never hold up."""

from __future__ import annotations

from collections import deque

import pytest

from drivers.positioners.positioner import OperatorPositioner
from procedures.attended import Attendant
from procedures.journal_protocol import Outcome
from procedures.requests import Request, RequestKind
from procedures.sweep_outcome import SweepState

PAUSE = Request(1, RequestKind.PAUSE, "ann", "a cable")
GO_ON = Request(2, RequestKind.CONTINUE, "bob")
SOAK, COLLECT, INDEX = "T1/S1/restabilise", "T1/S1/C1/collect", "T1/S1/C2/index"


class Asked:
    """Asks at given times of the clock."""

    def __init__(self, clock, *requests):
        self._clock, self._waiting = clock, deque(sorted(requests, key=lambda each: each[0]))
        self.answers = []

    def asked(self):
        due = []
        while self._waiting and self._clock.now() >= self._waiting[0][0]:
            due.append(self._waiting.popleft()[1])
        return due

    def answer(self, request, accepted, message):
        self.answers.append((request.kind, accepted, message))


def _outcomes(bench, key):
    return [result.outcome for step, _, result in bench.record.ends if step == key]


def _restored(bench):
    return [evidence["step"] for kind, _, evidence in bench.record.events if kind == "restored"]


def _continued(bench):
    return next(evidence for kind, _, evidence in bench.record.events if kind == "continue")


def _began(bench, key):
    """Run once undisturbed and say when a step began there, by the clock."""
    times = {}

    class Onlooker:
        def __getattr__(self, _):
            return lambda *_: None

        def step_began(self, step, attempt):
            times.setdefault(step.key, bench.clock.now())

    assert bench.run(onlookers=[Onlooker()]).state is SweepState.COMPLETE
    return times[key]


def test_a_pause_in_a_soak_ends_it_at_once_and_begins_it_anew(bench, new_bench):
    """Half a soak with hands on the bench is no soak; the setpoint stays commanded meanwhile."""
    at_s = _began(new_bench(), SOAK) + 300.0
    control = Asked(bench.clock, (at_s, PAUSE), (at_s + 4000.0, GO_ON))
    assert bench.run(control=control).state is SweepState.COMPLETE
    assert _outcomes(bench, SOAK) == [Outcome.ABORTED, Outcome.DONE]
    assert control.answers[0] == (RequestKind.PAUSE, True, "pauses at once; the chamber is held")
    assert bench.record.results[SOAK].data["waited_s"] >= 600.0
    assert _continued(bench)["reason"] == "it was not finished"
    assert _restored(bench) == ["identify"]


@pytest.mark.parametrize("key", [COLLECT, INDEX])
def test_a_pause_between_collects_keeps_a_soak_whose_band_was_held(bench, new_bench, key):
    """A collect that was begun is finished; the unit is brought back to its position; the soak counts."""
    at_s = _began(new_bench(), key)
    control = Asked(bench.clock, (at_s, PAUSE), (at_s + 2000.0, GO_ON))
    assert bench.run(control=control).state is SweepState.COMPLETE
    assert _outcomes(bench, COLLECT) == [Outcome.DONE]
    assert _outcomes(bench, SOAK) == [Outcome.DONE]
    assert SOAK not in _restored(bench)
    assert _continued(bench)["soak_kept"] is True


@pytest.mark.parametrize(
    ("disturb", "why"),
    [
        (lambda b, t: setattr(b.chamber, "offset_degC", lambda now: 2.0 if t + 100 < now < t + 500 else 0.0), "air"),
        (lambda b, t: setattr(b.imu, "silent", lambda now: t + 100 < now < t + 500), "unit was silent"),
    ],
)
def test_a_pause_that_lost_the_band_or_the_unit_restarts_the_soak(bench, new_bench, disturb, why):
    """A door that was open, a unit that was without power: neither can be taken for equilibrium."""
    at_s = _began(new_bench(), COLLECT)
    disturb(bench, at_s)
    control = Asked(bench.clock, (at_s, PAUSE), (at_s + 2000.0, GO_ON))
    assert bench.run(control=control).state is SweepState.COMPLETE
    assert SOAK in _restored(bench)
    assert _continued(bench)["soak_kept"] is False
    assert why in _continued(bench)["reason"]


def test_an_interlock_ends_a_pause_too(bench, new_bench):
    """A chamber that runs away does not wait for anybody."""
    at_s = _began(new_bench(), SOAK) + 100.0
    bench.chamber.alarm = lambda t: ("HIGH",) if t > at_s + 500.0 else ()
    outcome = bench.run(control=Asked(bench.clock, (at_s, PAUSE)))
    assert (outcome.state, outcome.left.safe) == (SweepState.FAILED, True)
    assert outcome.reason.startswith("chamber-alarm")
    assert bench.clock.now() < at_s + 1000.0


@pytest.mark.slow
def test_a_pause_to_which_nobody_comes_back_ends_in_the_safe_state(bench, new_bench):
    """A pause never lasts for ever."""
    at_s = _began(new_bench(), SOAK)
    outcome = bench.run(control=Asked(bench.clock, (at_s, PAUSE)))
    assert outcome.state is SweepState.FAILED
    assert "paused-too-long: paused by ann: a cable, and nobody came back" in outcome.reason
    assert bench.chamber.safe
    assert at_s + bench.interlocks.pause_s <= bench.clock.now() < at_s + bench.interlocks.pause_s + 700.0


def test_another_unit_that_was_connected_in_a_pause_is_refused(bench, new_bench):
    """The first half of a self-calibration and the second must be of one unit."""
    at_s = _began(new_bench(), COLLECT)

    class Swapped(Asked):
        def asked(self):
            if bench.clock.now() > at_s + 500.0:
                bench.imu.serial = "8"
            return super().asked()

    outcome = bench.run(control=Swapped(bench.clock, (at_s, PAUSE), (at_s + 2000.0, GO_ON)))
    assert outcome.state is SweepState.FAILED
    assert "is now FAKE S/N 8, the night began with FAKE S/N 7" in outcome.reason


def test_an_abort_is_heard_at_the_next_poll_also_in_a_pause(bench, new_bench):
    """And says who and why."""
    at_s = _began(new_bench(), SOAK)
    abort = Request(3, RequestKind.ABORT, "bob", "fire drill")
    outcome = bench.run(control=Asked(bench.clock, (at_s, PAUSE), (at_s + 100.0, abort)))
    assert (outcome.state, outcome.reason) == (SweepState.ABORTED, "aborted by bob: fire drill")
    assert bench.clock.now() <= at_s + 100.0 + 2 * bench.polling.read_interval_s
    assert bench.chamber.safe


class Sitter:
    """Somebody at the terminal who answers a question after so many seconds, or whose terminal is gone."""

    def __init__(self, clock, answer=True, after_s=30.0, broken=False):
        self._clock, self._answer, self._after_s, self._broken = clock, answer, after_s, broken
        self.asked_s, self.ended = None, []

    def put(self, question, timeout_s, wants_words=False):
        if self._broken:
            raise OSError(5, "Input/output error")
        self.asked_s = self._clock.now()

    def answer(self):
        return self._answer if self._clock.now() >= self.asked_s + self._after_s else None

    def settle(self, how):
        self.ended.append(how)


def _attended(bench, terminal):
    attendant = Attendant(terminal)
    table = OperatorPositioner(attendant, bench.clock)
    bench.imu.table = type("Where", (), {"where": property(lambda _: table.position())})()
    bench.table = table
    return attendant


def test_a_question_is_answered_at_the_terminal_while_the_bench_is_looked_at(bench):
    """The stream is drained and heartbeats go on; who answered is on record."""
    sitter = Sitter(bench.clock, after_s=45.0)
    assert bench.run(attendant=_attended(bench, sitter)).state is SweepState.COMPLETE
    ended = [evidence for kind, _, evidence in bench.record.events if kind == "prompt-ended"]
    assert [(each["how"], each["who"]) for each in ended] == [("confirmed", "the terminal")] * 4
    assert sitter.ended == ["confirmed"] * 4


def test_a_pause_withdraws_the_question_and_it_is_put_again_afterwards(bench, new_bench):
    """Whoever pauses has their hands on the unit; the answer of before would not be worth much."""
    at_s = _began(new_bench(), "T1/S1/C1/index") + 20.0
    control = Asked(bench.clock, (at_s, PAUSE), (at_s + 600.0, GO_ON))
    outcome = bench.run(control=control, attendant=_attended(bench, Sitter(bench.clock, after_s=45.0)))
    assert outcome.state is SweepState.COMPLETE
    ended = [evidence["how"] for kind, _, evidence in bench.record.events if kind == "prompt-ended"]
    assert ended == ["withdrawn", *["confirmed"] * 4]
    assert _outcomes(bench, "T1/S1/C1/index") == [Outcome.ABORTED, Outcome.DONE]


def test_a_chamber_that_runs_away_while_somebody_is_asked_is_made_safe(bench, new_bench):
    """The interlock does not wait for the answer; the question is withdrawn."""
    at_s = _began(new_bench(), "T1/S1/C1/index")
    bench.chamber.alarm = lambda t: ("HIGH",) if t > at_s + 20.0 else ()
    outcome = bench.run(attendant=_attended(bench, Sitter(bench.clock, after_s=1e9)))
    assert outcome.reason.startswith("chamber-alarm")
    assert bench.clock.now() < at_s + 60.0
    assert "withdrawn" in [evidence.get("how") for _, _, evidence in bench.record.events]


def test_a_question_that_nobody_answers_is_asked_again_and_then_ends_the_night(bench):
    """Bounded, with the terminal gone as well: it still stands in the journal."""
    outcome = bench.run(attendant=_attended(bench, Sitter(bench.clock, broken=True)))
    assert outcome.state is SweepState.FAILED
    assert "did not confirm position 1" in outcome.reason
    assert bench.record.kinds().count("prompt") == bench.polling.device_attempts
    assert bench.chamber.safe


def test_a_refusal_is_not_asked_again(bench):
    """Somebody said no."""
    outcome = bench.run(attendant=_attended(bench, Sitter(bench.clock, answer=False)))
    assert "refused to confirm position 1" in outcome.reason
    assert bench.record.kinds().count("prompt") == 1


def test_a_question_needs_a_sweep():
    """Before it has begun nothing could be looked at."""
    with pytest.raises(ValueError, match="before the sweep"):
        Attendant()("?", 1.0)
