"""The sequencer carries out a plan in order, and a clean sweep ends complete and safe."""

from __future__ import annotations

from dataclasses import replace
from datetime import UTC, datetime

import numpy as np
import pytest

from drivers.errors import SetpointOutOfLimits, WrongDevice
from procedures.journal_protocol import Outcome
from procedures.plan import StepKind
from procedures.progress import Progress
from procedures.sweep_outcome import SweepState
from procedures.verdict import Verdict, self_calibration_verdict

BEGAN_EARLIER = datetime(1985, 10, 1, 15, 0, tzinfo=UTC)  # two hours before the fakes' clock begins


def test_a_clean_sweep_does_every_step_once_in_order_and_ends_safe(bench):
    """Every step of the plan is begun and DONE exactly once, in the plan's order."""
    outcome = bench.run()
    assert (outcome.state, outcome.reason, outcome.missing) == (SweepState.COMPLETE, "every step is done", ())
    assert bench.record.begins == [step.key for step in bench.plan.steps]
    assert [key for key, _, _ in bench.record.ends] == bench.record.begins
    assert {result.outcome for _, _, result in bench.record.ends} == {Outcome.DONE}
    assert outcome.left.safe
    assert bench.chamber.safe
    assert bench.chamber.safe_calls == 1


def test_collects_hold_what_the_campaign_needs(bench):
    """Averages, conditions, times and counts of a collect, JSON-able, in campaign time."""
    bench.run()
    data = bench.collects()["T2/S1/C2/collect"]
    rate = data["sensors"]["2"]["rates"]["RA"]
    assert rate["mean_deg_per_hr"] == pytest.approx(-3.0, abs=0.01)
    assert data["sensors"]["2"]["accelerations"] == {"A": 0.5}
    assert data["sensors"]["2"]["conditions"] == {"spin_period_us": 10000.0}
    assert data["sensors"]["2"]["temperature_degC"] == pytest.approx(26.0, abs=0.5)
    assert abs(data["sensors"]["2"]["dTdt_degC_per_min"]) < 0.05
    assert data["conditions"] == {"supply_V": 28.0}
    assert (data["position"], data["verdict"], data["n_samples"], data["n_missing"]) == ("2", "PASS", 1200, 0)
    assert data["chamber_degC"] == data["setpoint_degC"] == pytest.approx(26.0)
    assert data["time_since_power_on_s"] == data["start_s"]
    assert data["time_since_index_s"] == pytest.approx(10.0, abs=0.1)
    setpoint = bench.record.results["T2/setpoint"].data
    assert data["time_since_setpoint_s"] == pytest.approx(data["start_s"] - setpoint["commanded_s"])


def test_a_collects_samples_and_raw_bytes_go_to_the_journal_in_campaign_time(bench):
    """The block's times lie within the collect; the raw bytes are all there."""
    bench.run(began=BEGAN_EARLIER)
    key, _, result = next(end for end in bench.record.ends if end[0].endswith("collect"))
    times = result.samples.time_s
    start_s, duration_s = result.data["start_s"], result.data["duration_s"]
    assert start_s > 5000.0
    assert start_s <= times[0] < times[-1] <= start_s + duration_s + 1e-6, key
    assert len(result.samples.raw) == len(times) == result.data["n_samples"]


def test_heartbeats_name_the_step_and_never_fall_silent(bench):
    """A watchdog sees a sign of life at least every two minutes of every soak."""
    bench.run()
    soaks = [readings for key, readings in bench.record.heartbeats if key == "T1/S1/restabilise"]
    assert len(soaks) >= 5
    assert {"chamber_degC", "setpoint_degC", "unit_2_degC"} <= set(soaks[0])


def test_a_device_error_is_retried_and_the_attempts_are_on_record(bench):
    """An index that times out twice is tried three times; both failures are in the journal."""
    bench.table.refuse = 2
    outcome = bench.run()
    assert outcome.state is SweepState.COMPLETE
    assert [result.outcome for _, _, result in bench.record.ends].count(Outcome.ERROR) == 2
    assert bench.record.kinds().count("retry") == 2
    assert [attempt for key, attempt, _ in bench.record.ends if key == "T1/S1/C1/index"] == [1, 2, 3]


