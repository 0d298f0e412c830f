"""The coverage of the catalogue: one effect through bytes, and its table with wrong names first."""

from __future__ import annotations

from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest

from benchmarks.coverage import SWEEPS, case, entries, hidden, judged, table
from hil.model.effects.catalogue import effect_by_id
from tests.hil.reconcile.hidden_effects import hidden_campaign
from tests.hil.short_sweeps import published


def told(name: str, **found: float) -> dict[str, Any]:
    """A case of which these names were found."""
    head = {
        "sweep": "published",
        "kind": "mean",
        "id": name,
        "size": "high",
        "rms": 4.0,
        "off": 0.0001,
        "off_deg_per_hr": 0.004,
    }
    said = {"found": found, "rivals": [], "named": name in found, "covered": 1, "of": 2, "gap": [4.0, None, 1.0]}
    return {**head, **said, "class": [name, "k2"], "beside_visible": 2.0}


def test_wrong_names_are_listed_first() -> None:
    """Then what was missed, then what is right or in its class, then what cannot be simulated, with its reason."""
    cannot = {"sweep": "triad", "kind": "mean", "id": "vre", "size": "low", "why_not": "nothing vibrates"}
    rows = [told("scale", scale=0.9), told("mag", k2=0.6), cannot, told("tilt"), told("drift", ageing=1.0)]
    order = [line.split("`")[1] for line in list(table(rows))[2:]]
    assert order == ["drift", "tilt", "scale", "mag", "vre"]


def test_every_entry_of_the_catalogue_is_asked_for() -> None:
    """On the mean, on the scatter and inside the collects."""
    assert {kind for kind, _ in entries()} == {"mean", "scatter", "inside"}
    assert len(list(entries())) > 50


def test_what_is_there_or_not_is_there() -> None:
    """A sign is turned or it is not: half of it is no frame defect, and nothing that a search may call one."""
    rows = hidden_campaign(7).sensors[2].conditions
    frame = hidden(effect_by_id("frame"), rows, "high")["parameters"]
    assert {each["value"] for each in frame.values()} == {1.0}
    supply = hidden(effect_by_id("supply"), rows, "high")["parameters"]
    assert len({each["value"] for each in supply.values()}) == len(supply)


def test_a_value_is_covered_by_the_interval_that_is_stated() -> None:
    """Student's, of so many runs as there are: not so many standard errors."""
    parameters = [{"name": "b_A", "value": 1.0, "se": 0.1, "low": 0.7, "high": 1.3}]
    effect = SimpleNamespace(id="supply", probability=1.0, confusable_with=(), parameters=parameters)
    gap = SimpleNamespace(before=2.0, after=1.0, noise_floor=1.0)
    result: Any = SimpleNamespace(effects=[effect], verdict="named", gap=gap)
    for truth, covered in ((1.25, 1), (1.35, 0)):
        found = judged(result, "supply", {"parameters": {"b_A": {"value": truth}}})
        assert (found["covered"], found["of"]) == (covered, 1)


@pytest.mark.slow(seconds=8)
def test_an_effect_in_the_bytes_is_found_named_and_covered(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Mass unbalances that were taken for zero, through bytes, at two temperatures."""
    monkeypatch.setitem(SWEEPS, "published", published(tmp_path / "sweep.yaml", "-20 degC, 60 degC"))
    found = case(("published", "mean", "MU_real", "high"), twin=False)
    assert found["named"]
    assert found["covered"] == found["of"] == 2
    assert found["off"] < 0.01
    assert found["gap"][1] < found["gap"][0]
