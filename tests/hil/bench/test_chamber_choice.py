"""A bench file may name any chamber: it is assembled, simulated and served, and the published sweep runs on it."""

from __future__ import annotations

from collections.abc import Mapping
from contextlib import ExitStack
from functools import cache
from pathlib import Path
from typing import Any

import pytest
import yaml

import hil.bench.assemble
from drivers.chambers import CHAMBER_DRIVERS
from drivers.clock import Clock
from drivers.errors import TransportError
from drivers.simulators.memory import MemoryTransport
from drivers.transports import Transport
from hil.bench import build_bench, open_chamber
from hil.config import Bench, load_bench, load_sweep, parse_bench, parse_sweep
from hil.config.recorded import configuration_of, configuration_text
from hil.errors import InputError
from hil.night import start_night
from hil.records.export import campaign_of_night
from hil.solve import Estimate, solve_campaign
from tests.drivers.transcript import TranscriptDevice
from tests.hil.twin.serving import client_bench, served

_SHIPPED = load_bench("simulated")


def bench_with(driver: str, **chamber: Any) -> Bench:
    """The simulated bench with another chamber; a key given as None is taken out."""
    document = yaml.safe_load(_SHIPPED.text)
    described = {"description": "temptronic-ats"} if driver == "box" else {}
    section = document["chamber"] | {"driver": driver, "model": None} | described | chamber
    document["chamber"] = {key: value for key, value in section.items() if value is not None}
    return parse_bench(yaml.safe_dump(document), "my-bench.yaml")


@pytest.mark.parametrize("driver", CHAMBER_DRIVERS)
def test_any_chamber_can_be_simulated_in_process(driver: str) -> None:
    """Prepared, set and read through its production driver."""
    with build_bench(bench_with(driver)) as live:
        chamber = live.devices.chamber
        chamber.prepare()
        chamber.set_temperature(45.0)
        assert chamber.read().setpoint_degC == pytest.approx(45.0)
        assert live.simulators is not None
        assert live.simulators.plant.commanded_degC == pytest.approx(45.0)


@pytest.mark.slow
@pytest.mark.parametrize("driver", ["watlow-f4", "simserv"])
def test_any_chamber_can_be_served_to_any_client(driver: str) -> None:
    """`hil simulate` on a terminal and on a TCP port, and the production driver as the client, in real time."""
    bench = bench_with(driver)
    with ExitStack() as opened:
        simulation = opened.enter_context(served(bench, tcp=driver == "simserv"))
        live = opened.enter_context(build_bench(client_bench(bench, simulation.ports)))
        assert live.devices.chamber.identify().unit == "degC"
        assert live.devices.chamber.read().temperature_degC == pytest.approx(23.0, abs=0.2)


