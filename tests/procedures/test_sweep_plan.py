"""A plan is pure data: its keys, counts and times follow from the sweep alone."""

from __future__ import annotations

from dataclasses import replace

import pytest
from hypothesis import given
from hypothesis import strategies as st

from procedures.plan import StepKind, make_plan
from procedures.settings import CollectSettings, InterlockSettings, Polling, Restabilisation, SweepProcedure

SWEEPS = st.builds(
    SweepProcedure,
    title=st.just("any"),
    temperatures_degC=st.lists(st.floats(-60, 80), min_size=1, max_size=9).map(tuple),
    self_calibrations=st.integers(1, 4),
    positions=st.lists(st.sampled_from(["1", "2", "3", "4"]), min_size=1, max_size=6).map(tuple),
    ramp_degC_per_min=st.floats(0.1, 10),
    start_degC=st.floats(-20, 40),
    final_degC=st.none() | st.floats(15, 30),
)


@given(SWEEPS)
def test_keys_are_unique_indices_count_and_steps_follow_each_other(sweep):
    """Each step begins where the one before it ends; the total is the end of the last."""
    plan = make_plan(sweep)
    keys = [step.key for step in plan.steps]
    assert len(set(keys)) == len(keys)
    assert [step.index for step in plan.steps] == list(range(len(keys)))
    assert plan.steps[0].starts_s == 0.0
    for before, after in zip(plan.steps, plan.steps[1:], strict=False):
        assert after.starts_s == pytest.approx(before.starts_s + before.duration_s)
        assert after.starts_s >= before.starts_s
    assert plan.total_s == pytest.approx(sum(step.duration_s for step in plan.steps))
    assert plan.steps[0].kind is StepKind.IDENTIFY
    assert plan.steps[-1].kind is StepKind.SAFE_STATE


@given(SWEEPS)
def test_every_position_is_indexed_and_collected_in_order_in_every_self_calibration(sweep):
    """Self-calibrations are numbered 1, 2, … over the sweep; each restabilises first."""
    plan = make_plan(sweep)
    groups = plan.self_calibrations
    assert list(groups) == list(range(1, len(sweep.temperatures_degC) * sweep.self_calibrations + 1))
    for number, steps in groups.items():
        temperature = sweep.temperatures_degC[(number - 1) // sweep.self_calibrations]
        assert {step.temperature_degC for step in steps} == {temperature}
        assert steps[0].kind is StepKind.RESTABILISE
        assert [step.kind for step in steps[1:]] == [StepKind.INDEX, StepKind.COLLECT] * len(sweep.positions)
        assert [step.position for step in steps[1:]] == [p for p in sweep.positions for _ in range(2)]


@given(SWEEPS)
def test_the_same_sweep_gives_the_same_plan_and_its_steps_carry_their_settings(sweep):
    """A resume reads the plan again: nothing in it may depend on anything but the sweep."""
    plan = make_plan(sweep)
    assert plan == make_plan(replace(sweep))
    soak = plan.of_kind(StepKind.RESTABILISE)[0]
    collect = plan.of_kind(StepKind.COLLECT)[0]
    assert Restabilisation.from_parameters(soak.parameters) == sweep.restabilisation
    assert CollectSettings.from_parameters(collect.parameters) == sweep.collect


def test_the_published_sweep_has_24_self_calibrations_and_72_collects():
    """Eight temperatures by three self-calibrations by three positions; 18 hours of it are soak."""
    plan = make_plan(SweepProcedure("RD-GC-86-1", (-29.7, -14.4, -6.8, 6.3, 23.4, 37.8, 48.9, 60.0)))
    assert len(plan.self_calibrations) == 24
    assert len(plan.of_kind(StepKind.COLLECT)) == 72
    assert sum(step.duration_s for step in plan.of_kind(StepKind.RESTABILISE)) == 24 * 2700.0
    assert plan.steps[1].key == "T1/setpoint"
    assert plan.steps[1].duration_s == pytest.approx(60.0 * 52.7 / 3.0)
    assert plan.of_kind(StepKind.COLLECT)[-1].key == "T8/S3/C3/collect"


@pytest.mark.parametrize(
    ("make", "words"),
    [
        (lambda: Restabilisation(ceiling_s=60.0), "ceiling_s"),
        (lambda: Restabilisation(band_degC=0.0), "band_degC"),
        (lambda: Restabilisation(at_least_s=-1.0), "at_least_s"),
        (lambda: CollectSettings(duration_s=0.0), "duration_s"),
        (lambda: CollectSettings(minimum_fraction=1.1), "minimum_fraction"),
        (lambda: CollectSettings(attempts=0), "attempts"),
        (lambda: Polling(read_interval_s=0.0), "read_interval_s"),
        (lambda: InterlockSettings(unit_low_degC=100.0), "unit_low_degC"),
        (lambda: InterlockSettings(chamber_loss_s=-1.0), "chamber_loss_s"),
        (lambda: InterlockSettings(chamber_loss_s=float("inf")), "chamber_loss_s"),
    ],
)
def test_settings_that_make_no_sense_are_refused_by_name(make, words):
    """One sentence that names the setting."""
    with pytest.raises(ValueError, match=words):
        make()
