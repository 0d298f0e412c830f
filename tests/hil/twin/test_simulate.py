"""The simulated devices of a bench, served to clients through real ports in real time."""

from __future__ import annotations

import json
import signal
import socket
import subprocess
import sys
from pathlib import Path

import pytest
import serial

from drivers.errors import WrongDevice
from hil.bench import build_bench
from hil.config import Bench, load_bench, parse_bench
from hil.errors import InputError
from tests.hil.twin.serving import client_bench, served

_SIMULATED = load_bench("simulated")
_PTY = load_bench("simulated-pty")


def _at(imu: object, chamber: object) -> Bench:
    text = _PTY.text.replace("/tmp/hil-imu", str(imu)).replace("/tmp/hil-chamber", str(chamber))  # noqa: S108
    return parse_bench(text, "my-bench.yaml")


@pytest.mark.parametrize("tcp", [False, pytest.param(True, marks=pytest.mark.slow)])
def test_a_client_gets_frames_and_chamber_replies_through_pyserial(tcp: bool) -> None:
    """The production drivers on a pseudo-terminal or a TCP port, against the same devices as in process."""
    with served(_SIMULATED, tcp=tcp) as simulation:
        assert all(port.startswith("socket://" if tcp else "/dev/") for port in simulation.ports.values())
        bench = client_bench(_SIMULATED, simulation.ports)
        assert bench.simulated
        assert (bench.clock, bench.polling.read_interval_s) == ("system", 0.5)
        with build_bench(bench) as live:
            assert live.simulators is None
            assert live.devices.imu.identify().serial == "SIM-0001"
            assert "SIMULATED" in live.devices.chamber.identify().model
            live.devices.imu.discard()
            live.devices.clock.sleep(0.5)
            block = live.devices.imu.read_block()
    assert 5 <= len(block) <= 15
    assert block.counts.ok == len(block)
    assert block.fields["accel_A1"].mean() == pytest.approx(1.0, abs=0.01)  # at position 3, sensor 1's A points up


def test_another_unit_on_the_port_is_refused() -> None:
    """The bench file says which one belongs there."""
    with served(_SIMULATED) as simulation:
        client = client_bench(_SIMULATED, simulation.ports)
        other = parse_bench(client.text.replace("SIM-0001", "SIM-0002"), "my-bench.yaml")
        with build_bench(other) as live, pytest.raises(WrongDevice, match="SIM-0002"):
            live.devices.imu.identify()


def test_any_serial_program_can_talk_to_the_chamber() -> None:
    """Plain pyserial, no driver of ours."""
    with served(_SIMULATED) as simulation, serial.Serial(simulation.ports["chamber"], timeout=2.0) as port:
        port.write(b"TEMP?\r\n")
        assert port.read_until(b"\r\n") == b"23.0,23.0,105.0,-75.0\r\n"


def test_paths_of_the_bench_file_lead_to_the_terminals_while_they_are_served(tmp_path: Path) -> None:
    """And are gone afterwards."""
    bench = _at(tmp_path / "imu", tmp_path / "chamber")
    with served(bench) as simulation:
        assert simulation.ports == {"imu": str(tmp_path / "imu"), "chamber": str(tmp_path / "chamber")}
        with serial.Serial(str(tmp_path / "imu"), timeout=2.0) as port:
            assert port.read_until(b"\xa5\x5a").endswith(b"\xa5\x5a")
    assert list(tmp_path.iterdir()) == []


def test_a_path_that_a_killed_server_left_behind_is_used_again(tmp_path: Path) -> None:
    """It leads nowhere."""
    (tmp_path / "imu").symlink_to("/dev/pts/nowhere")
    with served(_at(tmp_path / "imu", tmp_path / "chamber")):
        assert (tmp_path / "imu").exists()


@pytest.mark.parametrize("other", ["file", "link"])
def test_a_path_that_somebody_else_has_is_left_alone(other: str, tmp_path: Path) -> None:
    """A real port, or another server's: the sentence says what to do, and nothing is left of the attempt."""
    taken = tmp_path / "chamber"
    if other == "file":
        taken.touch()
    else:
        taken.symlink_to(sys.executable)
    with (
        pytest.raises(InputError, match=r"my-bench\.yaml: chamber\.port: .* is there already"),
        served(_at(tmp_path / "imu", taken)),
    ):
        pass
    assert [path.name for path in tmp_path.iterdir()] == ["chamber"]


def test_a_tcp_port_that_is_taken_is_bad_input() -> None:
    """With its number."""
    with socket.create_server(("127.0.0.1", 0)) as taken:
        url = f"socket://127.0.0.1:{taken.getsockname()[1]}"
        with pytest.raises(InputError, match=f"{url}.* cannot be served"), served(_at("/nowhere/imu", url)):
            pass


@pytest.mark.parametrize(
    ("imu", "chamber", "message"),
    [
        ("rfc2217://127.0.0.1:1", "/nowhere/x", r"imu\.port: rfc2217://127\.0\.0\.1:1 cannot be simulated"),
        ("socket://127.0.0.1:1", "socket://127.0.0.2:1", "name different hosts"),
        ("/nowhere/imu", "/nowhere/chamber", r"imu\.port: /nowhere/imu cannot be made"),
    ],
)
def test_ports_that_cannot_be_served_are_bad_input(imu: str, chamber: str, message: str) -> None:
    """One sentence each."""
    with pytest.raises(InputError, match=message), served(_at(imu, chamber)):
        pass


def test_a_real_bench_cannot_be_simulated() -> None:
    """It says nothing about what to simulate."""
    text = _PTY.text[: _PTY.text.index("simulation:")]
    with pytest.raises(InputError, match="there is no simulation section"), served(parse_bench(text, "b")):
        pass


@pytest.mark.slow
@pytest.mark.parametrize(
    "number", [*(pytest.param(each, marks=pytest.mark.slow) for each in (signal.SIGTERM, signal.SIGHUP)), signal.SIGINT]
)
def test_serving_says_where_in_one_json_line_and_ends_at_a_signal(number: signal.Signals, tmp_path: Path) -> None:
    """What `hil simulate` does: the terminals are gone when it has ended, and it ends well."""
    (tmp_path / "bench.yaml").write_text(_at(tmp_path / "imu", tmp_path / "chamber").text)
    program = (
        "import sys; from hil.config import load_bench; from hil.twin.serve import serve_bench\n"
        "serve_bench(load_bench(sys.argv[1]), lambda line: print(line, flush=True))"
    )
    command = [sys.executable, "-c", program, str(tmp_path / "bench.yaml")]
    with subprocess.Popen(command, stdout=subprocess.PIPE, text=True) as process:
        assert process.stdout is not None
        document = json.loads(process.stdout.readline())
        assert document == {
            "schema": "hil.simulate/1",
            "bench": "simulated-pty",
            "simulated": True,
            "ports": {"imu": str(tmp_path / "imu"), "chamber": str(tmp_path / "chamber")},
        }
        assert (tmp_path / "imu").exists()
        process.send_signal(number)
        assert process.wait(timeout=20) == 0
        assert process.stdout.read() == ""
    assert not (tmp_path / "imu").is_symlink()
