"""What is written reads back as the same campaign, to the last bit, or is not there at all."""

from __future__ import annotations

from dataclasses import replace
from functools import partial
from pathlib import Path

import numpy as np
import pytest

from hil.campaign import Campaign, Collects, Conditions, Sensor, Series
from hil.campaign.reader import read_campaign
from hil.campaign.writer import write_campaign
from hil.errors import InputError
from procedures.verdict import Judgement, Verdict

ROTOR = Sensor(2, ("A", "B", "S"), {"RA": "A", "RB": "B"})
TRIAD = Sensor(1, ("X", "Y", "Z"), {"GX": "X", "GY": "Y", "GZ": "Z"}, "MEMS")


COLLECT = {1: 10, 3: 5, 5: 7, 7: 9, 2: 6, 4: 4, 6: 8}
"""Collect numbers by order in time: unique, and not chronological, as some laboratory will have it."""


def collects(sensor: Sensor, first: int, n: int, seed: int, **columns: np.ndarray) -> Collects:
    """Return n collects at random orientations with awkward decimals and a missing rate."""
    rng = np.random.default_rng(seed)
    f_g = rng.normal(size=(n, 3))
    f_g /= np.linalg.norm(f_g, axis=-1, keepdims=True)
    rates = rng.normal(0, 100, (n, len(sensor.channels)))
    rates[1, 0] = np.nan
    conditions = Conditions(
        sensor,
        np.array([COLLECT[turn] for turn in range(first, first + 2 * n, 2)]),
        np.repeat(np.arange(1, n + 1), 2)[:n],
        np.array([f"pose-{first + 2 * i}" for i in range(n)]),
        100.0 * np.arange(first, first + 2 * n, 2) + rng.uniform(size=n),
        np.full(n, 60.0),
        f_g,
        rng.normal(0, 5, (n, 3)),
        columns,
    )
    return Collects(conditions, rates, np.abs(rng.normal(1, 0.1, rates.shape)))


@pytest.fixture
def campaign() -> Campaign:
    """Return a simulated campaign of a rotor sensor and a triad whose collects alternate in time."""
    temperature = np.array([-29.722222222222225, np.nan, 1 / 3, 60.0])
    return Campaign(
        title="Prüfling 7: Übersicht",
        source="a test",
        sensors={
            2: collects(ROTOR, 1, 4, 0, temperature_degC=temperature, supply_V=np.array([28.0, 28.1, 28.2, 1e-300])),
            1: collects(TRIAD, 2, 3, 1, n_samples=np.array([1200.0, 1199.0, 1200.0])),
        },
        condition_units={"supply_V": "supply voltage, volt"},
        simulated=True,
        site={"latitude_deg": 34.6, "heading_deg": 30.0},
        notes="seed 7",
        series_block_s=0.5,
    )


def test_a_campaign_reads_back_to_the_last_bit(campaign: Campaign, tmp_path: Path) -> None:
    """Every array, every key, both sensors; NaN stays NaN; the simulated mark stays."""
    folder = write_campaign(campaign, tmp_path / "out")
    back = read_campaign(folder)
    for key in ("title", "source", "simulated", "site", "notes", "condition_units", "series_block_s", "centrifuge"):
        assert getattr(back, key) == getattr(campaign, key), key
    assert list(back.sensors) == list(campaign.sensors)
    for number, written in campaign.sensors.items():
        read = back.sensors[number]
        assert read.conditions.sensor == written.conditions.sensor
        np.testing.assert_array_equal(read.rates_deg_per_hr, written.rates_deg_per_hr)
        np.testing.assert_array_equal(read.rates_se_deg_per_hr, written.rates_se_deg_per_hr)
        for name in ("collect", "run", "position", "start_s", "duration_s", "f_g", "w_deg_per_hr"):
            np.testing.assert_array_equal(getattr(read.conditions, name), getattr(written.conditions, name), name)
        assert read.conditions.columns.keys() == written.conditions.columns.keys()
        for name, values in written.conditions.columns.items():
            np.testing.assert_array_equal(read.conditions.columns[name], values, name)


def test_rows_of_all_sensors_are_chronological_and_a_person_can_read_them(campaign: Campaign, tmp_path: Path) -> None:
    """Sorted by time; whole numbers without a point; empty cells for what is missing."""
    folder = write_campaign(campaign, tmp_path / "out")
    lines = (folder / "collects.csv").read_text().splitlines()
    assert [line.split(",")[0] for line in lines[1:]] == [str(COLLECT[turn]) for turn in range(1, 8)]
    assert lines[0].startswith("collect,run,sensor,position,start_s,duration_s,f_A_g,f_B_g,f_S_g,f_X_g")
    assert ",60," in lines[1]
    assert "nan" not in "".join(lines).lower()
    assert not any("chronological" in warning for warning in read_campaign(folder).warnings)


