"""Screen campaign folders: read each, put those of one layout together, weigh them on as many processes as there are.

    screened = screen_folders([Path("units")], "matrix-6", workers=4)
    [unit for unit in screened.units if unit.worth]     # those that a full reconcile is worth

A campaign that cannot be read, or screened, is told with its reason and the others go on. What is kept of each is its
rates and what each name says of it, some kilobytes. Units are weighed in the order of their names (of a Parquet file,
in its own), in pieces of a size that does not depend on the workers, so that the numbers do not either.
"""

from __future__ import annotations

import hashlib
import sqlite3
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field, replace
from functools import lru_cache
from importlib.metadata import version
from pathlib import Path
from typing import Any

import numpy as np

from drivers.given_file import check_folder
from hil.campaign import Campaign, FloatArray
from hil.campaign.fleet_file import pieces_of, read_piece
from hil.campaign.header import day_of
from hil.campaign.plausibility import usable
from hil.campaign.reader import HEADER_FILE
from hil.campaign.stand_ins import with_stand_ins
from hil.errors import InputError
from hil.files.processes import Map, processes
from hil.model import Model, load_model
from hil.reconcile.fleet import NOISY_UNITS, Asked, Screen, SharedFinding, Stood, UnitFinding, beside_the_earth
from hil.reconcile.proof.places import false_discovery
from hil.records.export import open_source
from hil.records.reader import is_night, units_in
from hil.solve.omissions import by_records
from hil.solve.wrong_rows import failed, pooled

LEVEL = 0.05
"""False discoveries among the units that are called, at most, on average."""
_PIECE = 256  # units that a process takes at once
_AT_ONCE = 8  # pieces that are read at once; memory holds two times as many
_WEIGHED = 64  # that are weighed at once


@dataclass(frozen=True)
class Facts:
    """Which campaign it is, of whom and when, and which runs FAIL, as far as its records say.

    `wrong` is what is left out of it for that, missing or not settled, in the keys of every document.
    """

    folder: str
    title: str
    serial: str
    date: str
    simulated: bool
    runs_failed: Sequence[int]
    wrong: Mapping[str, Any]

    @property
    def runs_in_use(self) -> list[int]:
        """Runs that FAIL and are screened all the same: what is wrong with them is no rate's, or every run has it."""
        return sorted({*self.runs_failed}.difference(*self.wrong.get("runs_not_used", {}).values()))

    @classmethod
    def of(cls, folder: str, campaign: Campaign) -> Facts:
        """Return what the records of a campaign say."""
        day, serial = day_of(campaign.source), campaign.identity.get("serial", "")
        bad = sorted(set().union(*(failed(campaign, number) for number in campaign.sensors)))
        known = (campaign.title, serial, day.isoformat() if day else "", campaign.simulated)
        return cls(folder, *known, bad, by_records(campaign))


@dataclass(frozen=True)
class ScreenedUnit(Facts):
    """One campaign, which layout it has, and what was found."""

    layout: int
    finding: UnitFinding

    @property
    def worth(self) -> bool:
        """Whether a full reconcile is worth it."""
        return self.finding.q_value < LEVEL


@dataclass(frozen=True)
class Screened:
    """A fleet: its units, what those of each layout have in common (with their number), what could not be read.

    `said` is what else to know: which workers took no part.
    """

    model: str
    units: Sequence[ScreenedUnit]
    shared: Sequence[tuple[int, SharedFinding]]
    not_screened: Mapping[str, str]
    said: Sequence[str] = ()


@dataclass(frozen=True)
class _Layout:
    """What a screen is made of: the first unit, and those that say what noise is. `key` tells layouts apart."""

    key: str
    model: Model = field(compare=False)
    units: Sequence[Campaign] = field(compare=False)


