"""Whatever ends a sweep, the chamber is brought to its safe state and the reason is on record."""

from __future__ import annotations

import errno
import re
from dataclasses import replace
from datetime import timedelta

import pytest

from drivers.imu import ImuIdentity
from procedures.journal_protocol import Outcome
from procedures.progress import Progress
from procedures.sweep_outcome import SweepState


def _at(t0, t1=1e9):
    return lambda t: t0 <= t < t1


@pytest.mark.parametrize("minute", [0, 1, 5, 12, 13, 14, 15, 20, 40])
def test_a_stop_request_at_any_time_ends_aborted_and_safe(bench, minute):
    """The open step is ABORTED; the campaign goes on from there after a resume."""

    class Onlooker(Progress):
        def update(self, snapshot):
            if snapshot.elapsed_s >= 60.0 * minute:
                bench.stop.request("stopped by SIGINT")

    outcome = bench.run(onlookers=[Onlooker()])
    assert (outcome.state, outcome.reason) == (SweepState.ABORTED, "stopped by SIGINT")
    assert [result.outcome for _, _, result in bench.record.ends].count(Outcome.ABORTED) == 1
    assert outcome.missing
    assert bench.chamber.safe
    assert outcome.left.safe
    assert bench.record.events[-1][0] == "safe-state"
    bench.reboot()
    assert bench.run().state is SweepState.COMPLETE


@pytest.mark.parametrize(
    ("fault", "name"),
    [
        (lambda b: setattr(b.chamber, "alarm", lambda t: ("HIGH TEMPERATURE",) if t > 700 else ()), "chamber-alarm"),
        (lambda b: setattr(b.chamber, "silent", _at(700, 1000)), "chamber-lost"),
        (lambda b: setattr(b.chamber, "offset_degC", lambda t: 70.0 if t > 700 else 0.0), "chamber-limits"),
        (lambda b: setattr(b.chamber, "offset_degC", lambda t: float("nan") if t > 700 else 0.0), "chamber-limits"),
        (lambda b: setattr(b.chamber, "offset_degC", lambda t: 5.0 if t > 700 else 0.0), "setpoint-not-followed"),
        (lambda b: setattr(b.chamber, "stuck", True), "ramp-too-long"),
        (lambda b: setattr(b.imu, "silent", _at(700)), "stream-lost"),
        (lambda b: setattr(b.imu, "damaged", _at(700)), "stream-lost"),
        (lambda b: setattr(b.imu, "broken", _at(700)), ""),
        (lambda b: setattr(b, "interlocks", replace(b.interlocks, unit_high_degC=21.0)), "unit-limits"),
    ],
)
def test_each_interlock_ends_the_sweep_failed_and_safe(bench, fault, name):
    """A real fault costs neither the chamber nor the truth about it: air that reads 93 °C shows nothing safe."""
    fault(bench)
    outcome = bench.run()
    assert outcome.state is SweepState.FAILED, outcome
    assert name in outcome.reason
    assert bench.chamber.safe
    kinds = bench.record.kinds()
    assert kinds[-1] == ("safe-state-not-reached" if name == "chamber-limits" else "safe-state")
    assert "interlock" in kinds


@pytest.mark.parametrize("what", ["silent", "alarm"])
def test_one_glitch_of_the_chamber_does_not_end_a_night(bench, what):
    """A fault of ten seconds is on record, begins nothing new, and costs nothing."""
    if what == "silent":
        bench.chamber.silent = _at(800, 835)
    else:
        bench.chamber.alarm = lambda t: ("DOOR",) if 800 <= t < 809 else ()
    outcome = bench.run()
    assert outcome.state is SweepState.COMPLETE
    assert {"interlock-suspected", "interlock-cleared"} <= set(bench.record.kinds())


def test_no_step_begins_while_something_is_suspected(bench):
    """An alarm begins in the last look of a soak: the sweep holds, goes on when it has cleared, and says so."""
    bench.run()
    soaked_s = bench.collects()["T1/S1/C1/collect"]["start_s"] - 15.0
    again = type(bench)()
    again.chamber.alarm = lambda t: ("DOOR",) if soaked_s - 5.0 <= t < soaked_s + 8.0 else ()
    outcome = again.run()
    assert outcome.state is SweepState.COMPLETE
    assert again.collects()["T1/S1/C1/collect"]["start_s"] >= soaked_s + 8.0 + 15.0
    kinds = again.record.kinds()
    assert "hold" in kinds
    assert kinds.index("hold") < kinds.index("hold-ended")


