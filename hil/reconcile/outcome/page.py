"""The result for people: one self-contained page that tells what is missing in the order in which it was found out."""

from __future__ import annotations

import json
from collections.abc import Collection, Iterator, Mapping, Sequence
from itertools import groupby
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from hil.files.figure import LOOKS, blank
from hil.files.numbers import WHOSE
from hil.files.page import inline_svg, rendered
from hil.model import save_model
from hil.model.effects.prior import ALPHA
from hil.reconcile.naming import LIKELY
from hil.reconcile.outcome.sentences import (
    LEAST,
    gap_in_words,
    number,
    of_few,
    summary,
    titled,
    what_to_do,
)
from hil.reconcile.outcome.stated import at_most
from hil.reconcile.result import FoundEffect, Reconciliation, stated
from procedures.words import hours_minutes, numbered, unit_in_words

if TYPE_CHECKING:
    from matplotlib.axes import Axes

_MOST_PLACES = 12
_MOST_PANELS = 4
_SHORT = 6  # lines of values that stand open
_MOST_LEVEL = 8  # labels that are written side by side
_WIDE = 0.7  # of the distance of two positions: over so much their collects are spread


def page(result: Reconciliation) -> str:
    """Return the page as one HTML document: no scripts, no other files."""
    rows = list(result.picture.get("rows", []))
    disagree = {(each.where["sensor"], each.where["channel"]) for each in result.disagreements}
    panels, driver = panels_of(rows, disagree), driver_of(result, rows)
    acting = [own for own in panels if any(row["effect"] for row in own)]
    on_mean = any(effect.acts_on == "mean" and not effect.inside_collects for effect in result.effects)
    minutes = result.picture.get("minutes_per_collect")
    following = dict(result.next_experiment or {})
    count = sum(each["runs"] for each in following.get("collects", [])) * following.get("repeats", 1)
    # What only scatters stands out of what the model before explains; the band that it widens is the noise of after.
    only_scatters = bool(result.effects) and not on_mean
    known = {(n["sensor"], n["channel"]): n["explained_deg_per_hr"] for n in result.noise if only_scatters}
    view = {
        "title": f"{result.campaign}: what the model lacks",
        "simulated": result.simulated,
        "result": result,
        "act": what_to_do(result),
        "summary": summary(result),
        "driver": driver,
        "scatters_more": bool(at_most(result.noise)),
        "held_out": result.gap.each,
        "before": list(pictures(panels, driver, "held_before", "before", known)),
        "curves": list(pictures(acting, driver, "left", "with what was added", {}, curve=True)) if on_mean else [],
        "after": list(pictures(panels, driver, "held_after", "after", {})) if result.effects else [],
        "nights": list(beside_simulated(result.twin or {}, panels)),
        "most_places": _MOST_PLACES,
        "place_in_words": place_in_words,
        "effects": [_effect(effect) for effect in result.effects],
        "gap": gap_in_words(result),
        "next": following,
        "why": titled(result, str(following.get("why", ""))),
        "takes": hours_minutes(60.0 * count * minutes) if minutes and count else "",
        "number": number,
        "chance": _chance,
        "apart": ALPHA,
        "of_few": of_few(result.twin["draws"]) if result.twin else "",
    }
    return rendered("hil.reconcile.outcome", "page.html.j2", view)


def _chance(value: float) -> str:
    return f"below {LEAST:.4f}" if value < LEAST else f"{value:.2g}"


def _effect(effect: FoundEffect) -> dict[str, Any]:
    """What the page shows of one effect: its values by sensor, its size beside what is typical."""
    tables = []
    for sensor, own in groupby(sorted(effect.parameters, key=_sensor), key=_sensor):
        told = list(dict.fromkeys(stated([{**each, "sensor": None} for each in own])))
        cells = {(at, name): value for name, at, value in told}
        places, names = (list(dict.fromkeys(each[i] for each in told)) for i in (1, 0))
        tables.append((sensor, names, [(at or "value", [cells.get((at, n), "–") for n in names]) for at in places]))
    short = sum(len(lines) for _, _, lines in tables) <= _SHORT
    return {"of": effect, "tables": tables, "short": short, "size": _size(effect)}


def _sensor(parameter: Mapping[str, Any]) -> str:
    return str(parameter.get("sensor") or "")


def _size(effect: FoundEffect) -> str:
    """Say how large an effect is beside what is typical of it; nothing where nobody knows."""
    known = [each for each in effect.parameters if "typical" in each]
    if not known:
        return ""
    each = max(known, key=lambda each: abs(each["value"]) / (each["typical"][1] or 1.0))
    size, (low, high) = abs(each["value"]), each["typical"]
    word = "larger than" if size > high else "smaller than" if size < low else "within"
    return f"At most {size:.3g} {unit_in_words(each['unit'])}: {word} what is typical, {low:g} to {high:g}."


