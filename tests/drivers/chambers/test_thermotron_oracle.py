"""pymeasure's Thermotron client, by others, against our simulator, through a pseudo-terminal and without VISA."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any, Literal

import pytest
from pymeasure.adapters import SerialAdapter
from pymeasure.instruments.thermotron import thermotron3800

from drivers.clock import SystemClock
from drivers.simulators.chambers.described import SimulatedSetpointBox
from drivers.simulators.chambers.plant import ChamberPlant
from drivers.simulators.serve import DeviceServer
from tests.drivers.chambers.shipped import simulated_thermotron
from tests.drivers.simulators.running import running


@pytest.fixture(autouse=True)
def _without_its_pauses(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(thermotron3800, "sleep", lambda _: None)


@contextmanager
def _client(replies: Literal["echo", "code"]) -> Iterator[tuple[Any, SimulatedSetpointBox]]:
    device = simulated_thermotron(ChamberPlant(ambient_degC=23.5), replies=replies, latency_s=0.0)
    with running(DeviceServer({"chamber": device}, SystemClock())) as server:
        adapter = SerialAdapter(server.urls["chamber"], timeout=2.0, write_termination="\r", read_termination="\r")
        try:
            yield thermotron3800.Thermotron3800(adapter), device
        finally:
            adapter.connection.close()


def test_pymeasure_reads_our_thermotron() -> None:
    """Name, temperature, setpoint and mode."""
    with _client("code") as (client, _):
        assert client.id == "8800 SIMULATED"
        assert client.temperature == pytest.approx(23.5, abs=0.01)
        assert client.setpoint == 23.0
        assert client.mode == thermotron3800.Thermotron3800.Thermotron3800Mode.EDIT_MODE_STOP


def test_pymeasure_sets_runs_and_stops_our_thermotron() -> None:
    """It never reads what an operation answers: those replies are taken off the line between."""
    with _client("code") as (client, device):
        for act in (lambda: setattr(client, "setpoint", -30), client.run):
            act()
            assert client.adapter.read() == "0"
        assert client.mode == thermotron3800.Thermotron3800.Thermotron3800Mode.MANUAL_MODE
        assert client.setpoint == -30.0
        client.stop()
        assert client.adapter.read() == "0"
    assert (device.setpoint_degC, device.mode) == (-30.0, "OFF")