@dataclass
class _Group:
    """Units of one layout, by what is kept of them."""

    first: Campaign
    stood: Stood
    facts: list[Facts] = field(default_factory=list)
    values: list[Mapping[int, FloatArray]] = field(default_factory=list)

    def has_like(self, other: Campaign, values: Mapping[int, FloatArray]) -> bool:
        """Whether a campaign is of this layout: it stood so, and the same of its rates are there."""
        alike = self.first.sensors.keys() == values.keys() and self.stood.like(other)
        return alike and all(np.array_equal(*np.isfinite([own, values[n]])) for n, own in self.values[0].items())

    def layout(self, model: Model) -> _Layout:
        """Return what a screen is laid out by: the first unit, and others evenly over the fleet."""
        some = np.unique(np.linspace(0, len(self.values) - 1, NOISY_UNITS).astype(np.int64)).tolist()
        told = b"".join(own.tobytes() for i in some for own in self.values[i].values())
        return _Layout(hashlib.sha256(told).hexdigest(), model, [self._again(self.values[i]) for i in some])

    def _again(self, values: Mapping[int, FloatArray]) -> Campaign:
        """Return a unit with its own rates, under the first one's conditions."""
        w = {number: of.conditions.w_channels_deg_per_hr for number, of in self.first.sensors.items()}
        sensors = {n: replace(of, rates_deg_per_hr=values[n] + w[n]) for n, of in self.first.sensors.items()}
        return replace(self.first, sensors=sensors)


def screen_folders(
    folders: Sequence[Path], model: Model | str, workers: int = 1, cluster: str | None = None
) -> Screened:
    """Screen every campaign and night that the folders are or hold, by `workers` processes or on a Dask cluster.

    Raises `InputError` where there is none, where the model cannot be used, or the cluster is not there.
    """
    chosen, places = load_model(model) if isinstance(model, str) else model, pieces_in(folders)
    told: dict[str, str] = {}
    known: dict[bytes, str] = {}
    groups: list[_Group] = []
    units: list[ScreenedUnit] = []
    shared: list[tuple[int, SharedFinding]] = []
    with _workers(workers, cluster) as (mapped, said):
        for place, campaign in in_turn(mapped, places):
            if isinstance(campaign, str):
                told[place] = campaign
                continue
            try:
                read = with_stand_ins(usable(pooled(campaign)))
            except InputError as error:
                told[place] = str(error)
                continue
            values = beside_the_earth(read)
            told_apart_by = hashlib.sha256(b"".join(own.tobytes() for own in values.values())).digest()
            if (first := known.setdefault(told_apart_by, place)) != place:
                told[place] = f"the very rates of {first}: a copy, which counts once"
                continue
            if (group := next((each for each in groups if each.has_like(read, values)), None)) is None:
                groups.append(group := _Group(read, Stood({n: rows.conditions for n, rows in read.sensors.items()})))
            group.facts.append(Facts.of(place, campaign))
            group.values.append(values)
        for number, group in enumerate(groups, 1):
            try:
                found, common = _weighed(group, chosen, mapped)
            except InputError as error:
                told |= {facts.folder: str(error) for facts in group.facts}
                continue
            units += [ScreenedUnit(**vars(facts), layout=number, finding=each) for facts, each in found]
            shared.append((number, common))
    if not units:
        raise InputError("; ".join(f"{place}: {why}" for place, why in list(told.items())[:3]))
    q_values = false_discovery(np.array([each.finding.p_value for each in units])).tolist()
    units = [replace(each, finding=replace(each.finding, q_value=q)) for each, q in zip(units, q_values, strict=True)]
    return Screened(chosen.full_title, sorted(units, key=lambda each: each.finding.p_value), shared, told, said)


def pieces_in(folders: Sequence[Path]) -> list[tuple[str, int]]:
    """Return what is read at once: campaigns and nights that folders are or hold (-1), pieces of files.

    Each once, by name. Raises `InputError` where a folder or file is none, or no campaign is in it.
    """
    found: list[tuple[str, int]] = []
    for folder in folders:
        if folder.suffix == ".parquet" and not folder.is_dir():
            found += [(str(folder), piece) for piece in range(pieces_of(folder))]
            continue
        check_folder(folder)
        inside = [(str(unit), -1) for each in _held(folder) for unit in (*units_in(each).values(),) or (each,)]
        if not inside:
            raise InputError(f"{folder}: no campaign folder (with {HEADER_FILE}) and no night is there")
        found += inside
    return list(dict.fromkeys(found))


