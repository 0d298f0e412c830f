"""One file for other programs: what the libraries of HDF5, NetCDF and MATLAB read is what the campaign folder has."""

from __future__ import annotations

import sys
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from scipy.io import loadmat, netcdf_file

from hil.campaign import Campaign
from hil.campaign.formats import Format, unit_of, write_file
from hil.campaign.reader import read_campaign
from hil.campaign.writer import columns_of
from hil.cli.app import run
from hil.errors import InputError
from tests.hil.audit.folders import written

Read = Callable[[Path], tuple[dict[str, Any], dict[str, str], dict[str, Any]]]


def from_hdf5(path: Path) -> tuple[dict[str, Any], dict[str, str], dict[str, Any]]:
    """Return columns, their units and the file's attributes."""
    import h5py

    with h5py.File(path) as file:
        columns = {name: each.asstr()[:] if each.dtype.kind == "O" else each[:] for name, each in file.items()}
        return columns, {name: each.attrs["units"] for name, each in file.items()}, dict(file.attrs)


def from_netcdf(path: Path) -> tuple[dict[str, Any], dict[str, str], dict[str, Any]]:
    """Return the same of a NetCDF file."""
    with netcdf_file(path, mmap=False) as file:
        columns = {name: each[:] for name, each in file.variables.items()}
        columns["position"] = np.array([b"".join(row).rstrip(b"\0").decode() for row in columns["position"]])
        attributes = {name: getattr(file, name) for name in ("title", "simulated")}
        units = {name: each.units.decode() for name, each in file.variables.items()}
    return columns, units, {**attributes, "title": attributes["title"].decode()}


def from_mat(path: Path) -> tuple[dict[str, Any], dict[str, str], dict[str, Any]]:
    """Return the same of a MATLAB file."""
    found = {name: each for name, each in loadmat(path, squeeze_me=True).items() if not name.startswith("__")}
    units = {name: str(found["units"][name]) for name in found["units"].dtype.names}
    attributes = {"title": str(found["title"]), "simulated": found["simulated"]}
    return {name: found[name] for name in units}, units, attributes


def _there(form: Format) -> None:
    if form == "hdf5":
        pytest.importorskip("h5py", reason="the extra `hdf5` is not installed")


READERS: dict[Format, Read] = {"hdf5": from_hdf5, "netcdf": from_netcdf, "mat": from_mat}


@pytest.fixture(scope="module")
def campaign(tmp_path_factory: pytest.TempPathFactory) -> Campaign:
    """Return a campaign with repeats of two sensors; a rate is not known, nor one sensor's temperatures."""
    found = read_campaign(written("short soaks", tmp_path_factory.mktemp("given") / "campaign"))
    number, rows = next(iter(found.sensors.items()))
    rows.rates_deg_per_hr[3, 0] = np.nan
    sensor = replace(rows.conditions.sensor, number=number + 1)
    fewer = {name: values for name, values in rows.conditions.columns.items() if name != "temperature_degC"}
    conditions = replace(rows.conditions, sensor=sensor, collect=rows.conditions.collect + 1000, columns=fewer)
    return replace(found, sensors={number: rows, number + 1: replace(rows, conditions=conditions)})


@pytest.mark.parametrize("form", READERS)
def test_a_file_reads_back_to_the_last_bit(form: Format, campaign: Campaign, tmp_path: Path) -> None:
    """Every column with its unit, NaN where nothing is known, and the mark of a simulated one."""
    _there(form)
    path = tmp_path / f"campaign.{form}"
    write_file(replace(campaign, simulated=True), path, form)
    columns, units, attributes = READERS[form](path)
    known = columns_of(campaign)
    assert set(columns) == set(known)
    for name, values in known.items():
        assert np.array_equal(columns[name], values, equal_nan=name != "position")
    assert np.isnan(columns["RA_deg_per_hr"]).sum() == 2
    assert np.isnan(columns["temperature_degC"]).sum() == len(known["run"]) / 2
    assert (units["RA_deg_per_hr"], units["temperature_degC"], units["position"].strip("[]")) == ("deg/hr", "degC", "")
    assert (attributes["title"], int(attributes["simulated"])) == (campaign.title, 1)


@pytest.mark.parametrize("form", READERS)
@pytest.mark.slow
def test_a_night_has_its_series_in_the_file(form: Format, tmp_path: Path) -> None:
    """The block means of the campaign folder, one below the other, each with its collect; from either folder."""
    _there(form)
    night, folder = tmp_path / "night", tmp_path / "campaign"
    assert run(["run", "quick", "--bench", "simulated", "--out", str(night), "--yes", "--quiet"]) == 0
    assert run(["export", str(night), str(folder)]) == 0
    for source in (night, folder):
        path = tmp_path / f"{source.name}.{form}"
        assert run(["export", str(source), str(path), "--format", form]) == 0
        columns, _, _ = READERS[form](path)
        stored = read_campaign(folder)
        for number in stored.recorded:
            series = stored.series(number)
            assert series is not None
            own = columns["series_collect"] == number
            assert np.array_equal(columns["series_RA_deg_per_hr"][own], series.rates_deg_per_hr[:, 0])


def test_what_cannot_be_written_is_one_sentence(
    campaign: Campaign, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A file in the way, no folder, no library, names that would be one; nothing is left behind."""
    (tmp_path / "there.mat").write_text("mine")
    with pytest.raises(InputError, match="exists already"):
        write_file(campaign, tmp_path / "there.mat", "mat")
    with pytest.raises(InputError, match=r"the folder .* does not exist"):
        write_file(campaign, tmp_path / "no" / "a.mat", "mat")
    numbers, rows = next(iter(campaign.sensors.items()))
    columns = {**rows.conditions.columns, "a-b": rows.conditions.start_s, "a b": rows.conditions.start_s}
    odd = replace(campaign, sensors={numbers: replace(rows, conditions=replace(rows.conditions, columns=columns))})
    with pytest.raises(InputError, match="cannot be told apart in it: a b, a-b"):
        write_file(odd, tmp_path / "odd.mat", "mat")
    monkeypatch.setitem(sys.modules, "h5py", None)
    with pytest.raises(InputError, match=r"this needs h5py, .* 'hil\[hdf5\]'"):
        write_file(campaign, tmp_path / "a.h5", "hdf5")
    assert [path.name for path in tmp_path.iterdir()] == ["there.mat"]


def test_units_come_from_the_ends_of_names() -> None:
    """A name that ends otherwise has none."""
    assert [unit_of(name) for name in ("RA_se_deg_per_hr", "dTdt_degC_per_min", "f_A_g", "start_s", "run")] == [
        "deg/hr",
        "degC/min",
        "g",
        "s",
        "",
    ]
