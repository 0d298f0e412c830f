"""The result for people: one self-contained page that a technician can follow."""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from io import StringIO
from pathlib import Path
from typing import Any

import jinja2
import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.image import AxesImage

from hil.model import save_model
from hil.reconcile.result import LEFT_OUT, FoundEffect, Reconciliation, rival_in_words, stated, values_off
from procedures.words import listed, numbered, percent

_TEMPLATE = "page.html.j2"
_LIMIT = 5.0
_FALLS = 0.98  # of what it was: from there on a gap is said to fall
_MORE_THAN_NOISE = 1.3  # times the noise's mean square: from there on it is not said that nothing else is left
_MOST_PLACES = 12
_TOLD, _LEAST = 0.05, 1e-4  # simulated nights are told apart below; p-values are said down to

VERDICTS = {
    "none": "Nothing is missing: no disagreement beyond the noise.",
    "named": "Something is missing, and it has a name.",
    "ambiguous": "Something is missing; these collects cannot tell which of several causes it is.",
    "empirical": "Something is missing that no effect of the catalogue describes.",
    "unresolved": "Something is missing, but these collects support no added term.",
}
_LABELS_ONLY = "Nothing is missing from the model: collects carry each other's labels."


def page(result: Reconciliation) -> str:
    """Return the page as one HTML document: no scripts, no other files."""
    environment = jinja2.Environment(
        loader=jinja2.FileSystemLoader(Path(__file__).parent), autoescape=True, undefined=jinja2.StrictUndefined
    )
    environment.filters["number"] = _number
    environment.filters["percent"] = percent
    rows = list(result.picture.get("rows", []))
    return environment.get_template(_TEMPLATE).render(
        result=result,
        headline=_headline(result),
        map_svg=_svg(_map(rows)) if rows else "",
        gap_svg=_svg(_gap(result)) if np.isfinite(result.gap.before) else "",
        rivals=[_candidates(effect) for effect in result.effects],
        places=[place_in_words(d.where) for d in result.disagreements],
        most_places=_MOST_PLACES,
        summary=summary(result),
        twin=_twin(result.twin),
        tables=[_by_temperature(effect) for effect in result.effects],
    )


def _headline(result: Reconciliation) -> str:
    """Say the verdict in a sentence: labels that were exchanged are no lack of the model."""
    only = result.verdict == "named" and all(effect.mends_labels for effect in result.effects)
    return _LABELS_ONLY if only else VERDICTS[result.verdict]


def summary(result: Reconciliation) -> list[str]:
    """Say what was found in a few sentences: what, how sure, what it mends, what to do next."""
    added = [effect for effect in result.effects if not effect.mends_labels and LEFT_OUT not in effect.shape]
    found = [effect for effect in added if not effect.inside_collects]
    swapped = [effect for effect in result.effects if effect.mends_labels]
    per_temperature = " calibrated at each temperature" if result.calibration != "one set" else ""
    if not result.effects:
        if result.verdict == "none":
            how = per_temperature or " fitted to these collects"
            more = result.gap.standardised_after
            noise = (
                "nothing but noise"
                if not more > _MORE_THAN_NOISE
                else (f"nothing that can be told from noise, of {more:.2g} times the variance that the fit gives it")
            )
            nothing = f"The model {result.model_before},{how}, leaves {noise}."
            return [nothing, *(f"{text[0].upper()}{text[1:]}." for text in values_off(result.as_it_stands, result.gap))]
        return [f"{result.model_before} does not describe these collects, and nothing that was tried mends it."]
    said = [f"{effect.title} ({effect.id}): {effect.equation}." for effect in swapped]
    said += [f"{effect.title}. They were left out." for effect in result.effects if LEFT_OUT in effect.shape]
    for effect in added:
        same = [rival for rival in effect.confusable_with if rival.overlap > 0.95]
        alike = [rival.id for rival in same]
        when = f", {effect.shape_in_words}," if effect.shape_in_words else ""
        sentence = f"{effect.title} ({effect.id}){when} is missing from {result.model_before}"
        if effect.kind == "ambiguous" and alike:
            sentence += f", or {' or '.join(alike[:3])}: these collects cannot tell them apart"
            if same[0].probability < effect.probability:
                sentence += f", and that it is {effect.id} ({percent(effect.probability)}) is what physics expects"
        elif effect.kind == "ambiguous":
            sentence += f" – probably ({percent(effect.probability)}), not certainly"
        if effect.inside_collects:
            sentence += "; it shows inside the collects and leaves no trace in their averages"
        said.append(sentence + ".")
    mended = ["the labels put right"] * bool(swapped) + ["it in the model"] * bool(found)
    if mended and np.isfinite(result.gap.before):
        proved = np.isfinite(result.gap.improved_p_value)
        how = "on data that was held out" if proved else "of the fit (nothing could be held out)"
        gap, score = result.gap, result.gap.log_score
        if gap.after < _FALLS * gap.before or score is None:
            said.append(
                f"With {listed(mended)} the gap {how} falls from {_number(gap.before)} to {_number(gap.after)} deg/hr; "
                f"noise alone leaves {_number(gap.noise_floor)}."
            )
        else:  # what only scatters moves no average
            better = float(np.exp(score["after"] - score["before"]))
            said.append(f"With {listed(mended)} every rate {how} is {better:.2g} times as probable as before.")
    said += [f"It follows {d.replace('_', ' ')} ({percent(share)})." for d, share in result.follows[:1] if added]
    if per_temperature:
        said.append("The model's other values were calibrated at each temperature.")
    if result.next_experiment and result.next_experiment.get("what"):
        said.append(f"Measure next: {result.next_experiment['what']}.")
    return said


