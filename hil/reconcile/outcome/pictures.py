"""The pictures of a reconciliation: measured less simulated over what it follows, before and after."""

from collections.abc import Iterator, Mapping, Sequence
from typing import Any

import numpy as np

from hil.files.figure import LOOKS, blank
from hil.files.page import inline_svg
from hil.reconcile.result import Reconciliation

_MOST_PANELS = 4


def driver_of(result: Reconciliation, rows: Sequence[Mapping[str, Any]]) -> str:
    """Choose what the pictures run over: what the disagreement follows, as far as that is one of the three."""
    for follows, _ in result.follows:
        if follows == "pose":
            return "position"
        if follows.startswith("temperature"):
            break
        if follows != "run":
            return "run"
    known = {row["temperature_degC"] for row in rows if row["temperature_degC"] is not None}
    return "temperature, °C" if len({round(t) for t in known if np.isfinite(t)}) > 1 else "run"


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
        figure.subplots_adjust(top=0.88)
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
            axes.plot(x, np.array([r[key] for r in at]) + added, markersize=4, label=f"position {label}", **marks)
            if curve:
                order = np.argsort(x, kind="stable")
                axes.plot(x[order], added[order], color=look["color"], linewidth=1.4)
        if not curve:
            limit = 1.1 * max(abs(r[k]) for r in own for k in ("held_before", "held_after"))
            axes.set_ylim(-limit, limit)
        if driver == "position":
            axes.set_xticks(range(len(labels)), labels)
        axes.set_xlabel(driver)
        axes.set_ylabel("deg/hr")
        title = f"sensor {own[0]['sensor']}, {own[0]['channel']}, {when}"
        axes.set_title(title, loc="left", fontsize=10)
        if len(labels) <= len(LOOKS):
            axes.legend(frameon=False, fontsize=7, ncols=2)
        values = [r[key] for r in own]
        ends = f"from {min(values):.1f} to {max(values):.1f} deg/hr, noise {size:.1f}"
        yield inline_svg(figure, f"{title}: measured less simulated over {driver}, {ends}")


def _along(row: Mapping[str, Any], driver: str, labels: Sequence[str]) -> float:
    if driver == "position":
        return float(labels.index(row["position"]))
    value = row["run"] if driver == "run" else row["temperature_degC"]
    return float("nan" if value is None else value)
