"""A signal asks for the end once; asking again neither hurries it nor skips the safe state."""

from __future__ import annotations

import os
import signal

import pytest

from procedures.progress import Progress
from procedures.stop import StopRequest, StopRequested
from procedures.sweep_outcome import SweepState


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGQUIT, signal.SIGTERM, signal.SIGHUP])
def test_a_signal_becomes_a_stop_request_with_its_name(number):
    """Nothing is raised where the signal strikes; the next check raises."""
    stop = StopRequest()
    stop.check()
    with stop.on_signals():
        os.kill(os.getpid(), number)
        assert stop.requested
        with pytest.raises(StopRequested, match=number.name):
            stop.check()


def test_the_former_handlers_come_back():
    """Also after an error inside."""
    former = signal.getsignal(signal.SIGTERM)

    def fail_inside():
        with StopRequest().on_signals():
            assert signal.getsignal(signal.SIGTERM) is not former
            raise RuntimeError

    with pytest.raises(RuntimeError):
        fail_inside()
    assert signal.getsignal(signal.SIGTERM) is former


def test_what_a_terminal_stops_a_process_with_is_ignored_and_what_was_ignored_stays_so():
    """Ctrl-Z must not put a controller to sleep; nohup means what it says."""
    former = signal.signal(signal.SIGHUP, signal.SIG_IGN)
    stopping = (signal.SIGTSTP, signal.SIGTTIN, signal.SIGTTOU)
    before = [signal.getsignal(number) for number in stopping]
    try:
        with StopRequest().on_signals() as stop:
            assert [signal.getsignal(number) for number in stopping] == [signal.SIG_IGN] * 3
            os.kill(os.getpid(), signal.SIGHUP)
            assert not stop.requested
        assert [signal.getsignal(number) for number in stopping] == before
        assert signal.getsignal(signal.SIGHUP) is signal.SIG_IGN
    finally:
        signal.signal(signal.SIGHUP, former)


def test_the_first_reason_is_kept():
    """Two people, one reason: who was first."""
    stop = StopRequest()
    assert stop.reason == ""
    stop.request("stopped by SIGINT")
    stop.request("stopped by SIGHUP")
    assert stop.reason == "stopped by SIGINT"


def test_a_second_interrupt_does_not_skip_the_safe_state(bench):
    """Ctrl-C in a soak, and again while the chamber is being brought to safety."""

    class Impatient(Progress):
        def update(self, snapshot):
            if snapshot.elapsed_s > 700.0:
                os.kill(os.getpid(), signal.SIGINT)

        def event(self, kind, message, at_s):
            if kind == "safe-state-retry":
                os.kill(os.getpid(), signal.SIGINT)

    bench.chamber.safe_fails = 3
    with bench.stop.on_signals():
        outcome = bench.run(onlookers=[Impatient()])
    assert outcome.state is SweepState.ABORTED
    assert outcome.reason == "stopped by Ctrl-C, SIGINT"
    assert bench.chamber.safe
    assert bench.chamber.safe_calls == 4


def test_a_stop_is_heard_within_one_read_interval(bench):
    """Waiting is done in pieces, and the stop is asked for between them."""
    times = []

    class Onlooker(Progress):
        def update(self, snapshot):
            if snapshot.elapsed_s > 700.0 and not times:
                times.append(bench.clock.now())
                bench.stop.request("a button")

    bench.run(onlookers=[Onlooker()])
    assert bench.clock.now() - times[0] <= bench.polling.read_interval_s
