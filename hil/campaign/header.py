"""campaign.yaml: what was measured, where, with which channels."""

import re
from collections.abc import Iterator, Mapping
from contextlib import suppress
from dataclasses import dataclass, fields
from datetime import date
from pathlib import Path
from typing import Any, get_args

import numpy as np

from drivers.given_file import read_text
from drivers.strict_yaml import parse_yaml
from hil.campaign.data import SCHEMA, Campaign, Sensor, Technology
from hil.errors import InputError
from procedures.pose import PoseTolerance
from procedures.verdict import Judgement, Verdict

KNOWN_KEYS = frozenset(
    {"schema", "title", "source", "site", "sensors", "conditions", "series", "notes", "simulated", "centrifuge"}
    | {"verdicts", "pose", "identity", "largest_standard_error_deg_per_hr", "rebuilt", "missing"}
)
OF_A_SENSOR = frozenset({"axes", "channels", "technology"})
_DATE = re.compile(r"\b\d{4}-[01]\d-[0-3]\d\b")


@dataclass(frozen=True)
class Header:
    """The checked contents of campaign.yaml: a `campaign` without its collects; `extra` are keys that are not known.

    `series` says of how many collects series were written, 0 where it does not.
    """

    campaign: Campaign
    sensors: Mapping[int, Sensor]
    extra: tuple[str, ...]
    series: float


def read_header(path: Path) -> Header:
    """Read and check campaign.yaml; raise InputError with the file and the key."""
    return parse_header(read_text(path), path)


def parse_header(text: str, path: Path) -> Header:
    """Read and check the text of a campaign.yaml, which stands at `path`; raise InputError with that and the key."""
    keys = parse_yaml(text, str(path))
    if keys.get("schema") != SCHEMA:
        found = f"it is {keys['schema']!r}" if "schema" in keys else "it is missing"
        raise InputError(f"{path}, key schema: {found}; this program reads {SCHEMA}")
    block, written = (_mapping(path, keys, "series").get(key) for key in ("block_s", "collects"))
    campaign = Campaign(
        title=str(keys.get("title") or path.parent.name),
        source=str(keys.get("source") or ""),
        sensors={},
        condition_units={str(name): str(unit) for name, unit in _mapping(path, keys, "conditions").items()},
        simulated=_flag(path, keys, "simulated") or str(keys.get("notes")).startswith("SIMULATED"),
        site={str(k): _number(path, f"site.{k}", v) for k, v in _mapping(path, keys, "site").items()},
        centrifuge=_flag(path, keys, "centrifuge"),
        folder=path.parent,
        notes=str(keys.get("notes") or ""),
        rebuilt=_flag(path, keys, "rebuilt"),
        series_block_s=None if block is None else _number(path, "series.block_s", block),
        verdicts=dict(_verdicts(path, keys)),
        missing=_texts(path, keys, "missing"),
        identity={str(name): str(text) for name, text in _mapping(path, keys, "identity").items()},
        pose=_pose(path, _mapping(path, keys, "pose")),
        largest_se=_positive(path, keys, "largest_standard_error_deg_per_hr"),
    )
    extra = tuple(sorted(str(key) for key in keys.keys() - KNOWN_KEYS))
    return Header(campaign, _sensors(path, keys), extra, _number(path, "series.collects", written or 0))


def day_of(source: str) -> date | None:
    """Return the first date, such as 1985-10-01, in the words about where a campaign comes from."""
    for said in _DATE.findall(source):
        with suppress(ValueError):  # the 39th of a month
            return date.fromisoformat(said)
    return None


def _texts(path: Path, keys: Mapping[Any, Any], key: str) -> tuple[str, ...]:
    given = keys.get(key) or []
    if not isinstance(given, list):
        raise InputError(f"{path}, key {key}: it must be a list of texts")
    return tuple(str(each) for each in given)


def _sensors(path: Path, keys: Mapping[Any, Any]) -> dict[int, Sensor]:
    described = keys.get("sensors")
    if not isinstance(described, dict) or not described:
        raise InputError(f"{path}, key sensors: it must describe at least one sensor by its number, axes and channels")
    sensors = {}
    for number, layout in described.items():
        where = f"{path}, key sensors.{number}"
        if isinstance(number, bool) or not isinstance(number, int):
            raise InputError(f"{where}: a sensor is called by a whole number, such as 2")
        if not isinstance(layout, dict):
            raise InputError(f"{where}: it must give axes and channels")
        sensors[number] = _sensor(where, number, layout)
    return sensors


