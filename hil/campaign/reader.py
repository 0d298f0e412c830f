"""Read a campaign folder (schema hil.campaign/1), recorded by this project or written by hand in a spreadsheet.

    campaign = read_campaign("my-campaign")
    campaign.warnings  # suspicious but legal input, with its rows
    series = campaign.series(7)  # the rates within a collect, read when asked for

Bad input is refused whole, with one sentence that names file, row and column: nothing partial is imported.
"""

import re
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import replace
from functools import partial
from itertools import chain
from pathlib import Path

import numpy as np
import pyarrow as pa

from drivers.given_file import RECORDING_MB, check_folder, opened, read_text
from hil.campaign.data import Campaign, Collects, Conditions, FloatArray, Sensor, Series, TextArray
from hil.campaign.header import Header, parse_header
from hil.campaign.laws import average
from hil.campaign.plausibility import accelerometer_columns, judged_by_its_records
from hil.campaign.table import LARGEST, Table, rows_in_words
from hil.campaign.warnings import F_LIMITS_G, suspicions
from hil.errors import InputError
from hil.files.columns import read_csv, read_parquet
from procedures.verdict import Judgement, Verdict, combine
from procedures.words import numbered

HEADER_FILE = "campaign.yaml"
COLLECTS_FILE = "collects.csv"
SERIES_FOLDER = "series"
_LEAST_SE = 1e-12  # deg/hr: less is a slip, and its weight is beyond arithmetic

NUMBERED = ("collect", "run", "sensor")
IDENTITY = (*NUMBERED, "position", "start_s", "duration_s")

STANDARD_CONDITIONS = (
    "n_samples",
    "temperature_degC",
    "case_degC",
    "chamber_degC",
    "setpoint_degC",
    "dTdt_degC_per_min",
    "time_since_power_on_s",
    "time_since_setpoint_s",
    "time_since_index_s",
)
"""Condition columns whose meaning and unit the format itself gives."""


def columns_for(sensor: Sensor) -> dict[str, list[str]]:
    """Names of a sensor's own columns: `f`, g, and `w`, deg/hr, by axis; `rate` and its `se`, deg/hr, by channel."""
    return {
        "f": [f"f_{axis}_g" for axis in sensor.axes],
        "w": [f"w_{axis}_deg_per_hr" for axis in sensor.axes],
        "rate": [f"{channel}_deg_per_hr" for channel in sensor.channels],
        "se": [f"{channel}_se_deg_per_hr" for channel in sensor.channels],
    }


def collects_from(
    sensor: Sensor, position: TextArray, cells: Mapping[str, FloatArray], columns: Mapping[str, FloatArray]
) -> Collects:
    """Return a sensor's n collects by the columns of collects.csv, (n,) each; `columns` are what it does not need."""
    own = {kind: np.stack([cells[name] for name in names], -1) for kind, names in columns_for(sensor).items()}
    collect, run = (cells[name].astype(np.int64) for name in ("collect", "run"))
    times = cells["start_s"], cells["duration_s"]
    conditions = Conditions(sensor, collect, run, position, *times, own["f"], own["w"], columns)
    return Collects(conditions, own["rate"], own["se"])


def read_campaign(folder: Path | str) -> Campaign:
    """Read and check a campaign folder; raise InputError for anything that campaign.md says must be refused."""
    root = Path(folder)
    check_folder(root)
    header = parse_header(read_text(root / HEADER_FILE), root / HEADER_FILE)
    _check_names(root / HEADER_FILE, header)
    table = Table(root / COLLECTS_FILE)
    if not len(table):
        raise InputError(f"{table.path}, row 2: there is no collect; at least one row is needed")
    used = _used_sensors(table, header)
    own = {name for sensor in header.sensors.values() for name in _own_columns(sensor)}
    needed = [columns_for(sensor)[kind] for sensor in used.values() for kind in ("f", "w", "rate")]
    table.require([*IDENTITY, *chain.from_iterable(needed)])
    collects = table.integers("collect")
    _check_identity(table)
    shown = {name for sensor in header.sensors.values() for name in accelerometer_columns(sensor)}
    declared = {*STANDARD_CONDITIONS, *shown, *header.campaign.condition_units}
    others = [name for name in table.header if name not in IDENTITY and name not in own]
    remarks = [name for name in others if name not in declared and table.holds_text(name)]
    extra = [name for name in others if name not in remarks]
    columns = {name: table.numbers(name) for name in extra}
    numbers = table.integers("sensor")
    sensors: dict[int, Collects] = {}
    lines: dict[int, list[int]] = {}
    for number, sensor in used.items():
        chosen = np.flatnonzero(numbers == number)
        lines[number] = [table.rows[int(i)] for i in chosen]
        sensors[number] = _collects_of(table, sensor, chosen, columns, header.campaign.centrifuge)
    files = _series_files(root / SERIES_FOLDER, {int(collect) for collect in collects})
    block_s = header.campaign.series_block_s
    series = {
        each: partial(_read_series, files[each], columns_for(used[number])["rate"], block_s)
        for each, number in zip(collects.tolist(), numbers.tolist(), strict=True)
        if each in files
    }
    undeclared = [name for name in extra if name not in declared]
    said = (
        *suspicions(table, header, sensors, lines, undeclared),
        *(f"{table.path}, column {name}: holds no number; taken as a remark, and not used" for name in remarks),
    )
    campaign = replace(header.campaign, sensors=sensors, warnings=said, recorded=series)
    campaign = _without_series(campaign, header.series)
    # Nothing partial is imported: a bad cell of a series is refused now, not when somebody needs it.
    return judged_by_its_records(campaign, dict(_averages(campaign)))