def in_turn(mapped: Map, pieces: Sequence[tuple[str, int]]) -> Iterator[tuple[str, Campaign | str]]:
    """Read campaigns, each with its folder, or the sentence why it cannot be read; some at once, to spare memory."""
    folders = all(piece < 0 for _, piece in pieces)
    for read in _some_at_once(mapped, _read, pieces, _PIECE if folders else _AT_ONCE):
        yield from read


def _holds_one(folder: Path) -> bool:
    return (folder / HEADER_FILE).is_file() or (folder.is_dir() and is_night(folder))


def _held(folder: Path) -> Iterator[Path]:
    """Yield the campaigns and nights that a folder is or holds, in the order of their names: none holds others."""
    if _holds_one(folder):
        yield folder
        return
    for each in sorted(folder.iterdir()):
        if (each.is_dir() and not each.is_symlink()) or _holds_one(each):
            yield from _held(each)


def _some_at_once(mapped: Map, function: Callable[[Any], Any], things: Sequence[Any], most: int) -> Iterator[Any]:
    """Yield what a function makes of things; the next of them are under way while these are taken."""
    ahead = mapped(function, things[:most])
    for first in range(most, len(things) + most, most):
        these, ahead = ahead, mapped(function, things[first : first + most])
        yield from these


def _read(piece: tuple[str, int]) -> list[tuple[str, Campaign | str]]:
    place, number = piece
    try:
        return [(place, open_source(Path(place)))] if number < 0 else list(read_piece(Path(place), number))
    except (InputError, OSError, sqlite3.Error) as error:
        return [(place if number < 0 else f"{place}, row group {number}", str(error))]


def _weighed(group: _Group, model: Model, mapped: Map) -> tuple[list[tuple[Facts, UnitFinding]], SharedFinding]:
    """Weigh the units of a layout. Raises `InputError` for an unfit model."""
    layout = group.layout(model)
    pieces = [(layout, group.values[first : first + _PIECE]) for first in range(0, len(group.values), _PIECE)]
    findings: list[UnitFinding] = []
    mixed: FloatArray = np.zeros(())
    for asked, by_name in _some_at_once(mapped, _weigh, pieces, _WEIGHED):
        findings += asked.findings(by_name)
        mixed = mixed + asked.mixed(by_name)
    return list(zip(group.facts, findings, strict=True)), asked.in_common(mixed)


@lru_cache(maxsize=2)
def _screen(layout: _Layout) -> Screen:
    return Screen.of(layout.units, layout.model)


def _weigh(piece: tuple[_Layout, Sequence[Mapping[int, FloatArray]]]) -> tuple[Asked, FloatArray]:
    """Weigh some units, in whichever process this is, which lays a layout out once."""
    screen, values = _screen(piece[0]), piece[1]
    return screen.asked, screen.weigh([screen.in_blocks(each, "") for each in values])


@contextmanager
def _workers(count: int, cluster: str | None) -> Iterator[tuple[Map, Sequence[str]]]:
    """Give what carries a function out over many things, in their order, and what to know of the workers.

    A worker with another version of hil takes no part: the numbers would depend on who weighed what.
    """
    if cluster is not None:
        try:
            from distributed import Client  # the optional extra `cluster`
        except ImportError:
            raise InputError(f"--cluster {cluster}: needs distributed, which comes with hil[cluster]") from None
        try:
            client = Client(cluster, timeout="10s")
        except (OSError, ValueError) as error:
            raise InputError(f"--cluster {cluster}: no Dask scheduler answers there ({error})") from None
        with client:
            told = {who: str(each) for who, each in client.run(_version, on_error="return").items()}
            same = [who for who, each in told.items() if each == _version()]
            others = [f"{who} has hil {each}" for who, each in sorted(told.items()) if who not in same]
            if told and not same:
                raise InputError(f"--cluster {cluster}: no worker has hil {_version()} as here; {'; '.join(others)}")
            said = [f"{each}, not {_version()} as here, and took no part" for each in others]
            yield (
                lambda function, things: iter(
                    client.gather(client.map(function, list(things), pure=False, workers=same if others else None))
                ),
                said,
            )
    else:
        with processes(count) as mapped:
            yield mapped, ()


def _version() -> str:
    return version("hil")
