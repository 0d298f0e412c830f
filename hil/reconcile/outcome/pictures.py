"""The pictures of a reconciliation: measured less simulated over what it follows, before and after."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from typing import TYPE_CHECKING, Any

import numpy as np

from hil.files.figure import LOOKS, blank
from hil.files.page import inline_svg
from hil.reconcile.result import Reconciliation

if TYPE_CHECKING:
    from matplotlib.axes import Axes

_MOST_PANELS = 4
_MOST_LEVEL = 8  # labels that are written side by side


def driver_of(result: Reconciliation, rows: Sequence[Mapping[str, Any]]) -> str:
    """Choose what the pictures run over: what the disagreement follows, as far as that is one of the three.

    Nothing runs over the only run.
    """
    over_runs = "run" if len({row["run"] for row in rows}) > 1 else "position"
    for follows, _ in result.follows:
        if follows == "pose":
            return "position"
        if follows.startswith("temperature"):
            break
        if follows != "run":
            return over_runs
    known = {row["temperature_degC"] for row in rows if row["temperature_degC"] is not None}
    return "temperature, °C" if len({round(t) for t in known if np.isfinite(t)}) > 1 else over_runs


def panels_of(rows: Sequence[Mapping[str, Any]]) -> list[list[Mapping[str, Any]]]:
    """Return the rows of the channels that disagree most, the worst first."""
    channels: dict[tuple[int, str], list[Mapping[str, Any]]] = {}
    for row in rows:
        channels.setdefault((row["sensor"], row["channel"]), []).append(row)
    squares = {key: np.mean([(r["held_before"] / r["noise_after"]) ** 2 for r in own]) for key, own in channels.items()}
    return [channels[key] for key in sorted(channels, key=lambda key: -squares[key])[:_MOST_PANELS]]


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
        for label, look in zip(
            labels, [*LOOKS.values(), *({"color": "0.4", "marker": "."},) * len(labels)], strict=False
        ):
            at = [r for r in own if r["position"] == label]
            x = np.array([_along(r, driver, labels) for r in at])
            added = np.array([curve * r["effect"] for r in at])
            marks = {**look, "linestyle": "none"}
            axes.plot(
                x,
                np.array([r[key] for r in at]) + added,
                markersize=4,
                label=f"{'position ' * (label == labels[0])}{label}",
                **marks,
            )
            if curve:
                order = np.argsort(x, kind="stable")
                axes.plot(x[order], added[order], color=look["color"], linewidth=1.4)
        if not curve:
            limit = 1.1 * max(abs(r[k]) for r in own for k in ("held_before", "held_after"))
            axes.set_ylim(-limit, limit)
        if driver == "position":
            upright = len(labels) > _MOST_LEVEL
            axes.set_xticks(range(len(labels)), labels, rotation=90 * upright)
            figure.subplots_adjust(bottom=0.35 if upright else None)
        axes.set_xlabel(driver)
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
        ordered = sorted(own, key=lambda p: (p["where"]["temperature_degC"], p["where"]["position"]))
        figure, axes = blank(4.4, 2.7)
        low, high = np.array([p["simulated_deg_per_hr"] for p in ordered]).T
        axes.bar(range(len(own)), high - low, 0.8, low, color="0.85", label=f"{twin['draws']} simulated nights")
        measured = [p["measured_deg_per_hr"] for p in ordered]
        axes.plot(range(len(own)), measured, **{**LOOKS["matrix"], "linestyle": "none"}, markersize=4, label="measured")
        levels = [p["where"]["temperature_degC"] for p in ordered]
        first = [n for n in range(len(own)) if n == 0 or levels[n] != levels[n - 1]]
        axes.set_xticks(first, [f"{levels[n]:g}" for n in first])
        axes.set_xlabel("temperature, °C, and at each every position")
        axes.set_ylabel("size of what is left, deg/hr")
        axes.set_ylim(0.0, 1.25 * max(ends))
        title = f"sensor {worst['sensor']}, {worst['channel']}, {when}"
        _headed(axes, title)
        inside = sum(a <= m <= b for a, m, b in zip(low, measured, high, strict=True))
        yield inline_svg(figure, f"{title}: {inside} of {len(own)} measured sizes lie among the simulated ones")


def _headed(axes: Axes, title: str, *, legend: bool = True) -> None:
    """Write the title, and what the marks mean between it and the axes, where no point lies."""
    axes.set_title(title, loc="left", fontsize=10, pad=18.0 if legend else 6.0)
    if legend:
        near = {"columnspacing": 1.0, "handletextpad": 0.2, "borderaxespad": 0.0, "handlelength": 1.4}
        axes.legend(frameon=False, fontsize=9, ncols=5, loc="lower left", bbox_to_anchor=(-0.02, 1.0), **near)


def _along(row: Mapping[str, Any], driver: str, labels: Sequence[str]) -> float:
    if driver == "position":
        return float(labels.index(row["position"]))
    value = row["run"] if driver == "run" else row["temperature_degC"]
    return float("nan" if value is None else value)
