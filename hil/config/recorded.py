"""The configuration of a night as its journal keeps it: everything that the files said, in one text.

The bench and sweep files may be edited, moved or lost while a night goes on. What counts is what they said at its
beginning; that includes the IMU's frame description, the simulated unit's model and the description of a chamber
without a driver of its own, which the bench file only names.
"""

import tempfile
from collections.abc import Iterator, Mapping
from functools import lru_cache, reduce
from operator import getitem
from pathlib import Path
from typing import Any

import yaml

from drivers.frames.description import whole_text
from drivers.given_file import read_bytes
from drivers.strict_yaml import check_schema
from hil.config import Bench, parse_bench
from hil.config.limits import Limits
from hil.config.sweep import Sweep, limits_of, parse_sweep
from hil.errors import InputError
from hil.files.durable import RealDisk, write_durably
from hil.files.strict import parse_yaml, read_text

SCHEMA = "hil.configuration/1"
CONFIGURATION = "configuration"
"""The folder within a night's that the files are written into."""
_FILES: Mapping[str, tuple[str | int, ...]] = {
    "imu": ("bench", "imu", "description"),
    "model": ("bench", "simulation", "model"),
    "chamber": ("bench", "chamber", "description"),
    "limits": ("sweep", "limits"),
}
"""Where bench and sweep file name what stands in the text, by its name there."""
_OF_A_UNIT: Mapping[str, tuple[str, ...]] = {"imu": ("description",), "model": ("simulation", "model")}
"""Where an entry of the bench's list of units names what it has for itself."""


def _files(document: Mapping[str, Any]) -> dict[str, tuple[str | int, ...]]:
    """Return where each file is named, by its name in the text and in the folder, those of listed units too."""
    found = dict(_FILES)
    bench = document["bench"]
    for place, entry in enumerate(bench.get("units", ()) if isinstance(bench, dict) else ()):
        for name, keys in _OF_A_UNIT.items():
            if keys[0] in entry and (len(keys) == 1 or keys[1] in entry[keys[0]]):
                found[f"{name}-{entry['serial']}"] = ("bench", "units", place, *keys)
    return found


def configuration_text(bench: Bench, sweep: Sweep, seed: int | None = None) -> str:
    """Return everything that the night depends on as YAML; `seed` takes the place of the bench file's.

    Raises `InputError` where a file that the bench names cannot be found, or a seed is given and nothing is simulated.
    """
    document: dict[str, Any] = {
        "schema": SCHEMA,
        "bench_file": bench.source,
        "sweep_file": sweep.source,
        "bench": parse_yaml(bench.text, bench.source),
        "sweep": parse_yaml(sweep.text, sweep.source),
    }
    if "unit" in document["bench"]:
        document["bench"]["unit"]["serial"] = bench.unit.serial  # which somebody may have typed
    for name in _files(document):
        kind, _, serial = name.partition("-")
        own = bench.units[serial] if serial else bench
        path = {"imu": own.imu_description, "model": own.simulation_model, "chamber": own.chamber_description}.get(kind)
        if path is not None:
            document[name] = whole_text(path) if kind == "imu" else read_text(path)
    if (limits := limits_of(sweep, bench)) is not None:
        document |= {"limits": limits.text, "limits_file": limits.source}
    if seed is not None:
        if bench.simulation is None:
            raise InputError(f"{bench.source}: a seed was given, but nothing on this bench is simulated")
        document["bench"]["simulation"]["seed"] = seed
    return yaml.safe_dump(document, sort_keys=False, allow_unicode=True, width=120)


def configuration_of(text: str, folder: Path) -> tuple[Bench, Sweep]:
    """Return bench and sweep of a journal's text, their files put into `folder`; `InputError` where not understood."""
    document: Any = parse_yaml(text, "the night's configuration")
    check_schema(document, SCHEMA, "the night's configuration")
    bench: dict[str, Any] = document["bench"]
    folder = folder.resolve()
    folder.mkdir(exist_ok=True)
    for name, (*sections, key) in _files(document).items():
        if name in document:
            write_durably(RealDisk(), folder / f"{name}.yaml", document[name].encode())
            reduce(getitem, sections, document)[str(key)] = str(folder / f"{name}.yaml")
    return (
        parse_bench(yaml.safe_dump(bench, sort_keys=False, allow_unicode=True), document["bench_file"]),
        parse_sweep(yaml.safe_dump(document["sweep"], sort_keys=False, allow_unicode=True), document["sweep_file"]),
    )


def lost_files(text: str, folder: Path) -> Iterator[str]:
    """Yield in words which files of `folder` are not what `configuration_of` wrote there."""
    document = {"bench": {}, **understood(text)}
    for path in (folder / f"{name}.yaml" for name in _files(document) if name in document):
        try:
            what = "" if read_bytes(path) == document[path.stem].encode() else "is not what the journal has on record"
        except InputError as error:
            what = f"is lost ({error})"
        if what:
            yield f"{folder.name}/{path.name} {what}; nothing is read from it, the journal has its text"


def recorded_limits(text: str) -> Limits | None:
    """Return a night's limits as they were at its beginning, None for none; `InputError` where not understood."""
    document = understood(text if "limits_file:" in text else "")
    return Limits.parse(document["limits"], document["limits_file"]) if "limits" in document else None


def key_file(text: str) -> Path | None:
    """Return the file of the key with which the night's head is signed (`record.key`), None where none is named."""
    key = understood(text if "key:" in text else "").get("bench", {}).get("record", {}).get("key")  # it is a long text
    return None if key is None else Path(key)


def understood(text: str) -> dict[str, Any]:
    """Return what a journal's text says; nothing where this version does not understand it."""
    try:
        return parse_yaml(text, "the night's configuration")
    except InputError:
        return {}


@lru_cache(4)  # the units of one night share it
def bench_of_record(text: str) -> Bench:
    """Return the bench of a journal's text to look at it: orientations, site, sensors. Nothing is left behind."""
    with tempfile.TemporaryDirectory(prefix="hil-") as folder:
        return configuration_of(text, Path(folder))[0]
