"""A campaign as one file of another program's format: HDF5, NetCDF or MATLAB.

write_file(campaign, Path("night-014.mat"), "mat", series)

Each has the columns of collects.csv under their names (what is no letter, digit or _ becomes _), one value for each
collect and sensor, and those of the series folder as `series_…`, one value for each row of every series, whose collect
is in `series_collect`. NaN is not known. Attributes carry title, source, notes, units and whether it is simulated.
"""

import io
import re
from collections.abc import Callable, Iterable, Mapping
from importlib import import_module
from pathlib import Path
from typing import Any, Literal

import numpy as np

from hil.campaign.data import Campaign, Sensor, Series
from hil.campaign.writer import columns_of, columns_of_series
from hil.errors import InputError
from hil.files.durable import RealDisk, write_durably

Format = Literal["hdf5", "netcdf", "mat"]
_LONGEST_NAME = 63  # MATLAB reads no more
_UNITS = {"deg_per_hr": "deg/hr", "degC": "degC", "degC_per_min": "degC/min", "g": "g", "s": "s", "V": "V", "us": "us"}
_Columns = Mapping[str, np.ndarray[Any, Any]]
_Attributes = Mapping[str, str | int]


def write_file(campaign: Campaign, path: Path, form: Format, series: Iterable[tuple[int, Series]] = ()) -> None:
    """Write `campaign` with the `series` of its collects as one file, whole or not at all.

    Raises `InputError` where `path` exists, its folder does not, it cannot be written, or the library is not installed.
    """
    if path.exists():
        raise InputError(f"{path}: exists already; give another name")
    writer = _WRITERS[form]()
    attributes: dict[str, str | int] = {
        "title": campaign.title,
        "source": campaign.source,
        "notes": campaign.notes,
        "simulated": int(campaign.simulated),
    }
    columns = columns_of(campaign)
    collects = {re.sub(r"^(?=[\W\d_])", "c", re.sub(r"\W", "_", name)): _array(columns[name]) for name in columns}
    if len(collects) < len(columns) or max(map(len, collects)) > _LONGEST_NAME:
        names = ", ".join(name for name in columns if not name.isidentifier() or len(name) > _LONGEST_NAME)
        raise InputError(f"{path}: the names of these columns cannot be told apart in it: {names}; name them otherwise")
    try:
        write_durably(RealDisk(), path, writer(collects, _samples(campaign, series), attributes))
    except OSError as error:
        raise InputError(f"{path}: cannot be written: {error.strerror}") from None


def unit_of(column: str) -> str:
    """Return the unit that the end of a column's name says; empty where it says none."""
    return next((_UNITS[end] for end in sorted(_UNITS, key=len, reverse=True) if column.endswith(f"_{end}")), "")


def _array(cells: list[Any]) -> np.ndarray[Any, Any]:
    """Return cells as one array: whole numbers, text, or numbers with NaN for what is not known."""
    if all(isinstance(cell, int | str) for cell in cells):
        return np.array(cells, dtype=np.int32 if isinstance(cells[0], int) else np.str_)
    return np.array([np.nan if cell is None else cell for cell in cells], dtype=np.float64)


def _samples(campaign: Campaign, series: Iterable[tuple[int, Series]]) -> _Columns:
    """Return all series, one below the other; a column that a series lacks is NaN there."""
    owner: dict[int, Sensor] = {
        int(collect): rows.conditions.sensor
        for rows in campaign.sensors.values()
        for collect in rows.conditions.collect
    }
    parts = [(number, columns_of_series(each, owner[number])) for number, each in series]
    names = dict.fromkeys(name for _, columns in parts for name in columns)
    stacked = (
        {"series_collect": np.concatenate([np.full(len(c["t_s"]), n, np.int32) for n, c in parts])} if parts else {}
    )
    for name in names:
        pieces = [columns.get(name, [np.nan] * len(columns["t_s"])) for _, columns in parts]
        stacked[f"series_{name}"] = np.concatenate([np.asarray(piece, dtype=np.float64) for piece in pieces])
    return stacked


def _hdf5() -> Callable[[_Columns, _Columns, _Attributes], bytes]:
    try:
        h5py = import_module("h5py")
    except ImportError:
        raise InputError("HDF5 needs h5py, which is not installed: pip install 'hil[hdf5]' brings it") from None

    def written(collects: _Columns, samples: _Columns, attributes: _Attributes) -> bytes:
        stream = io.BytesIO()
        with h5py.File(stream, "w") as file:
            file.attrs.update(attributes)
            for name, values in {**collects, **samples}.items():
                text = values.dtype.kind == "U"
                column = file.create_dataset(
                    name, data=values.astype(object) if text else values, dtype=h5py.string_dtype() if text else None
                )
                column.attrs["units"] = unit_of(name)
        return stream.getvalue()

    return written


def _netcdf() -> Callable[[_Columns, _Columns, _Attributes], bytes]:
    from scipy.io import netcdf_file

    def written(collects: _Columns, samples: _Columns, attributes: _Attributes) -> bytes:
        stream = io.BytesIO()
        file = netcdf_file(stream, "w", version=2)
        for name, value in attributes.items():
            setattr(file, name, value.encode() if isinstance(value, str) else value)
        for dimension, columns in (("row", collects), ("sample", samples)):
            if columns:
                file.createDimension(dimension, len(next(iter(columns.values()))))
            for name, values in columns.items():
                axes = [dimension]
                if values.dtype.kind == "U":
                    values = np.char.encode(values, "utf-8")
                    values = values.view("S1").reshape(len(values), -1)
                    file.createDimension(f"{name}_length", values.shape[1])
                    axes.append(f"{name}_length")
                column = file.createVariable(name, values.dtype, tuple(axes))
                column[:] = values
                column.units = unit_of(name).encode()
        file.flush()
        return stream.getvalue()

    return written


def _mat() -> Callable[[_Columns, _Columns, _Attributes], bytes]:
    from scipy.io import savemat

    def written(collects: _Columns, samples: _Columns, attributes: _Attributes) -> bytes:
        columns = {
            name: values.astype(object) if values.dtype.kind == "U" else values
            for name, values in {**collects, **samples}.items()
        }
        units = {name: unit_of(name) for name in columns}
        stream = io.BytesIO()
        savemat(
            stream,
            {**columns, **attributes, "units": units},
            long_field_names=True,
            oned_as="column",
            do_compression=True,
        )
        return stream.getvalue()

    return written


_WRITERS = {"hdf5": _hdf5, "netcdf": _netcdf, "mat": _mat}
