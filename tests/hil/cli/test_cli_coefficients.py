"""thermal, allan and audit on what the other commands make: a night, its campaign folder, an imported table."""

from __future__ import annotations

import json
from pathlib import Path

import pytest

from tests.hil.cli.conftest import Run


@pytest.mark.slow
def test_a_nights_collects_are_stretches_of_one_allan_deviation(hil: Run, night: Path, tmp_path: Path) -> None:
    """All collects of a channel together, one alone, and the exported campaign's series: the same white noise."""
    whole = hil("allan", night, "--sensor", "2", "--channel", "RA", "--json")
    assert whole.returncode == 0, whole.stderr
    document = json.loads(whole.stdout)
    assert document["simulated"]
    assert document["stretches"] == 12  # two temperatures, two self-calibrations, three collects
    n = document["fit"]["N"]
    assert n["value"] == pytest.approx(0.12, rel=0.05)  # deg/sqrt(hr), the shipped truth's
    single = json.loads(hil("allan", night, "--sensor", "2", "--channel", "RA", "--collect", "2", "--json").stdout)
    assert single["stretches"] == 1
    assert single["samples"] * 12 == pytest.approx(document["samples"], rel=0.01)
    assert hil("export", night, tmp_path / "campaign").returncode == 0
    exported = json.loads(hil("allan", tmp_path / "campaign", "--sensor", "2", "--channel", "RA", "--json").stdout)
    assert exported["fit"]["N"]["value"] == pytest.approx(0.12, rel=0.15)


def test_a_channel_that_several_sensors_have_must_be_chosen(hil: Run, night: Path) -> None:
    """Status 2, with what there is to choose from."""
    ended = hil("allan", night, "--channel", "RA")
    assert ended.returncode == 2
    assert "RA of sensor 1" in ended.stderr
    ended = hil("allan", night, "--sensor", "2", "--channel", "RA", "--collect", "999")
    assert ended.returncode == 2
    assert "no series of collect 999" in ended.stderr


@pytest.mark.slow
def test_two_temperatures_are_too_few_for_a_curve(hil: Run, night: Path) -> None:
    """The short night is refused with what would be needed."""
    ended = hil("thermal", night)
    assert ended.returncode == 2
    assert "at least three are needed" in " ".join(ended.stderr.split())


@pytest.mark.slow
def test_the_published_table_is_imported_by_its_name_and_fitted(hil: Run, tmp_path: Path) -> None:
    """`hil import` takes the table that ships; `hil thermal` says what a cubic is worth on it."""
    imported = hil("import", "rd-gc-86-1-table-1", tmp_path / "t1")
    assert imported.returncode == 0, imported.stderr
    assert "kept as printed" in imported.stderr
    ended = hil("thermal", tmp_path / "t1", "--highest-order", "3")
    assert ended.returncode == 0
    assert "MUB: differs between temperatures beyond its noise" in ended.stdout