def _without_series(campaign: Campaign, written: float) -> Campaign:
    """Say which averages no series proves, where there were some; MARGINAL where more were `written` than are here."""
    here, rows = len(campaign.recorded), [each.conditions for each in campaign.sensors.values()]
    run_of = {n: run for c in rows for n, run in zip(c.collect.tolist(), c.run.tolist(), strict=True)}
    lost = [n for n in sorted(run_of) if n not in campaign.recorded]
    if here >= written and not (lost and campaign.series_block_s):
        return campaign
    which = lost or sorted(run_of)
    how = f" ({written:g} were written, {here} are here)" if here < written else ""
    words = f"{numbered('collect', which)}: no series{how}, so no samples prove the averages"
    gone = Judgement(Verdict.MARGINAL, words)
    runs = {run_of[n] for n in which} if how else ()
    verdicts = {run: combine([gone, campaign.verdicts.get(run, gone)]) for run in runs}
    return replace(campaign, warnings=(*campaign.warnings, words), verdicts={**campaign.verdicts, **verdicts})


def _averages(campaign: Campaign) -> Iterator[tuple[int, FloatArray]]:
    for rows in (each.conditions for each in campaign.sensors.values()):
        n_samples = rows.columns.get("n_samples", np.full(len(rows), np.nan))
        for collect, n, duration_s in zip(rows.collect.tolist(), n_samples, rows.duration_s, strict=True):
            series = campaign.series(collect)
            if series is not None:
                yield collect, average(series, n, duration_s)


def _read_series(path: Path, rates: Sequence[str], block_s: float | None) -> Series:
    columns = _finite(path, read_parquet(path)) if path.suffix == ".parquet" else _csv_columns(path)
    missing = [name for name in ["t_s", *rates] if name not in columns]
    if missing:
        raise InputError(f"{path}, row 1: column {missing[0]} is missing; a series has t_s and {', '.join(rates)}")
    times = columns["t_s"]
    if np.any(np.isnan(times)) or np.any(np.diff(times) <= 0.0):
        bad = int(np.flatnonzero(np.isnan(times) | (np.diff(times, prepend=-np.inf) <= 0.0))[0])
        raise InputError(f"{path}, row {bad + 2}, column t_s: times must be filled and increase from row to row")
    measured = np.stack([columns[name] for name in rates], -1)
    return Series(times, measured, columns.get("temperature_degC"), block_s, columns.get("n_samples"))


def _own_columns(sensor: Sensor) -> list[str]:
    return [*chain.from_iterable(columns_for(sensor).values())]


def _check_names(path: Path, header: Header) -> None:
    """Refuse channels whose column would be another column's (a channel called w_A, or RA_se beside RA)."""
    for number, sensor in header.sensors.items():
        names = [*IDENTITY, *STANDARD_CONDITIONS, *_own_columns(sensor)]
        twice = sorted({name for name in names if names.count(name) > 1})
        if twice:
            raise InputError(f"{path}, key sensors.{number}.channels: two things would share the column {twice[0]}")


def _used_sensors(table: Table, header: Header) -> dict[int, Sensor]:
    table.require(["sensor"])
    numbers = table.integers("sensor")
    for i, number in enumerate(numbers):
        if int(number) not in header.sensors:
            known = ", ".join(str(key) for key in sorted(header.sensors))
            raise table.complaint(i, "sensor", f"sensor {number} is not described in {HEADER_FILE} (it has {known})")
    return {number: sensor for number, sensor in header.sensors.items() if number in numbers}


def _check_identity(table: Table) -> None:
    collects = table.integers("collect")
    first: dict[int, int] = {}
    for i, collect in enumerate(collects):
        if int(collect) in first:
            earlier = table.rows[first[int(collect)]]
            raise table.complaint(
                i, "collect", f"collect {collect} already stands in row {earlier}; every row needs a number of its own"
            )
        first[int(collect)] = i
        if collect < 0:
            raise table.complaint(i, "collect", f"{collect} is negative")
    table.integers("run")
    for i, position in enumerate(table.texts("position")):
        if not position:
            raise table.complaint(i, "position", "the cell is empty; the orientation needs a label")
    table.numbers("start_s", required=True)
    for line in np.flatnonzero(table.numbers("duration_s", required=True) <= 0.0):
        raise table.complaint(int(line), "duration_s", "the averaging time must be more than 0 s")


