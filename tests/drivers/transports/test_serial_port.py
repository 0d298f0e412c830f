"""Serial ports through real pyserial: pseudo-terminals, TCP, and everything that goes wrong with a port."""

from __future__ import annotations

import errno
import os
import select
import socket
import termios
import threading
from collections.abc import Iterator
from pathlib import Path

import pytest
import serial

from drivers.clock import SystemClock, VirtualClock
from drivers.errors import DeviceTimeout, TransportError
from drivers.imu.stream import StreamImu
from drivers.positioners.indexing import IndexingPositioner
from drivers.simulators.serve import DeviceServer
from drivers.simulators.unit import IndexSettings, SimulatedImu
from drivers.transports import open_port, serial_port
from drivers.transports.serial_port import SerialTransport
from tests.drivers.frames.streams import SteadyPhysics, mfs
from tests.drivers.simulators.running import running


@pytest.fixture
def nothing_leaks() -> Iterator[None]:
    """Fail the test where it leaves a descriptor or a thread behind."""
    descriptors, threads = set(os.listdir("/proc/self/fd")), set(threading.enumerate())
    yield
    assert set(threading.enumerate()) == threads
    left = {fd for fd in set(os.listdir("/proc/self/fd")) - descriptors if Path(f"/proc/self/fd/{fd}").exists()}
    assert not left


@pytest.fixture
def terminal() -> Iterator[tuple[int, str]]:
    """Return the far end of a pseudo-terminal and the path of the near end."""
    master, slave = os.openpty()
    path = os.ttyname(slave)
    yield master, path
    os.close(slave)
    os.close(master)


def arrived(master: int, data: bytes, transport: SerialTransport) -> None:
    """Send `data` from the far end, and wait until the system has it for the near one."""
    os.write(master, data)
    assert select.select([transport._port.fd], [], [], 10.0)[0]


@pytest.mark.usefixtures("nothing_leaks")
def test_bytes_go_both_ways_and_reads_leave_the_rest(terminal: tuple[int, str]) -> None:
    """Write, read a number of bytes, read to a terminator, read what is left."""
    master, path = terminal
    transport = open_port(path, clock=VirtualClock())
    transport.write(b"TEMP?\r\n")
    assert os.read(master, 100) == b"TEMP?\r\n"
    arrived(master, b"12.5,0.0\r\nrest", transport)
    assert transport.read(5, timeout_s=1.0) == b"12.5,"
    assert transport.read_until(b"\r\n", timeout_s=1.0) == b"0.0\r\n"
    assert transport.read_available() == b"rest"
    assert transport.read_available() == b""
    transport.close()
    transport.close()


def test_every_byte_value_passes_unchanged(terminal: tuple[int, str]) -> None:
    """No line discipline, no flow control characters."""
    master, path = terminal
    transport = open_port(path, clock=SystemClock())
    everything = bytes(range(256)) * 4
    os.write(master, everything)
    assert transport.read(len(everything), timeout_s=10.0) == everything
    transport.write(everything)
    assert os.read(master, 4096) == everything
    transport.close()


@pytest.mark.usefixtures("nothing_leaks")
def test_a_terminal_with_parity_can_be_opened_again(terminal: tuple[int, str]) -> None:
    """A simulated circulator has even parity too, and a second program comes after the first."""
    for _ in range(3):
        open_port(terminal[1], clock=SystemClock(), baudrate=4800, bytesize=7, parity="E").close()


def test_settings_that_the_system_refuses_are_said(terminal: tuple[int, str], monkeypatch: pytest.MonkeyPatch) -> None:
    """Some adapters have no parity: pyserial passes on an error of its own kind."""

    def refuses(*arguments: object) -> None:
        raise termios.error(errno.EINVAL, "Invalid argument")

    monkeypatch.setattr(termios, "tcsetattr", refuses)
    with pytest.raises(TransportError, match="does not accept these settings"):
        open_port(terminal[1], clock=SystemClock(), parity="E")


def test_deadlines_are_the_injected_clocks(terminal: tuple[int, str]) -> None:
    """A minute's time-out under a virtual clock costs nothing and moves that clock by a minute."""
    clock = VirtualClock()
    transport = open_port(terminal[1], clock=clock)
    assert transport.read(10, timeout_s=60.0) == b""
    assert clock.now() == pytest.approx(60.0)
    arrived(terminal[0], b"garbage", transport)
    with pytest.raises(DeviceTimeout, match=r"no b'\\n' within 5 s; what arrived: b'garbage'"):
        transport.read_until(b"\n", timeout_s=5.0)
    assert clock.now() == pytest.approx(65.0)
    transport.close()


