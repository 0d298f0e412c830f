"""Where a report's numbers come from: who, when, with what, and the hashes by which the records can be recognised."""

import hashlib
from collections.abc import Mapping
from typing import Any

from drivers.given_file import opened
from hil.campaign import Campaign
from hil.campaign.reader import COLLECTS_FILE, HEADER_FILE
from hil.config.recorded import understood
from hil.records import JournalReader


def night_provenance(journal: JournalReader, identity: Mapping[str, Mapping[str, Any]]) -> list[tuple[str, str]]:
    """Return names and values for a night; `identity` is what the devices said of themselves."""
    night = journal.night
    controllers = journal.controllers()
    first = night.versions or {}
    clock = understood(night.configuration).get("bench", {}).get("clock")
    told = [
        ("folder", journal.folder.resolve().name),
        ("began (UTC)", f"{night.began_utc:%Y-%m-%d %H:%M:%S}" + " (simulated time)" * (clock == "virtual")),
        ("began by", night.who),
        ("carried on by", ", ".join(each.who for each in controllers[1:])),
        *((device, ", ".join(f"{k} {v}" for k, v in said.items() if v)) for device, said in identity.items()),
        ("seed of the simulation", "" if night.seed is None else str(night.seed)),
        ("configuration, SHA-256", hashlib.sha256(night.configuration.encode()).hexdigest()),
        ("plan and configuration, digest in the journal", night.digest(journal.plan)),
        *((f"version of {name}", version) for name, version in first.items()),
    ]
    return [(name, value) for name, value in told if value]


def campaign_provenance(campaign: Campaign) -> list[tuple[str, str]]:
    """Return names and values for a campaign folder."""
    folder = campaign.folder
    told = [("campaign", folder.resolve().name if folder else campaign.title), ("source", campaign.source)]
    return [(name, value) for name, value in told if value]


def campaign_files(campaign: Campaign) -> list[tuple[str, int, str]]:
    """Return path, size in bytes and SHA-256 of the files that a campaign folder was read from."""
    if campaign.folder is None:
        return []
    folder = campaign.folder
    files = []
    for path in (folder / HEADER_FILE, folder / COLLECTS_FILE, *campaign.series_files.values()):
        if path.is_file():
            name = str(path.relative_to(folder)) if path.is_relative_to(folder) else path.name
            with opened(path) as file:
                files.append((name, path.stat().st_size, hashlib.file_digest(file, "sha256").hexdigest()))
    return files
