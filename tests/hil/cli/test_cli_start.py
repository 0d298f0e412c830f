"""`hil init` and `hil docs`: a bench file that is read back, and pages that are there without a checkout."""

from __future__ import annotations

import sys
import webbrowser
from pathlib import Path

import pytest

from drivers.chambers import CHAMBER_DRIVERS
from hil.bench.new_file import new_bench
from hil.cli import start
from hil.cli.app import run
from hil.config import load_bench
from hil.config.sweep import cautions, check_sweep_against_bench, load_sweep
from hil.errors import InputError
from hil.files.strict import config_folders

GIVEN = {
    "--chamber": "espec",
    "--chamber-port": "COM3",
    "--limits": "-40 to 185 degF",
    "--unit": "stim300",
    "--unit-port": "socket://127.0.0.1:1",
    "--latitude": "59.9 deg",
}
UNITS = sorted(path.stem for folder in config_folders("imus") for path in folder.glob("*.yaml"))
OPTIONS = [word for pair in GIVEN.items() for word in pair]


def test_six_options_give_a_bench_that_check_reads(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """What was given stands in it, in whatever unit; a sweep through six positions fits; it is not written over."""
    out = tmp_path / "my-bench.yaml"
    assert run(["init", str(out), *OPTIONS]) == 0
    bench = load_bench(out)
    assert (bench.name, bench.chamber.port, bench.imu.port) == ("my-bench", "COM3", "socket://127.0.0.1:1")
    assert (bench.chamber.limits.low_degC, bench.chamber.limits.high_degC) == (-40.0, pytest.approx(85.0))
    assert bench.site.latitude_deg == 59.9
    assert bench.frames.name == bench.unit.model == "STIM300"
    sweep = load_sweep("triad-six-positions")
    check_sweep_against_bench(sweep, bench)
    assert cautions(sweep, bench) == []
    capsys.readouterr()
    assert run(["check", str(out)]) == 2  # no such ports
    assert "NOT  chamber.port: COM3" in capsys.readouterr().out
    text = out.read_text()
    assert run(["init", str(out), *OPTIONS]) == 2
    assert "exists already" in capsys.readouterr().err
    assert out.read_text() == text


def test_what_is_not_given_is_asked(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    """Six questions and no more; where nobody sits there, the option that is missing is named."""
    asked: list[str] = []
    answers = iter(GIVEN.values())

    def answer(question: str) -> str:
        asked.append(question)
        return next(answers)

    monkeypatch.setattr(start, "ask_words", answer)
    monkeypatch.setattr(sys.stdin, "isatty", lambda: True, raising=False)
    assert run(["init", str(tmp_path / "a.yaml")]) == 0
    assert run(["init", str(tmp_path / "b.yaml"), *OPTIONS]) == 0
    assert len(asked) == 6
    assert (tmp_path / "a.yaml").read_text().replace("a.yaml", "b.yaml").replace("name: a", "name: b") == (
        tmp_path / "b.yaml"
    ).read_text()
    monkeypatch.setattr(sys.stdin, "isatty", lambda: False, raising=False)
    assert run(["init", str(tmp_path / "c.yaml"), *OPTIONS[:-2]]) == 2
    assert "nobody can be asked here; give --latitude" in capsys.readouterr().err


def test_an_answer_that_cannot_be_read_is_asked_again(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    """At once, with the reason, and no other answer is lost; an option that cannot be read is no question."""
    typed = iter(
        ("Espek", "espec", "COM3", "-40", "-40 to 185 degF", "stim30", "stim300", "tcp://x", "COM4", "52", "52 deg")
    )
    monkeypatch.setattr(start, "ask_words", lambda _: next(typed))
    monkeypatch.setattr(sys.stdin, "isatty", lambda: True, raising=False)
    assert run(["init", str(tmp_path / "a.yaml")]) == 0
    assert next(typed, None) is None
    assert load_bench(tmp_path / "a.yaml").site.latitude_deg == 52.0
    said = capsys.readouterr().err
    assert run(["init", str(tmp_path / "b.yaml"), "--chamber", "espex"]) == 2  # and nothing is asked
    for why in ("'Espek' is no chamber", "'-40' is not a range", "did you mean 'stim300'", "imu.port", "latitude"):
        assert why in said


@pytest.mark.parametrize("chamber", sorted(CHAMBER_DRIVERS))
def test_every_chamber_is_written(chamber: str) -> None:
    """Each driver of the catalogue but one that needs a description of its own."""
    asked = {"chamber": chamber, "latitude": "-33.9 deg"}
    if chamber == "box":
        with pytest.raises(InputError, match="'box' is no chamber that hil knows"):
            new_bench("b", asked)
    else:
        assert f"driver: {chamber}\n" in new_bench("b", asked)


@pytest.mark.parametrize("unit", UNITS)
def test_every_unit_is_written(unit: str) -> None:
    """Each triad among the descriptions that ship; for another unit the file to copy is named."""
    asked = {"unit": unit}
    if unit == "mfs":
        with pytest.raises(InputError, match="mfs: not a triad: copy the bench file simulated"):
            new_bench("b", asked)
    else:
        assert f'description: "{unit}"' in new_bench("b", asked)


@pytest.mark.parametrize(
    ("option", "value", "says"),
    [
        ("--chamber", "espex", "'espex' is no chamber that hil knows; did you mean 'espec'?"),
        ("--limits", "-40", "limits: '-40' is not a range with its unit; write -40 to 85 degC"),
        ("--limits", "-40 to 85", "limits: '-40 to 85' is not a range with its unit"),
        ("--limits", "a to b degC", "limits: "),
        ("--limits", "85 to -40 degC", "must be below high"),
        ("--unit", "stim30", "did you mean 'stim300'"),
        ("--unit-port", "tcp://x", "imu.port"),
        ("--latitude", "north", "latitude"),
        ("--latitude", "59.9", "latitude"),
    ],
)
def test_an_answer_that_cannot_be_is_one_sentence(
    option: str, value: str, says: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """It names what is wrong, and nothing is written."""
    given = {**GIVEN, option: value}
    assert run(["init", str(tmp_path / "x.yaml"), *(word for pair in given.items() for word in pair)]) == 2
    assert says in capsys.readouterr().err
    assert list(tmp_path.iterdir()) == []


@pytest.mark.slow
def test_a_page_is_printed_or_shown(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    """By its name, however it is written; an unknown one names the nearest; the browser gets a file."""
    for name in ("wire-a-chamber", "how-to/wire-a-chamber.md", "docs/how-to/wire-a-chamber"):
        assert run(["docs", name]) == 0
        assert capsys.readouterr().out.startswith("# Wire a chamber\n")
    assert run(["docs"]) == 0
    assert capsys.readouterr().out.startswith("# Documentation\n")
    assert run(["docs", "wire-a-chambr"]) == 2
    assert "did you mean 'wire-a-chamber'?" in capsys.readouterr().err
    opened: list[str] = []
    monkeypatch.setattr(webbrowser, "open", lambda url: opened.append(url) or True)
    assert run(["docs", "effects", "--open", "--site", str(tmp_path / "site")]) == 0
    assert opened == [(tmp_path / "site" / "effects" / "README.html").as_uri()]
    monkeypatch.setattr(webbrowser, "open", lambda _: False)
    assert run(["docs", "--open", "--site", str(tmp_path / "site")]) == 2
    assert "no browser could be started here; open " in capsys.readouterr().err
