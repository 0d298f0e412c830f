"""The report's numbers as tables: the same that the page shows, for a spreadsheet or a program.

    write_tables(content, Path("night-014/report"), "csv")   # report-parameters.csv, report-collects.csv, …

Units stand in the names of columns, or in a column `unit`. A cell is empty where a thing is not known.
"""

import io
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any, Literal

import numpy as np
import pyarrow as pa
import pyarrow.csv
import pyarrow.parquet

from hil.files.document import picked, plain
from hil.files.durable import write_result
from hil.report.content import ReportContent

TableFormat = Literal["csv", "parquet"]
_SIMULATED = b"simulated"


def tables_of(content: ReportContent) -> Mapping[str, pa.Table]:
    """Return the tables by name; one that would be empty is left out."""
    night = content.night
    rows: dict[str, list[dict[str, Any]]] = {
        "parameters": list(_parameters(content)),
        "collects": [
            {name: value for name, value in each.items() if name != "counts"}
            | {f"frames_{name}": count for name, count in each["counts"].items()}
            for each in (night.collects if night else ())
        ],
        "soaks": list(night.soaks if night else ()),
        "differences": [
            {
                **picked(each, "sensor temperature_degC temperature_of parameter"),
                "unit": now.unit,
                "now": now.value,
                "earlier": earlier.value,
                "sigma": plain(each.difference.sd),
                "runs_now": now.runs,
                "runs_earlier": earlier.runs,
                "difference": each.difference.value,
                "beyond_3_sigma": each.flagged,
                "beyond_chance": compared.counts(each),
            }
            for compared in filter(None, [content.comparison])
            for each in compared.differences
            for now, earlier in [each.means]
        ],
    }
    tables = {name: pa.Table.from_pylist(found) for name, found in rows.items() if found}
    if night is not None and len(night.hours):
        named = {f"{label.replace(', ', '_').replace(' ', '_')}_degC": v for label, v in night.temperatures.items()}
        # Where the controller was silent the plot has a gap; the table needs no row for it.
        there = ~np.all(np.isnan(np.array(list(named.values()))), axis=0) if named else np.ones(len(night.hours), bool)
        columns = {"hours": night.hours[there], **{name: values[there] for name, values in named.items()}}
        tables["temperatures"] = pa.table({name: pa.array(v, from_pandas=True) for name, v in columns.items()})
    mark = {_SIMULATED: b"true" if content.campaign.simulated else b"false"}
    return {name: table.replace_schema_metadata(mark) for name, table in tables.items()}


def write_tables(content: ReportContent, stem: Path, kind: TableFormat) -> list[Path]:
    """Write every table as `<stem>-<name>.<kind>`; return the files. Raises `InputError` where it cannot."""
    written = []
    for name, table in tables_of(content).items():
        stream = io.BytesIO()
        if kind == "csv":
            marked = table.append_column("simulated", pa.array([content.campaign.simulated] * len(table)))
            pyarrow.csv.write_csv(marked, stream)
        else:
            pyarrow.parquet.write_table(table, stream)
        path = stem.with_name(f"{stem.name}-{name}.{kind}")
        write_result(path, stream.getvalue())
        written.append(path)
    return written


def _parameters(content: ReportContent) -> Iterator[dict[str, Any]]:
    for sensor in content.sensors:
        for solution in [*sensor.solutions, *sensor.contractor.values()]:
            beside = {name: of.document() for name, of in sensor.shown.of_run(solution).items()}
            for name, each in solution.parameters.items():
                yield {
                    **picked(solution, "sensor run"),
                    "temperature_degC": sensor.shown.temperature_degC.get(solution.runs[0]),
                    "model": solution.model,
                    "parameter": name,
                    **picked(each, "value se unit"),
                    "verdict": str(solution.verdict),
                    **{key: beside.get(name, {}).get(key) for key in ("sd", "low", "high")},
                }
