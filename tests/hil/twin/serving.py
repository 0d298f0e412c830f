"""Devices that are served from a thread, and the bench as a client of them has it."""

from collections.abc import Iterator, Mapping
from contextlib import contextmanager

import yaml

from hil.config.bench import Bench, parse_bench
from hil.files.strict import parse_yaml
from hil.twin.serve import Simulation, serving
from tests.drivers.simulators.running import running


@contextmanager
def served(bench: Bench, *, tcp: bool = False) -> Iterator[Simulation]:
    """Serve a bench's devices from a thread for as long as the context lasts."""
    with serving(bench, tcp=tcp) as (server, simulation), running(server):
        yield simulation


def client_bench(bench: Bench, ports: Mapping[str, str]) -> Bench:
    """Return the bench as a client of served devices has it: their ports, the computer's clock, live polling."""
    document = parse_yaml(bench.text, bench.source)
    document["clock"] = "system"
    document.pop("polling", None)
    document.pop("faults", None)  # they happen to the devices, which the server has
    sections = {"imu": document["imu"], "chamber": document["chamber"]}
    sections |= {f"imu-{name}": own for name, own in zip(bench.units, document.get("units", ()), strict=True)}
    for device, port in ports.items():
        sections[device]["port"] = port
    return parse_bench(yaml.safe_dump(document, sort_keys=False, allow_unicode=True), bench.source)
