"""One Parquet file of many campaigns: read as it was written, and screened as the folders are."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import pytest

from hil.campaign import Campaign
from hil.campaign.fleet_file import pieces_of, read_piece, write_fleet_file
from hil.cli.app import run
from hil.errors import InputError
from hil.reconcile.campaigns import Facts, Screened, screen_folders
from procedures.verdict import Judgement, Verdict
from tests.hil.reconcile.fleet_units import unit


@pytest.mark.slow
def test_one_file_of_all_gives_what_the_folders_give(
    fleet: Path, screened: Screened, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """The same numbers to the digit; what cannot be screened is told, and so is a file that is none."""
    file = tmp_path / "fleet.parquet"
    assert run(["export", str(fleet), str(file), "--fleet"]) == 0
    assert "x-broken" in capsys.readouterr().err
    by_file = screen_folders([file], "matrix-6-thermal")
    said = [{key: of for key, of in unit.wrong.items() if key != "warnings"} for unit in screened.units]
    as_filed = [replace(unit, wrong=wrong) for unit, wrong in zip(screened.units, said, strict=True)]
    assert by_file.units == as_filed  # a file of numbers does not keep what reading folders warned of
    assert by_file.shared == screened.shared
    assert by_file.not_screened.keys() == screened.not_screened.keys() - {str(fleet / "x-broken")}
    assert run(["export", str(fleet), str(file), "--fleet"]) == 2  # and what is there stays
    assert run(["export", str(fleet), str(tmp_path / "two.parquet"), "--fleet", "--format", "hdf5"]) == 2
    whole = pq.read_table(file)
    spoiled = {
        "no Parquet file": b"campaigns",
        "column layout is missing": whole.drop_columns(["layout"]),
        "RA_deg_per_hr: it is string": whole.set_column(
            whole.schema.get_field_index("RA_deg_per_hr"), "RA_deg_per_hr", pa.array(["1"] * len(whole))
        ),
        "f_A_g: a number is missing": whole.set_column(
            whole.schema.get_field_index("f_A_g"), "f_A_g", pa.array([None] * len(whole), pa.float64())
        ),
    }
    for k, (why, given) in enumerate(spoiled.items()):
        other = tmp_path / f"{k}.parquet"
        other.write_bytes(given) if isinstance(given, bytes) else pq.write_table(given, other)
        with pytest.raises(InputError, match=why):
            screen_folders([other], "matrix-6-thermal")


def test_a_file_of_campaigns_is_read_as_it_was_written(tmp_path: Path) -> None:
    """Every number, name and layout, in pieces, whichever piece a campaign is in; no file is left of what failed."""
    units = [(f"u{i}", unit(i, 5.0)) for i in range(3)] + [("gone", "it cannot be read")]
    file = tmp_path / "fleet.parquet"
    for left in ("fleet.parquet", f"fleet.parquet-{2**30}"):  # another command's, and what a killed one left
        (tmp_path / f".partial-{left}").touch()
    assert write_fleet_file(units, file) == {"gone": "it cannot be read"}
    found = [each for piece in range(pieces_of(file)) for each in read_piece(file, piece)]
    assert [place for place, _ in found] == ["u0", "u1", "u2"]
    for (_, was), (_, read) in zip(units, found, strict=False):
        assert isinstance(was, Campaign)
        assert isinstance(read, Campaign)
        assert (read.title, read.source, read.identity["serial"]) == (was.title, was.source, was.identity["serial"])
        for number, rows in was.sensors.items():
            again = read.sensors[number]
            assert again.conditions.sensor == rows.conditions.sensor
            assert np.array_equal(again.rates_deg_per_hr, rows.rates_deg_per_hr)
            assert np.array_equal(again.rates_se_deg_per_hr, rows.rates_se_deg_per_hr)
            assert np.array_equal(again.conditions.w_deg_per_hr, rows.conditions.w_deg_per_hr)
            assert again.conditions.columns.keys() == rows.conditions.columns.keys()
    more = unit(1, 5.0)
    columns = {
        **more.sensors[2].conditions.columns,
        "humidity_percent": np.zeros(len(more.sensors[2].rates_deg_per_hr)),
    }
    damp = replace(more.sensors[2], conditions=replace(more.sensors[2].conditions, columns=columns))
    campaigns = [("dry", unit(0, 5.0)), ("damp", replace(more, sensors={2: damp}))]
    (said,) = write_fleet_file(campaigns, tmp_path / "two.parquet").values()
    assert said.startswith("left out: of it and the first campaign, one lacks humidity_percent; ")
    (tmp_path / "two.parquet").unlink()
    with pytest.raises(InputError, match="gone: it cannot be read"):
        write_fleet_file(units[3:], tmp_path / "none.parquet")
    assert sorted(each.name for each in tmp_path.iterdir()) == [".partial-fleet.parquet", "fleet.parquet"]


def test_a_file_of_campaigns_knows_which_runs_fail(tmp_path: Path) -> None:
    """As the folders do, by how a run was measured and by what its records contradict; a MARGINAL run is none."""
    marks = {1: Judgement(Verdict.MARGINAL, "the soak was short"), 3: Judgement(Verdict.FAIL, "the stream broke off")}
    bad = replace(unit(1, 5.0), verdicts=marks, contradicted={(5, 2): Judgement(Verdict.FAIL, "it lay otherwise")})
    file = tmp_path / "fleet.parquet"
    write_fleet_file([("sound", unit(0, 5.0)), ("bad", bad)], file)
    failed = {}
    for place, read in read_piece(file, 0):
        assert isinstance(read, Campaign)
        failed[place] = Facts.of(place, read).runs_failed
    assert failed == {"sound": [], "bad": Facts.of("bad", bad).runs_failed} == {"sound": [], "bad": [3, 5]}