def test_a_device_that_stays_lost_ends_the_sweep_safely(bench):
    """After bounded retries: failed, safe, and the reason names the step."""
    bench.table.refuse = 99
    outcome = bench.run()
    assert outcome.state is SweepState.FAILED
    assert "T1/S1/C1/index" in outcome.reason
    assert len(bench.table.moves) == bench.polling.device_attempts
    assert bench.chamber.safe


@pytest.mark.parametrize("error", [WrongDevice("not this unit"), SetpointOutOfLimits("99 °C")])
def test_what_cannot_succeed_is_not_retried(bench, monkeypatch, error):
    """A wrong device or a setpoint out of limits ends the sweep at the first try."""

    def refuse(setpoint_degC: float) -> None:
        if setpoint_degC != 23.0:
            raise error

    monkeypatch.setattr(bench.chamber, "set_temperature", refuse)
    outcome = bench.run()
    assert outcome.state is SweepState.FAILED
    assert bench.record.begins.count("T1/setpoint") == 1
    assert bench.chamber.safe


def test_nothing_is_sent_to_a_chamber_that_is_not_the_benchs(bench, monkeypatch):
    """Not even the safe state; the outcome says so."""

    def refuse() -> None:
        raise WrongDevice("a GL speaks at this port, the bench file says P-300")

    monkeypatch.setattr(bench.chamber, "identify", refuse)
    outcome = bench.run()
    assert outcome.state is SweepState.FAILED
    assert not outcome.left.safe
    assert "nothing was sent" in outcome.left.reason
    assert bench.chamber.safe_calls == 0


def test_a_collect_that_is_not_good_is_taken_again_once_and_the_last_one_kept(bench):
    """A knock spoils the first take only: two attempts, the first FAILED with its samples, the second DONE."""
    bench.imu.extra_accel = lambda t: np.where((t > 970) & (t < 980), 0.1, 0.0)
    bench.run()
    ends = [(attempt, result) for key, attempt, result in bench.record.ends if result.data.get("samples_verdict")]
    failed = [(attempt, result) for attempt, result in ends if result.outcome is Outcome.FAILED]
    assert [attempt for attempt, _ in failed] == [1]
    assert "moved" in failed[0][1].reason
    assert failed[0][1].samples is not None
    assert all(data["verdict"] == "PASS" for data in bench.collects().values())


def test_a_unit_that_always_drifts_gives_a_complete_campaign_with_fail(bench):
    """A bad unit is a finding, not a reason to have no data."""
    bench.imu.extra = lambda t: 1.0 * t
    outcome = bench.run()
    assert outcome.state is SweepState.COMPLETE
    assert {data["verdict"] for data in bench.collects().values()} == {"FAIL"}
    assert "drifts" in bench.collects()["T1/S1/C1/collect"]["reason"]


def test_a_position_that_is_confirmed_as_another_one_is_not_collected(bench):
    """The table says that it is at 2 when it was sent to 1: no collect is taken there."""
    bench.table.ends_at = "2"
    outcome = bench.run()
    assert outcome.state is SweepState.FAILED
    assert "sent to position 1 and confirms 2" in outcome.reason
    assert not any(key.endswith("collect") for key in bench.record.begins)


def test_the_chambers_own_limits_are_set_before_anything_is_measured(bench):
    """The second safety layer is in place when the first setpoint is commanded."""
    bench.run()
    assert bench.chamber.prepared_first


def test_a_unit_that_leaves_its_position_during_a_collect_is_brought_back_and_collected_again(bench):
    """The first collect ends somewhere else: FAILED; the unit is indexed again before the second take."""

    class Slips(Progress):
        def update(self, snapshot):
            if snapshot.note == "sampling" and snapshot.step.key == "T1/S1/C1/collect" and snapshot.attempt == 1:
                bench.table.where = "2"

    outcome = bench.run(onlookers=[Slips()])
    assert outcome.state is SweepState.COMPLETE
    assert bench.table.moves[:3] == ["1", "1", "2"]
    first = next(result for key, _, result in bench.record.ends if key == "T1/S1/C1/collect")
    assert first.outcome is Outcome.FAILED
    assert "stood at position 2" in first.reason
    assert bench.collects()["T1/S1/C1/collect"]["verdict"] == "PASS"


