"""A night as Bluesky's documents: all of its journal once, in order, the same each time, by event-model's rules."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import pytest

from hil.campaign.writer import columns_of
from hil.cli.app import run
from hil.records import documents
from hil.records.export import campaign_of_night
from hil.records.reader import reading


@pytest.fixture(scope="module")
def told(night: Path, tmp_path_factory: pytest.TempPathFactory) -> list[tuple[str, Any]]:
    """Return what the command wrote."""
    out = tmp_path_factory.mktemp("told") / "night.jsonl"
    assert run(["export", str(night), str(out), "--format", "documents"]) == 0
    return [(name, document) for name, document in map(json.loads, out.read_text().splitlines())]


@pytest.mark.slow
def test_every_collect_step_and_event_is_there_once_and_in_order(night: Path, told: list[tuple[str, Any]]) -> None:
    """With the numbers of collects.csv, null where one is not known, and the mark of a simulated night."""
    (_, start), (_, stop) = told[0], told[-1]
    streams = {d["uid"]: d["name"] for name, d in told if name == "descriptor"}
    events = [d for name, d in told if name == "event"]
    assert (start["simulated"], start["operator"], stop["exit_status"]) == (True, "rk", "success")
    times = [start["time"], *(each["time"] for each in events), stop["time"]]
    assert times == sorted(times)
    with reading(night) as journal:
        assert stop["num_events"]["steps"] == len(journal.attempts())
        assert stop["num_events"]["happened"] == len(journal.events())
        assert start["time"] == journal.night.began_utc.timestamp()
    rows = [each["data"] for each in events if streams[each["descriptor"]].startswith("sensor_")]
    rows.sort(key=lambda row: (row["start_s"], row["collect"]))
    known = columns_of(campaign_of_night(night))
    for name in ("collect", "position", "RA_deg_per_hr", "temperature_degC"):
        assert [row[name] for row in rows] == known[name].tolist(), name


def test_the_same_night_gives_the_same_documents(night: Path, told: list[tuple[str, Any]]) -> None:
    """Uids included, each of which is one document's."""
    with reading(night) as journal:
        assert json.loads(json.dumps(list(documents.documents_of(journal)))) == [list(each) for each in told]
    uids = [document["uid"] for _, document in told]
    assert len(set(uids)) == len(uids)


def test_a_night_that_is_not_complete_says_so(night: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """In its stop: abort, and what is missing."""
    monkeypatch.setattr(documents, "missing_in_words", lambda *_: ["self-calibration 2 at 20 °C"])
    with reading(night) as journal:
        *_, (name, stop) = documents.documents_of(journal)
    assert (name, stop["exit_status"], stop["reason"]) == ("stop", "abort", "self-calibration 2 at 20 °C")


def test_what_is_no_night_or_exists_is_refused(
    night: Path, told: list[tuple[str, Any]], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """In one sentence; nothing is written."""
    assert run(["export", str(night), str(tmp_path / "c")]) == 0
    assert run(["export", str(tmp_path / "c"), str(tmp_path / "d.jsonl"), "--format", "documents"]) == 2
    assert "no night; documents are made of a journal" in capsys.readouterr().err
    assert not (tmp_path / "d.jsonl").exists()
    assert run(["export", str(night), str(tmp_path / "c"), "--format", "documents"]) == 2


def test_event_models_own_schemas_accept_it(told: list[tuple[str, Any]]) -> None:
    """Every document, by its kind."""
    model = pytest.importorskip("event_model", reason="event-model is not installed; pip install event-model")
    for name, document in told:
        model.schema_validators[model.DocumentNames[name]].validate(document)
