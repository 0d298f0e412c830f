"""What the bench file says about the IMU's stream reaches the decoder, and a real port is drained by a thread."""

from __future__ import annotations

import threading
from pathlib import Path

import pytest

from drivers.clock import SystemClock
from drivers.simulators.serve import DeviceServer
from drivers.transports import open_port
from hil.bench import build_bench
from hil.config import Bench, load_bench, parse_bench
from hil.errors import InputError
from tests.drivers.simulators.running import running

_STIM300 = load_bench("espec-stim300-example").text


def _stim300(parameters: str) -> Bench:
    text = _STIM300.replace("  rate: 125 Hz\n", f"  rate: 500 Hz\n  parameters: {parameters}\n")
    assert text != _STIM300
    return parse_bench(text, "my-bench.yaml")


def test_parameters_and_rate_of_the_bench_file_set_scales_and_counter() -> None:
    """A 10 g unit at 500 Hz: its accelerations count half as much, its counter moves by 4."""
    description = _stim300("{acceleration_range: 10 g, datagram: rate_acc_temp}").frames
    frame = description.frames["rate_acc_temp"]
    assert frame.fields["acc_x"].scale == 2.0**-19
    assert frame.counter is not None
    assert frame.counter.step == 4
    assert description.roles is not None
    assert description.roles.frame == "rate_acc_temp"
    assert description.roles.sensors[1].temperature == "gyro_temp_x"


def test_a_parameter_that_the_unit_does_not_have_is_bad_input() -> None:
    """With the description's file, the key and what there is."""
    with pytest.raises(
        InputError, match=r"stim300\.yaml: parameters\.range: there is no such parameter; there are: acc"
    ):
        _ = _stim300("{range: 10}").frames


def test_a_real_stream_is_drained_by_a_thread_that_ends_with_the_bench(tmp_path: Path) -> None:
    """Over a terminal; the simulated bench in this process has no thread at all."""
    simulated = load_bench("simulated")
    with build_bench(simulated) as served:
        before = set(threading.enumerate())
        assert served.simulators is not None
        devices = {"imu": served.simulators.imu, "chamber": served.simulators.chamber}
        with running(DeviceServer(devices, SystemClock())) as server:
            text = simulated.text.replace("clock: virtual", "clock: system")
            for name in devices:
                text = text.replace(f"sim://{name}", server.urls[name])
            during = set(threading.enumerate())
            with build_bench(parse_bench(text, "my-bench.yaml")) as live:
                readers = set(threading.enumerate()) - during
                assert [thread.name for thread in readers] == [f"reader of {server.urls['imu']}"]
                assert live.devices.imu.identify().model == simulated.unit.model
            assert set(threading.enumerate()) == during
            again = open_port(server.urls["imu"], clock=SystemClock())
            again.close()
        assert set(threading.enumerate()) == before