def _sensor(where: str, number: int, layout: Mapping[Any, Any]) -> Sensor:
    axes = layout.get("axes")
    if not isinstance(axes, list) or len(axes) != 3 or not all(isinstance(axis, str) and axis for axis in axes):
        raise InputError(f"{where}.axes: it must be a list of three names, such as [A, B, S]")
    if len(set(axes)) != 3:
        raise InputError(f"{where}.axes: {', '.join(axes)} are not three different names")
    channels = layout.get("channels")
    if not isinstance(channels, dict) or not channels:
        raise InputError(
            f"{where}.channels: it must say which axis each channel measures about, such as {{RA: A, RB: B}}"
        )
    for channel, axis in channels.items():
        if not isinstance(channel, str) or not channel:
            raise InputError(f"{where}.channels: {channel!r} is no name of a channel")
        if axis not in axes:
            raise InputError(f"{where}.channels.{channel}: {axis!r} is not one of the axes {', '.join(axes)}")
    unknown = sorted(str(key) for key in layout.keys() - OF_A_SENSOR)
    if unknown:
        raise InputError(f"{where}.{unknown[0]}: this key is not known; a sensor has axes, channels and technology")
    technology = layout.get("technology", "")
    if technology not in get_args(Technology):
        raise InputError(f"{where}.technology: {technology!r} is none of {', '.join(get_args(Technology)[1:])}")
    # In the order of their axes: the six parameters of a rotor sensor do not depend on how the file lists its channels.
    ordered = dict(sorted(channels.items(), key=lambda item: axes.index(item[1])))
    return Sensor(number, (axes[0], axes[1], axes[2]), ordered, technology)


def _verdicts(path: Path, keys: Mapping[Any, Any]) -> Iterator[tuple[int, Judgement]]:
    """Yield how each run was measured, by its number."""
    for run, said in _mapping(path, keys, "verdicts").items():
        where = f"{path}, key verdicts.{run}"
        if isinstance(run, bool) or not isinstance(run, int):
            raise InputError(f"{where}: a run is called by its whole number, as in the column run")
        if not isinstance(said, dict) or said.keys() - {"verdict", "reason"}:
            raise InputError(f"{where}: it must hold verdict and reason, and nothing else")
        if said.get("verdict") not in list(Verdict):
            raise InputError(f"{where}.verdict: {said.get('verdict')!r} is none of {', '.join(Verdict)}")
        yield run, Judgement(Verdict(said["verdict"]), str(said.get("reason") or "no reason is given"))


def _pose(path: Path, given: Mapping[Any, Any]) -> PoseTolerance:
    """Return how far accelerometers may be from f."""
    known = [each.name for each in fields(PoseTolerance)]
    unknown = sorted(str(key) for key in given.keys() - set(known))
    if unknown:
        raise InputError(f"{path}, key pose.{unknown[0]}: this key is not known; there are {', '.join(known)}")
    try:
        return PoseTolerance(**{key: _number(path, f"pose.{key}", value) for key, value in given.items()})
    except ValueError as error:
        raise InputError(f"{path}, key {error}") from None


def _mapping(path: Path, keys: Mapping[Any, Any], key: str) -> Mapping[Any, Any]:
    value = keys.get(key)
    if value is None:
        return {}
    if not isinstance(value, dict):
        raise InputError(f"{path}, key {key}: it must hold names and values")
    return value


def _number(path: Path, key: str, value: object) -> float:
    if isinstance(value, bool) or not isinstance(value, int | float) or not np.isfinite(value):
        raise InputError(f"{path}, key {key}: {value!r} is not a number")
    return float(value)


def _positive(path: Path, keys: Mapping[Any, Any], key: str) -> float | None:
    if keys.get(key) is None:
        return None
    if (value := _number(path, key, keys[key])) <= 0.0:
        raise InputError(f"{path}, key {key}: it must be more than 0")
    return value


def _flag(path: Path, keys: Mapping[Any, Any], key: str) -> bool:
    value = keys.get(key, False)
    if not isinstance(value, bool):
        raise InputError(f"{path}, key {key}: it must be true or false, not {value!r}")
    return value