def place_in_words(where: Mapping[str, Any]) -> str:
    """Say a place in words."""
    parts = [f"sensor {where['sensor']}, channel {where['channel']}"]
    if "position" in where:
        parts.append(f"position {where['position']}")
    if "collect_of_run" in where:
        parts.append(f"collect {where['collect_of_run']} of each run")
    if "temperature_degC" in where:
        low, high = where["temperature_degC"]
        span = f"at {low:z.0f} °C" if high - low < 1.0 else f"from {low:z.0f} to {high:z.0f} °C"
        parts.append(f"{span} ({WHOSE[where['temperature_of']]})")
    if where.get("of") == "scatter":
        parts.append(f"what its averages scatter by, rms over all of them ({where['effect']})")
    if "runs" in where:
        parts.append(numbered("run", where["runs"]))
    return ", ".join(parts)


def write_result(result: Reconciliation, out_dir: Path) -> None:
    """Write reconciliation.json, model.yaml and reconciliation.html into `out_dir`, which is made if need be."""
    out_dir.mkdir(parents=True, exist_ok=True)
    document = json.dumps(result.document(), indent=2, ensure_ascii=False, allow_nan=False)
    (out_dir / "reconciliation.json").write_text(document + "\n", encoding="utf-8")
    save_model(result.model_after, out_dir / "model.yaml")
    (out_dir / "reconciliation.html").write_text(page(result), encoding="utf-8")


def driver_of(result: Reconciliation, rows: Sequence[Mapping[str, Any]]) -> str:
    """Choose what the pictures run over: of the three that it can be, and that are likely, what most of it follows.

    Nothing runs over the only run.
    """
    over_runs = "run" if len({row["run"] for row in rows}) > 1 else "position"
    known = {row["temperature_degC"] for row in rows if row["temperature_degC"] is not None}
    over_all = "temperature, °C" if len({round(t) for t in known if np.isfinite(t)}) > 1 else over_runs
    likely = [follows for follows, chance in result.follows if chance > LIKELY] or [f for f, _ in result.follows[:1]]
    drivers = {"position" if f == "pose" else over_all if f.startswith(("run", "temp")) else over_runs for f in likely}
    return min(sorted(drivers), key=lambda driver: _left_within(rows, driver), default=over_all)


def _left_within(rows: Sequence[Mapping[str, Any]], driver: str) -> float:
    """Return the mean square of what differs among a channel's rows at one value of a driver, (deg/hr)²."""
    labels = sorted({row["position"] for row in rows})
    alike: dict[tuple[Any, ...], list[float]] = {}
    for row in rows:
        place = (row["sensor"], row["channel"], f"{_along(row, driver, labels):.0f}")
        alike.setdefault(place, []).append(row["held_before"])
    squares = sum(float(np.var(each)) * len(each) for each in alike.values())
    return squares / max(len(rows) - len(alike), 1)


def panels_of(
    rows: Sequence[Mapping[str, Any]], disagree: Collection[tuple[int, str]] = ()
) -> list[list[Mapping[str, Any]]]:
    """Return the rows of the channels that disagree most, the worst first.

    Of those that `disagree` or to which something was added, if there are any.
    """
    channels: dict[tuple[int, str], list[Mapping[str, Any]]] = {}
    for row in rows:
        channels.setdefault((row["sensor"], row["channel"]), []).append(row)
    squares = {key: np.mean([(r["held_before"] / r["noise_after"]) ** 2 for r in own]) for key, own in channels.items()}
    acting = {key for key, own in channels.items() if any(row["effect"] for row in own)}
    asked = acting.union(disagree) & channels.keys() or channels
    return [channels[key] for key in sorted(asked, key=lambda key: -squares[key])[:_MOST_PANELS]]


