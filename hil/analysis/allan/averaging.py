"""What an Allan deviation means for a collect: how long to average, and when longer stops helping."""

from dataclasses import dataclass

import numpy as np

from hil.analysis.allan.fit import NoiseFit
from hil.campaign import FloatArray
from procedures.words import duration

_WORTH = 1.1  # a deviation this close to the lowest is as good as the lowest
MU_FACTOR = float(np.sqrt(1.5))
"""MU of one three-collect self-calibration scatters by this many times what one collect does (G1 = 1 g)."""


@dataclass(frozen=True)
class Averaging:
    """How averages scatter, from the fitted curve between the shortest and the longest tau of the record.

    `lowest_deg_per_hr` is the least that averaging reaches, at `lowest_at_s`; from `enough_s` on it is reached within
    10 %. `turns` tells whether the curve rises again within the record, so that longer averages are worse. `white` is N
    in deg/hr·sqrt(s), its upper bound where not `is_white`: averages of T seconds scatter by about N / sqrt(T).
    `judged` tells whether the record shows any term at all; one that does not cannot say how long to average.
    """

    lowest_deg_per_hr: float
    lowest_at_s: float
    enough_s: float
    turns: bool
    longest_s: float
    white: float
    is_white: bool
    judged: bool
    _tau_s: FloatArray
    _deviation: FloatArray

    @property
    def shortest_s(self) -> float:
        """The shortest averaging time of the record, s."""
        return float(self._tau_s[0])

    def reach_s(self, deg_per_hr: float) -> float | None:
        """Return the shortest averaging time that reaches a deviation; None where the record shows none."""
        below = np.flatnonzero(self._deviation <= deg_per_hr)
        return float(self._tau_s[below[0]]) if len(below) else None

    def at(self, duration_s: float) -> float | None:
        """Return how averages of a length scatter, deg/hr; None outside the record."""
        if not self._tau_s[0] <= duration_s <= self._tau_s[-1]:
            return None
        return float(np.exp(np.interp(np.log(duration_s), np.log(self._tau_s), np.log(self._deviation))))


def averaging(fit: NoiseFit) -> Averaging:
    """Read the fitted curve; nothing is said about averages longer than the record can compare."""
    tau_s = np.geomspace(fit.deviation.tau_s[0], fit.deviation.tau_s[-1], 2000)
    # A rate random walk that may be nothing must not end the averaging.
    seen = any(term.seen for term in fit.terms.values())
    deviation = fit.at(tau_s, only_seen=seen)
    least = int(np.argmin(deviation))
    enough = int(np.flatnonzero(deviation <= _WORTH * deviation[least])[0])
    return Averaging(
        lowest_deg_per_hr=float(deviation[least]),
        lowest_at_s=float(tau_s[least]),
        enough_s=float(tau_s[enough]),
        turns=bool(deviation[-1] > _WORTH * deviation[least]),
        longest_s=float(tau_s[-1]),
        white=fit.terms["N"].value if fit.terms["N"].seen else fit.terms["N"].high,
        is_white=fit.terms["N"].seen,
        judged=seen,
        _tau_s=tau_s,
        _deviation=deviation,
    )


def in_words(found: Averaging, collect_s: float, wanted_deg_per_hr: float | None) -> list[str]:
    """Say it in sentences for whoever plans a collect."""
    said = []
    scatter = found.at(collect_s)
    if scatter is None:
        least = found.white / np.sqrt(collect_s)
        said.append(
            f"a collect of {duration(collect_s)} is outside what this record can judge ({duration(found.shortest_s)} "
            f"to {duration(found.longest_s)}); the white noise in it alone scatters by "
            f"{'' if found.is_white else 'less than '}{least:.3g} deg/hr"
        )
    else:
        said.append(
            f"a collect of {duration(collect_s)} scatters by {scatter:.3g} deg/hr, MU of one three-collect "
            f"self-calibration by {MU_FACTOR * scatter:.3g} deg/hr/g"
        )
    if wanted_deg_per_hr is not None:
        needed = found.reach_s(wanted_deg_per_hr)
        said.append(
            f"{wanted_deg_per_hr:g} deg/hr needs {duration(needed)} of averaging"
            if needed is not None
            else f"{wanted_deg_per_hr:g} deg/hr is not reached by averages up to {duration(found.longest_s)}; the "
            f"least is {found.lowest_deg_per_hr:.3g} deg/hr"
        )
    if not found.judged:
        said.append("this record is too short to tell how long to average: it shows none of the terms")
    elif found.turns:
        said.append(
            f"longer stops helping at {duration(found.enough_s)}: from there averages are within 10 % of the least, "
            f"{found.lowest_deg_per_hr:.3g} deg/hr at {duration(found.lowest_at_s)}; longer ones are worse again"
        )
    elif found.enough_s < 0.5 * found.longest_s:
        said.append(
            f"longer stops helping at {duration(found.enough_s)}: from there on averages scatter by "
            f"{found.lowest_deg_per_hr:.3g} deg/hr, within 10 %"
        )
    else:
        said.append(f"longer keeps helping as far as this record can tell ({duration(found.longest_s)})")
    return said
