"""What `hil thermal --out` writes: the document, a model file, plots, and for triads autopilot parameter files."""

from __future__ import annotations

import io
import json
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.figure import Figure

from hil.analysis.thermal.document import thermal_document
from hil.analysis.thermal.exports import ARDUPILOT_LEAST_RANGE_DEGC, ardupilot_parameters, px4_parameters
from hil.analysis.thermal.fit import SensorFit, ThermalFit
from hil.errors import InputError
from hil.files.durable import RealDisk, write_durably
from hil.model import save_model

_SETTINGS: Any = {"svg.fonttype": "none", "svg.hashsalt": "hil", "font.family": "sans-serif", "font.size": 9.0}


def write_thermal(result: ThermalFit, folder: Path) -> list[str]:
    """Write everything into `folder`, which is made where it is not there; return the names.

    Raises `InputError` where it cannot be written, or the sensors have different forms.
    """
    model = result.model()
    contents = {
        "thermal.json": json.dumps(thermal_document(result), indent=2, ensure_ascii=False, allow_nan=False) + "\n"
    }
    for fit in result.sensors.values():
        contents[f"sensor-{fit.number}.svg"] = _figure(fit, result.campaign.simulated)
        if fit.layout.collects.conditions.sensor.is_triad:
            contents[f"sensor-{fit.number}-px4.params"] = px4_parameters(fit)
            low, high = fit.range_degC
            if high - low >= ARDUPILOT_LEAST_RANGE_DEGC:
                contents[f"sensor-{fit.number}-ardupilot.parm"] = ardupilot_parameters(fit)
    try:
        folder.mkdir(parents=True, exist_ok=True)
        for name, text in contents.items():
            write_durably(RealDisk(), folder / name, text.encode())
        save_model(model, folder / "model.yaml")
    except OSError as error:
        raise InputError(f"{folder}: cannot be written: {error.strerror}") from None
    return ["model.yaml", *contents]


def _figure(fit: SensorFit, simulated: bool) -> str:
    """Draw every parameter's values with its curve."""
    import matplotlib as mpl

    count = len(fit.parameters)
    figure = Figure(figsize=(9.0, 2.6 * ((count + 1) // 2)), layout="constrained")
    low, high = fit.range_degC
    temperatures = np.linspace(low, high, 200)
    centre = fit.layout.stations.centre_degC
    for place, each in enumerate(fit.parameters.values()):
        axes = figure.add_subplot((count + 1) // 2, 2, place + 1)
        axes.errorbar(centre, each.values.values, yerr=each.values.half_width, fmt="o", color="#0072B2", capsize=2)
        axes.plot(temperatures, each.curve.at(temperatures), color="#D55E00", linewidth=1.2)
        axes.set_title(f"{each.name}: {each.form}", loc="left", fontsize=9)
        axes.set_ylabel(each.unit)
        axes.set_xlabel("temperature, °C")
        axes.grid(visible=True, color="0.92")
    mark = "SIMULATED: " if simulated else ""
    figure.suptitle(f"{mark}sensor {fit.number}: free values (95 %) and chosen curves", fontsize=10)
    stream = io.StringIO()
    with mpl.rc_context(_SETTINGS):
        figure.savefig(stream, format="svg", metadata={"Date": None, "Creator": None})
    return stream.getvalue()
