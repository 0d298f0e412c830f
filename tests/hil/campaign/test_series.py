"""Series of samples beside a campaign's collects: found by their collect, read when asked, refused with their row."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pyarrow as pa
import pyarrow.parquet
import pytest

from hil.campaign.reader import read_campaign
from hil.errors import InputError
from tests.hil.campaign.test_campaign_reader import ROWS, YAML, table


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    """Return a good campaign folder."""
    (tmp_path / "campaign.yaml").write_text(YAML)
    (tmp_path / "collects.csv").write_text(table(*ROWS))
    return tmp_path


def test_series_are_found_by_their_collect_and_read_when_asked(folder: Path) -> None:
    """CSV or Parquet, uniform or not; a missing sample's cell is NaN; a collect without series has none."""
    (folder / "campaign.yaml").write_text(YAML + "series: {block_s: 0.5}\n")
    (folder / "series").mkdir()
    (folder / "series" / "0003.csv").write_text("t_s,RA_deg_per_hr,RB_deg_per_hr\n0,1,2\n0.5,,3\n1.7,4,5\n")
    columns = {
        "RB_deg_per_hr": [1.0, None],
        "RA_deg_per_hr": [3.0, 4.0],
        "t_s": [0, 1],
        "temperature_degC": [20.0, 21.0],
    }
    pyarrow.parquet.write_table(pa.table(columns), folder / "series" / "0001.parquet")
    (folder / "series" / "readme.txt").write_text("ignored")
    campaign = read_campaign(folder)
    series = campaign.series(3)
    assert series is not None
    np.testing.assert_array_equal(series.t_s, [0, 0.5, 1.7])
    np.testing.assert_array_equal(series.rates_deg_per_hr, [[1, 2], [np.nan, 3], [4, 5]])
    assert series.temperature_degC is None
    assert series.block_s == 0.5
    other = campaign.series(1)
    assert other is not None
    np.testing.assert_array_equal(other.rates_deg_per_hr, [[3, 1], [4, np.nan]])
    assert other.temperature_degC is not None
    assert campaign.series(2) is None


@pytest.mark.parametrize(
    ("name", "text", "message"),
    [
        ("0009.csv", "t_s\n", r"0009\.csv: a series without its row: collects\.csv, column collect, holds no 9"),
        ("first.csv", "t_s\n", r"first\.csv: a series is named after its collect"),
        ("0001.csv", "t_s,RA_deg_per_hr\n0,1\n", r"0001\.csv, row 1: column RB_deg_per_hr is missing"),
        ("0001.csv", "t_s,RA_deg_per_hr,RB_deg_per_hr\n0,1,2\n1,x,2\n", r"0001\.csv, row 3, column RA_deg_per_hr: 'x'"),
        ("0001.csv", "t_s,RA_deg_per_hr,RB_deg_per_hr\n0,1,2\n0,1,2\n", r"0001\.csv, row 3, column t_s: .* increase"),
        ("0001.csv", "t_s,RA_deg_per_hr,RB_deg_per_hr\n0,1,inf\n", r"0001\.csv, row 2, column RB_deg_per_hr: .*finite"),
        ("0001.parquet", "no parquet", r"0001\.parquet: it is no Parquet file"),
    ],
)
def test_bad_series_are_refused(folder: Path, name: str, text: str, message: str) -> None:
    """A series without its row refuses the folder, and so does one with a bad cell: nothing is imported in part."""
    (folder / "series").mkdir()
    (folder / "series" / name).write_text(text)
    with pytest.raises(InputError, match=message):
        read_campaign(folder)


def test_two_series_of_one_collect_are_refused(folder: Path) -> None:
    """Which of them is right cannot be known."""
    (folder / "series").mkdir()
    for name in ("0001.csv", "00001.csv"):
        (folder / "series" / name).write_text("t_s\n")
    with pytest.raises(InputError, match="collect 1 has two series"):
        read_campaign(folder)