def _twin(asked: Mapping[str, Any] | None) -> str:
    """Say whether nights simulated before and after can be told from the measured one; nothing where nobody asked."""
    if not asked:
        return ""
    said = []
    for when, words in (("before", "as it was"), ("after", "as it is now")):
        chance = asked[when]["p_value"]
        told = "can" if chance < _TOLD else "cannot"
        size = "below 0.0001" if chance < _LEAST else f"= {chance:.2g}"
        said.append(f"from those with the model {words} it {told} be told (p {size})")
    return f"The night beside {asked['draws']} simulated ones, through bytes: {', '.join(said)}."


def _by_temperature(effect: FoundEffect) -> tuple[list[str], list[tuple[str, list[str]]]]:
    """Parameters side by side, by temperature; one row per parameter where there are few: headings and rows."""
    told = list(dict.fromkeys(stated(effect.parameters)))
    cells = {(at, name): value for name, at, value in told}
    places, names = (list(dict.fromkeys(each[i] for each in told)) for i in (1, 0))
    if len(places) < 3 or len(told) < 6:
        return ["value ± one standard error", "at"], [(name, [value, at]) for name, at, value in told]
    return names, [(place, [cells.get((place, name), "–") for name in names]) for place in places]


def _candidates(effect: FoundEffect) -> list[tuple[str, float, str]]:
    """The leader and its rivals: name, probability, how alike they are, what data and what knowledge before say."""
    rows = [(effect.id, effect.probability, "")]
    for rival in effect.confusable_with:
        alike = "the same in these collects" if rival.overlap > 0.95 else f"overlap {rival.overlap:.2f}"
        if rival.same_on:
            alike = f"the same on sensor {listed(rival.same_on)}, taken by itself"
        rows.append((rival.id, rival.probability, "; ".join(filter(None, (alike, rival_in_words(rival.document()))))))
    return rows


def place_in_words(where: Mapping[str, Any]) -> str:
    """Say a place in words."""
    parts = [f"sensor {where['sensor']}, channel {where['channel']}"]
    if "position" in where:
        parts.append(f"position {where['position']}")
    if "temperature_degC" in where:
        low, high = where["temperature_degC"]
        parts.append(f"{low:.0f} to {high:.0f} °C")
    if "runs" in where:
        parts.append(numbered("run", where["runs"]))
    return ", ".join(parts)


