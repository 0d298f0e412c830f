"""The Allan deviation as a plot, SVG or PNG by the name of the file."""

import numpy as np
from matplotlib.figure import Figure

from hil.analysis.allan.document import TERMS, AllanResult
from hil.analysis.allan.fit import SLOPES

_LOOKS = {"Q": ("#CC79A7", ":"), "N": ("#D55E00", "--"), "B": ("#009E73", "-."), "K": ("#E69F00", (0, (5, 1)))}


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
    axes.set_xscale("log")
    axes.set_yscale("log")
    axes.set_ylim(0.5 * float(np.min(found.low)), 2.0 * float(np.max(found.high)))
    axes.set_xlabel("averaging time, s")
    axes.set_ylabel("overlapping Allan deviation, deg/hr")
    mark = "SIMULATED  " if result.recording.simulated else ""
    axes.set_title(f"{mark}{result.recording.name}", loc="left", fontsize=10, parse_math=False)
    axes.grid(visible=True, which="both", color="0.92")
    axes.legend(frameon=False, fontsize=8)
    return figure