def _collects_of(
    table: Table, sensor: Sensor, chosen: np.ndarray, columns: Mapping[str, FloatArray], centrifuge: bool
) -> Collects:
    """Gather one sensor's lines, `chosen` (n,), and check what is special to them."""
    names = columns_for(sensor)
    cells = {name: _filled(table, name, chosen) for name in (*names["f"], *names["w"])}
    size = np.linalg.norm(np.stack([cells[name] for name in names["f"]], -1), axis=-1)
    low, high = F_LIMITS_G
    for i in [] if centrifuge else np.flatnonzero((size < low) | (size > high)):
        allowed = f"on a centrifuge, `centrifuge: true` in {HEADER_FILE} allows it"
        wrong = f"|f| is {size[i]:.3f} g, outside {low:g} to {high:g} g; is it in g? ({allowed})"
        raise table.complaint(int(chosen[i]), ", ".join(names["f"]), wrong)
    plain = ("collect", "run", "start_s", "duration_s", *names["rate"])
    cells |= {name: table.numbers(name)[chosen] for name in plain}
    for name in names["rate"]:
        if np.all(np.isnan(cells[name])):
            rows = rows_in_words(np.take(table.rows, chosen))
            raise InputError(
                f"{table.path}, {rows}, column {name}: no cell is filled for sensor {sensor.number}; "
                f"leave the channel out of {HEADER_FILE} where it was not measured"
            )
    cells |= {name: _errors(table, name, chosen) for name in names["se"]}
    # A column that is empty in all of a sensor's rows is one that its data lacks.
    known = {name: values[chosen] for name, values in columns.items() if not np.all(np.isnan(values[chosen]))}
    return collects_from(sensor, np.array(table.texts("position"), dtype=np.str_)[chosen], cells, known)


def _filled(table: Table, column: str, chosen: np.ndarray) -> FloatArray:
    values = np.asarray(table.numbers(column)[chosen])
    hint = " (0 where w is unknown)" if column.startswith("w_") else ""
    for i in np.flatnonzero(np.isnan(values)):
        raise table.complaint(int(chosen[i]), column, f"the cell is empty; a number is needed{hint}")
    return values


def _errors(table: Table, column: str, chosen: np.ndarray) -> FloatArray:
    """Return standard errors, NaN where not stated; an error of exactly zero states nothing."""
    if column not in table.header:
        return np.full(len(chosen), np.nan)
    values = np.asarray(table.numbers(column)[chosen])
    for i in np.flatnonzero(values < 0.0):
        raise table.complaint(int(chosen[i]), column, "a standard error cannot be negative")
    for i in np.flatnonzero((values > 0.0) & (values < _LEAST_SE)):
        raise table.complaint(int(chosen[i]), column, f"no standard error is as small (less than {_LEAST_SE:g} deg/hr)")
    return np.where(values > 0.0, values, np.nan)


def _series_files(folder: Path, collects: set[int]) -> dict[int, Path]:
    """Find the series by their collect; refuse one without its row, and two for one collect."""
    found: dict[int, Path] = {}
    for path in sorted(folder.iterdir()) if folder.is_dir() else []:
        if path.suffix not in {".csv", ".parquet"} or path.name.startswith("."):
            continue
        if not re.fullmatch(r"\d{4,}", path.stem):
            raise InputError(f"{path}: a series is named after its collect, four digits or more, such as 0007.csv")
        collect = int(path.stem)
        if collect not in collects:
            raise InputError(f"{path}: a series without its row: {COLLECTS_FILE}, column collect, holds no {collect}")
        if collect in found:
            raise InputError(f"{path}: collect {collect} has two series, this and {found[collect].name}; keep one")
        found[collect] = path
    return found


def _csv_columns(path: Path) -> dict[str, FloatArray]:
    with opened(path, RECORDING_MB) as file:
        try:
            table = read_csv(path, file)
        except pa.ArrowInvalid:
            table = None
    if table is None or not all(pa.types.is_floating(t) or pa.types.is_integer(t) for t in table.schema.types):
        slow = Table(path)  # says which cell is wrong, and takes what the fast reader will not
        return {name: slow.numbers(name) for name in slow.header}
    return _finite(path, table)


def _finite(path: Path, table: pa.Table) -> dict[str, FloatArray]:
    columns = {}
    for name in table.column_names:
        if not (pa.types.is_floating(table[name].type) or pa.types.is_integer(table[name].type)):
            raise InputError(f"{path}, column {name}: it does not hold numbers")
        values = np.asarray(table[name].cast(pa.float64()).to_numpy(), dtype=np.float64)
        if np.any(np.abs(values) > LARGEST):
            row = int(np.flatnonzero(np.abs(values) > LARGEST)[0]) + 2
            raise InputError(f"{path}, row {row}, column {name}: the value is not finite, or no measured one")
        columns[name.removeprefix("\ufeff")] = values
    return columns
