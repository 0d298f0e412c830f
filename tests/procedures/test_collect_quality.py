"""What makes a collect good: enough samples, a unit that stands still, values that are being measured."""

from __future__ import annotations

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest

from drivers.frames.counts import StreamCounts
from drivers.frames.roles import SensorRole
from drivers.imu import SampleBlock
from procedures.collect import join, reduce_collect
from procedures.quality import longest_run, missing_in_gaps, moved, not_measured, slope_per_min
from procedures.settings import CollectSettings

N, HZ = 1200, 20.0
IMU = SimpleNamespace(
    sensors={
        2: SensorRole(
            rates={"RA": "ra", "RB": "rb"},
            accelerations={"A": "aa", "S": "as"},
            temperature="t2",
            conditions={"spin_period_us": "spin"},
        ),
        1: SensorRole(rates={"RA": "ra1"}),
    },
    conditions={"supply_V": "supply"},
    sample_rate_hz=HZ,
)
SETTINGS = CollectSettings()


def _samples(**changes):
    rng = np.random.default_rng(5)
    fields = {name: 3.0 * rng.standard_normal(N) for name in ("ra", "rb", "ra1")}
    fields |= {"aa": -1.0 + 0.001 * rng.standard_normal(N), "as": 0.001 * rng.standard_normal(N)}
    fields |= {"t2": 20.0 + np.arange(N) / HZ / 60.0 * 0.03, "spin": np.full(N, 1e4), "supply": np.full(N, 28.0)}
    fields |= {"index_position": np.ones(N)}
    counts = changes.pop("counts", StreamCounts(ok=N))
    return SampleBlock(np.arange(N) / HZ, fields | changes, counts, b"raw", 60.0)


def _keep(block, kept):
    return replace(block, time_s=block.time_s[kept], fields={k: v[kept] for k, v in block.fields.items()})


def _judge(block, duration_s=60.0):
    data, judgement = reduce_collect(block, duration_s, IMU, SETTINGS)
    return data, judgement.verdict.value, judgement.reason


def test_a_good_collect_passes_with_all_its_numbers():
    """Means, errors, slope of the temperature, conditions, by the names the campaign uses."""
    data, verdict, _ = _judge(_samples())
    assert verdict == "PASS"
    sensor = data["sensors"]["2"]
    assert set(sensor["rates"]) == {"RA", "RB"}
    assert sensor["rates"]["RA"]["se_deg_per_hr"] == pytest.approx(3.0 / np.sqrt(N), rel=0.1)
    assert sensor["accelerations"]["A"] == pytest.approx(-1.0, abs=1e-4)
    assert sensor["dTdt_degC_per_min"] == pytest.approx(0.03)
    assert sensor["conditions"] == {"spin_period_us": 1e4}
    assert data["sensors"]["1"]["temperature_degC"] is None
    assert data["sensors"]["1"]["dTdt_degC_per_min"] is None
    assert data["conditions"] == {"supply_V": 28.0}
    assert (data["n_samples"], data["n_expected"], data["n_missing"]) == (N, N, 0)


def test_a_rate_that_rises_has_a_drift_that_is_positive():
    """By 12 deg/hr in each minute in the one channel; the other falls by half as much."""
    rises = 12.0 * np.arange(N) / HZ / 60.0
    block = _samples()
    rates = _judge(replace(block, fields=block.fields | {"ra": block.fields["ra"] + rises, "rb": -0.5 * rises}))[0]
    drift = {channel: of["drift_deg_per_hr_per_min"] for channel, of in rates["sensors"]["2"]["rates"].items()}
    assert drift == {"RA": pytest.approx(12.0, abs=1.5), "RB": pytest.approx(-6.0)}


def test_a_single_rate_that_is_no_number_is_missing():
    """Too few for their number to differ, with neither a gap nor a count."""
    rates = _samples().fields["ra"].copy()
    rates[700] = np.nan
    data, *_ = _judge(_samples(ra=rates))
    assert (data["n_samples"], data["n_missing"]) == (N - 1, 1)


def test_a_few_missing_samples_are_marginal_and_many_inconclusive():
    """Counted from the gap in time although the counter was not seen."""
    data, verdict, reason = _judge(_keep(_samples(), np.r_[0:500, 510:N]))
    assert (data["n_missing"], verdict) == (10, "MARGINAL")
    assert "10 of 1200" in reason
    data, verdict, _ = _judge(_keep(_samples(), np.r_[0:500, 600:N]))
    assert (data["n_missing"], verdict) == (100, "INCONCLUSIVE")


def test_the_units_own_counter_counts_too():
    """Lost frames by the counter, although the times show no gap."""
    data, verdict, reason = _judge(_samples(counts=StreamCounts(ok=N, lost=90, bad_checksum=7)))
    assert (data["n_missing"], verdict) == (90, "INCONCLUSIVE")
    assert "7 frames damaged" in reason
    assert data["counts"]["lost"] == 90


def test_samples_missing_at_the_end_count():
    """A stream that stops leaves no gap behind it, and says nothing of the unit's rate."""
    data, verdict, reason = _judge(_keep(_samples(), np.r_[0:900]))
    assert (data["n_missing"], verdict) == (300, "INCONCLUSIVE")
    assert reason.startswith("300 of 1200 samples are missing")
    slow = _judge(_keep(_samples(), np.r_[0:N:2]))[2]
    assert slow.startswith("600 of 1200 expected samples: the unit sends at 10 Hz, the description says 20; write its")


def test_a_rate_that_is_not_a_number_is_a_missing_sample():
    """It is neither zero nor part of the mean."""
    bad = _samples()
    bad.fields["rb"][100:130] = np.nan
    data, verdict, _ = _judge(bad)
    assert (data["n_samples"], data["n_missing"], verdict) == (N - 30, 30, "MARGINAL")
    assert np.isfinite(data["sensors"]["2"]["rates"]["RB"]["mean_deg_per_hr"])


