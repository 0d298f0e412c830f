"""Kill the controller at any call of its journal, and resume gives the same campaign as if nothing had happened."""

from __future__ import annotations

from dataclasses import replace

import pytest

from procedures.journal_protocol import Outcome
from procedures.sweep_outcome import SweepState
from procedures.verdict import Verdict, self_calibration_verdict

_SAME = ("position", "n_samples", "n_expected", "n_missing", "sensors", "verdict", "reason")


def _die_at(bench, killed, call, when):
    def fails(this_call, this_when):
        if (this_call, this_when) == (call, when):
            bench.chamber.dead = True
            raise killed

    return fails


def _comparable(data):
    rates = data["sensors"]["2"]["rates"]["RA"]
    return [data[name] for name in _SAME if name != "sensors"] + [
        pytest.approx(rates["mean_deg_per_hr"], abs=1e-9),
        pytest.approx(rates["se_deg_per_hr"], abs=1e-9),
    ]


@pytest.mark.parametrize("every", [9, pytest.param(1, marks=pytest.mark.slow)])
@pytest.mark.parametrize("when", ["before", "after"])
def test_killed_at_any_journal_call_the_resumed_campaign_is_complete_and_equal(new_bench, killed, when, every):
    """Every call, before and after it takes effect: same results, no DONE step twice, chamber safe at the end."""
    whole = new_bench()
    assert whole.run().state is SweepState.COMPLETE
    expected = {key: _comparable(data) for key, data in whole.collects().items()}
    calls = whole.journal.calls
    assert calls > 40
    for call in range(1, calls + 1, every):
        bench = new_bench()
        with pytest.raises(killed):
            bench.run(_die_at(bench, killed, call, when))
        committed = dict(bench.record.results)
        bench.reboot()
        outcome = bench.run()
        assert outcome.state is SweepState.COMPLETE, (call, outcome)
        assert bench.chamber.safe, call
        for key, result in committed.items():
            assert bench.record.results[key] is result, (call, key)
        done = [key for key, _, result in bench.record.ends if result.outcome is Outcome.DONE]
        assert sorted(done) == sorted({step.key for step in bench.plan.steps}), call
        assert {key: _comparable(data) for key, data in bench.collects().items()} == expected, call


def test_a_resume_between_two_collects_restores_identity_setpoint_soak_and_position(bench, killed):
    """The soak starts over before the missing collect; the restoration is on record, not a second result."""

    def fails(call, when):
        if bench.record.begins[-1:] == ["T1/S1/C2/collect"] and when == "after":
            bench.chamber.dead = True
            raise killed

    with pytest.raises(killed):
        bench.run(fails)
    bench.reboot()
    bench.run()
    restored = [evidence["step"] for kind, _, evidence in bench.record.events if kind == "restored"]
    assert restored == ["identify", "T1/setpoint", "T1/S1/restabilise", "T1/S1/C2/index"]
    first, second = (bench.collects()[f"T1/S1/C{c}/collect"] for c in (1, 2))
    assert second["start_s"] - first["start_s"] > 3600.0 + bench.sweep.restabilisation.at_least_s
    assert bench.table.moves[:4] == ["1", "2", "2", "1"]
    assert "resumed" in bench.record.kinds()


def test_a_self_calibration_with_an_interruption_inside_is_marginal(bench, killed):
    """Its collects are an hour apart: a slow drift would look like an acceleration sensitivity."""

    def fails(call, when):
        if bench.record.begins[-1:] == ["T1/S1/C2/collect"]:
            raise killed

    with pytest.raises(killed):
        bench.run(fails)
    bench.reboot()
    bench.run()
    groups = bench.plan.self_calibrations
    judgement = self_calibration_verdict(groups[1], bench.record.results)
    assert judgement.verdict is Verdict.MARGINAL
    assert "min apart" in judgement.reason
    assert self_calibration_verdict(groups[2], bench.record.results).verdict is Verdict.PASS


def test_the_soak_of_a_resume_counts_for_the_collect_behind_it(bench, killed):
    """The journal's soak was good; the one after the resume is not: the collect is not PASS."""

    def fails(call, when):
        if bench.record.begins[-1:] == ["T1/S1/C2/collect"]:
            bench.chamber.dead = True
            raise killed

    with pytest.raises(killed):
        bench.run(fails)
    bench.reboot()
    bench.sweep = replace(bench.sweep, temperatures_degC=(20.0,))
    bench.chamber.offset_degC = lambda t: 0.7 if int(t / 100.0) % 2 else 0.0
    bench.run()
    assert bench.record.results["T1/S1/restabilise"].data["verdict"] == "PASS"
    assert bench.collects()["T1/S1/C2/collect"]["verdict"] == "INCONCLUSIVE"


def test_another_unit_is_refused_on_resume(bench):
    """The sweep began with unit 7; unit 8 does not go on with it, and the chamber is made safe."""
    bench.stop.request("somebody")
    first = bench.run()
    assert first.state is SweepState.ABORTED
    bench.reboot()
    bench.table.refuse = 99
    bench.run()
    bench.reboot()
    bench.table.refuse = 0
    bench.imu.serial = "8"
    outcome = bench.run()
    assert outcome.state is SweepState.FAILED
    assert "the unit behind sim://imu is now FAKE S/N 8, the night began with FAKE S/N 7" in outcome.reason
    assert bench.chamber.safe


def test_a_complete_sweep_touches_nothing_when_resumed(bench):
    """No command reaches the chamber, no step begins."""
    bench.run()
    begins, safe_calls = list(bench.record.begins), bench.chamber.safe_calls
    outcome = bench.run()
    assert outcome.state is SweepState.COMPLETE
    assert bench.record.begins == begins
    assert bench.chamber.safe_calls == safe_calls


def test_a_gap_in_an_ended_sweep_is_filled_and_the_chamber_brought_home_again(bench):
    """Only the missing collect is taken, and the sweep ends at its final temperature."""
    bench.run()
    del bench.record.results["T1/S1/C1/collect"]
    before = len(bench.record.begins)
    safe_calls = bench.chamber.safe_calls
    bench.reboot()
    outcome = bench.run()
    assert outcome.state is SweepState.COMPLETE
    assert bench.record.begins[before:] == ["T1/S1/C1/collect"]
    restored = [evidence["step"] for kind, _, evidence in bench.record.events if kind == "restored"]
    assert restored[-1] == "final/setpoint"
    assert bench.chamber.safe
    assert bench.chamber.safe_calls == safe_calls + 1


def test_time_since_the_setpoint_counts_from_the_first_command_where_the_chamber_held_it(bench, killed):
    """The controller died, the chamber did not: its time at this setpoint goes on."""

    def fails(call, when):
        if bench.record.begins[-1:] == ["T1/S1/C1/collect"]:
            bench.chamber.dead = True
            raise killed

    with pytest.raises(killed):
        bench.run(fails)
    commanded_s = bench.record.results["T1/setpoint"].data["commanded_s"]
    bench.reboot()
    bench.run()
    data = bench.collects()["T1/S1/C1/collect"]
    assert data["time_since_setpoint_s"] == pytest.approx(data["start_s"] - commanded_s)
