"""The archive's folder: what was measured of every unit, taken up from nights and campaign folders, each once.

    archive/
      archive.yaml                 says that it is one
      unit-0042/                   everything of serial number 0042
        20260301T1700Z-9f31c2a4d07b/
          campaign/                a campaign folder (hil.campaign/1), averages only
          configuration.yaml       of a night: what its journal has on record
          archived.yaml            hil.archived/1: when, of which unit, from where, hashes of the files beside it
      index.sqlite                 made from the folders, and from nothing else (hil.archive.index)

An entry appears whole or not at all, and is never changed: what is taken up again with more in it stands beside, and
the same rates with corrected labels take its place. The folders are the truth. The night itself stays where it is; when
it goes, what was averaged of it is still here.
"""

import hashlib
import shutil
from collections.abc import Mapping
from dataclasses import dataclass, replace
from datetime import UTC, date, datetime, timedelta
from pathlib import Path
from typing import Any

import numpy as np
import yaml

from drivers.given_file import read_bytes
from drivers.strict_yaml import check_schema
from hil.archive.places import CAMPAIGN, CONFIGURATION, ENTRY, HASHED, MARK, check_archive, folder_of, found
from hil.campaign import Campaign
from hil.campaign.header import day_of
from hil.campaign.reader import read_campaign
from hil.campaign.writer import write_campaign
from hil.errors import InputError, worded
from hil.files.durable import PARTIAL, RealDisk, is_new, make_folders, whole_or_nothing, write_durably
from hil.files.strict import parse_yaml, read_text
from hil.model.effects.history import joined
from hil.records import reading
from hil.records.export import open_source
from hil.records.ledger import read_head
from hil.records.reader import is_night
from hil.records.status import WORKING, night_status
from procedures.words import counted

SCHEMA = "hil.archived/1"
_MARK_TEXT = (
    "schema: hil.archive/1\n# Taken up by hil archive. The folders are the truth; index.sqlite is made from them.\n"
)
_DIGITS = 12
_OF_A_NIGHT = ("began_utc", "ended_utc", "state", "night", "versions")  # what a table of it does not know, or less well


@dataclass(frozen=True)
class Taken:
    """What was taken up: the entry, the unit's serial number, whether it was there `before`, and what it `replaces`."""

    entry: str
    serial: str
    before: bool
    replaces: str = ""


def take_up(
    archive: Path, source: Path, serial: str | None = None, day: date | None = None, state: str | None = None
) -> Taken:
    """Take up a night or a campaign folder; `serial` and `day` are for those that do not say.

    `state` is how the night ended, where the caller knows it. Raises `InputError` where the source cannot be read, is
    still being measured, tells no serial number or date and none is given, or contradicts them; `Damaged` where a
    night's records are not what was written. Nothing is changed then. What is damaged in the archive is replaced, and
    an export by the night that it is of, which has all of it.
    """
    campaign = open_source(source)
    own = campaign.identity.get("serial", "")
    if serial is not None and own not in ("", serial):
        raise InputError(f"{source}: --serial {serial}: its records say {own}")
    if not (serial := own or serial):
        raise InputError(f"{source}: its records do not say which unit it is of; give --serial")
    campaign = replace(campaign, identity={**campaign.identity, "serial": serial}, folder=None, recorded={})
    facts, configuration = _facts(source, campaign, day, state)
    unit, began = archive / folder_of(serial), datetime.fromisoformat(facts["began_utc"])
    digest = _rates_digest(campaign)
    there = next(unit.glob(f"[!.]*-{digest}"), None)
    name, why = f"{unit.name}/{there.name}" if there else "", ""
    if there:
        why, of_night, campaign = _replaced(archive, name, campaign, is_night(source))
        if not why:
            return Taken(name, serial, before=True)
        if of_night:
            facts |= {key: of_night[key] for key in _OF_A_NIGHT}
            began, configuration = datetime.fromisoformat(facts["began_utc"]), read_text(there / CONFIGURATION)
    found_archive(archive, new=True)
    target = unit / f"{began:%Y%m%dT%H%MZ}-{digest}"
    aside = unit / f"{PARTIAL}{digest}-replaced"
    with whole_or_nothing(target) as partial:
        write_campaign(replace(campaign, series_block_s=None), partial / CAMPAIGN)
        if configuration is not None:
            RealDisk().write(partial / CONFIGURATION, configuration.encode())
        hashes = {name: _sha256(partial / name) for name in HASHED if (partial / name).is_file()}
        text = yaml.safe_dump({**facts, "sha256": hashes}, sort_keys=False, allow_unicode=True, width=120)
        RealDisk().write(partial / ENTRY, text.encode())
        if there:
            shutil.rmtree(aside, ignore_errors=True)  # of somebody who was killed here
            RealDisk().rename(there, aside)
    shutil.rmtree(aside, ignore_errors=True)
    return Taken(f"{unit.name}/{target.name}", serial, before=False, replaces=why)