def test_the_line_is_the_makers_unless_the_file_says_otherwise(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    """Baud, data bits and parity."""
    asked: list[Mapping[str, Any]] = []

    def refuse(url: str, *, clock: Clock, **settings: Any) -> Transport:
        asked.append({key: value for key, value in settings.items() if key != "on_close"})
        raise InputError("not now")

    monkeypatch.setattr(hil.bench.assemble, "open_port", refuse)
    port = tmp_path / "chamber"
    port.touch()
    document = yaml.safe_load(bench_with("ezt-570i").text) | {"clock": "system"}
    for more in ({}, {"baud": 19200, "parity": "none"}, {"data_bits": 7, "parity": "odd"}):
        document["chamber"] = document["chamber"] | {"port": str(port)} | more
        with pytest.raises(InputError, match="not now"):
            build_bench(parse_bench(yaml.safe_dump(document), "b.yaml"))
    assert asked == [
        {"baudrate": 9600, "bytesize": 8, "parity": "E"},
        {"baudrate": 19200, "bytesize": 8, "parity": "N"},
        {"baudrate": 19200, "bytesize": 7, "parity": "O"},
    ]


@pytest.mark.slow
def test_a_tcp_port_has_one_owner() -> None:
    """A second program would get the first one's answers; it is told so instead."""
    bench = bench_with("simserv")
    with served(bench, tcp=True) as simulation:
        client = client_bench(bench, simulation.ports)
        with build_bench(client), pytest.raises(TransportError, match="somebody else has the port open"):
            build_bench(client)
        build_bench(client).close()


@pytest.mark.parametrize(
    ("chamber", "message"),
    [
        ({"driver": "easy"}, r"chamber\.driver: 'easy' is not a chamber driver; there are .*, watlow-f4"),
        ({"parity": "mark"}, r"chamber\.parity"),
        ({"description": "temptronic-ats"}, r"chamber\.description: a box needs the file"),
        ({"driver": "box", "description": "nothing-here"}, r"chamber\.description: nothing-here: there is no"),
        ({"driver": "box", "description": None}, r"chamber\.description: a box needs the file"),
        (
            {"driver": "watlow-f4", "dead_man": "3 h"},
            r"chamber\.dead_man: watlow-f4 has no .*; espec and box",
        ),
        ({"driver": "espec", "dead_man": "9 min"}, r"chamber\.dead_man"),
        ({"ramp": "0 degC/min"}, r"chamber\.ramp"),
        ({"framing": "ascii"}, r"chamber\.framing"),
        ({"layout": {"pairs": 6}}, r"chamber\.layout: only voetsch-ascii2"),
        ({"driver": "voetsch-ascii2", "layout": {"pairs": 4}}, r"chamber\.layout: written \(5\) must be 1 to"),
        ({"driver": "voetsch-ascii2", "layout": {"error_bit": 1}}, r"chamber\.layout: .*must be different bits"),
        ({"driver": "voetsch-ascii2", "layout": {"bits": 2}}, r"chamber\.layout: .*different bits from 0 to 1"),
        ({"driver": "voetsch-ascii2", "layout": {"bit": 8}}, r"chamber\.layout: unknown key 'bit'"),
        ({"ramp_port": "socket://192.0.2.5:5025"}, r"chamber: unknown key 'ramp_port'"),
    ],
)
def test_a_wrong_chamber_is_one_sentence(chamber: dict[str, Any], message: str) -> None:
    """File, key, what is allowed."""
    driver = chamber.pop("driver", "watlow-f4t")
    with pytest.raises(InputError, match=message):
        bench_with(driver, **chamber)


def test_a_layout_reaches_the_driver(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Two actual-first pairs and eight bits, as this chamber has them, are read as its manual says."""
    device = TranscriptDevice([(b"$01I\r", b"0021.5 0050.0 0001.0 0002.0 01000000\r")] * 2)

    def transcript(url: str, *, clock: Clock, **settings: Any) -> Transport:
        return MemoryTransport(device, clock, url)

    monkeypatch.setattr(hil.bench.assemble, "open_port", transcript)
    document = yaml.safe_load(_SHIPPED.text) | {"clock": "system"}
    layout = {"pairs": 2, "nominal_first": False, "written": 2, "bits": 8, "channel_bit": None}
    port = tmp_path / "chamber"
    port.touch()
    document["chamber"] |= {"driver": "voetsch-ascii2", "model": "", "address": 1, "layout": layout, "port": str(port)}
    with open_chamber(parse_bench(yaml.safe_dump(document), "b.yaml")) as (driven, _):
        reading = driven.read()
    assert (reading.temperature_degC, reading.setpoint_degC, reading.mode) == (21.5, 50.0, "CONSTANT")


def test_a_fault_that_no_chamber_has_is_one_sentence() -> None:
    """The kinds are listed."""
    text = _SHIPPED.text.replace("simulation:\n", "simulation:\n  chamber_faults: [{kind: sulking}]\n")
    with pytest.raises(InputError, match=r"simulation\.chamber_faults.*fahrenheit"):
        parse_bench(text, "my-bench.yaml")


@pytest.mark.parametrize(("driver", "usual", "other"), [("watlow-f4", "rtu", "tcp"), ("watlow-f4t", "tcp", "rtu")])
def test_the_framing_of_the_file_is_spoken_on_both_sides(driver: str, usual: str, other: str) -> None:
    """And its maker's where it says nothing."""
    for said, spoken in ((None, usual), (other, other)):
        with build_bench(bench_with(driver, framing=said)) as live:
            assert live.devices.chamber.identify().unit == "degC"
            assert live.simulators is not None
            assert vars(live.simulators.chamber)["_framing"] == spoken


def test_a_ramp_and_a_dead_man_reach_the_chamber() -> None:
    """The box arms its own timer, and the host steps its setpoint."""
    with build_bench(bench_with("box", dead_man="3 h", ramp="1 degC/min")) as live:
        live.devices.chamber.prepare()
        live.devices.chamber.set_temperature(45.0)
        device: Any = live.simulators and live.simulators.chamber
        assert device.dead_man_s == 10800.0
        assert device.setpoint_degC == pytest.approx(23.5, abs=0.2)
        assert live.devices.chamber.read().setpoint_degC == 45.0


def test_the_dead_man_of_an_espec_is_its_quick_timer() -> None:
    """Armed with the first setpoint, and read back by the driver."""
    with build_bench(bench_with("espec", dead_man="3 h")) as live:
        live.devices.chamber.prepare()
        device: Any = live.simulators and live.simulators.chamber
        assert device.timer_ends_s == pytest.approx(live.devices.clock.now() + 10800.0, abs=30.0)


def test_the_record_keeps_the_description_of_a_box(tmp_path: Path) -> None:
    """A night can be resumed after the file was lost."""
    bench = bench_with("box")
    text = configuration_text(bench, load_sweep("quick"))
    kept, _ = configuration_of(text, tmp_path)
    assert kept.chamber_description == tmp_path / "chamber.yaml"
    assert "TTIM" in (tmp_path / "chamber.yaml").read_text()


def test_an_f4t_ramps_by_itself() -> None:
    """One setpoint is written, and the air follows at the rate that was asked for."""
    with build_bench(bench_with("watlow-f4t", ramp="0.5 degC/min")) as live:
        live.devices.chamber.prepare()
        live.devices.chamber.set_temperature(45.0)
        device: Any = live.simulators and live.simulators.chamber
        assert device.plant.ramp_degC_per_min == (0.5, 0.5)
        assert device.setpoint_degC == pytest.approx(45.0)


# Layouts as they were seen elsewhere: actual values first, no bit for the channel; one that numbers its bits to 32.
LAYOUTS: list[dict[str, Any]] = [
    {"pairs": 2, "nominal_first": False, "written": 2, "bits": 8, "channel_bit": None},
    {"pairs": 6, "written": 6, "bits": 32, "start_bit": 0, "channel_bit": 5, "error_bit": 31},
    {"pairs": 7, "written": 5, "start_bit": 2, "channel_bit": 1, "error_bit": 0},
]


@pytest.mark.parametrize("layout", LAYOUTS, ids=lambda layout: f"{layout['pairs']} pairs")
def test_any_layout_can_be_simulated(layout: dict[str, Any]) -> None:
    """Prepared, set, read, an alarm, the safe state: as a VT 4002 does it."""
    with build_bench(bench_with("voetsch-ascii2", layout=layout)) as live:
        chamber, device = live.devices.chamber, live.simulators and live.simulators.chamber
        assert device is not None
        chamber.prepare()
        chamber.set_temperature(60.0)
        live.devices.clock.sleep(3600.0)
        reading = chamber.read()
        assert reading.temperature_degC == pytest.approx(60.0, abs=0.1)
        assert (reading.mode, reading.alarms) == ("CONSTANT", ())
        device.alarms = ("02",)
        assert chamber.read().alarms == ("error 02: error",)
        device.alarms = ()
        chamber.safe_state()
        assert device.mode == "OFF"


@cache
def _solved(choice: str, folder: Path) -> Mapping[tuple[int, int, str], Estimate]:
    document = yaml.safe_load(Path(load_sweep("rd-gc-86-1").source).read_text(encoding="utf-8"))
    document |= {"self_calibrations_per_temperature": 1, "temperatures": ["50 degC", "-10 degC"]}
    document["restabilisation"]["at_least"] = "15 min"
    sweep = parse_sweep(yaml.safe_dump(document), "sweep.yaml")
    driver, more = CHOICES[choice]
    night = folder / choice
    assert start_night(night, sweep, bench_with(driver, **more)).state == "complete"
    return {
        (solution.sensor, solution.run or 0, name): estimate
        for solution in solve_campaign(campaign_of_night(night))
        for name, estimate in solution.parameters.items()
    }


CHOICES: dict[str, tuple[str, dict[str, Any]]] = {
    **{driver: (driver, {}) for driver in CHAMBER_DRIVERS},
    **{f"voetsch-ascii2-{place}": ("voetsch-ascii2", {"layout": LAYOUTS[place]}) for place in (0, 1)},
    "watlow-f4t-ramp": ("watlow-f4t", {"ramp": "2 degC/min"}),
    "espec-dead-man": ("espec", {"dead_man": "2 h"}),
}


@pytest.fixture(scope="module")
def nights(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Where the nights of this module are kept."""
    return tmp_path_factory.mktemp("nights")


@pytest.mark.slow
@pytest.mark.parametrize("choice", [name for name in CHOICES if name != "espec"])
def test_the_published_sweep_gives_the_same_parameters_on_every_chamber(choice: str, nights: Path) -> None:
    """Hot and cold, all three positions. Only when samples fall differs between two chambers: noise."""
    reference, found = _solved("espec", nights), _solved(choice, nights)
    assert found.keys() == reference.keys()
    assert len(found) == 2 * 2 * 6
    for key, estimate in found.items():
        other = reference[key]
        assert estimate.value is not None
        assert other.value is not None
        assert estimate.se is not None
        assert other.se is not None
        assert abs(estimate.value - other.value) < 5.0 * (estimate.se**2 + other.se**2) ** 0.5, key
