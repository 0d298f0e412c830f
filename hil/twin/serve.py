"""The simulated devices of a bench for any client, on pseudo-terminals or TCP ports, in real time.

Where the bench file names a simulated port (`sim://imu`), the device gets a pseudo-terminal of the system's choosing;
where it names a path, the terminal appears there; where it names `socket://host:port`, that TCP port is served. One
chamber, one unit, one air between them, as in process.
"""

import json
import os
import signal
from collections.abc import Callable, Iterator, Mapping
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass
from pathlib import Path
from urllib.parse import urlsplit

from drivers.clock import SystemClock
from drivers.simulators import SimulatedDevice
from drivers.simulators.serve import DeviceServer
from hil.config.bench import Bench
from hil.config.ports import SIMULATED_SCHEME, unit_port
from hil.errors import InputError, worded
from hil.twin.devices import FaultInjector, SimulatedBench, simulate_devices

# Windows has no terminals to close.
_SIGNALS = (signal.SIGINT, signal.SIGTERM, getattr(signal, "SIGHUP", signal.SIGTERM))
_HOST = "127.0.0.1"


@dataclass(frozen=True)
class Simulation:
    """What a client opens, by device (chamber; imu, or of several units imu-SERIAL), and the devices served."""

    bench: Bench
    ports: Mapping[str, str]
    devices: SimulatedBench


def serve_bench(bench: Bench, announce: Callable[[str], None], *, tcp: bool = False) -> None:
    """Serve, in the main thread, until a signal ends it; one JSON line tells where. Raises as `serving` does."""
    with serving(bench, tcp=tcp) as (server, simulation):
        former = {number: signal.signal(number, lambda *_: server.interrupt()) for number in _SIGNALS}
        try:
            said = {"schema": "hil.simulate/1", "bench": bench.name, "simulated": True, "ports": dict(simulation.ports)}
            announce(json.dumps(said))
            server.run()
        finally:
            for number, handler in former.items():
                signal.signal(number, handler)


@contextmanager
def serving(bench: Bench, *, tcp: bool) -> Iterator[tuple[DeviceServer, Simulation]]:
    """Give what serves a bench's devices, and what a client opens.

    `tcp` gives simulated ports a free TCP port instead of a terminal. Raises `InputError` where the bench has nothing
    to simulate, or one of its ports cannot be served.
    """
    clock = SystemClock()
    devices = simulate_devices(bench, begins_s=clock.now())
    FaultInjector(bench.faults, clock).inject(devices, {})
    wanted = {f"imu-{name}" if name else "imu": (unit_port(name), own.imu.port) for name, own in bench.each.items()}
    wanted["chamber"] = "chamber.port", bench.chamber.port
    there: list[SimulatedDevice] = [*devices.imus.values(), devices.chamber]
    host, tcp_ports = _tcp_ports(bench, wanted, tcp=tcp)
    with ExitStack() as stack:
        where = ", ".join(port for _, port in wanted.values())
        with worded(InputError, f"{bench.source}: {where} cannot be served: ", OSError):
            server = DeviceServer(dict(zip(wanted, there, strict=True)), clock, tcp_ports=tcp_ports, host=host)
        stack.callback(server.close)
        ports = dict(server.urls)
        for device, (key, port) in wanted.items():
            if "://" not in port:
                stack.callback(_link(bench, key, Path(port), Path(ports[device])))
                ports[device] = port
        yield server, Simulation(bench, ports, devices)


def _tcp_ports(bench: Bench, wanted: Mapping[str, tuple[str, str]], *, tcp: bool) -> tuple[str, dict[str, int]]:
    hosts, numbers = set(), {}
    for device, (key, url) in wanted.items():
        if url.startswith("rfc2217://"):
            raise InputError(f"{bench.source}: {key}: {url} cannot be simulated; write socket://host:port")
        if url.startswith("socket://"):
            parts = urlsplit(url)
            hosts.add(parts.hostname or _HOST)
            numbers[device] = parts.port or 0
        elif tcp and url.startswith(SIMULATED_SCHEME):
            numbers[device] = 0
    if len(hosts) > 1:
        raise InputError(f"{bench.source}: the ports name different hosts; one program serves one host")
    return (hosts.pop() if hosts else _HOST), numbers


def _link(bench: Bench, key: str, path: Path, terminal: Path) -> Callable[[], None]:
    """Let `path` lead to the terminal; return what undoes it."""
    # A link that a killed server left behind: its terminal is gone, or its number has a new owner since.
    if path.is_symlink() and (not path.exists() or path.stat().st_ctime_ns > path.lstat().st_ctime_ns):
        path.unlink()
    try:
        path.symlink_to(terminal)
    except FileExistsError as error:
        raise InputError(
            f"{bench.source}: {key}: {path} is there already: a real port, or another simulation; stop that one, or "
            "delete what it left"
        ) from error
    except OSError as error:
        raise InputError(f"{bench.source}: {key}: {path} cannot be made ({error.strerror})") from error

    def undo() -> None:
        if path.is_symlink() and os.readlink(path) == str(terminal):
            path.unlink()

    return undo
