"""The catalogue as people and programs read it never differs from the catalogue."""

from __future__ import annotations

import json
import re
from collections.abc import Mapping
from pathlib import Path

import numpy as np
import pytest

from docs.effect_pages import family_pages, write_pages
from hil.campaign import Conditions, FloatArray
from hil.model.effects.base import Base, Effect, Parameter
from hil.model.effects.catalogue import EFFECTS, entries
from hil.model.effects.columns import column, per_channel
from hil.model.effects.document import effects_document
from tests.hil.model.effect_conditions import one_run

DOCS = Path(__file__).resolve().parents[3] / "docs"


def test_pages_in_the_docs_are_those_of_the_catalogue(tmp_path: Path) -> None:
    """Written again they are the same, and none is left over: `python docs/effect_pages.py`."""
    write_pages(tmp_path)
    written = {path.name: path.read_text(encoding="utf-8") for path in tmp_path.iterdir()}
    assert written == family_pages()
    assert {path.name: path.read_text(encoding="utf-8") for path in (DOCS / "effects").iterdir()} == written


def test_document_holds_every_id_once_and_is_json() -> None:
    """With parameters, units and typical sizes; an id that works in two ways says both."""
    document = json.loads(json.dumps(effects_document(), allow_nan=False))
    assert document["schema"] == "hil.effects/1"
    identifiers = [effect["id"] for effect in document["effects"]]
    assert sorted(identifiers) == sorted({entry.id for entry in entries()})
    settle = next(effect for effect in document["effects"] if effect["id"] == "settle")
    assert settle["works_on"] == ["averages of collects", "within a collect"]
    assert settle["shape_parameters"][0]["name"] == "tau_s"
    assert settle["parameters"][0]["typical"] == [5.0, 100.0]
    assert all(effect["what"] and effect["experiment"] for effect in document["effects"])
    idealised = {effect["id"] for effect in document["effects"] if effect["idealises"]}
    assert idealised == {effect.id for effect in EFFECTS if effect.idealises}
    assert "settle" in idealised


def test_every_effect_is_on_the_page_of_its_family() -> None:
    """By title, id and equation."""
    pages = family_pages()
    for entry in entries():
        assert f"## {entry.title} (`{entry.id}`)" in pages[f"{entry.family}.md"]
        assert f"`{entry.id}`" in pages["README.md"]


def test_the_example_of_the_how_to_is_an_effect() -> None:
    """Its class runs as printed and does what the text says."""
    text = (DOCS / "how-to" / "add-an-effect.md").read_text(encoding="utf-8")
    source = next(block for block in re.findall(r"```python\n(.*?)```", text, re.DOTALL) if "class " in block)
    names = {
        "Effect": Effect,
        "Parameter": Parameter,
        "Conditions": Conditions,
        "Base": Base,
        "FloatArray": FloatArray,
        "Mapping": Mapping,
        "column": column,
        "per_channel": per_channel,
    }
    exec(compile(source, "add-an-effect.md", "exec"), names)  # noqa: S102 (our own documentation)
    effect = names["HumidityBias"]()  # type: ignore[operator]
    conditions = one_run()
    conditions.columns["humidity_percent"] = np.array([60.0, np.nan, 40.0])  # type: ignore[index]
    assert effect.columns(conditions, None, {})[:, 0, 0] == pytest.approx([10.0, 0.0, -10.0])
    assert [parameter.name for parameter in effect.parameters_for(conditions)] == ["K_h_A", "K_h_B"]
