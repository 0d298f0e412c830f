"""The result for people: one self-contained page that tells what is missing in the order in which it was found out."""

import json
import re
from collections.abc import Mapping, Sequence
from itertools import groupby
from pathlib import Path
from typing import Any

import numpy as np

from drivers.strict_yaml import packaged
from hil.files.page import in_style, rendered
from hil.model import save_model
from hil.reconcile.outcome.pictures import beside_simulated, driver_of, panels_of, pictures
from hil.reconcile.outcome.scatter import EXCESS
from hil.reconcile.result import (
    LEFT_OUT,
    FoundEffect,
    Reconciliation,
    Rival,
    in_times,
    rival_in_words,
    stated,
    values_off,
)
from hil.solve.runs import runs_in_words
from hil.solve.wrong_rows import LEFT_OUT as OMITTED
from procedures.words import hours_minutes, listed, numbered, percent, unit_in_words

_FALLS = 0.98  # of what it was: from there on a gap is said to fall
_MORE_THAN_NOISE = 1.3  # times the noise's mean square: from there on it is not said that nothing else is left
_MOST_PLACES = 12
_EXPECTED = 5.0  # times as probable before the data, from which on physics is said to expect a name
_LEAST = 1e-4  # p-values are said down to it


_ACT = packaged("hil.reconcile.outcome", "what_to_do.yaml")
_LIKELY = 0.5
_MEASURED = " The model holds at temperatures that were measured: how far off it may be at others, hil thermal says."
_APART = 0.05  # p-value below which nights simulated after are told from the measured one
_BY = {
    "averages": "its averages",
    "run_scatter": "how its averages scatter",
    "series": "what its collects are like inside",
    "conditions": "its temperatures and times",
}


def what_to_do(result: Reconciliation) -> tuple[str, str]:
    """Return the verdict and what somebody has to do now; "labels": only those were wrong, "untested": none was.

    And "scatter": the mean lacks nothing that can be told, but what scatters makes `hil solve` FAIL; "apart": neither,
    but simulated nights can be told from the measured one.
    """
    only = result.verdict in {"named", "ambiguous"} and all(effect.mends_labels for effect in result.effects)
    kind = "labels" if only else result.verdict if result.tested else "untested"
    after = (result.twin or {}).get("after", {})
    apart = after.get("p_value", 1.0) < _APART
    beyond = result.left.beyond_errors
    kind = ("scatter" if beyond else "apart" if apart else kind) if kind == "none" else kind
    doubts = runs_in_words(result.doubtful)
    first = ["what is missing of the measurement (hil report says what)"] if result.without.get("missing") else []
    first += [f"what was not measured well (hil report says why): {doubts}"] if doubts else []
    if result.contradicted:
        first.append(f"what its own records contradict (notes): {numbered('run', result.contradicted)}")
    omitted = [row for row in result.rows if row["done"] == OMITTED]
    said = {*result.contradicted, *(row["run"] for row in omitted), *(beyond if kind == "scatter" else ())}
    said |= {run for runs in result.doubtful.values() for run in runs}
    left = result.left.not_passed.items()
    doubts = runs_in_words({verdict: [run for run in runs if run not in said] for verdict, runs in left})
    why = " (hil report says" if result.left == result.solved else ", even with what is known taken off (notes say"
    first += [f"what hil solve does not pass{why} why): {doubts}"] if doubts else []
    spoiled = sorted({collect for row in omitted for collect in row["collects"]})
    first += [f"what is left out (notes): {numbered('collect', spoiled)}"] if spoiled else []
    excess = [n["observed_deg_per_hr"] / n["stated_deg_per_hr"] for n in result.noise if n["stated_deg_per_hr"]]
    most = _number(max(excess, default=0.0))
    act = "The model itself lacks nothing that can be told." if kind == "none" and first else _ACT[kind]
    if kind == "scatter":
        runs = numbered("run", beyond)
        act = f"{act} No effect is named, but averages scatter more than their standard errors say ({runs}: FAIL)."
    elif kind in {"none", "apart"} and max(excess, default=0.0) > EXCESS:
        act += f" Averages scatter {most} times as much as standard errors say; the ± of hil solve"
        act += " and the noise of model.yaml have it."
    if kind in {"none", "named", "ambiguous"} and _follows_temperature(result):
        act += _MEASURED
    if apart:
        part = min(_BY, key=lambda each: 1.0 if after["parts"].get(each) is None else after["parts"][each])
        act += f" Nights simulated with the model as it is now can be told from the measured one by {_BY[part]}."
    return kind, f"First see to {'; '.join(first)}. {act}" if first else act


def _follows_temperature(result: Reconciliation) -> bool:
    """Whether what is held out stands at a temperature that other runs have, and the values there follow it."""
    return result.calibration != "one set" or dict(result.follows).get("temperature", 0.0) > _LIKELY


