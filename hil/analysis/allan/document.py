"""The result of `hil allan` as one document (schema hil.allan/1), as text and as a plot: how long to average."""

from collections.abc import Mapping
from typing import Any

import numpy as np
from matplotlib.figure import Figure

from hil.analysis.allan.fit import CONFIDENCE, SLOPES, NoiseFit, NoiseKind, Term, octaves
from hil.analysis.allan.sources import Recording
from hil.files.document import picked
from hil.files.figure import marked
from hil.files.page import filled
from procedures.words import duration

TERMS: Mapping[str, tuple[str, str, float]] = {
    "Q": ("quantisation (white in angle)", "arcsec", 1.0),
    "N": ("angle random walk (white in rate)", "deg/sqrt(hr)", 1.0 / 60.0),
    "B": ("bias instability", "deg/hr", 1.0),
    "K": ("rate random walk", "deg/hr/sqrt(hr)", 60.0),
}
"""What each term is, its unit, and how many of that unit one deg/hr (with seconds) is."""

_WORTH = 1.1  # a deviation this close to the lowest is as good as the lowest

MU_FACTOR = float(np.sqrt(1.5))
"""MU of one three-collect self-calibration scatters by this many times what one collect does (G1 = 1 g)."""

_LOOKS = {"Q": ("#CC79A7", ":"), "N": ("#D55E00", "--"), "B": ("#009E73", "-."), "K": ("#E69F00", (0, (5, 1)))}


class AllanResult:
    """A recording with the fit to its Allan deviation, in octaves, and what it means for averaging."""

    def __init__(self, recording: Recording) -> None:
        self.recording = recording
        self.fit = NoiseFit(octaves(recording.stretches, recording.interval_s))
        self.averaging = Averaging(self.fit)

    def document(self, collect_s: float, wanted_deg_per_hr: float | None = None) -> dict[str, Any]:
        """Return what `hil allan --json` prints: finite numbers, null where a thing is not known."""
        found, fit, read = self.recording, self.fit, self.averaging
        deviation = fit.deviation
        logs = np.log(deviation.deviation), np.log(deviation.tau_s)
        slope = np.gradient(*logs) if len(deviation.tau_s) > 1 else np.zeros(1)  # in a log-log plot, from neighbours
        told = {"read": read, "collect_s": collect_s, "wanted": wanted_deg_per_hr}
        undescribed = (
            f"the four terms do not describe this record (misfit {fit.misfit:.3g} times what chance allows): "
            f"fitted from {fit.fitted_from_s:g} s with a model error of {fit.model_error:.0%} allowed for"
        )
        return {
            "schema": "hil.allan/1",
            **picked(found, "source=name simulated"),
            "unit": "deg/hr",
            "rate_hz": 1.0 / found.interval_s,
            **picked(found, "samples longest_stretch_s=longest_s"),
            "stretches": len(found.stretches),
            "method": "overlapping Allan deviation, octaves; stretches pooled, gaps never bridged",
            "confidence": CONFIDENCE,
            **picked(deviation, "tau_s deviation low high edf"),
            "noise": (kinds := [NoiseKind(each).name.lower() for each in deviation.kind.tolist()]),
            "noise_kinds": kinds,
            "slope": slope.tolist(),
            "fitted": fit.at(deviation.tau_s).tolist(),
            "fit": {name: _term(name, fit.terms[name]) for name in SLOPES},
            **picked(fit, "fitted_from_s misfit describes model_error"),
            "averaging": {
                **picked(
                    read, "lowest_deg_per_hr lowest_at_s enough_s longest_judged_s=longest_s longer_is_worse=turns"
                ),
                "collect_s": collect_s,
                "collect_deg_per_hr": read.at(collect_s),
                "wanted_deg_per_hr": wanted_deg_per_hr,
                "wanted_needs_s": None if wanted_deg_per_hr is None else read.reach_s(wanted_deg_per_hr),
            },
            "summary": filled(__package__, "words.txt.j2", **told, duration=duration, mu_factor=MU_FACTOR).splitlines(),
            "notes": [*found.notes, *([] if fit.describes else [undescribed])],
        }


