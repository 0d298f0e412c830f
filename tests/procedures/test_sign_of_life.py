"""A watchdog hears of the controller at every poll, and before whatever keeps it silent for long."""

from __future__ import annotations

import pytest

from procedures.sweep_outcome import SweepState


class Heard:
    """Keeps when signs of life came, by the clock, and what silence was asked for."""

    def __init__(self, clock):
        self._clock, self.signs = clock, []

    def alive(self, silent_s=0.0):
        """Keep it."""
        self.signs.append((self._clock.now(), silent_s))


def test_no_two_signs_are_further_apart_than_the_silence_that_was_asked_for(bench):
    """Over a whole night: soaks, collects, moves; the interval between two polls is asked for as well."""
    heard = Heard(bench.clock)
    assert bench.run(vital=heard.alive).state is SweepState.COMPLETE
    for (before_s, silent_s), (after_s, _) in zip(heard.signs, heard.signs[1:], strict=False):
        assert after_s - before_s <= silent_s + 1e-6
    assert {silent_s for _, silent_s in heard.signs} >= {60.0}  # an index move may take its time-out


def test_a_safe_state_that_has_to_be_tried_again_and_again_is_no_silence(bench):
    """The watchdog must not kill a controller that is busy with what the watchdog would do."""
    bench.chamber.safe_fails = 20
    bench.chamber.alarm = lambda t: ("HIGH",) if t > 700.0 else ()
    heard = Heard(bench.clock)
    outcome = bench.run(vital=heard.alive)
    assert outcome.left.safe
    leaving = [silent_s for time_s, silent_s in heard.signs if time_s > 700.0 + bench.interlocks.alarm_grace_s]
    assert len(leaving) >= 20
    assert leaving[-1] >= 60.0


@pytest.mark.parametrize("kind", ["interlock-suspected", "interlock"])
def test_what_an_interlock_saw_is_in_the_journal(bench, kind):
    """Temperatures, alarms, the stream: the evidence, not only a sentence."""
    bench.chamber.alarm = lambda t: ("HIGH",) if t > 700.0 else ()
    bench.run()
    evidence = next(evidence for each, _, evidence in bench.record.events if each == kind)
    assert evidence["chamber"]["alarms"] == ("HIGH",)
    assert evidence["commanded_degC"] == 20.0
    assert evidence["samples"] > 0
    assert set(evidence["unit_degC"]) == {2}