def page(result: Reconciliation) -> str:
    """Return the page as one HTML document: no scripts, no other files."""
    rows = list(result.picture.get("rows", []))
    panels, driver = panels_of(rows), driver_of(result, rows)
    on_mean = any(effect.acts_on == "mean" and not effect.inside_collects for effect in result.effects)
    minutes = result.picture.get("minutes_per_collect")
    following = dict(result.next_experiment or {})
    count = sum(each["runs"] for each in following.get("collects", [])) * following.get("repeats", 1)
    # What only scatters stands out of what the model before explains; the band that it widens is the noise of after.
    only_scatters = bool(result.effects) and not on_mean
    known = {(n["sensor"], n["channel"]): n["explained_deg_per_hr"] for n in result.noise if only_scatters}
    view = {
        "title": f"{result.campaign}: what the model lacks",
        "running_title": in_style(result.campaign),
        "simulated": result.simulated,
        "whole": False,
        "result": result,
        "act": what_to_do(result),
        "summary": summary(result),
        "driver": driver,
        "held_out": np.isfinite(result.gap.improved_p_value),
        "before": list(pictures(panels, driver, "held_before", "before", known)),
        "curves": list(pictures(panels, driver, "left", "with what was added", {}, curve=True)) if on_mean else [],
        "after": list(pictures(panels, driver, "held_after", "after", {})) if result.effects else [],
        "nights": list(beside_simulated(result.twin or {}, panels)),
        "most_places": _MOST_PLACES,
        "place_in_words": place_in_words,
        "effects": [_effect(effect) for effect in result.effects],
        "gap": _gap(result),
        "next": following,
        "why": _titled(result, str(following.get("why", ""))),
        "takes": hours_minutes(60.0 * count * minutes) if minutes and count else "",
        "number": _number,
        "chance": _chance,
        "rival_in_words": rival_in_words,
    }
    return rendered("hil.reconcile.outcome", "page.html.j2", view)


def summary(result: Reconciliation) -> list[str]:
    """Say what was found in a few sentences: what, how sure, what it mends, what to do next."""
    added = [effect for effect in result.effects if not effect.mends_labels and LEFT_OUT not in effect.shape]
    swapped = [effect for effect in result.effects if effect.mends_labels]
    model = result.input_model.full_title
    per_temperature = " calibrated at each temperature" if result.calibration != "one set" else ""
    if not result.effects:
        if not result.tested:
            return ["These collects leave nothing over by which the model could be told from another."]
        if result.verdict == "none":
            how = per_temperature or " fitted to these collects"
            more = result.gap.standardised_after
            noise = (
                "nothing but noise" if _ACT["none"] in what_to_do(result)[1] else "nothing that can be told from noise"
            )
            if more > _MORE_THAN_NOISE:
                noise = f"nothing that can be told from noise, of {more:.2g} times the variance that the fit gives it"
            nothing = f"The model {model},{how}, leaves {noise}."
            return [nothing, *(f"{text[0].upper()}{text[1:]}." for text in values_off(result.as_it_stands, result.gap))]
        return [f"{model} does not describe these collects, and nothing that was tried mends it."]
    said = [f"{effect.title} ({effect.id}): {effect.equation}." for effect in swapped]
    said += [f"{effect.title}: left out." for effect in result.effects if LEFT_OUT in effect.shape]
    for effect in added:
        same = [rival for rival in effect.confusable_with if rival.overlap > 0.95]
        alike = [rival.id for rival in same]
        when = f", {effect.shape_in_words}," if effect.shape_in_words else ""
        sentence = f"{effect.title} ({effect.id}){when} is missing from {model}"
        if effect.kind == "ambiguous" and alike:
            others = " or ".join(_titled(result, each) for each in alike[:3])
            sentence += f", or {others}: these collects cannot tell them apart"
            sentence += f"; {percent(effect.probability)} for {effect.id}, {_usual(result, same)}"
        elif effect.kind == "ambiguous":
            own = percent(effect.probability)
            likelier = [rival for rival in effect.confusable_with if rival.probability > effect.probability]
            if likelier:
                sentence += f" ({own}), or – {percent(likelier[0].probability)} – {_titled(result, likelier[0].id)}"
                sentence += ": what may be no more than scatter is written as scatter" * (effect.acts_on == "scatter")
            else:
                sentence += f" – probably ({own}), not certainly"
        if effect.inside_collects:
            sentence += "; it shows inside the collects and leaves no trace in their averages"
        said.append(sentence + ".")
    said += _gap(result)[:1]
    said += [f"It follows {d.replace('_', ' ')} ({percent(share)})." for d, share in result.follows[:1] if added]
    if per_temperature:
        said.append("The model's other values were calibrated at each temperature.")
    if result.next_experiment and result.next_experiment.get("what"):
        following = result.next_experiment
        said.append(f"Measure next: {following['what']}: {_titled(result, str(following.get('why', '')))}.")
    return said


def _usual(result: Reconciliation, same: Sequence[Rival]) -> str:
    """Say whether physics alone, before any data, favours the first name or one of those that look the `same`."""
    odds = {each.id: each.prior_odds if each.prior_odds is not None else 1.0 for each in same}
    most = max(odds, key=lambda name: odds[name])
    if odds[most] * _EXPECTED <= 1.0:
        return (
            f"which physics expects: before these data it was {in_times(1.0 / odds[most])} as probable as any of those"
        )
    if odds[most] >= _EXPECTED:
        return f"though physics expects {_titled(result, most)}, before these data {in_times(odds[most])} as probable"
    return "which before these data was not known to be much more usual than those"