def _term(name: str, term: Term) -> dict[str, Any]:
    meaning, unit, factor = TERMS[name]
    sizes = {key: factor * getattr(term, key) for key in ("value", "low", "high")}
    return {"meaning": meaning, **sizes, "unit": unit, "slope": SLOPES[name], "seen": term.seen}


class Averaging:
    """How averages scatter, from the fitted curve between the shortest and the longest tau of the record.

    `lowest_deg_per_hr` is the least that averaging reaches, at `lowest_at_s`; from `enough_s` on it is reached within
    10 %. `turns` tells whether the curve rises again within the record, so that longer averages are worse. `white` is N
    in deg/hr·sqrt(s), its upper bound where not `is_white`: averages of T seconds scatter by about N / sqrt(T).
    `judged` tells whether the record shows any term at all; one that does not cannot say how long to average.
    """

    def __init__(self, fit: NoiseFit) -> None:
        self._tau_s = tau_s = np.geomspace(fit.deviation.tau_s[0], fit.deviation.tau_s[-1], 2000)
        self.shortest_s, self.longest_s = float(tau_s[0]), float(tau_s[-1])
        # A rate random walk that may be nothing must not end the averaging.
        self.judged = any(term.seen for term in fit.terms.values())
        self._deviation = deviation = fit.at(tau_s, only_seen=self.judged)
        least = int(np.argmin(deviation))
        self.lowest_deg_per_hr, self.lowest_at_s = float(deviation[least]), float(tau_s[least])
        self.enough_s = float(tau_s[np.flatnonzero(deviation <= _WORTH * deviation[least])[0]])
        self.turns = bool(deviation[-1] > _WORTH * deviation[least])
        self.is_white = fit.terms["N"].seen
        self.white = fit.terms["N"].value if self.is_white else fit.terms["N"].high

    def reach_s(self, deg_per_hr: float) -> float | None:
        """Return the shortest averaging time that reaches a deviation; None where the record shows none."""
        below = np.flatnonzero(self._deviation <= deg_per_hr)
        return float(self._tau_s[below[0]]) if len(below) else None

    def at(self, duration_s: float) -> float | None:
        """Return how averages of a length scatter, deg/hr; None outside the record."""
        if not self.shortest_s <= duration_s <= self.longest_s:
            return None
        return float(np.exp(np.interp(np.log(duration_s), np.log(self._tau_s), np.log(self._deviation))))


def draw(result: AllanResult) -> Figure:
    """Draw deviations with intervals, the fit and its terms."""
    figure = Figure(figsize=(7.0, 4.6), layout="constrained")
    axes = figure.add_subplot()
    found = result.fit.deviation
    spread = np.stack([found.deviation - found.low, found.high - found.deviation])
    axes.errorbar(found.tau_s, found.deviation, yerr=spread, fmt="o", color="#0072B2", markersize=4, capsize=2)
    tau_s = np.geomspace(found.tau_s[0], found.tau_s[-1], 300)
    fitted = result.fit.at(tau_s)
    axes.plot(tau_s, fitted, color="black", linewidth=1.2, label="fit")
    for name, slope in SLOPES.items():
        term = result.fit.terms[name]
        if not term.seen:
            continue
        _, unit, factor = TERMS[name]
        unit_size = {"Q": np.sqrt(3.0), "N": 1.0, "B": np.sqrt(2 * np.log(2) / np.pi), "K": 1 / np.sqrt(3.0)}[name]
        color, style = _LOOKS[name]
        label = f"{name} = {term.value * factor:.3g} {unit}"
        axes.plot(
            tau_s, unit_size * term.value * tau_s**slope, color=color, linestyle=style, linewidth=1.0, label=label
        )
    axes.set(xscale="log", yscale="log", ylim=(0.5 * float(np.min(found.low)), 2.0 * float(np.max(found.high))))
    axes.set(xlabel="averaging time, s", ylabel="overlapping Allan deviation, deg/hr")
    title = marked(result.recording.name, simulated=result.recording.simulated)
    axes.set_title(title, loc="left", fontsize=10, parse_math=False)
    axes.grid(visible=True, which="both", color="0.92")
    axes.legend(frameon=False, fontsize=8)
    return figure
