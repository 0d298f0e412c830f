"""Many campaigns as one Parquet file that is read in pieces: for `hil fleet`, where folders are too many to be opened.

    write_fleet_file(campaigns, Path("fleet.parquet"))      # (folder, campaign) pairs, taken one at a time
    for piece in range(pieces_of(Path("fleet.parquet"))):
        for folder, campaign in read_piece(Path("fleet.parquet"), piece): ...

A row per collect and sensor with the columns of collects.csv. In front of them stand what the campaign is (`folder`,
`title`, `source`, `serial`, `simulated`) and its `layout`: campaign.yaml without what is a campaign's own, but for the
runs that FAIL, by how they were measured or by what their records contradict of each other. The rows of a campaign
stand together and in one row group.
"""

from collections.abc import Iterable, Iterator, Mapping
from contextlib import ExitStack
from dataclasses import replace
from functools import lru_cache
from itertools import chain, pairwise
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq

from hil.campaign.data import Campaign, Collects, FloatArray, Sensor
from hil.campaign.header import parse_header
from hil.campaign.reader import IDENTITY, NUMBERED, collects_from, columns_for
from hil.campaign.writer import columns_of, header_of
from hil.errors import InputError
from hil.files.columns import opened_parquet
from hil.files.durable import check_new, whole_file
from procedures.verdict import Verdict

PIECE = 256
"""Campaigns in a row group, which is what is read at once."""
ABOUT = {"folder": "", "title": "", "source": "", "serial": "", "simulated": False, "layout": ""}
"""What stands in every row of a campaign, with a value of its type."""
_SEE = "(the layout is in the documentation: Files and formats)"
_TEXTS = tuple(name for name, value in ABOUT.items() if value == "")


def write_fleet_file(campaigns: Iterable[tuple[str, Campaign | str]], path: Path) -> dict[str, str]:
    """Write campaigns, each with its folder, into one file, which appears whole or not at all.

    Return why some are not in it: a sentence in a campaign's place, or columns that the first one has not. Raises
    `InputError` where the file exists, or no campaign is left.
    """
    check_new(path)
    told: dict[str, str] = {}
    with whole_file(path) as partial, ExitStack() as opened:
        writer: pq.ParquetWriter | None = None
        kept: list[pa.Table] = []
        for folder, campaign in campaigns:
            if isinstance(campaign, str):
                told[folder] = campaign
                continue
            table = _table(folder, campaign)
            writer = writer or opened.enter_context(pq.ParquetWriter(partial, table.schema, compression="zstd"))
            if table.schema != writer.schema:
                apart = sorted({*table.schema.names} ^ {*writer.schema.names})
                told[folder] = (
                    f"left out: of it and the first campaign, one lacks {', '.join(apart)}; "
                    "such campaigns need a file of their own"
                )
                continue
            kept.append(table)
            if len(kept) == PIECE:
                writer.write_table(pa.concat_tables(kept))
                kept = []
        if writer is None:
            raise InputError("; ".join(f"{folder}: {why}" for folder, why in list(told.items())[:3]) or "no campaign")
        if kept:
            writer.write_table(pa.concat_tables(kept))
    return told


def _table(folder: str, campaign: Campaign) -> pa.Table:
    columns = columns_of(campaign)
    rows = len(columns["collect"])
    recorded = {run: of for run, of in campaign.verdicts.items() if of.verdict is Verdict.FAIL}
    failed = {run: of for (run, _), of in campaign.contradicted.items()} | recorded
    layout = header_of(replace(campaign, title="-", source="", identity={}, verdicts=failed, missing=(), notes=""), 0)
    about: dict[str, Any] = {"folder": folder, "title": campaign.title, "source": campaign.source, "layout": layout}
    about |= {"serial": campaign.identity.get("serial", ""), "simulated": campaign.simulated}
    found = {name: pa.array([about[name]] * rows) for name in ABOUT}
    return pa.table(found | {name: pa.array(values, from_pandas=True) for name, values in columns.items()})


def pieces_of(path: Path) -> int:
    """Return how many pieces a file has; raises `InputError` where it is none, or a column is not what it must be."""
    with opened_parquet(path) as file:
        schema = file.schema_arrow
        for name in (*ABOUT, *IDENTITY):
            if name not in schema.names:
                raise InputError(f"{path}: column {name} is missing {_SEE}")
        for name, kind in zip(schema.names, schema.types, strict=True):
            own = kind.value_type if pa.types.is_dictionary(kind) else kind
            text, texts = pa.types.is_string(own) or pa.types.is_large_string(own), name in _TEXTS or name == "position"
            if texts != text or (name == "simulated") != pa.types.is_boolean(kind):
                raise InputError(f"{path}, column {name}: it is {kind} {_SEE}")
        return int(file.num_row_groups)


def read_piece(path: Path, piece: int) -> Iterator[tuple[str, Campaign | str]]:
    """Yield the campaigns of a piece with their folders, or the sentence why one cannot be read.

    Raises `InputError` where the file cannot be read. Warnings are those of the folder, which its reader gives.
    """
    with opened_parquet(path) as file:
        table = file.read_row_group(piece, use_threads=False)
    about = {name: table.column(name).to_pylist() for name in ABOUT}
    position = np.array(table.column("position").to_pylist(), dtype=str)
    other = [name for name in table.column_names if name not in ABOUT and name != "position"]
    numbers = {name: table.column(name).cast(pa.float64()).to_numpy() for name in other}
    folder = np.array(about["folder"], dtype=str)
    starts = np.flatnonzero(folder[1:] != folder[:-1]) + 1
    for first, end in pairwise([0, *starts.tolist(), len(folder)]):
        own = {name: values[first:end] for name, values in numbers.items()}
        what = {name: values[first] for name, values in about.items()}
        try:
            yield what["folder"], _campaign(path, what, own, position[first:end])
        except InputError as error:
            yield what["folder"], str(error)


_layout = lru_cache(maxsize=64)(parse_header)


def _campaign(path: Path, what: Mapping[str, Any], numbers: Mapping[str, FloatArray], position: Any) -> Campaign:
    header, sensors = _layout(what["layout"], path), {}
    for number in np.unique(numbers["sensor"]).astype(np.int64).tolist():
        if number not in header.sensors:
            raise InputError(f"{path}, {what['folder']}: sensor {number} is not described in its layout")
        mine = numbers["sensor"] == number
        own = {name: values[mine] for name, values in numbers.items()}
        sensors[number] = _collects(f"{path}, {what['folder']}", header.sensors[number], own, position[mine])
    named = {"serial": what["serial"]} if what["serial"] else {}
    said = {name: what[name] for name in ("title", "source", "simulated")}
    return replace(header.campaign, **said, identity=named, sensors=sensors)


def _collects(where: str, sensor: Sensor, numbers: Mapping[str, FloatArray], position: Any) -> Collects:
    own = columns_for(sensor)
    needed = [*NUMBERED, "start_s", "duration_s", *own["f"], *own["w"]]
    for name in (*needed, *own["rate"]):
        if name not in numbers or (name in needed and not np.all(np.isfinite(numbers[name]))):
            raise InputError(f"{where}, column {name}: a number is missing")
    errors = {name: numbers.get(name, np.full(len(position), np.nan)) for name in own["se"]}
    known = {*IDENTITY, *chain.from_iterable(own.values())}
    others = {name: values for name, values in numbers.items() if name not in known and not np.all(np.isnan(values))}
    return collects_from(sensor, position, {**numbers, **errors}, others)