def _replaced(archive: Path, entry: str, campaign: Campaign, by_night: bool) -> tuple[str, dict[str, Any], Campaign]:
    """Return why an entry is replaced by what holds the same rates (empty: by nothing), what it says of their night.

    And which campaign stays: of a night and a corrected table the table's. Raises `InputError` where it is not read.
    """
    try:
        facts, known, _ = read_entry(archive, entry)
    except InputError as error:
        if isinstance(error.__cause__, OSError):
            raise
        return f"{entry}, which was damaged", {}, campaign
    if _labels_digest(known) == _labels_digest(campaign):
        return f"{entry}, an export of this night" if by_night and facts["night"] is None else "", {}, campaign
    if by_night:
        why = "" if facts["night"] else f"{entry}, which did not say of which night it is"
        return why, {}, replace(known, folder=None, recorded={})
    return f"{entry}, whose labels or poses were others", facts if facts["night"] else {}, campaign


def read_entry(archive: Path, entry: str) -> tuple[dict[str, Any], Campaign, Mapping[str, Any]]:
    """Return archived.yaml, the campaign and the configuration (empty for a campaign's); `InputError` where damaged."""
    folder = archive / entry
    facts = parse_yaml(read_text(folder / ENTRY), str(folder / ENTRY))
    check_schema(facts, SCHEMA, str(folder / ENTRY))
    if not isinstance(hashes := facts.get("sha256"), dict):
        raise InputError(f"{folder / ENTRY}, key sha256: it is missing, or no mapping")
    if folder_of(str(facts.get("serial"))) != folder.parent.name:
        raise InputError(f"{folder / ENTRY}: it is of unit {facts.get('serial')}, and stands in another unit's folder")
    when = f"{folder / ENTRY}: when it was measured cannot be read ("
    with worded(InputError, when, (KeyError, TypeError, ValueError), ")"):
        began, ended = (datetime.fromisoformat(str(facts[key])) for key in ("began_utc", "ended_utc"))
        _ = ended - began
    if not {*HASHED[:2]} <= hashes.keys() or not isinstance(facts.get("night"), dict | None):
        raise InputError(f"{folder / ENTRY}: is not whole")
    for name, digest in hashes.items():
        if name not in HASHED or _sha256(folder / name) != digest:
            raise InputError(f"{folder / name}: is not what was taken up (another hash)")
    text = folder / CONFIGURATION
    configuration = parse_yaml(read_text(text), str(text)) if CONFIGURATION in hashes else {}
    return facts, read_campaign(folder / CAMPAIGN), configuration


def life(archive: Path, names: list[str]) -> Campaign:
    """Return a unit's campaigns as one, in the order of time: runs are numbered on, times are those of the calendar.

    Age shows in it, and in no single night. Raises `InputError` as `read_entry`, and where sensors differ.
    """
    if not names:
        raise InputError(f"{archive}: no calibration of this unit tells anything of it")
    parts = sorted((read_entry(archive, name)[:2] for name in names), key=lambda each: str(each[0]["began_utc"]))
    first = datetime.fromisoformat(parts[0][0]["began_utc"])
    whole = parts[0][1]
    for facts, campaign in parts[1:]:
        since_s = (datetime.fromisoformat(facts["began_utc"]) - first).total_seconds()
        layouts = [{n: of.conditions.sensor for n, of in each.sensors.items()} for each in (whole, campaign)]
        if layouts[0] != layouts[1]:
            raise InputError(f"{archive}: from {facts['began_utc'][:10]} on its sensors are others: no one campaign")
        whole = _together(whole, campaign, since_s)
    return replace(whole, title=f"{whole.identity['serial']}, {counted(len(parts), 'campaign')}", notes="", missing=())