def test_a_port_that_does_not_exist_lists_those_that_do(monkeypatch: pytest.MonkeyPatch) -> None:
    """The message is what a technician needs to correct the bench file."""
    monkeypatch.setattr(serial_port, "existing_ports", lambda: ["/dev/ttyUSB1", "/dev/ttyUSB3"])
    with pytest.raises(
        TransportError, match=r"/dev/ttyNONE: there is no such port; .* exist: /dev/ttyUSB1, /dev/ttyUSB3"
    ):
        open_port("/dev/ttyNONE", clock=VirtualClock())


def test_a_port_that_somebody_else_has_open_is_refused(terminal: tuple[int, str]) -> None:
    """Two programs on one port would steal each other's bytes."""
    first = open_port(terminal[1], clock=VirtualClock())
    with pytest.raises(TransportError, match="somebody else has the port open"):
        open_port(terminal[1], clock=VirtualClock())
    first.close()
    open_port(terminal[1], clock=VirtualClock()).close()


@pytest.mark.parametrize(
    ("number", "message"),
    [(errno.EACCES, "no permission; its group is tape"), (errno.EBUSY, "somebody else has the port open")],
)
def test_what_the_system_refuses_is_explained(number: int, message: str, monkeypatch: pytest.MonkeyPatch) -> None:
    """Permission and occupation have their own advice; who may open a port, its own group says."""

    def refuse(url: str, **settings: object) -> None:
        raise serial.SerialException(number, f"could not open port {url}")

    monkeypatch.setattr(serial, "serial_for_url", refuse)
    monkeypatch.setattr(Path, "group", lambda _: "tape")
    with pytest.raises(TransportError, match=f"/dev/ttyUSB0: .*{message}"):
        open_port("/dev/ttyUSB0", clock=VirtualClock())


@pytest.mark.parametrize("error", [KeyError(99), OSError(errno.ENOENT, "gone"), NotImplementedError()])
def test_a_port_whose_group_has_no_name_is_looked_up_by_hand(error: Exception, monkeypatch: pytest.MonkeyPatch) -> None:
    """A number in a container, a port that went meanwhile, a system on which ports are no files."""

    def refuse(url: str, **settings: object) -> None:
        raise serial.SerialException(errno.EACCES, f"could not open port {url}")

    def unknown(_: Path) -> str:
        raise error

    monkeypatch.setattr(serial, "serial_for_url", refuse)
    monkeypatch.setattr(Path, "group", unknown)
    with pytest.raises(TransportError, match="/dev/ttyUSB0: no permission; see whose it is"):
        open_port("/dev/ttyUSB0", clock=VirtualClock())


def test_a_url_that_cannot_be_opened_says_what_to_write(tmp_path: Path) -> None:
    """A server that is not there, a scheme that does not exist, and a file that is no port."""
    with socket.create_server(("127.0.0.1", 0)) as held:
        port = held.getsockname()[1]
    with pytest.raises(TransportError, match=f"socket://127.0.0.1:{port}: cannot be reached"):
        open_port(f"socket://127.0.0.1:{port}", clock=VirtualClock())
    with pytest.raises(TransportError, match="carrier-pigeon://loft: is not a port; write a device path, socket://"):
        open_port("carrier-pigeon://loft", clock=VirtualClock())
    (tmp_path / "file").write_bytes(b"")
    with pytest.raises(TransportError, match=r"file: cannot be opened .* is it a serial port"):
        open_port(str(tmp_path / "file"), clock=VirtualClock())


def test_a_port_that_is_unplugged_fails_and_works_again_when_it_is_back(tmp_path: Path) -> None:
    """The same transport survives; the path stays, as a udev link does."""
    link = tmp_path / "imu"
    master, slave = os.openpty()
    link.symlink_to(os.ttyname(slave))
    transport = open_port(str(link), clock=VirtualClock())
    os.close(slave)
    os.close(master)
    with pytest.raises(TransportError, match=r"imu: the port failed .* check its cable"):
        transport.read_available()
    link.unlink()
    with pytest.raises(TransportError, match="there is no such port"):
        transport.write(b"x")
    master, slave = os.openpty()
    link.symlink_to(os.ttyname(slave))
    transport.write(b"back")
    assert os.read(master, 10) == b"back"
    transport.close()
    with pytest.raises(TransportError, match="the port is closed"):
        transport.write(b"x")
    os.close(slave)
    os.close(master)


def test_a_server_that_hangs_up_is_an_error_not_silence() -> None:
    """An end of the connection would otherwise look like a unit that says nothing."""
    with socket.create_server(("127.0.0.1", 0)) as listener:
        transport = open_port(f"socket://127.0.0.1:{listener.getsockname()[1]}", clock=SystemClock())
        client, _ = listener.accept()
        client.sendall(b"hello")
        assert transport.read(5, timeout_s=10.0) == b"hello"
        client.close()
        with pytest.raises(TransportError, match="the port failed"):
            transport.read(1, timeout_s=10.0)
        transport.close()


