"""The identifiability map for people: what is seen and how small, what looks alike, what is not, what would help.

print(visibility_text(sweep_document(sweep, bench)))
"""

from collections.abc import Mapping
from typing import Any

from hil.files.text import filled
from hil.solve.omissions import in_words
from procedures.words import unit_in_words

_WORTH = 0.95  # of the size at which effects are seen without a change


def visibility_text(document: Mapping[str, Any]) -> str:
    """Return a screenful of plain lines from the document hil.visibility/1."""
    seen = [effect for effect in document["effects"] if effect["visible"]]
    asked = {effect["id"] for effect in document["effects"]}
    reasons = {
        name: why
        for sensor in document["sensors"].values()
        for name, why in sensor["cannot_be_asked"].items()
        if name not in asked and "cannot" in why
    }
    helps = ("newly_visible", "separated", "protected")
    return filled(
        "hil.design.visibility",
        "text.txt.j2",
        r=document,
        wrong=list(in_words(document)),
        seen=sorted(seen, key=_against_typical),
        alike=sorted({tuple(effect["class"]) for effect in seen if len(effect["class"]) > 1}),
        needing={name: why.removeprefix("cannot be asked: ") for name, why in reasons.items()},
        changes=[
            each for each in document["changes"] if any(each[key] for key in helps) or each["size_ratio"] < _WORTH
        ],
        worth=_WORTH,
        unit_in_words=unit_in_words,
    ).rstrip("\n")


def _against_typical(effect: Mapping[str, Any]) -> float:
    smallest = effect["smallest_visible"]
    sizes = [each or float("inf") for each in (smallest["value"], smallest["easiest"]["value"])]
    least = sizes[0] if sizes[0] <= smallest["typical"][1] else sizes[1]
    return float(least / max(smallest["typical"][1], 1e-300))