def test_a_changed_setpoint_is_noticed(bench):
    """Somebody turned the knob: the chamber follows them, the sweep does not."""

    class Knob(Progress):
        def update(self, snapshot):
            if snapshot.step.key == "T1/S1/restabilise":
                bench.chamber.setpoint_degC = 21.0

    outcome = bench.run(onlookers=[Knob()])
    assert outcome.state is SweepState.FAILED
    assert "setpoint-changed" in outcome.reason
    assert "20.0 °C was commanded" in outcome.reason


@pytest.mark.parametrize("call", [1, 2, 3, 9, 20, 40])
def test_a_full_disk_ends_in_error_and_the_safe_state(bench, call):
    """From this call on the journal writes nothing any more; the chamber is brought to safety all the same."""

    def fails(this_call, when):
        if this_call >= call and when == "before":
            raise OSError(28, "No space left on device")

    outcome = bench.run(fails)
    assert outcome.state is SweepState.ERROR
    assert "No space left" in outcome.reason
    assert outcome.left.safe
    assert bench.chamber.safe or not bench.chamber.prepared


def test_an_interrupt_that_nobody_caught_still_reaches_the_safe_state(bench):
    """KeyboardInterrupt passes through, after the chamber is safe."""

    class Interrupted(Progress):
        def update(self, snapshot):
            if snapshot.elapsed_s > 700:
                raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        bench.run(onlookers=[Interrupted()])
    assert bench.chamber.safe
    assert bench.record.ends[-1][2].outcome is Outcome.ERROR


def test_an_error_of_the_program_reaches_the_safe_state_and_is_named(bench, monkeypatch):
    """A bug is an error with its type, not a finding."""

    def bug():
        raise ZeroDivisionError("a bug")

    monkeypatch.setattr(bench.imu, "discard", bug)
    outcome = bench.run()
    assert outcome.state is SweepState.ERROR
    assert outcome.reason == "ZeroDivisionError: a bug"
    assert isinstance(outcome.error, ZeroDivisionError)
    assert bench.chamber.safe


def test_the_safe_state_is_tried_again(bench):
    """A chamber that comes back after minutes is not left hot."""
    bench.table.refuse = 99
    bench.chamber.safe_fails = 20
    outcome = bench.run()
    assert outcome.left.safe
    assert bench.chamber.safe


def test_a_safe_state_that_cannot_be_reached_is_said(bench):
    """The outcome and the journal say that the chamber is NOT safe."""
    bench.chamber.silent = _at(700)
    outcome = bench.run()
    assert outcome.state is SweepState.FAILED
    assert not outcome.left.safe
    assert "could not be brought to its safe state" in outcome.left.reason
    assert bench.record.kinds()[-1] == "safe-state-not-reached"


def test_somebody_who_watches_sees_that_the_safe_state_is_still_tried(bench):
    """Minutes without a word look like a program that hangs; the journal keeps the first of them."""
    said = []

    class Onlooker(Progress):
        def event(self, kind, message, at_s):
            if kind == "safe-state-retry":
                said.append(message)

    bench.chamber.safe_fails = 4
    bench.stop.request("stopped by SIGINT")
    bench.run(onlookers=[Onlooker()])
    seconds = [int(found[1]) for found in (re.search(r"trying again, (\d+) s left", line) for line in said) if found]
    assert len(seconds) == 4
    assert sorted(seconds, reverse=True) == seconds
    assert bench.record.kinds().count("safe-state-retry") <= 1


def test_an_onlooker_that_fails_is_dropped_and_the_night_and_the_others_go_on(bench):
    """The terminal was closed: that must not end what the page shows."""

    class Closed(Progress):
        def update(self, snapshot):
            raise OSError("the terminal is gone")

    class Counting(Progress):
        seen = 0

        def update(self, snapshot):
            self.seen += 1

    page = Counting()
    outcome = bench.run(onlookers=[Closed(), page])
    assert outcome.state is SweepState.COMPLETE
    assert bench.record.kinds().count("onlooker-lost") == 1
    assert page.seen > 10