def test_a_chamber_at_a_third_of_its_ramp_rate_still_arrives(bench):
    """The time allowed for a ramp grows with its length: an hour for 63 °C is slow, not a fault."""
    bench.chamber.ramp_degC_per_min = 1.05
    bench.sweep = replace(bench.sweep, temperatures_degC=(-40.0,))
    assert bench.run().state is SweepState.COMPLETE
    assert bench.record.results["T1/setpoint"].data["ramp_s"] > 3500.0


def test_a_soak_that_never_settles_is_collected_as_inconclusive_where_the_sweep_says_so(bench):
    """At the ceiling: collects are taken, none is PASS."""
    bench.chamber.offset_degC = lambda t: 0.7 * np.sin(t / 60.0)
    outcome = bench.run()
    assert outcome.state is SweepState.COMPLETE
    assert {data["verdict"] for data in bench.collects().values()} == {"INCONCLUSIVE"}
    assert {data["samples_verdict"] for data in bench.collects().values()} == {"PASS"}
    groups = bench.plan.self_calibrations
    assert self_calibration_verdict(groups[1], bench.record.results).verdict is Verdict.INCONCLUSIVE


def test_a_soak_that_never_settles_is_skipped_where_the_sweep_says_so(bench):
    """At the ceiling: TIMEOUT, its collects are skipped with the reason, the sweep goes on and ends incomplete."""
    soak = replace(bench.sweep.restabilisation, collect_at_ceiling=False)
    bench.sweep = replace(bench.sweep, restabilisation=soak)
    bench.chamber.offset_degC = lambda t: 0.7 * np.sin(t / 60.0) if t < 4000 else 0.0
    outcome = bench.run()
    assert outcome.state is SweepState.INCOMPLETE
    assert outcome.missing[0] == "T1/S1/restabilise"
    assert outcome.reason.startswith("5 steps not done, the first is T1/S1/restabilise: not restabilised")
    assert [result.outcome for _, _, result in bench.record.ends].count(Outcome.TIMEOUT) == 1
    assert list(bench.collects()) == ["T2/S1/C1/collect", "T2/S1/C2/collect"]
    assert bench.record.kinds().count("skipped") == 4
    assert bench.chamber.safe


def test_soaks_that_never_settle_end_the_night_after_three(bench):
    """A criterion never waits for ever, and neither do criteria in a row."""
    soak = replace(bench.sweep.restabilisation, collect_at_ceiling=False)
    bench.sweep = replace(bench.sweep, restabilisation=soak, self_calibrations=9)
    bench.chamber.offset_degC = lambda t: 0.7 * np.sin(t / 60.0)
    outcome = bench.run()
    assert outcome.state is SweepState.FAILED
    assert "3 soaks in a row" in outcome.reason
    assert bench.chamber.safe


@pytest.mark.slow
def test_the_published_night_costs_little_beyond_its_devices(bench):
    """Eight temperatures, three self-calibrations each: 24 self-calibrations and 72 collects, all PASS."""
    soak = replace(bench.sweep.restabilisation, at_least_s=2700.0, window_s=600.0, ceiling_s=14400.0)
    temperatures = (-29.7, -14.4, -6.8, 6.3, 23.4, 37.8, 48.9, 60.0)
    bench.sweep = replace(
        bench.sweep,
        temperatures_degC=temperatures,
        self_calibrations=3,
        positions=("1", "2", "3"),
        restabilisation=soak,
    )
    bench.polling = replace(bench.polling, interval_s=30.0, read_interval_s=30.0)
    outcome = bench.run()
    assert outcome.state is SweepState.COMPLETE
    assert len(bench.plan.of_kind(StepKind.COLLECT)) == len(bench.collects()) == 72
    groups = bench.plan.self_calibrations
    verdicts = [self_calibration_verdict(steps, bench.record.results) for steps in groups.values()]
    assert {each.verdict for each in verdicts} == {Verdict.PASS}
    assert len(verdicts) == 24