def _gap(result: Reconciliation) -> list[str]:
    """Say by how much the gap shrank; where it lies in the scatter, that each rate became more probable, first."""
    gap, score = result.gap, result.gap.log_score
    if np.isfinite(gap.before) and not gap.noise_floor > 0.0:
        return ["These runs have as many parameters as rates: nothing is left to be noise, and no gap can be stated."]
    if not np.isfinite(gap.before) or not result.effects:
        return []
    proved = np.isfinite(gap.improved_p_value)
    how = "on runs that were held out" if proved else "of the fit (nothing could be held out)"
    swapped = any(effect.mends_labels for effect in result.effects)
    mended = ["the labels put right"] * swapped
    added = sum(
        not (effect.mends_labels or effect.inside_collects or LEFT_OUT in effect.shape) for effect in result.effects
    )
    mended += [f"{'them' if added > 1 else 'it'} in the model"] * bool(added)
    if not mended:
        return []
    falls = f"the gap {how} falls from {_number(gap.before)} to {_number(gap.after)} deg/hr"
    noise = f"noise alone leaves {_number(gap.noise_floor)}"
    if gap.after < _FALLS * gap.before or score is None:
        return [f"With {listed(mended)} {falls}; {noise}."]
    better = float(np.exp(score["after"] - score["before"]))  # what only scatters moves no average
    return [
        f"With {listed(mended)} every rate {how} is {_number(better)} times as probable as before.",
        f"It scatters and moves no average: the mean gap stays, {_number(gap.after)} deg/hr; {noise}.",
    ]


def _chance(value: float) -> str:
    return f"below {_LEAST:.4f}" if value < _LEAST else f"{value:.2g}"


def _effect(effect: FoundEffect) -> dict[str, Any]:
    """What the page shows of one effect: its values by sensor, its size beside what is typical."""
    tables = []
    for sensor, own in groupby(sorted(effect.parameters, key=_sensor), key=_sensor):
        told = list(dict.fromkeys(stated([{**each, "sensor": None} for each in own])))
        cells = {(at, name): value for name, at, value in told}
        places, names = (list(dict.fromkeys(each[i] for each in told)) for i in (1, 0))
        tables.append((sensor, names, [(at or "value", [cells.get((at, n), "–") for n in names]) for at in places]))
    return {"of": effect, "tables": tables, "size": _size(effect)}


def _sensor(parameter: Mapping[str, Any]) -> str:
    return str(parameter.get("sensor") or "")


def _size(effect: FoundEffect) -> str:
    """Say how large an effect is beside what is typical of it; nothing where nobody knows."""
    known = [each for each in effect.parameters if "typical" in each]
    if not known:
        return ""
    each = max(known, key=lambda each: abs(each["value"]))
    size, (low, high) = abs(each["value"]), each["typical"]
    word = "larger than" if size > high else "smaller than" if size < low else "within"
    return f"At most {size:.3g} {unit_in_words(each['unit'])}: {word} what is typical, {low:g} to {high:g}."


def _titled(result: Reconciliation, said: str) -> str:
    """Put its title beside every id of an effect or of a rival that stands alone."""
    titles = {effect.id: effect.title for effect in result.effects}
    titles |= {each.id: each.title for effect in result.effects for each in effect.confusable_with}
    for identifier, title in titles.items():
        if title and title != identifier:
            said = re.sub(rf"(?<![(\w]){re.escape(identifier)}(?![\w)])", f"{title} ({identifier})", said)
    return said


def place_in_words(where: Mapping[str, Any]) -> str:
    """Say a place in words."""
    parts = [f"sensor {where['sensor']}, channel {where['channel']}"]
    if "position" in where:
        parts.append(f"position {where['position']}")
    if "temperature_degC" in where:
        low, high = where["temperature_degC"]
        parts.append(f"at {low:.0f} °C" if high - low < 1.0 else f"from {low:.0f} to {high:.0f} °C")
    if "runs" in where:
        parts.append(numbered("run", where["runs"]))
    return ", ".join(parts)


def _number(value: float | None) -> str:
    """Three significant digits without powers of ten, or a dash."""
    if value is None or not np.isfinite(value):
        return "–"
    if 0.0 < abs(value) < _LEAST:
        return f"below {_LEAST:.4f}"
    return f"{value:.3g}" if abs(value) < 1000.0 else f"{value:.0f}"


def write_result(result: Reconciliation, out_dir: Path) -> None:
    """Write reconciliation.json, model.yaml and reconciliation.html into `out_dir`, which is made if need be."""
    out_dir.mkdir(parents=True, exist_ok=True)
    document = json.dumps(result.document(), indent=2, ensure_ascii=False, allow_nan=False)
    (out_dir / "reconciliation.json").write_text(document + "\n", encoding="utf-8")
    save_model(result.model_after, out_dir / "model.yaml")
    (out_dir / "reconciliation.html").write_text(page(result), encoding="utf-8")
