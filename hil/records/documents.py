"""A night's journal as Bluesky's event-model documents: JSON lines, each the kind of a document and itself.

The start says what the night is, the stop whether it is complete. Stream `sensor_N` has an event for each collect with
the columns of collects.csv, `steps` one for each attempt at a step, `happened` one for each event of the journal. What
is not known is null; times are seconds since 1970. The same journal gives the same documents, uids included.
"""

import json
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import replace
from itertools import count
from pathlib import Path
from typing import Any
from uuid import NAMESPACE_OID, uuid5

from hil.campaign.formats import unit_of
from hil.campaign.writer import columns_of
from hil.errors import InputError
from hil.files.document import plain
from hil.files.durable import check_new, write_result
from hil.records.export import campaign_of_night
from hil.records.reader import JournalReader, is_night, reading
from hil.records.status import in_brief, missing_in_words
from hil.records.units import unit_folder

Document = tuple[str, Mapping[str, Any]]
_Rows = Sequence[tuple[float, Mapping[str, Any]]]
_DTYPES = {bool: "boolean", int: "integer", float: "number", str: "string"}


def export_documents(folder: Path | str, out: Path | str) -> int:
    """Write the documents of a night as a new file `out`, whole or not at all; return how many there are.

    Raises `InputError` where the folder is no night, no collect was completed, or `out` exists or cannot be written;
    `Damaged` where the journal or samples are not what was written.
    """
    folder, target = Path(folder), Path(out)
    check_new(target)
    if not is_night(folder):
        raise InputError(f"{folder}: no night; documents are made of a journal, which a campaign folder does not have")
    with reading(folder) as journal:
        lines = [json.dumps(each, allow_nan=False) + "\n" for each in documents_of(journal)]
    write_result(target, "".join(lines))
    return len(lines)


def documents_of(journal: JournalReader) -> Iterator[Document]:
    """Yield the documents of a night: start, a descriptor for each stream, all events in the order of time, stop."""
    night, campaign = journal.night, campaign_of_night(unit_folder(journal.folder, journal.unit))
    began = night.began_utc.timestamp()
    digest, numbers = night.digest(journal.plan), count()

    def uid() -> str:
        return str(uuid5(NAMESPACE_OID, f"{digest} {next(numbers)}"))

    run = uid()
    facts = {"plan_name": "hil", "title": night.title, "simulated": night.simulated, "operator": night.who}
    yield "start", {"uid": run, "time": began, **facts, **campaign.identity, "source": campaign.source}
    streams: dict[str, _Rows] = {}
    for number, collects in campaign.sensors.items():
        columns = columns_of(replace(campaign, sensors={number: collects}))
        lines = [dict(zip(columns, line, strict=True)) for line in zip(*map(plain, columns.values()), strict=True)]
        streams[f"sensor_{number}"] = [(float(line["start_s"]), line) for line in lines]
    streams["steps"] = [
        (
            each.began_s,
            {"step": each.step_key, "attempt": each.attempt, "ended_s": each.ended_s, "reason": each.reason}
            | {"outcome": str(each.outcome or "never ended")},
        )
        for each in journal.attempts()
    ]
    streams["happened"] = [(each.at_s, {"kind": each.kind, "message": each.message}) for each in journal.events()]
    events: list[dict[str, Any]] = []
    last_s = 0.0
    for name, rows in ((name, rows) for name, rows in streams.items() if rows):
        descriptor = uid()
        keys: dict[str, dict[str, Any]] = {}
        for key in rows[0][1]:
            kind = next((_DTYPES[type(data[key])] for _, data in rows if data[key] is not None), "number")
            keys[key] = {"dtype": kind, "shape": [], "source": campaign.source, "units": unit_of(key) or None}
        yield "descriptor", {"uid": descriptor, "run_start": run, "time": began, "name": name, "data_keys": keys}
        for number, (at_s, data) in enumerate(rows, start=1):
            stamps = dict.fromkeys(data, began + at_s)
            told = {"descriptor": descriptor, "seq_num": number, "time": began + at_s, "data": data}
            events.append({"uid": uid(), **told, "timestamps": stamps, "filled": {}})
            last_s = max(last_s, at_s)
    for event in sorted(events, key=lambda each: each["time"]):
        yield "event", event
    lacking = in_brief(missing_in_words(journal.plan, journal.completed(), journal.attempts()))
    sizes = {name: len(rows) for name, rows in streams.items() if rows}
    status = {"exit_status": "abort" if lacking else "success", "reason": "; ".join(lacking), "num_events": sizes}
    yield "stop", {"uid": uid(), "run_start": run, "time": began + last_s, **status}