def pictures(
    panels: Sequence[Sequence[Mapping[str, Any]]],
    driver: str,
    key: str,
    when: str,
    known: Mapping[tuple[int, str], float | None],
    *,
    curve: bool = False,
) -> Iterator[str]:
    """Yield a picture of each channel: measured less simulated over the driver, on one scale before and after.

    The band is the noise, deg/hr, as `known` of a channel, else as it is after. With a `curve`, what was added as
    lines, and the points beside them as they would be without it.
    """
    for own in panels:
        labels = sorted({r["position"] for r in own})
        figure, axes = blank(4.4, 2.7)
        size = known.get((own[0]["sensor"], own[0]["channel"])) or float(
            np.sqrt(np.mean([r["noise_after"] ** 2 for r in own]))
        )
        axes.axhspan(-size, size, color="0.85", linewidth=0.0, zorder=0, label="noise")
        looks = [*LOOKS.values(), *({"color": "0.4", "marker": "."},) * len(labels)]
        for label, look in zip(labels, looks, strict=False):
            at = [r for r in own if r["position"] == label]
            x = np.array([_along(r, driver, labels) for r in at])
            x += (driver == "position") * (_WIDE * (np.arange(len(at)) + 0.5) / len(at) - 0.5 * _WIDE)
            added = np.array([curve * r["effect"] for r in at])
            marks = {**look, "linestyle": "none"}
            told = f"{'position ' * (label == labels[0])}{label}"
            axes.plot(x, np.array([r[key] for r in at]) + added, markersize=4, label=told, **marks)
            if curve:
                order = np.argsort(x, kind="stable")
                axes.plot(x[order], added[order], color=look["color"], linewidth=1.4)
        if not curve:
            limit = 1.1 * max(abs(r[k]) for r in own for k in ("held_before", "held_after")) or 1.0
            axes.set_ylim(-limit, limit)
        if driver == "position":
            upright = len(labels) > _MOST_LEVEL
            axes.set_xticks(range(len(labels)), labels, rotation=90 * upright)
            figure.subplots_adjust(bottom=0.35 if upright else None)
        axes.set_xlabel("position, at each in the order of the night" if driver == "position" else driver)
        axes.set_ylabel("deg/hr")
        title = f"sensor {own[0]['sensor']}, {own[0]['channel']}, {when}"
        _headed(axes, title, legend=len(labels) <= len(LOOKS))
        values = [r[key] for r in own]
        ends = f"from {min(values):.1f} to {max(values):.1f} deg/hr, noise {size:.1f}"
        yield inline_svg(figure, f"{title}: measured less simulated over {driver}, {ends}")


def beside_simulated(twin: Mapping[str, Any], panels: Sequence[Sequence[Mapping[str, Any]]]) -> Iterator[str]:
    """Yield the sizes of what a model leaves of the worst channel, among those of nights simulated before and after.

    `twin` is the result's, with `places`; nothing where these have no sizes of the channel.
    """
    worst = {key: panels[0][0][key] for key in ("sensor", "channel")} if panels else {}
    halves = {
        when: [
            each
            for each in twin.get(when, {}).get("places", ())
            if "measured_deg_per_hr" in each and worst.items() <= each["where"].items()
        ]
        for when in ("before", "after")
    }
    ends = [v for own in halves.values() for p in own for v in (p["measured_deg_per_hr"], *p["simulated_deg_per_hr"])]
    for when, own in halves.items():
        if not own:
            continue
        ordered = sorted(own, key=lambda p: (p["where"].get("temperature_degC", 0.0), p["where"]["position"]))
        figure, axes = blank(4.4, 2.7)
        low, high = np.array([p["simulated_deg_per_hr"] for p in ordered]).T
        axes.bar(range(len(own)), high - low, 0.8, low, color="0.85", label=f"{twin['draws']} simulated nights")
        measured = [p["measured_deg_per_hr"] for p in ordered]
        axes.plot(range(len(own)), measured, **{**LOOKS["matrix"], "linestyle": "none"}, markersize=4, label="measured")
        levels = [p["where"].get("temperature_degC") for p in ordered]
        first = [n for n in range(len(own)) if levels[n] is not None and (n == 0 or levels[n] != levels[n - 1])]
        axes.set_xticks(first, [f"{levels[n]:g}" for n in first])
        axes.set_xlabel("temperature, °C, and at each every position" if first else "every position")
        axes.set_ylabel("size of what is left, deg/hr")
        axes.set_ylim(0.0, 1.25 * max(ends))
        title = f"sensor {worst['sensor']}, {worst['channel']}, {when}"
        _headed(axes, title)
        inside = sum(a <= m <= b for a, m, b in zip(low, measured, high, strict=True))
        yield inline_svg(figure, f"{title}: {inside} of {len(own)} measured sizes lie among the simulated ones")


def _headed(axes: Axes, title: str, *, legend: bool = True) -> None:
    """Write the title, and what the marks mean between it and the axes, where no point lies."""
    # At a height that is given: it would be looked for among all labels, in a fifth of the time that a picture takes.
    axes.set_title(title, loc="left", fontsize=10, pad=18.0 if legend else 6.0, y=1.0)
    if legend:
        near = {"columnspacing": 1.0, "handletextpad": 0.2, "borderaxespad": 0.0, "handlelength": 1.4}
        axes.legend(frameon=False, fontsize=9, ncols=5, loc="lower left", bbox_to_anchor=(-0.02, 1.0), **near)


def _along(row: Mapping[str, Any], driver: str, labels: Sequence[str]) -> float:
    if driver == "position":
        return float(labels.index(row["position"]))
    value = row["run"] if driver == "run" else row["temperature_degC"]
    return float("nan" if value is None else value)