def test_onlookers_see_a_finishing_time_that_holds(bench):
    """Seen from the middle of the sweep, the finishing time is right to a few minutes."""
    seen = []
    bench.sweep = replace(bench.sweep, restabilisation=replace(bench.sweep.restabilisation, at_least_s=1800.0))

    class Onlooker(Progress):
        def update(self, snapshot):
            seen.append(snapshot)

    bench.run(onlookers=[Onlooker()])
    middle = seen[len(seen) // 2]
    assert abs((middle.finishing_utc - bench.clock.utc()).total_seconds()) < 180.0
    sampling = [each for each in seen if each.note == "sampling"]
    assert sampling[-1].rates_deg_per_hr["2.RA"] == pytest.approx(-3.0, abs=0.1)
    assert sampling[-1].steps_total == len(bench.plan.steps)


def test_each_time_the_wall_clock_is_set_is_on_record(bench):
    """Back two hours, forward a day, and right again: three events, each with what the clock is off by then."""
    for at_s, by_s in ((300.0, -7200.0), (700.0, 93600.0), (1100.0, -86400.0)):
        bench.clock.wall_jumps.append((bench.clock.now() + at_s, by_s))
    assert bench.run().state is SweepState.COMPLETE
    told = [message for kind, message, _ in bench.record.events if kind == "wall-clock-jump"]
    assert [message.split()[6] for message in told] == ["-7200", "+86400", "+0"]


def test_a_wall_clock_that_is_set_moves_no_campaign_time(bench, monkeypatch):
    """Somebody sets the clock back an hour: it is on record once, and times go on as before."""
    true_utc = bench.clock.utc
    bench_started = bench.clock.now()

    def wrong_utc():
        return true_utc() - (timedelta(hours=1) if bench.clock.now() > bench_started + 700.0 else timedelta())

    monkeypatch.setattr(bench.clock, "utc", wrong_utc)
    outcome = bench.run()
    assert outcome.state is SweepState.COMPLETE
    assert bench.record.kinds().count("wall-clock-jump") == 1
    starts = [data["start_s"] for data in bench.collects().values()]
    assert starts == sorted(starts)


def test_a_suspicion_of_which_nothing_more_is_heard_ends_the_hold_at_a_ceiling(bench):
    """The unit was too hot in one look, then its thermometer says nothing any more: no hold for ever."""
    true_read = bench.imu.read_block

    def read_block():
        block = true_read()
        t = bench.clock.now()
        if len(block) and t > 700.0:
            block.fields["rotor_2_degC"][:] = 95.0 if t <= 710.0 else float("nan")
        return block

    bench.imu.read_block = read_block
    outcome = bench.run()
    assert outcome.state is SweepState.FAILED
    assert "held-too-long: unit-limits" in outcome.reason
    assert bench.chamber.safe


def test_a_stream_that_is_silent_from_the_start_is_lost_however_often_it_is_drained(bench):
    """Ten drains a second, each too short to expect a frame: together they say that nothing comes."""
    bench.polling = replace(bench.polling, read_interval_s=0.1)
    bench.imu.silent = _at(0.0)
    outcome = bench.run()
    assert outcome.state is SweepState.FAILED
    assert "stream-lost" in outcome.reason
    assert bench.clock.now() < 120.0


def test_a_simulated_device_on_a_bench_said_to_be_real_is_refused(bench, monkeypatch) -> None:
    """Its data would pass for measurements: nothing is collected, and the reason says what to do."""
    monkeypatch.setattr(bench.imu, "identify", lambda: ImuIdentity("MFS", "1", "simulated"))
    bench.simulation_declared = False
    outcome = bench.run()
    assert outcome.state is SweepState.FAILED
    assert "simulation section" in outcome.reason
    assert bench.collects() == {}


def test_a_simulated_device_on_a_bench_that_says_so_is_welcome(bench, monkeypatch) -> None:
    """The declared simulation runs to its end."""
    monkeypatch.setattr(bench.imu, "identify", lambda: ImuIdentity("MFS", "1", "simulated"))
    assert bench.run().state is SweepState.COMPLETE


def test_a_full_disk_is_said_in_words(bench) -> None:
    """No class name reaches the technician, and the chamber is safe."""

    def full(call: int, when: str) -> None:
        if call >= 6:
            raise OSError(errno.ENOSPC, "No space left on device")

    outcome = bench.run(full)
    assert outcome.reason == "the disk is full (No space left on device): free some space, then carry on"
    assert outcome.left.safe
