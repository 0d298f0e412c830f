"""A campaign as one file of another program's format: HDF5, NetCDF or MATLAB.

write_file(campaign, Path("night-014.mat"), "mat")

Each has the columns of collects.csv under their names (what is no letter, digit or _ becomes _), one value for each
collect and sensor, and those of the series folder as `series_…`, one value for each row of every series, whose collect
is in `series_collect`. NaN is not known. Attributes carry title, source, notes, units and whether it is simulated.
"""

import io
import re
from collections.abc import Mapping
from pathlib import Path
from typing import Any, Literal

import numpy as np

from drivers.outside import library
from hil.campaign.data import Campaign
from hil.campaign.writer import columns_of, columns_of_series
from hil.errors import InputError
from hil.files.durable import check_new, write_result

Format = Literal["hdf5", "netcdf", "mat"]

_LONGEST_NAME = 63  # MATLAB reads no more
_UNITS = {"deg_per_hr": "deg/hr", "degC": "degC", "degC_per_min": "degC/min", "g": "g", "s": "s", "V": "V", "us": "us"}
_Columns = Mapping[str, np.ndarray[Any, Any]]
_Attributes = Mapping[str, str | int]


def write_file(campaign: Campaign, path: Path, form: Format) -> None:
    """Write `campaign` with the series of its collects as one file, whole or not at all.

    Raises `InputError` where `path` exists, its folder does not, it cannot be written, the names of two columns would
    be one, or the library is not installed.
    """
    check_new(path)
    given = columns_of(campaign)
    columns = {re.sub(r"^(?=[\W\d_])", "c", re.sub(r"\W", "_", name)): cells for name, cells in given.items()}
    if len(columns) < len(given) or max(map(len, columns)) > _LONGEST_NAME:
        names = ", ".join(name for name in given if not name.isidentifier() or len(name) > _LONGEST_NAME)
        raise InputError(f"{path}: the names of these columns cannot be told apart in it: {names}; name them otherwise")
    attributes: dict[str, str | int] = {name: getattr(campaign, name) for name in ("title", "source", "notes")}
    attributes["simulated"] = int(campaign.simulated)
    columns |= _samples(campaign)  # NetCDF has no whole numbers of eight bytes
    short = {name: cells.astype(np.int32) if cells.dtype.kind == "i" else cells for name, cells in columns.items()}
    write_result(path, _WRITERS[form](short, attributes))


def unit_of(column: str) -> str:
    """Return the unit that the end of a column's name says; empty where it says none."""
    return next((unit for end, unit in _UNITS.items() if column.endswith(f"_{end}")), "")


def _samples(campaign: Campaign) -> dict[str, np.ndarray[Any, Any]]:
    """Return all series, one below the other; a column that a series lacks is NaN there."""
    parts: list[dict[str, Any]] = [{"collect": number, **each} for number, each in columns_of_series(campaign)]
    return {
        f"series_{name}": np.concatenate(
            [np.broadcast_to(columns.get(name, np.nan), len(columns["t_s"])) for columns in parts]
        )
        for name in dict.fromkeys(name for columns in parts for name in columns)
    }


def _hdf5(columns: _Columns, attributes: _Attributes) -> bytes:
    h5py, stream = library("h5py", "hdf5"), io.BytesIO()
    with h5py.File(stream, "w") as file:
        file.attrs.update(attributes)
        for name, values in columns.items():
            text = values.dtype.kind == "U"
            kept, kind = (values.astype(object), h5py.string_dtype()) if text else (values, None)
            file.create_dataset(name, data=kept, dtype=kind).attrs["units"] = unit_of(name)
    return stream.getvalue()


def _netcdf(columns: _Columns, attributes: _Attributes) -> bytes:
    from scipy.io import netcdf_file

    stream = io.BytesIO()
    file = netcdf_file(stream, "w", version=2)
    for name, value in attributes.items():
        setattr(file, name, value.encode() if isinstance(value, str) else value)
    for name, values in columns.items():
        if values.dtype.kind == "U":  # as bytes, one below the other
            values = np.char.encode(values, "utf-8").view("S1").reshape(len(values), -1)
        along = ["sample" if name.startswith("series_") else "row", f"{name}_length"][: values.ndim]
        for dimension, size in zip(along, values.shape, strict=True):
            if dimension not in file.dimensions:
                file.createDimension(dimension, size)
        column = file.createVariable(name, values.dtype, tuple(along))
        column[:] = values
        column.units = unit_of(name).encode()
    file.flush()
    return stream.getvalue()


def _mat(columns: _Columns, attributes: _Attributes) -> bytes:
    from scipy.io import savemat

    kept = {name: values.astype(object) if values.dtype.kind == "U" else values for name, values in columns.items()}
    stream = io.BytesIO()
    units = {name: unit_of(name) for name in columns}
    savemat(
        stream, {**kept, **attributes, "units": units}, long_field_names=True, oned_as="column", do_compression=True
    )
    return stream.getvalue()


_WRITERS = {"hdf5": _hdf5, "netcdf": _netcdf, "mat": _mat}