def test_series_read_back_exactly(campaign: Campaign, tmp_path: Path) -> None:
    """Times, rates with a missing sample, temperature; by collect, for either sensor."""
    rng = np.random.default_rng(3)
    rates = rng.normal(size=(5, 2))
    rates[2, 1] = np.nan
    first = Series(np.cumsum(rng.uniform(0.01, 0.02, 5)), rates, rng.normal(20, 1, 5), 0.5)
    second = Series(np.arange(4.0), rng.normal(size=(4, 3)), block_s=0.5)
    folder = write_campaign(replace(campaign, recorded={7: lambda: first, 4: lambda: second}), tmp_path / "out")
    back = read_campaign(folder)
    assert sorted(back.recorded) == [4, 7]
    for collect, written in ((7, first), (4, second)):
        read = back.series(collect)
        assert read is not None
        np.testing.assert_array_equal(read.t_s, written.t_s)
        np.testing.assert_array_equal(read.rates_deg_per_hr, written.rates_deg_per_hr)
        assert read.block_s == 0.5
    read = back.series(7)
    assert read is not None
    np.testing.assert_array_equal(read.temperature_degC, first.temperature_degC)


def test_series_that_were_written_and_are_gone_are_said(campaign: Campaign, tmp_path: Path) -> None:
    """MARGINAL for the runs whose averages nothing proves any more; a folder that never had series stays as it was."""
    own = {
        n: rows.rates_deg_per_hr[i] for rows in campaign.sensors.values() for i, n in enumerate(rows.conditions.collect)
    }
    kept = {n: partial(Series, np.arange(2.0), np.stack([rates, rates]), block_s=0.5) for n, rates in own.items()}
    folder = write_campaign(replace(campaign, recorded=kept), tmp_path / "out")
    whole = read_campaign(folder)
    assert (whole.verdicts, [line for line in whole.warnings if "no series" in line]) == ({}, [])
    first, *others = sorted((folder / "series").iterdir())
    run = {
        int(n): int(r)
        for rows in whole.sensors.values()
        for n, r in zip(rows.conditions.collect, rows.conditions.run, strict=True)
    }
    first.unlink()
    one = read_campaign(folder)
    said = f"collect {int(first.stem)}: no series ({len(own)} were written, {len(own) - 1} are here)"
    assert one.verdicts.keys() == {run[int(first.stem)]}
    assert all(each.verdict is Verdict.MARGINAL and said in each.reason for each in one.verdicts.values())
    assert any(said in line for line in one.warnings)
    for path in others:
        path.unlink()
    assert read_campaign(folder).verdicts.keys() == set(run.values())
    header = folder / "campaign.yaml"
    header.write_text(
        header.read_text().replace(f"  collects: {len(own)}\n", "")
    )  # as it was written before it counted
    assert (read_campaign(folder).verdicts, "no series, so" in str(read_campaign(folder).warnings)) == ({}, True)
    header.write_text(header.read_text().replace("series:\n  block_s: 0.5\n", ""))
    assert not any("no series" in line for line in read_campaign(folder).warnings)


def test_a_place_where_no_folder_can_be_made_is_bad_input(campaign: Campaign, tmp_path: Path) -> None:
    """The message names the folder that was asked for, not the one it is written in first."""
    (tmp_path / "file").touch()
    with pytest.raises(InputError, match=r"file: is not a folder, so nothing can be made in it"):
        write_campaign(campaign, tmp_path / "file" / "out")


def test_an_existing_folder_is_never_overwritten(campaign: Campaign, tmp_path: Path) -> None:
    """The data that is there stays."""
    folder = write_campaign(campaign, tmp_path / "out")
    before = (folder / "collects.csv").read_bytes()
    with pytest.raises(InputError, match="exists and is not empty"):
        write_campaign(campaign, folder)
    assert (folder / "collects.csv").read_bytes() == before


def test_a_failure_leaves_no_half_made_folder(campaign: Campaign, tmp_path: Path) -> None:
    """A series that cannot be read, met after half the work, undoes everything."""

    def gone() -> Series:
        raise InputError("the block is missing")

    kept = {4: partial(Series, np.arange(2.0), np.zeros((2, 3))), 7: gone}
    with pytest.raises(InputError, match="the block is missing"):
        write_campaign(replace(campaign, recorded=kept), tmp_path / "out")
    assert list(tmp_path.iterdir()) == []


def test_runs_that_are_judged_and_have_no_row_are_said(campaign: Campaign, tmp_path: Path) -> None:
    """Rows were deleted, or a copy broke off at the end of a line: a report had been as good as of the whole."""
    run = int(next(iter(campaign.sensors.values())).conditions.run[0])
    judged = replace(campaign, verdicts={run: Judgement(Verdict.PASS, "measured well")})
    folder = write_campaign(judged, tmp_path / "out")
    assert not any("judges" in line for line in read_campaign(folder).warnings)
    header, more = (
        folder / "campaign.yaml",
        "  9998: {verdict: PASS, reason: good}\n  9999: {verdict: FAIL, reason: bad}\n",
    )
    header.write_text(header.read_text().replace("verdicts:\n", f"verdicts:\n{more}"))
    said = "collects.csv: runs 9998–9999, which campaign.yaml judges, have no row: what they measured is missing here"
    assert any(line.endswith(said) for line in read_campaign(folder).warnings)