def test_no_samples_at_all_are_inconclusive_with_nulls_instead_of_numbers():
    """Nothing measured is not zero measured."""
    data, verdict, _ = _judge(_keep(_samples(), np.r_[0:0]))
    assert verdict == "INCONCLUSIVE"
    assert data["sensors"]["2"]["rates"]["RA"]["mean_deg_per_hr"] is None
    assert data["conditions"]["supply_V"] is None


@pytest.mark.parametrize(("slope", "expected"), [(2.0, "PASS"), (7.0, "MARGINAL"), (14.0, "FAIL"), (-14.0, "FAIL")])
def test_a_drift_is_judged_by_its_size_where_it_is_significant(slope, expected):
    """Limit 10 deg/hr per minute; half of it is worth a look."""
    block = _samples()
    block.fields["ra"][:] += slope * block.time_s / 60.0
    _, verdict, reason = _judge(block)
    assert verdict == expected
    if expected != "PASS":
        assert "sensor 2 RA drifts" in reason


def test_a_drift_within_the_noise_is_none():
    """Noise of 300 deg/hr per sample gives slopes of tens of deg/hr per minute that mean nothing."""
    rng = np.random.default_rng(6)
    verdicts = {_judge(_samples(ra=300.0 * rng.standard_normal(N)))[1] for _ in range(50)}
    assert verdicts == {"PASS"}


def test_a_step_of_an_accelerometer_is_motion():
    """0.02 g for the last third; the reason names sensor and size."""
    block = _samples()
    block.fields["as"][800:] += 0.02
    _, verdict, reason = _judge(block)
    assert verdict == "FAIL"
    assert "sensor 2 moved: 0.02" in reason


def test_a_knock_of_one_second_is_motion():
    """However short in comparison with the collect."""
    block = _samples()
    block.fields["aa"][400:420] += 0.05
    assert _judge(block)[1] == "FAIL"


def test_leaving_the_index_position_is_motion():
    """The unit says in every frame where it stands."""
    block = _samples()
    block.fields["index_position"][600:] = 2.0
    _, verdict, reason = _judge(block)
    assert (verdict, "index position" in reason) == ("FAIL", True)


def test_a_frozen_rate_is_not_being_measured():
    """The same value for seven seconds."""
    block = _samples()
    block.fields["rb"][300:440] = block.fields["rb"][300]
    _, verdict, reason = _judge(block)
    assert verdict == "FAIL"
    assert "sensor 2 RB did not change for 140 samples" in reason


def test_a_clipped_rate_is_noticed():
    """At its upper and at its lower end."""
    for clip in (np.minimum, lambda x, limit: np.maximum(x, -limit)):
        block = _samples()
        block.fields["ra"][:] = clip(block.fields["ra"], 6.0)
        _, verdict, reason = _judge(block)
        assert verdict == "FAIL"
        assert "clipped at" in reason


def test_coarse_quantisation_is_neither_frozen_nor_clipped():
    """A unit with a large step still measures."""
    rng = np.random.default_rng(7)
    for step in (0.5, 1.0, 2.0, 4.0):
        values = np.round(3.0 * rng.standard_normal(N) / step) * step
        assert not_measured(values, frozen=len(values)) is None, step


def test_runs_gaps_and_slopes_of_edge_cases():
    """Empty, single and bunched."""
    assert longest_run(np.empty(0)) == 0
    assert longest_run(np.array([1.0])) == 1
    assert longest_run(np.array([1.0, 1.0, 2.0, 2.0, 2.0, 1.0])) == 3
    assert missing_in_gaps(np.array([0.0]), HZ) == 0
    assert missing_in_gaps(np.array([0.0, 0.05, 0.30, 0.35]), HZ) == 4
    bunched = np.array([0.0, 0.05, 0.30, 0.301, 0.302, 0.303, 0.304, 0.35])
    assert missing_in_gaps(bunched, HZ) == 0
    assert slope_per_min(np.array([0.0]), np.array([1.0])) is None
    assert slope_per_min(np.array([1.0, 1.0]), np.array([1.0, 2.0])) is None
    assert slope_per_min(np.array([0.0, 30.0, 60.0]), np.array([1.0, np.nan, 3.0])) == pytest.approx(2.0)
    assert moved(np.empty((0, 2)), HZ, 0.005) == (0.0, False)
    assert moved(np.empty((50, 0)), HZ, 0.005) == (0.0, False)


def test_blocks_join_to_what_they_were_read_from():
    """Samples, counts and bytes add up; an empty block between changes nothing."""
    whole = _samples()
    empty = SampleBlock(np.empty(0), {}, StreamCounts(bad_checksum=2), b"-")
    joined = join([_keep(whole, np.r_[0:700]), empty, _keep(whole, np.r_[700:N])])
    np.testing.assert_array_equal(joined.time_s, whole.time_s)
    np.testing.assert_array_equal(joined.fields["ra"], whole.fields["ra"])
    assert joined.counts == StreamCounts(ok=2 * N, bad_checksum=2)
    assert joined.raw == b"raw-raw"
    assert len(join([])) == 0


def test_frames_that_came_twice_count_once_and_are_said():
    """A few are nothing; a share of them is worth a look."""
    _, verdict, reason = _judge(_samples(counts=StreamCounts(ok=N, duplicate=N)))
    assert verdict == "MARGINAL"
    assert f"{N} frames that came twice" in reason
    assert _judge(_samples(counts=StreamCounts(ok=N, duplicate=2)))[1] == "PASS"