class Echo:
    """Sends back what it receives, in capitals; `fails` makes it raise."""

    def __init__(self) -> None:
        self.fails = False
        self._waiting = b""

    def receive(self, data: bytes, now_s: float) -> None:
        """Remember it."""
        self._waiting += data.upper()

    def transmit(self, now_s: float) -> bytes:
        """Send it back."""
        if self.fails:
            raise RuntimeError("the simulated device is broken")
        sent, self._waiting = self._waiting, b""
        return sent

    def next_transmission(self, now_s: float) -> float | None:
        """Nothing by itself."""
        return None


@pytest.mark.usefixtures("nothing_leaks")
def test_devices_are_served_on_terminals_and_on_tcp_and_clients_may_come_again() -> None:
    """Two devices in one loop; a client that left is followed by another."""
    clock = SystemClock()
    with running(DeviceServer({"pty": Echo(), "tcp": Echo()}, clock, tcp_ports={"tcp": 0})) as server:
        for _ in range(2):
            for name in ("pty", "tcp"):
                transport = open_port(server.urls[name], clock=clock)
                transport.write(b"hello\n")
                assert transport.read_until(b"\n", timeout_s=10.0) == b"HELLO\n"
                transport.close()
        assert server.urls["tcp"].startswith("socket://127.0.0.1:")


@pytest.mark.usefixtures("nothing_leaks")
def test_a_large_answer_reaches_a_slow_client_completely() -> None:
    """What does not fit in the line waits for the client."""
    clock = SystemClock()
    with running(DeviceServer({"pty": Echo(), "tcp": Echo()}, clock, tcp_ports={"tcp": 0})) as server:
        for name in ("pty", "tcp"):
            transport = open_port(server.urls[name], clock=clock)
            for number in range(20):
                transport.write(bytes([97 + number]) * 2000)
            clock.sleep(0.05)
            received = transport.read(40000, timeout_s=10.0)
            assert received == b"".join(bytes([65 + number]) * 2000 for number in range(20))
            transport.close()


@pytest.mark.usefixtures("nothing_leaks")
def test_an_error_in_a_simulated_device_ends_the_server() -> None:
    """And everything is released."""
    echo = Echo()
    echo.fails = True
    with pytest.raises(RuntimeError, match="is broken"):
        DeviceServer({"echo": echo}, SystemClock()).run()


@pytest.mark.usefixtures("nothing_leaks")
def test_a_server_that_was_never_started_and_one_whose_port_is_taken_release_everything() -> None:
    """Every way out closes the descriptors."""
    DeviceServer({"echo": Echo()}, SystemClock()).close()
    with socket.create_server(("127.0.0.1", 0)) as held, pytest.raises(OSError, match=r"[Aa]ddress already in use"):
        DeviceServer({"a": Echo(), "b": Echo()}, SystemClock(), tcp_ports={"b": held.getsockname()[1]})


@pytest.mark.usefixtures("nothing_leaks")
@pytest.mark.parametrize("tcp_ports", [{}, {"imu": 0}], ids=["pty", "tcp"])
def test_a_simulated_unit_is_identified_indexed_and_read_through_real_pyserial(tcp_ports: dict[str, int]) -> None:
    """The production driver at a real port, under the system clock, without losing a frame."""
    clock = SystemClock()
    device = SimulatedImu(mfs(500.0), SteadyPhysics(), starts_s=clock.now())
    with running(DeviceServer({"imu": device}, clock, tcp_ports=tcp_ports)) as server:
        imu = StreamImu(open_port(server.urls["imu"], clock=clock), mfs(500.0), clock)
        assert imu.identify().serial == "SIM-0001"
        imu.discard()
        blocks = []
        for _ in range(5):
            clock.sleep(0.05)
            blocks.append(imu.read_block())
        imu.close()
    assert sum(len(block) for block in blocks) > 50
    assert sum(block.counts.lost + block.counts.bad_checksum for block in blocks) == 0


@pytest.mark.usefixtures("nothing_leaks")
def test_a_simulated_unit_indexes_through_real_pyserial() -> None:
    """Command out, status back, position confirmed."""
    clock = SystemClock()
    index = {"1": 1, "2": 2}
    device = SimulatedImu(
        mfs(200.0), SteadyPhysics(), starts_s=clock.now(), index=IndexSettings(index, "1", move_s=0.1)
    )
    with running(DeviceServer({"imu": device}, clock)) as server:
        imu = StreamImu(open_port(server.urls["imu"], clock=clock), mfs(200.0), clock)
        positioner = IndexingPositioner(imu, clock, index, poll_s=0.02, confirm_s=0.05, reaction_s=0.05)
        positioner.move_to("2", timeout_s=20.0)
        assert positioner.position() == "2"
        imu.close()
