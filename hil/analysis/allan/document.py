"""The result of `hil allan` as one document (schema hil.allan/1) and as text."""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np

from hil.analysis.allan.averaging import Averaging, averaging, in_words
from hil.analysis.allan.deviation import CONFIDENCE, NoiseKind, octaves
from hil.analysis.allan.fit import SLOPES, NoiseFit, Term, fit_noise
from hil.analysis.allan.stretches import Recording
from hil.files.document import picked

SCHEMA = "hil.allan/1"

TERMS: Mapping[str, tuple[str, str, float]] = {
    "Q": ("quantisation (white in angle)", "arcsec", 1.0),
    "N": ("angle random walk (white in rate)", "deg/sqrt(hr)", 1.0 / 60.0),
    "B": ("bias instability", "deg/hr", 1.0),
    "K": ("rate random walk", "deg/hr/sqrt(hr)", 60.0),
}
"""What each term is, its unit, and how many of that unit one deg/hr (with seconds) is."""


@dataclass(frozen=True)
class AllanResult:
    """A recording with the fit to its Allan deviation and what it means for averaging."""

    recording: Recording
    fit: NoiseFit
    averaging: Averaging

    def document(self, collect_s: float, wanted_deg_per_hr: float | None = None) -> dict[str, Any]:
        """Return what `hil allan --json` prints: finite numbers, null where a thing is not known."""
        found, fit, read = self.recording, self.fit, self.averaging
        deviation = fit.deviation
        return {
            "schema": SCHEMA,
            "source": found.name,
            "simulated": found.simulated,
            "unit": "deg/hr",
            "rate_hz": 1.0 / found.interval_s,
            "samples": found.samples,
            "stretches": len(found.stretches),
            "longest_stretch_s": found.longest_s,
            "method": "overlapping Allan deviation, octaves; stretches pooled, gaps never bridged",
            "confidence": CONFIDENCE,
            **picked(deviation, "tau_s deviation low high edf"),
            "noise": (kinds := [NoiseKind(each).name.lower() for each in deviation.kind.tolist()]),
            "noise_kinds": kinds,
            "slope": local_slopes(deviation.tau_s, deviation.deviation).tolist(),
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
            "summary": in_words(read, collect_s, wanted_deg_per_hr),
            "notes": self.notes(),
        }

    def notes(self) -> list[str]:
        """Say what a reader of the numbers must know."""
        said = list(self.recording.notes)
        if not self.fit.describes:
            said.append(
                f"the four terms do not describe this record (misfit {self.fit.misfit:.3g} times what chance allows): "
                f"fitted from {self.fit.fitted_from_s:g} s with a model error of {self.fit.model_error:.0%} allowed for"
            )
        return said


def analyse(found: Recording) -> AllanResult:
    """Compute the deviations of a recording in octaves and fit them."""
    fit = fit_noise(octaves(found.stretches, found.interval_s))
    return AllanResult(found, fit, averaging(fit))


def local_slopes(tau_s: np.ndarray, deviation: np.ndarray) -> np.ndarray:
    """Return the slope of the deviation in a log-log plot at each tau, from its neighbours, shape (k,)."""
    if len(tau_s) < 2:
        return np.zeros(len(tau_s))
    return np.asarray(np.gradient(np.log(deviation), np.log(tau_s)))


def _term(name: str, term: Term) -> dict[str, Any]:
    meaning, unit, factor = TERMS[name]
    return {
        "meaning": meaning,
        "value": term.value * factor,
        "low": term.low * factor,
        "high": term.high * factor,
        "unit": unit,
        "slope": SLOPES[name],
        "seen": term.seen,
    }
