"""YAML that would take a machine's time and memory, or is no number that exists, is refused with its place."""

from __future__ import annotations

import pytest
from pydantic import BaseModel, ConfigDict, ValidationError

from drivers.errors import InputError
from drivers.strict_yaml import first_mistake, parse_yaml

BOMB = "a: &a [x, x, x, x, x, x, x, x, x]\n" + "".join(
    f"{new}: &{new} [{', '.join([f'*{old}'] * 9)}]\n" for old, new in zip("abcdefgh", "bcdefghi", strict=True)
)
MERGES = "a: &a {x: 1, y: 2}\n" + "".join(
    f"{new}: &{new} {{<<: [{', '.join([f'*{old}'] * 9)}]}}\n" for old, new in zip("abcdefgh", "bcdefghi", strict=True)
)


def test_what_one_reader_changes_no_other_reads() -> None:
    """A text is read once and remembered; everybody has a document of their own."""
    text = "a: {b: [1, 2]}\n"
    first = parse_yaml(text, "f.yaml")
    first["a"]["b"].append(3)
    first["c"] = 4
    assert parse_yaml(text, "g.yaml") == {"a": {"b": [1, 2]}}


@pytest.mark.parametrize(
    ("text", "message"),
    [
        (BOMB, "f.yaml, line 5, column "),
        (MERGES, "f.yaml, line 5, column "),
        ("a: &a [*a]\n", "f.yaml, line 1, column 4: not valid YAML: more than 200000 values"),
        ("a: &a {b: *a}\n", "f.yaml, line 1, column 4: not valid YAML: more than 200000 values"),
        (f"a: 1\nb: {'9' * 5000}\n", "f.yaml, line 2, column 4: not valid YAML: '999999"),
        (f"b: [{'9' * 400}]\n", "f.yaml, line 1, column 5: not valid YAML: '999999"),
        ("b: -0x10000000000000000\n", "f.yaml, line 1, column 4: not valid YAML: '-0x10000000000000000' is no value"),
        ("b: 2026-02-31\n", "f.yaml, line 1, column 4: not valid YAML: '2026-02-31' is no value that can be"),
        (f"b: 1{':59' * 200_000}\n", "f.yaml, line 1, column 4: not valid YAML: '1:59:59"),
        (f"b: 1{':59' * 900}.5\n", "f.yaml, line 1, column 4: not valid YAML: '1:59:59"),
        ("b: !!bool perhaps\n", "f.yaml, line 1, column 4: not valid YAML: 'perhaps' is no value"),
        ("b: !!timestamp soon\n", "f.yaml, line 1, column 4: not valid YAML: 'soon' is no value"),
        ("b: !!map [a]\n", "f.yaml: not valid YAML: a tag"),
        (f"{'k' * 2000}: 1\n{'k' * 2000}: 2\n", "f.yaml"),
    ],
)
@pytest.mark.timeout(20)
def test_what_cannot_be_borne_is_refused_with_its_place(text: str, message: str) -> None:
    """An alias counts as what it stands for; one of itself has no end."""
    with pytest.raises(InputError) as refusal:
        parse_yaml(text, "f.yaml")
    assert str(refusal.value).startswith(message)
    assert len(str(refusal.value)) < 1600


def test_aliases_and_whole_numbers_of_64_bits_are_read() -> None:
    """What ships uses them: a checksum that two frames share, a polynomial."""
    document = parse_yaml("a: &a {x: [1, 2]}\nb: *a\nc: {<<: *a, y: 0xffffffffffffffff}\n", "f.yaml")
    assert document == {"a": {"x": [1, 2]}, "b": {"x": [1, 2]}, "c": {"x": [1, 2], "y": 2**64 - 1}}


@pytest.mark.slow
@pytest.mark.timeout(120)
def test_a_text_of_the_largest_size_is_read_or_refused_in_seconds() -> None:
    """Nothing but comments, nothing but values."""
    assert parse_yaml("a: 1\n" + "# nothing\n" * 399_000, "f.yaml") == {"a": 1}
    with pytest.raises(InputError, match="more than 200000 values"):
        parse_yaml("a: [" + "1," * 1_999_000 + "]", "f.yaml")


def test_a_key_that_nobody_knows_is_named_before_the_one_that_is_missing() -> None:
    """The one is the other, misspelt."""

    class Section(BaseModel):
        model_config = ConfigDict(extra="forbid")
        temperature_degC: float

    document = {"temprature_degC": 20.0}
    with pytest.raises(ValidationError) as caught:
        Section.model_validate(document)
    assert first_mistake(caught.value, document).startswith("temprature_degC: ")


_TEXT = "text (in quotes where it looks like a number)"


class _OfKinds(BaseModel):
    model_config = ConfigDict(extra="forbid")
    either: str | int | bool = ""
    both: int | None = None
    within: dict[str, str | float] = {}


@pytest.mark.parametrize(
    ("document", "sentence"),
    [
        ({"either": [1]}, f"either: must be {_TEXT} or a whole number or true or false, not a list"),
        ({"both": {"a": 1}}, "both: must be a whole number, not a mapping"),
        ({"within": {"scale": {"a": 1}}}, f"within.scale: must be {_TEXT} or a number, not a mapping"),
    ],
)
def test_what_may_be_of_several_kinds_is_told_with_all_of_them(document: dict[str, object], sentence: str) -> None:
    """The place ended in ".str", which no file has, and the sentence named the first kind alone."""
    with pytest.raises(ValidationError) as caught:
        _OfKinds.model_validate(document)
    assert first_mistake(caught.value, document) == sentence
