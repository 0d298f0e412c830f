"""A bench as Bluesky's devices: by its protocols without it, and under its own RunEngine where it is installed."""

from __future__ import annotations

import pytest

from drivers.errors import DeviceError, SetpointOutOfLimits
from hil.bench.bluesky import DeviceStatus, bluesky_devices
from hil.config import load_bench
from hil.errors import InputError

BENCH = load_bench("simulated")


def test_a_chamber_is_set_waited_for_and_left_safe() -> None:
    """At the temperature when the status says so; safe at the end of the block although nobody unstaged it."""
    with bluesky_devices(BENCH) as (chamber, _):
        seen: list[DeviceStatus] = []
        status = chamber.set(35.0)
        status.add_callback(seen.append)
        assert status.exception(60.0) is None
        status.add_callback(seen.append)
        assert status.success
        assert seen == [status, status]
        found = chamber.read()
        assert found["chamber"]["value"] == pytest.approx(35.0, abs=0.5)
        assert found["chamber_setpoint"]["value"] == 35.0
        assert chamber.describe()["chamber"]["units"] == "degC"
        assert chamber.describe()["chamber"]["source"].startswith("SIMULATED")
        assert isinstance(chamber.set(900.0).exception(60.0), SetpointOutOfLimits)
        assert chamber.ours
    assert not chamber.ours


def test_a_bench_of_several_units_is_refused() -> None:
    """Before anything is opened."""
    with pytest.raises(InputError, match="one unit; this one lists 4"), bluesky_devices(load_bench("simulated-four")):
        pass


def test_a_move_that_is_stopped_or_alarmed_fails_and_is_made_safe() -> None:
    """And does not go on in its thread."""
    with bluesky_devices(BENCH) as (chamber, _):
        chamber.held_s = 1e9
        status = chamber.set(35.0)
        chamber.stop()
        with pytest.raises(DeviceError, match="chamber: stopped"):
            raise status.exception(60.0) or AssertionError
        assert not chamber.ours
        status = chamber.set(35.0)
        chamber.stop(success=True)
        assert "stopped" in str(status.exception(60.0))
        chamber.timeout_s = 10.0
        assert "after 10 s" in str(chamber.set(60.0).exception(60.0))


def test_a_units_rates_are_averages_with_standard_errors() -> None:
    """Of each channel of each sensor, by names that Bluesky takes."""
    with bluesky_devices(BENCH) as (_, imu):
        imu.stage()
        assert imu.trigger().exception(60.0) is None
        found = imu.read()
        assert set(found) == set(imu.describe())
        assert {"imu_1_RA", "imu_1_RA_se", "imu_2_RB"} <= set(found)
        assert 0.1 < found["imu_1_RA_se"]["value"] < 20.0


@pytest.mark.slow
def test_a_plan_of_blueskys_runs_on_it() -> None:
    """Scanned by the real RunEngine, its documents against the schemas."""
    why = "bluesky is not installed; pip install bluesky to try its RunEngine"
    engine, plans = (pytest.importorskip(f"bluesky{name}", reason=why) for name in ("", ".plans"))
    protocols, model = pytest.importorskip("bluesky.protocols", reason=why), pytest.importorskip("event_model")
    documents = []
    with bluesky_devices(BENCH) as (chamber, imu):
        for kind in ("Movable", "Readable", "Stageable", "Stoppable", "HasHints"):
            assert isinstance(chamber, getattr(protocols, kind))
        assert isinstance(imu, protocols.Triggerable)
        engine.RunEngine({})(plans.scan([imu], chamber, 25.0, 35.0, 2), lambda *each: documents.append(each))
        assert not chamber.ours
    for name, document in documents:
        model.schema_validators[model.DocumentNames[name]].validate(document)
    assert [round(d["data"]["chamber_setpoint"]) for name, d in documents if name == "event"] == [25, 35]
