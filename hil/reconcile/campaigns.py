"""Screen campaigns: read each, put those of one layout together, weigh them on as many processes as there are.

    screened = screen_folders([Path("units")], "matrix-6", workers=4)
    [unit for unit in screened.units if unit.worth]     # those that a full reconcile is worth

A campaign that cannot be read, or screened, is told with its reason and the others go on. What is kept of each is its
rates and what each name says of it, some kilobytes. Units are weighed in the order of their names (of a Parquet file,
in its own), in pieces of a size that does not depend on the workers, so that the numbers do not either.
"""

import hashlib
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field, replace
from functools import lru_cache
from importlib.metadata import version
from pathlib import Path
from typing import Any, Self

import numpy as np

from hil.campaign import Campaign, FloatArray
from hil.campaign.header import day_of
from hil.campaign.plausibility import usable
from hil.campaign.stand_ins import with_stand_ins
from hil.errors import InputError
from hil.files.processes import Map, processes
from hil.model import Model, load_model
from hil.model.effects.prior import ALPHA
from hil.reconcile.fleet import CALLED, NOISY_UNITS, Asked, Screen, SharedFinding, Stood, UnitFinding, beside_the_earth
from hil.reconcile.proof.places import false_discovery
from hil.records.folders import PIECE, in_turn, pieces_in, some_at_once
from hil.solve.omissions import by_records
from hil.solve.wrong_rows import MENDED, Wrong, failed, laid_right, pooled

_WEIGHED = 64  # pieces that are weighed at once


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
    def of(cls, folder: str, campaign: Campaign) -> "Facts":
        """Return what the records of a campaign say."""
        day, serial = day_of(campaign.source), campaign.identity.get("serial", "")
        bad = sorted(set().union(*(failed(campaign, number) for number in campaign.sensors)))
        known = (campaign.title, serial, day.isoformat() if day else "", campaign.simulated)
        reasons = "; ".join(each.reason for each in campaign.contradicted.values())  # which FAIL says already
        warned = [each for each in campaign.warnings if each not in reasons]
        return cls(folder, *known, bad, by_records(campaign) | ({"warnings": warned} if warned else {}))

    def beside(self, rows: Sequence[Wrong]) -> Self:
        """Return the same with what is wrong with rows."""
        found = [*self.wrong.get("rows", ()), *(row.document() for row in rows)]
        return replace(self, wrong={**self.wrong, "rows": found}) if rows else self


@dataclass(frozen=True)
class ScreenedUnit(Facts):
    """One campaign, which layout it has, and what was found."""

    layout: int
    finding: UnitFinding

    @property
    def worth(self) -> bool:
        """Whether a full reconcile is worth it."""
        return self.finding.q_value < ALPHA


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


_Rates = Mapping[int, FloatArray]
_Unit = tuple[_Rates, _Rates]  # rates less the earth's, and their standard errors


@dataclass
class _Group:
    """Units of one layout, by what is kept of them."""

    first: Campaign
    stood: Stood
    facts: list[Facts] = field(default_factory=list)
    units: list[_Unit] = field(default_factory=list)

    def has_like(self, other: Campaign, values: _Rates) -> bool:
        """Whether a campaign is of this layout: it stood so, and the same of its rates are there."""
        alike = self.first.sensors.keys() == values.keys() and self.stood.like(other)
        return alike and all(np.array_equal(*np.isfinite([own, values[n]])) for n, own in self.units[0][0].items())

    def layout(self, model: Model) -> _Layout:
        """Return what a screen is laid out by: the first unit, and others evenly over the fleet."""
        some = np.unique(np.linspace(0, len(self.units) - 1, NOISY_UNITS).astype(np.int64)).tolist()
        told = b"".join(own.tobytes() for i in some for own in self.units[i][0].values())
        return _Layout(hashlib.sha256(told).hexdigest(), model, [_again(self.first, self.units[i]) for i in some])


def _again(first: Campaign, unit: _Unit) -> Campaign:
    """Return a unit with its own rates, under the first one's conditions."""
    sensors = {}
    for number, of in first.sensors.items():
        values, errors = (each[number] for each in unit)
        rates = values + of.conditions.w_channels_deg_per_hr
        sensors[number] = replace(of, rates_deg_per_hr=rates, rates_se_deg_per_hr=errors)
    return replace(first, sensors=sensors)


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
                # What its records contradict has been asked about already.
                used, rows = laid_right(pooled(campaign)) if campaign.contradicted else (pooled(campaign), [])
                rows = [row for row in rows if row.done == MENDED]  # of all else the screen asks again
                read = with_stand_ins(usable(used))
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
            group.facts.append(Facts.of(place, campaign).beside(rows))
            group.units.append((values, {n: of.rates_se_deg_per_hr for n, of in read.sensors.items()}))
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


def _weighed(group: _Group, model: Model, mapped: Map) -> tuple[list[tuple[Facts, UnitFinding]], SharedFinding]:
    """Weigh the units of a layout. Raises `InputError` for an unfit model."""
    layout = group.layout(model)
    pieces = [(layout, group.units[first : first + PIECE]) for first in range(0, len(group.units), PIECE)]
    findings: list[UnitFinding] = []
    wrong: list[Sequence[Wrong]] = []
    mixed: list[FloatArray] = []
    for asked, by_name, rows in some_at_once(mapped, _weigh, pieces, _WEIGHED):
        findings += asked.findings(by_name)
        wrong += rows
        mixed.append(asked.mixed(by_name))
    facts = [each.beside(rows) for each, rows in zip(group.facts, wrong, strict=True)]
    return list(zip(facts, findings, strict=True)), asked.in_common(np.array(mixed), len(findings))


@lru_cache(maxsize=2)
def _screen(layout: _Layout) -> Screen:
    return Screen.of(layout.units, layout.model)


def _weigh(piece: tuple[_Layout, Sequence[_Unit]]) -> tuple[Asked, FloatArray, list[Sequence[Wrong]]]:
    """Weigh some units, in whichever process this is, which lays a layout out once.

    Of those that something may be missing from, and of few units of all, it is asked what is wrong with rows, as of
    every campaign that is solved, and said of each; what is filed elsewhere than it belongs is weighed again there.
    """
    (layout, units), screen = piece, _screen(piece[0])
    by_name = screen.weigh([screen.in_blocks(values, "") for values, _ in units])
    wrong: list[Sequence[Wrong]] = [()] * len(units)
    asked = screen.asked.statistic(by_name) > (CALLED if screen.few is not None else -np.inf)
    for i in np.flatnonzero(asked).tolist():
        right, wrong[i] = laid_right(_again(layout.units[0], units[i]))
        if any(row.done == MENDED for row in wrong[i]):
            by_name[:, i] = screen.weigh([screen.in_blocks(beside_the_earth(right), "")])[:, 0]
    return screen.asked, by_name, wrong


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
            here = version("hil")
            told = {who: str(each) for who, each in client.run(version, "hil", on_error="return").items()}
            same = [who for who, each in told.items() if each == here]
            others = [f"{who} has hil {each}" for who, each in sorted(told.items()) if who not in same]
            if told and not same:
                raise InputError(f"--cluster {cluster}: no worker has hil {here} as here; {'; '.join(others)}")
            said = [f"{each}, not {here} as here, and took no part" for each in others]
            yield (
                lambda function, things: iter(
                    client.gather(client.map(function, list(things), pure=False, workers=same if others else None))
                ),
                said,
            )
    else:
        with processes(count) as mapped:
            yield mapped, ()