def _together(whole: Campaign, later: Campaign, since_s: float) -> Campaign:
    """Return both as one: the later one's runs and collects are numbered on, its times are `since_s` behind."""
    runs = max(int(of.conditions.run.max()) for of in whole.sensors.values())
    collects = max(int(of.conditions.collect.max()) for of in whole.sensors.values())
    sensors = {}
    for number, of in whole.sensors.items():
        other = later.sensors[number]
        own = other.conditions
        on = replace(own, run=own.run + runs, collect=own.collect + collects, start_s=own.start_s + since_s)
        sensors[number] = replace(
            of,
            conditions=joined(of.conditions, on),
            rates_deg_per_hr=np.concatenate([of.rates_deg_per_hr, other.rates_deg_per_hr]),
            rates_se_deg_per_hr=np.concatenate([of.rates_se_deg_per_hr, other.rates_se_deg_per_hr]),
        )
    contradicted = {(run + runs, number): each for (run, number), each in later.contradicted.items()}
    return replace(
        whole,
        sensors=sensors,
        verdicts={**whole.verdicts, **{run + runs: each for run, each in later.verdicts.items()}},
        contradicted={**whole.contradicted, **contradicted},
        simulated=whole.simulated or later.simulated,
        condition_units={**later.condition_units, **whole.condition_units},
    )


def _facts(source: Path, campaign: Campaign, day: date | None, state: str | None) -> tuple[dict[str, Any], str | None]:
    """Return what archived.yaml says of a source, and a night's configuration."""
    rows = [each.conditions for each in campaign.sensors.values()]
    lasted = timedelta(seconds=max(float((each.start_s + each.duration_s).max()) for each in rows))
    record, versions, configuration = None, {}, None
    if not is_night(source):
        told = day_of(campaign.source)
        if (on := day or told) is None:
            raise InputError(f"{source}: its records do not say when it was measured; give --date")
        if None not in (day, told) and day != told:
            raise InputError(f"{source}: --date {day}: its records say {told}")
        began = datetime(on.year, on.month, on.day, tzinfo=UTC)
        state = "incomplete" if campaign.missing else "complete"
    else:
        if (state := state or str(night_status(source)["state"])) in WORKING:
            raise InputError(f"{source}: is {state}; it is taken up at its end")
        with reading(source) as journal:
            night = journal.night
        head, began, configuration = read_head(source), night.began_utc, night.configuration
        known = hashlib.sha256(f"{began.isoformat()}{configuration}".encode()).hexdigest()
        record, versions = {"id": known, "head_sha256": head[1] if head else None}, dict(night.versions or {})
    facts = {
        "schema": SCHEMA,
        "serial": campaign.identity["serial"],
        "model": campaign.identity.get("model", ""),
        "began_utc": began.isoformat(),
        "ended_utc": (began + lasted).isoformat(),
        "state": state,
        "from": str(source.resolve()),
        "night": record,
        "versions": versions,
    }
    return facts, configuration


def _rates_digest(campaign: Campaign) -> str:
    """Return what two sources of a model have in common that hold the very same rates, whatever else they say."""
    digest = hashlib.sha256(campaign.identity.get("model", "").encode())
    for number, of in sorted(campaign.sensors.items()):
        digest.update(f"{number} ".encode())
        for each in (of.conditions.run, of.conditions.start_s, of.rates_deg_per_hr):
            digest.update(np.ascontiguousarray(each).tobytes())
    return digest.hexdigest()[:_DIGITS]


def _labels_digest(campaign: Campaign) -> str:
    """Return what tells the same rates from those whose positions, f or w somebody has corrected."""
    digest = hashlib.sha256()
    for _, of in sorted(campaign.sensors.items()):
        poses = np.column_stack([of.conditions.f_g, of.conditions.w_deg_per_hr]) + 0.0  # no zero is negative
        digest.update(f"{of.conditions.position.tolist()} {poses.tolist()}".encode())
    return digest.hexdigest()


def found_archive(archive: Path, *, new: bool = False) -> None:
    """Make an archive, also (unless `new`) over units' folders that lost their mark; `InputError` over others."""
    if (archive / MARK).is_file():
        return
    unfinished = archive / f"{PARTIAL}{MARK}"  # of somebody who was killed here
    empty = is_new(archive) or (archive.is_dir() and list(archive.iterdir()) == [unfinished])
    if not empty and (new or not archive.is_dir() or not found(archive)[0]):
        check_archive(archive)
    with worded(InputError, f"{archive}: cannot be made (", OSError, ")"):
        make_folders(RealDisk(), archive)
        write_durably(RealDisk(), archive / MARK, _MARK_TEXT.encode())


def _sha256(path: Path) -> str:
    return hashlib.sha256(read_bytes(path)).hexdigest()
