"""A key means one thing in every command's JSON: its type, and where it has two, what the reference says of both."""

from __future__ import annotations

import json
import re
from collections import defaultdict
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest

from hil.cli.app import run
from hil.model.effects.document import effects_document
from hil.records.export import campaign_of_night
from tests.hil.audit.folders import written

REFERENCE = Path(__file__).parents[3] / "docs" / "reference" / "commands.md"
NAMES = re.compile(r"\d+|(B[ABXYZ]|GS[AB]?|MU[AB]?|G[XYZ]{2})(_per_degC2?)?|R[AB]|A-\d\d|unit_\d_degC")
"""Keys that are data: numbers of sensors and runs, names of parameters, channels, equations and thermometers."""
IDS = {
    name
    for each in effects_document()["effects"]
    for name in (
        each["id"],
        each["family"],
        *(shape["name"] for shape in each["shape_parameters"]),
        *(technology for of in each["parameters"] for technology in of.get("typical_other", ())),
    )
}
"""And of effects, their families and shapes, and technologies."""

IN_PLACE = ("judgement", "words", "improves", "noise_level", "noise_kinds", "forms")
COMMANDS = {
    "status": ["status", "{night}"],
    "verify": ["verify", "{night}"],
    "replay": ["replay", "{night}"],
    "plan": ["plan", "quick", "--bench", "simulated"],
    "effects": ["effects"],
    "audit": ["audit", "rd-gc-86-1-table-1"],
    "solve": ["solve", "{folder}"],
    "thermal": ["thermal", "{folder}"],
    "visibility": ["visibility", "{folder}"],
    "budget": ["budget", "{folder}", "--draws", "100"],
    "allan": ["allan", "{night}", "--sensor", "2", "--channel", "RA"],
    "scatter": ["scatter", "{folder}"],
    "reconcile": ["reconcile", "{folder}", "--model", "collins-4", "--out", "{folder}/out"],
    "fleet": ["fleet", "{folder}", "--model", "matrix-6"],
    "reproduce": ["reproduce", "{folder}"],
    "design": ["design", "quick", "--goal", "MU 20 deg/hr"],
    "check": ["check", "quick", "--bench", "simulated"],
    "decode": ["decode", "--frames", "mfs", "{raw}"],
}


def sweep_text(name: str) -> str:
    """Return the text of a sweep that ships."""
    return (REFERENCE.parents[2] / "configs" / "sweeps" / f"{name}.yaml").read_text()


def kind(value: Any) -> str | None:
    """Return the type of a value in JSON's words: of a list that of its items, None where nothing is there."""
    if isinstance(value, list):
        return next((found for item in value if (found := kind(item))), None)
    if value is None:
        return None
    names = ((bool, "yes or no"), (int | float, "number"), (str, "text"))
    return next((name for types, name in names if isinstance(value, types)), "object")


def keys(document: Any) -> Iterator[tuple[str, str]]:
    """Yield every key that is no data, with the type of what it holds."""
    if isinstance(document, list):
        for item in document:
            yield from keys(item)
    elif isinstance(document, dict):
        for key, value in document.items():
            found = kind(value)
            if found and not NAMES.fullmatch(key):
                yield key, found
            yield from keys(value)


def ambiguous(documents: dict[str, Any]) -> dict[str, set[str]]:
    """Return the keys that hold two types, with the types."""
    found: dict[str, set[str]] = defaultdict(set)
    for document in documents.values():
        for key, name in keys(document):
            found[key].add(name)
    return {key: names for key, names in found.items() if len(names) > 1}


def table() -> dict[str, str]:
    """Return the reference's table of shared keys: key to what it says of it."""
    text = REFERENCE.read_text().partition("## Keys that several documents share")[2].partition("\n## ")[0]
    rows = [line.split("|")[1:3] for line in text.splitlines() if line.startswith("| `")]
    return {key: meaning for keys, meaning in rows for key in re.findall(r"`(\w+)`", keys)}


def listed_keys() -> set[str]:
    """Return every word that the reference has as code; of the result of reconcile its own page."""
    pages = (REFERENCE, REFERENCE.with_name("reconciliation-result.md"))
    return {word for page in pages for code in re.findall(r"`+([^`]+)`+", page.read_text()) for word in _words(code)}


def _words(code: str) -> list[str]:
    return re.findall(r"[\w-]+", code)


def documents(folder: Path, capsys: pytest.CaptureFixture[str]) -> dict[str, Any]:
    """Return the JSON of each command over a campaign and a small night in `folder`."""
    night, campaign = folder / "night", written("good", folder / "campaign")
    sweep = folder / "cold.yaml"
    sweep.write_text(sweep_text("quick").replace("[23 degC]", "[19.7 degF]"))
    assert run(["run", str(sweep), "--bench", "simulated", "--out", str(night), "--quiet"]) == 0
    assert "\nINCONCLUSIVE: 2 of 2 solutions" in capsys.readouterr().err
    raw = next((night / "blocks").glob("*.raw*"), night)
    found = {}
    for command, words in COMMANDS.items():
        capsys.readouterr()
        arguments = [word.format(night=night, folder=campaign, raw=raw) for word in words]
        assert run([*arguments, "--json"]) in (0, 3, 4), command  # 4: in these bytes is no frame of another layout
        found[command] = json.loads(capsys.readouterr().out)
    return found


def check(found: dict[str, Any]) -> None:
    """Hold documents against the table; what stands in the place of what is to be removed is there, of one type."""
    told, present = table(), {key for document in found.values() for key, _ in keys(document)}
    two = ambiguous(found)
    assert sorted(present - listed_keys() - IDS) == []
    assert {key: names for key, names in two.items() if key not in told} == {}
    assert set(IN_PLACE) <= present & set(told)
    assert not set(IN_PLACE) & set(two)


@pytest.mark.slow
@pytest.mark.usefixtures("searched_once")
def test_a_key_has_one_type_or_stands_in_the_reference(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """Over every command; and complete is said with good beside it."""
    found = documents(tmp_path, capsys)
    check(found)
    assert found["status"]["state"] == "complete"
    assert found["verify"]["complete"]
    assert found["status"]["judgement"] == found["verify"]["judgement"]
    assert found["status"]["judgement"]["verdict"] == "INCONCLUSIVE"
    assert run(["verify", str(tmp_path / "night")]) == 0
    assert "complete, INCONCLUSIVE" in capsys.readouterr().out
    asked = campaign_of_night(tmp_path / "night").sensors[2].conditions.columns["setpoint_degC"]
    assert asked == pytest.approx((19.7 - 32.0) / 1.8)  # not the -6.8 °C that the chamber makes of it: 19.8 °F


def test_a_key_of_two_types_is_seen() -> None:
    """A verdict that is a word here and a sentence's object there; lists of a type are of that type, names are data."""
    two = {"a": {"verdict": "PASS", "low": 1.0, "BA": "deg/hr"}, "b": {"verdict": {}, "low": [2.0], "BA": 1.0}}
    assert ambiguous(two) == {"verdict": {"text", "object"}}