def _map(rows: Sequence[Mapping[str, Any]]) -> Figure:
    """Standardised residuals by run (in order of temperature) and position, before and after, on one scale."""
    channels = list(dict.fromkeys((r["sensor"], r["channel"]) for r in rows))
    longest = max(len(str(r["position"])) for r in rows)
    one_run = len({r["run"] for r in rows}) == 1  # positions then stand below, not beside
    below = 0.2 + 0.045 * (longest if one_run else 10)  # inches, of labels that stand on end
    width, height = 11.0, 0.3 + (0.95 + below) * len(channels)
    figure = Figure(figsize=(width, height))  # in stated places: a layout that is sought takes as long as all the rest
    gap = {"hspace": (0.25 + below) / 0.85, "wspace": 0.03}
    left = (0.15 + 0.07 * (0 if one_run else longest)) / width
    places = {"left": left, "right": 0.89, "bottom": below / height, "top": 1.0 - 0.3 / height}
    axes = figure.subplots(len(channels), 2, squeeze=False, sharey="row", gridspec_kw={**places, **gap})
    image: AxesImage | None = None
    for i, (sensor, channel) in enumerate(channels):
        own = [r for r in rows if (r["sensor"], r["channel"]) == (sensor, channel)]
        for j, when in enumerate(("before", "after")):
            image = _panel(axes[i, j], own, when)
            axes[i, j].set_title(f"sensor {sensor}, {channel}: {when}", fontsize=9)
    if image is not None:
        bar = figure.colorbar(image, cax=figure.add_axes((0.92, 0.5 - 0.5 * 0.6, 0.016, 0.6)))
        bar.set_label("residual / σ", fontsize=8)
    return figure


def _panel(axes: Axes, rows: Sequence[Mapping[str, Any]], when: str) -> AxesImage:
    runs = list(dict.fromkeys(r["run"] for r in rows))
    positions = sorted({r["position"] for r in rows})
    if len(runs) == 1:  # poses of one run: a single line of cells
        runs_of = {p: k for k, p in enumerate(positions)}
        cells = np.full((1, len(positions)), np.nan)
        for r in rows:
            cells[0, runs_of[r["position"]]] = r[when]
        labels, ticks, y_labels = positions, range(len(positions)), [""]
    else:
        cells = np.full((len(positions), len(runs)), np.nan)
        for r in rows:
            cells[positions.index(r["position"]), runs.index(r["run"])] = r[when]
        labels, ticks, y_labels = _run_labels(rows, runs), range(len(runs)), positions
    image = axes.imshow(cells, aspect="auto", cmap="RdBu_r", vmin=-_LIMIT, vmax=_LIMIT, interpolation="nearest")
    axes.set_yticks(range(len(y_labels)), y_labels, fontsize=7)
    axes.set_xticks(list(ticks), labels, fontsize=6, rotation=90)
    return image


def _run_labels(rows: Sequence[Mapping[str, Any]], runs: Sequence[int]) -> list[str]:
    known = {r["run"]: r["temperature_degC"] for r in rows if r["temperature_degC"] is not None}
    return [f"{run}: {known[run]:.0f} °C" if np.isfinite(known.get(run, np.nan)) else str(run) for run in runs]


def _gap(result: Reconciliation) -> Figure:
    """Held-out gap before and after, beside the noise floor."""
    figure = Figure(figsize=(6.0, 1.9))
    axes = figure.subplots(gridspec_kw={"left": 0.16, "right": 0.98, "bottom": 0.28, "top": 0.97})
    names = ["noise floor", "after", "before"]
    values = [result.gap.noise_floor, result.gap.after, result.gap.before]
    axes.barh(names, values, color=["0.7", "tab:green", "tab:red"])
    for place, value in enumerate(values):
        axes.annotate(f" {_number(value)}", (value, place), va="center", fontsize=9)
    axes.set_xlabel("rms of held-out residuals, deg/hr")
    axes.margins(x=0.15)
    axes.spines[["top", "right"]].set_visible(False)
    return figure


def _svg(figure: Figure) -> str:
    text = StringIO()
    figure.savefig(text, format="svg", metadata=dict.fromkeys(("Creator", "Date", "Format", "Type")))
    return text.getvalue()[text.getvalue().index("<svg") :]


def _number(value: float | None) -> str:
    """Three significant digits, or a dash."""
    if value is None or not np.isfinite(value):
        return "–"
    return f"{value:.3g}"


def write_result(result: Reconciliation, out_dir: Path) -> None:
    """Write reconciliation.json, model.yaml and reconciliation.html into `out_dir`, which is made if need be."""
    out_dir.mkdir(parents=True, exist_ok=True)
    text = json.dumps(result.document(), indent=2, ensure_ascii=False, allow_nan=False)
    (out_dir / "reconciliation.json").write_text(text + "\n", encoding="utf-8")
    save_model(result.model_after, out_dir / "model.yaml")
    (out_dir / "reconciliation.html").write_text(page(result), encoding="utf-8")
