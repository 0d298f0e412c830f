"""What `hil thermal --out` writes: the document, a model file, plots, and for triads autopilot parameter files."""

import json
from pathlib import Path

import numpy as np
from matplotlib.figure import Figure

from hil.analysis.thermal.document import thermal_document
from hil.analysis.thermal.exports import ARDUPILOT_LEAST_RANGE_DEGC, ardupilot_parameters, px4_parameters
from hil.analysis.thermal.fit import SensorFit, ThermalFit
from hil.campaign import Campaign
from hil.errors import InputError
from hil.files.durable import write_result
from hil.files.figure import drawn
from hil.model import save_model


def write_thermal(result: ThermalFit, folder: Path) -> list[str]:
    """Write everything into `folder`, which is made where it is not there; return the names.

    Raises `InputError` where it cannot be written, or the sensors have different forms.
    """
    model = result.model()
    contents = {
        "thermal.json": json.dumps(thermal_document(result), indent=2, ensure_ascii=False, allow_nan=False) + "\n"
    }
    for fit in result.sensors.values():
        contents[f"sensor-{fit.number}.svg"] = drawn(draw_fit(fit, result.campaign)).decode()
        if fit.layout.collects.conditions.sensor.is_triad:
            contents[f"sensor-{fit.number}-px4.params"] = px4_parameters(fit)
            low, high = fit.range_degC
            if high - low >= ARDUPILOT_LEAST_RANGE_DEGC:
                contents[f"sensor-{fit.number}-ardupilot.parm"] = ardupilot_parameters(fit)
    try:
        folder.mkdir(parents=True, exist_ok=True)
        for name, text in contents.items():
            write_result(folder / name, text)
        save_model(model, folder / "model.yaml")
    except OSError as error:
        raise InputError(f"{folder}: cannot be written: {error.strerror}") from None
    return ["model.yaml", *contents]


def draw_fit(fit: SensorFit, campaign: Campaign) -> Figure:
    """Draw every parameter's values at each temperature, with their 95 % intervals, and the curve that was chosen."""
    columns = 2 if len(fit.parameters) < 9 else 3
    rows = -(-len(fit.parameters) // columns)
    figure = Figure(figsize=(4.6 * columns, 2.4 * rows + 0.4), layout="constrained")
    grid = np.linspace(*fit.range_degC, 200)
    centre = fit.layout.stations.centre_degC
    for place, each in enumerate(fit.parameters.values(), 1):
        axes = figure.add_subplot(rows, columns, place)
        axes.errorbar(centre, each.values.values, yerr=each.values.half_width, fmt="o", color="#0072B2", capsize=2)
        axes.plot(grid, each.curve.at(grid), color="#D55E00", linestyle="--", linewidth=1.4, label=each.form)
        axes.set_ylabel(f"{each.name}, {each.unit}")
        axes.set_xlabel("unit temperature, °C")
        axes.grid(visible=True, color="0.92")
        axes.legend(frameon=False, fontsize=8)
    mark = "SIMULATED  " if campaign.simulated else ""
    title = f"{mark}{campaign.title}, sensor {fit.number}: free values (95 %) and chosen curves"
    figure.suptitle(title, x=0.01, ha="left", fontsize=10, parse_math=False)
    return figure
