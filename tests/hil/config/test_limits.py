"""A limits file is read strictly, with units, and held against the sensors of the bench before anything begins."""

from __future__ import annotations

from pathlib import Path

import pytest

from hil.cli.app import run
from hil.config import load_bench, parse_bench
from hil.config.limits import Limits, load_limits
from hil.config.recorded import configuration_of, configuration_text, recorded_limits
from hil.config.sweep import limits_of, load_sweep, parse_sweep
from hil.errors import InputError

TEXT = """\
title: a product
origin: its data sheet
unit: MFS-IMU
sensors:
  2:
    BA: {low: -0.01 deg/s, high: 36 deg/hr, scatter: 3 deg/hr}
    MUB: {high: 4 deg/hr/g, change: 2 deg/hr/mg, span: 9 deg/hr/g}
"""


def test_units_are_converted() -> None:
    """A bias may be given in deg/s, a sensitivity per mg."""
    of = Limits.parse(TEXT, "a.yaml").sensors[2]
    assert (of["BA"].low, of["BA"].high, of["BA"].scatter) == pytest.approx((-36.0, 36.0, 3.0))
    assert (of["MUB"].low, of["MUB"].high, of["MUB"].change) == (None, 4.0, pytest.approx(2000.0))


@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
        ("high: 4 deg/hr/g", "high: 4 deg/hr", "sensors: sensor 2, MUB: high: '4 deg/hr' is not a drift per g"),
        ("high: 36 deg/hr", "high: 36 deg/hr/g", "sensors: sensor 2, BA: high: '36 deg/hr/g' is not a rotation rate"),
        ("high: 36 deg/hr", "high: 36", "sensors: sensor 2, BA: high: 36 has no unit"),
        ("high: 36 deg/hr", "high: -40 deg/hr", "sensors: sensor 2, BA: low: -36 is not below high, -40"),
        ("scatter: 3", "scatter: -3", "sensors: sensor 2, BA: scatter: must be more than 0"),
        ("scatter: 3", "scater: 3", "sensors: sensor 2, BA: unknown key 'scater'; did you mean 'scatter'?"),
        (
            "{high: 4 deg/hr/g, change: 2 deg/hr/mg, span: 9 deg/hr/g}",
            "{}",
            "sensors: sensor 2, MUB: no limit is given",
        ),
        ("origin: its data sheet\n", "", "origin: this key is missing"),
        ("sensors:", "k: 0\nsensors:", "k: must be more than 0, not 0"),
        ("sensors:", "decision: guess\nsensors:", "decision: 'guess' is not allowed"),
        (
            "    MUB:",
            "    MUQ:",
            "sensors.2.MUQ: sensor 2 is a two-channel rotor sensor, without such a parameter; did",
        ),
        ("    MUB:", "    GXX:", "sensors.2.GXX: sensor 2 is a two-channel rotor sensor, without such a parameter"),
        ("  2:", "  3:", "sensors.3: there is no such sensor; allowed: 2, 1"),
        ("MFS-IMU", "MFS-2", "unit: these are limits of MFS-2, and the unit is MFS-IMU"),
    ],
)
def test_a_mistake_is_one_sentence_before_anything_begins(
    old: str, new: str, message: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """Of hil check, with the sweep that names the file, the file and the key."""
    assert TEXT.count(old) == 1
    (tmp_path / "product.yaml").write_text(TEXT.replace(old, new))
    sweep = tmp_path / "sweep.yaml"
    sweep.write_text(load_sweep("quick").text + "\nlimits: product\n")
    assert run(["check", str(sweep), "--bench", "simulated"]) == 2
    said = capsys.readouterr().err
    assert f"{sweep}: limits: " in said
    assert f"{tmp_path / 'product.yaml'}: {message}" in said


def test_the_bench_may_name_them_and_the_sweep_goes_first(tmp_path: Path) -> None:
    """The unit stands in the bench file; one sweep may ask more of it."""
    for name, title in (("usual", "usual"), ("strict", "strict")):
        (tmp_path / f"{name}.yaml").write_text(TEXT.replace("a product", title))
    bench = parse_bench(load_bench("simulated").text + "\nlimits: usual\n", str(tmp_path / "bench.yaml"))
    plain = load_sweep("quick")
    asked = parse_sweep(plain.text + "\nlimits: strict\n", str(tmp_path / "sweep.yaml"))
    found = [limits_of(each, bench) for each in (None, plain, asked)]
    assert [each.title for each in found if each] == ["usual", "usual", "strict"]
    assert limits_of(plain, load_bench("simulated")) is None


def test_a_night_keeps_them_as_they_were_when_it_began(tmp_path: Path) -> None:
    """The file may be edited or lost while the night goes on."""
    (tmp_path / "product.yaml").write_text(TEXT)
    sweep = parse_sweep(load_sweep("quick").text + "\nlimits: product\n", str(tmp_path / "sweep.yaml"))
    text = configuration_text(load_bench("simulated"), sweep)
    (tmp_path / "product.yaml").unlink()
    kept = recorded_limits(text)
    assert kept is not None
    assert kept.text == TEXT
    bench, again = configuration_of(text, tmp_path / "configuration")
    assert (said := limits_of(again, bench)) is not None
    assert said.sensors == kept.sensors
    assert recorded_limits(configuration_text(load_bench("simulated"), load_sweep("quick"))) is None


def test_those_that_ship_fit_the_simulated_bench() -> None:
    """Every sensor and parameter of the example is there."""
    bench = load_bench("simulated")
    load_limits("rd-gc-86-1").check({number: bench.sensor(number) for number in bench.sensors}, bench.unit.model)
    with pytest.raises(
        InputError, match="there is no set of limits of this name, nor such a file or folder; did you mean 'rd-gc-86-1'"
    ):
        load_limits("rd-gc-86")
