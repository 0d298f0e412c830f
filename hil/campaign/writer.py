"""Write a campaign folder (schema hil.campaign/1) that `hil.campaign.reader` reads back as the same campaign.

    write_campaign(campaign, "my-campaign")

The folder appears whole or not at all (hil.files.durable).
"""

import csv
import io
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any

import numpy as np
import yaml
from numpy.typing import NDArray

from hil.campaign.data import SCHEMA, Campaign, Collects, FloatArray, Sensor
from hil.campaign.reader import COLLECTS_FILE, HEADER_FILE, IDENTITY, SERIES_FOLDER, STANDARD_CONDITIONS, columns_for
from hil.errors import InputError
from hil.files.durable import RealDisk, is_new, whole_or_nothing
from procedures.pose import PoseTolerance


def write_campaign(campaign: Campaign, folder: Path | str, beside: Mapping[str, bytes] | None = None) -> Path:
    """Write `campaign` with the series of its collects, read one at a time.

    `beside` holds further files by name, which no reader of campaigns looks at. Values are written so that they read
    back to the last bit. Raises InputError where `folder` holds anything or cannot be made, or a series cannot be read.
    """
    target = Path(folder)
    if not is_new(target):
        raise InputError(f"{target}: it exists and is not empty; name a new folder")
    disk = RealDisk()
    with whole_or_nothing(target) as partial:
        disk.write(partial / COLLECTS_FILE, _csv(columns_of(campaign)))
        for name, data in (beside or {}).items():
            disk.write(partial / name, data)
        written, series = 0, partial / SERIES_FOLDER
        for collect, columns in columns_of_series(campaign):
            series.mkdir(exist_ok=True)
            disk.write(series / f"{collect:04d}.csv", _csv(columns))
            written += 1
        if written:
            disk.synchronise_folder(series)
        disk.write(partial / HEADER_FILE, header_of(campaign, written).encode())
    return target


def header_of(campaign: Campaign, written: int) -> str:
    """Return campaign.yaml of a campaign with so many series."""
    rows = [each for collects in campaign.sensors.values() for each in collects.conditions.run.tolist()]
    verdicts = {run: campaign.verdicts[run] for run in sorted(campaign.verdicts.keys() & set(rows))}
    always: dict[str, Any] = {"schema": SCHEMA, "title": campaign.title, "source": campaign.source}
    keys = {
        "identity": dict(campaign.identity),
        "simulated": campaign.simulated,
        "centrifuge": campaign.centrifuge,
        "rebuilt": campaign.rebuilt,
        "taken_as_zero": list(campaign.taken_as_zero),
        "site": dict(campaign.site),
        "sensors": {number: _layout(rows.conditions.sensor) for number, rows in campaign.sensors.items()},
        "conditions": dict(campaign.condition_units),
        "series": {name: n for name, n in (("block_s", campaign.series_block_s), ("collects", written)) if n},
        "pose": {} if campaign.pose == PoseTolerance() else dict(vars(campaign.pose)),
        "largest_standard_error_deg_per_hr": campaign.largest_se,
        "verdicts": {run: {"verdict": str(each.verdict), "reason": each.reason} for run, each in verdicts.items()},
        "missing": list(campaign.missing),
        "notes": campaign.notes,
    }
    known = always | {key: value for key, value in keys.items() if value}
    return str(yaml.safe_dump(known, sort_keys=False, allow_unicode=True, width=120))


def _layout(sensor: Sensor) -> dict[str, Any]:
    known = {"axes": list(sensor.axes), "channels": dict(sensor.channels)}
    return known | ({"technology": sensor.technology} if sensor.technology else {})


def columns_of(campaign: Campaign) -> dict[str, NDArray[Any]]:
    """Return the columns of collects.csv, (n,) each: a cell per collect and sensor in the order of time.

    The columns are the union of all sensors'; what is not known is NaN.
    """
    of_each = [_columns(rows) for rows in campaign.sensors.values()]
    present = {name for columns in of_each for name in columns}
    own = [columns_for(rows.conditions.sensor) for rows in campaign.sensors.values()]
    order = [*IDENTITY, *(name for kind in ("f", "w", "rate", "se") for names in own for name in names[kind])]
    order += [*STANDARD_CONDITIONS, *campaign.condition_units, *sorted(present)]
    whole = {
        name: np.concatenate([columns.get(name, np.full(len(columns["run"]), np.nan)) for columns in of_each])
        for name in dict.fromkeys(order)
        if name in present
    }
    in_time = np.lexsort((whole["collect"], whole["start_s"]))
    return {name: values[in_time] for name, values in whole.items()}


def _columns(rows: Collects) -> dict[str, NDArray[Any]]:
    c = rows.conditions
    columns: dict[str, NDArray[Any]] = {name: getattr(c, name) for name in IDENTITY if name != "sensor"}
    columns["sensor"] = np.full(len(c), c.sensor.number)
    stated = [] if np.all(np.isnan(rows.rates_se_deg_per_hr)) else [rows.rates_se_deg_per_hr]
    blocks = (c.f_g, c.w_deg_per_hr, rows.rates_deg_per_hr, *stated)
    for names, values in zip(columns_for(c.sensor).values(), blocks, strict=False):
        columns |= zip(names, values.T, strict=True)
    return columns | dict(c.columns)


def _cell(value: float | int | str) -> str:
    """Write a cell: shortest digits that read back exactly, whole numbers without a point, nothing for NaN."""
    if isinstance(value, float):
        return "" if np.isnan(value) else repr(value).removesuffix(".0")
    return str(value)


def columns_of_series(campaign: Campaign) -> Iterator[tuple[int, dict[str, FloatArray]]]:
    """Yield each collect that has series with the columns of its file, (k,), that are known: read one at a time."""
    every = [rows.conditions for rows in campaign.sensors.values()]
    for collect, sensor in sorted((n, each.sensor.number) for each in every for n in each.collect.tolist()):
        if (series := campaign.series(collect)) is None:
            continue
        rates = columns_for(campaign.sensors[sensor].conditions.sensor)["rate"]
        columns = {"t_s": series.t_s, **dict(zip(rates, series.rates_deg_per_hr.T, strict=True))}
        more = {"temperature_degC": series.temperature_degC, "n_samples": series.n_samples}
        yield collect, columns | {name: values for name, values in more.items() if values is not None}


def _csv(columns: Mapping[str, NDArray[Any]]) -> bytes:
    text = io.StringIO()
    writer = csv.writer(text, lineterminator="\n")
    writer.writerow(columns)
    writer.writerows(map(_cell, row) for row in zip(*(values.tolist() for values in columns.values()), strict=True))
    return text.getvalue().encode()
