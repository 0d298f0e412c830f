"""What a laboratory copies on Monday works: example bench files, and every block of YAML in the wiring guides."""

from __future__ import annotations

import errno
import re
from pathlib import Path
from typing import Any

import pytest
import serial
import yaml

from drivers.chambers import CHAMBER_DRIVERS
from drivers.clock import VirtualClock
from drivers.errors import TransportError
from drivers.frames.description import StreamDescription, whole_text
from drivers.transports import open_port
from hil.bench import build_bench
from hil.bench.advice import closed_port_advice
from hil.config import Bench, load_bench, load_sweep, parse_bench
from hil.files.strict import config_folders

_ROOT = Path(__file__).parents[3]
_SIMULATED: dict[str, Any] = yaml.safe_load(load_bench("simulated").text)
_EXAMPLES = sorted(path.stem for folder in config_folders("benches") for path in folder.glob("*-example.yaml"))


def blocks(guide: str, section: str) -> list[dict[str, Any]]:
    """The YAML blocks of a guide that are a section of a bench file."""
    text = (_ROOT / "docs" / "how-to" / guide).read_text()
    found = [yaml.safe_load(block) for block in re.findall(r"```yaml\n(.*?)```", text, re.DOTALL)]
    return [block[section] for block in found if section in block]


def bench_around(**sections: Any) -> Bench:
    """The simulated bench with other sections."""
    return parse_bench(yaml.safe_dump({**_SIMULATED, **sections}), "guide.yaml")


def with_simulated_chamber(section: dict[str, Any]) -> Bench:
    """The simulated bench with this chamber, which is simulated too."""
    simulated = section | {"port": "sim://chamber"}
    if simulated["driver"] == "espec":
        simulated["model"] = "P3"  # whom the simulated ESPEC is
    return bench_around(chamber=simulated)


_CHAMBERS = [
    *blocks("wire-a-chamber.md", "chamber"),
    *(yaml.safe_load(load_bench(name).text)["chamber"] for name in _EXAMPLES),
]


def test_there_is_a_block_for_every_driver() -> None:
    """A chamber that has a driver has a section that says how it is wired, and an example beside ESPEC's."""
    assert {block["driver"] for block in blocks("wire-a-chamber.md", "chamber")} == set(CHAMBER_DRIVERS) - {"box"}
    assert len(_EXAMPLES) >= 3


@pytest.mark.parametrize("section", _CHAMBERS, ids=lambda section: section["driver"])
def test_a_chamber_section_is_read_and_drives_its_simulator(section: dict[str, Any]) -> None:
    """As it is written it is a valid section; its driver prepares, sets and leaves a simulated chamber safe."""
    real = {key: value for key, value in _SIMULATED.items() if key != "simulation"}
    imu = {**_SIMULATED["imu"], "port": "/dev/ttyUSB0"}
    parse_bench(yaml.safe_dump({**real, "clock": "system", "imu": imu, "chamber": section}), "guide.yaml")
    with build_bench(with_simulated_chamber(section)) as live:
        chamber = live.devices.chamber
        chamber.prepare()
        chamber.set_temperature(30.0)
        assert chamber.read().setpoint_degC == pytest.approx(30.0)
        chamber.safe_state()


@pytest.mark.parametrize("section", blocks("wire-an-imu.md", "imu"), ids=lambda section: section["description"])
def test_an_imu_section_is_read_and_has_its_description(section: dict[str, Any]) -> None:
    """As it is written; the description knows rates."""
    bench = bench_around(imu=section, clock="system")
    assert bench.frames.roles is not None


@pytest.mark.parametrize("name", _EXAMPLES)
def test_an_example_names_the_unit_that_its_description_reports(name: str) -> None:
    """A unit that says nothing but its stream has the description's name; the channels are those of the stream."""
    bench = load_bench(name)
    description: StreamDescription = bench.frames
    assert description.roles is not None
    assert not bench.simulated
    if description.roles.identity is None:
        assert (bench.unit.model, bench.unit.serial) == (description.name, "")
    for number, section in bench.sensors.items():
        assert set(section.channels) == set(description.roles.sensors[number].rates)
    assert set(bench.imu.instructions) == set(bench.positions)


def test_the_table_of_imus_is_that_of_the_descriptions() -> None:
    """Every description that ships is in the guide, with its own baud rate and sample rate."""
    guide = (_ROOT / "docs" / "how-to" / "wire-an-imu.md").read_text()
    for folder in config_folders("imus"):
        for path in folder.glob("*.yaml"):
            described = yaml.safe_load(whole_text(path))
            row = next((line for line in guide.splitlines() if line.startswith(f"| `{path.stem}` |")), "")
            rate = described["sample_rate_hz"]
            assert f"{described['baudrate']} 8N1, " in row, path.stem
            if isinstance(rate, str):  # the bench file chooses the message, each with its rate
                chosen = [choice["message_rate"] for choice in described["parameters"]["message"]["choices"].values()]
                assert all(str(one) in row for one in chosen), path.stem
            else:
                assert f"{rate} Hz" in row, path.stem


def test_every_bench_to_start_from_has_a_sweep_that_fits() -> None:
    """Its positions are the bench's, so that check and plan are about the bench and not about names."""
    sweeps = [load_sweep(path) for folder in config_folders("sweeps") for path in sorted(folder.glob("*.yaml"))]
    for folder in config_folders("benches"):
        for path in folder.glob("*.yaml"):
            known = set(load_bench(path).positions)
            assert any(set(sweep.positions) <= known for sweep in sweeps), path.stem


@pytest.mark.parametrize(
    ("number", "advice"),
    [(errno.EACCES, ""), (errno.EBUSY, ""), (errno.ENOENT, "plug the adapter"), (5, "plug the")],
)
def test_a_port_that_does_not_open_has_one_advice(number: int, advice: str, monkeypatch: pytest.MonkeyPatch) -> None:
    """Whoever lacks the permission, or has another program there, is told so by the error, and plugs nothing in."""

    def refuse(url: str, **settings: object) -> None:
        raise serial.SerialException(number, f"could not open port {url}")

    monkeypatch.setattr(serial, "serial_for_url", refuse)
    with pytest.raises(TransportError) as refused:
        open_port("/dev/ttyUSB0", clock=VirtualClock())
    said = closed_port_advice(str(refused.value), "/dev/ttyUSB0", load_bench("espec-stim300-example"))
    assert said.startswith(advice)
    assert bool(said) is bool(advice)
