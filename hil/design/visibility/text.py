"""The identifiability map for people: what is seen and how small, what looks alike, what is not, what would help.

print(visibility_text(sweep_document(sweep, bench)))
"""

from collections.abc import Iterator, Mapping
from typing import Any

from hil.solve.wrong_rows import in_words
from procedures.words import unit_in_words


def visibility_text(document: Mapping[str, Any]) -> str:
    """Return a screenful of plain lines from the document hil.visibility/1."""
    lines = [str(document["title"]) + ("  SIMULATED" if document.get("simulated") else "")]
    forms = ", ".join(f"sensor {number}: {form}" for number, form in document["model"].items())
    lines += [f"beside the parameters of the model ({forms})", *_noise(document)]
    lines += [*in_words(document), ""]
    seen = [effect for effect in document["effects"] if effect["visible"]]
    probability = document["effects"][0]["smallest_visible"]["probability"] if document["effects"] else 0.9
    rate = document["false_alarm_rate"]
    lines += [f"Seen, from this size on (in {probability:.0%} of nights; {rate:.0%} of nights without any show one):"]
    lines += [_seen(effect) for effect in sorted(seen, key=_against_typical)]
    lines += ["", *_alike(seen), *_unseen(document), *_unasked(document), *_changes(document)]
    return "\n".join(lines)


def _noise(document: Mapping[str, Any]) -> Iterator[str]:
    """What each sensor is taken to scatter by, and whether it showed that: a planned sweep and its night may differ."""
    for number, of in document["sensors"].items():
        level, changes = of["noise"], []
        if level["run_bias_deg_per_hr"]:
            changes.append(f"the bias by {level['run_bias_deg_per_hr']:.2g} deg/hr")
        if level["run_mu_deg_per_hr_per_g"]:
            changes.append(f"MU by {level['run_mu_deg_per_hr_per_g']:.2g} deg/hr/g")
        said = f"from run to run {' and '.join(changes) or 'nothing'} ({level['source']})"
        yield f"noise, sensor {number}: {level['collect_deg_per_hr']:.2g} deg/hr in a collect; {said}"


def _against_typical(effect: Mapping[str, Any]) -> float:
    smallest = effect["smallest_visible"]
    return float("inf") if smallest["value"] is None else smallest["value"] / max(smallest["typical"][1], 1e-300)


def _seen(effect: Mapping[str, Any]) -> str:
    smallest = effect["smallest_visible"]
    low, high = smallest["typical"]
    size = "never" if smallest["value"] is None else f"{smallest['value']:.3g} {unit_in_words(smallest['unit'])}"
    small = smallest["value"] is not None and smallest["value"] <= high
    verdict = f"typical {low:g} to {high:g}" + ("" if small else ": too small to be found")
    return f"  {effect['id']:<18} {smallest['parameter']:<10} {size:<34} {verdict}"


def _alike(seen: list[Mapping[str, Any]]) -> Iterator[str]:
    groups = {tuple(effect["class"]) for effect in seen if len(effect["class"]) > 1}
    for group in sorted(groups):
        yield f"Look alike, so only the group can be named: {', '.join(group)}"
    if groups:
        yield ""


def _unseen(document: Mapping[str, Any]) -> Iterator[str]:
    unseen = [effect for effect in document["effects"] if not effect["visible"] and not effect["in_model"]]
    if unseen:
        yield "Not seen: the model's own parameters take it up (in brackets those that it moves by a standard error):"
        for effect in unseen:
            yield f"  {effect['id']}{_leaks(document, effect['id'])}"
        yield ""


def _leaks(document: Mapping[str, Any], name: str) -> str:
    """What an effect moves, sensor by sensor: they lie differently."""
    own = {number: e for number, of in document["sensors"].items() for e in of["effects"] if e["id"] == name}
    told = [f"sensor {number}: {', '.join(effect['leaks'])}" for number, effect in own.items() if effect["leaks"]]
    return f" ({'; '.join(told)})" if told else ""


def _unasked(document: Mapping[str, Any]) -> Iterator[str]:
    reasons: dict[str, str] = {}
    asked = {effect["id"] for effect in document["effects"]}
    for sensor in document["sensors"].values():
        reasons |= {name: why for name, why in sensor["cannot_be_asked"].items() if name not in asked}
    needing = [f"  {name}: {why.removeprefix('cannot be asked: ')}" for name, why in reasons.items() if "cannot" in why]
    if needing:
        yield from ["Cannot be asked about:", *needing, ""]


def _changes(document: Mapping[str, Any]) -> Iterator[str]:
    changes = [change for change in document["changes"] if _benefits(change)]
    if changes:
        some = document["changes_weighed_on_runs"]
        few = f", weighed on {some} runs of {document['runs']}" if some < document["runs"] else ""
        yield f"What would help, most first{few}:"
    for place, change in enumerate(changes, 1):
        yield f"  {place}. {change['change']} (costs {change['cost']})"
        yield from (f"     {benefit}" for benefit in _benefits(change))


def _benefits(change: Mapping[str, Any]) -> list[str]:
    benefits = []
    if change["newly_visible"]:
        benefits.append(f"brings into sight: {', '.join(change['newly_visible'])}")
    if change["separated"]:
        pairs = [" from ".join(pair) for pair in change["separated"]]
        rest = f" and {len(pairs) - 4} more pairs" if len(pairs) > 4 else ""
        benefits.append(f"tells apart: {', '.join(pairs[:4])}{rest}")
    if change["protected"]:
        told = []
        for number, pairs in change["protected_in"].items():
            effects = dict.fromkeys(effect for effect, _ in pairs)
            by_effect = [f"{e} of {', '.join(name for own, name in pairs if own == e)}" for e in effects]
            told.append(f"sensor {number}: {'; '.join(by_effect)}")
        benefits.append(f"keeps out ({'; '.join(told)})")
    if change["size_ratio"] < 0.95:
        benefits.append(f"shows effects at {change['size_ratio']:.0%} of the size")
    return benefits
