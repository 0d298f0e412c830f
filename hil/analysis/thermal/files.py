"""What `hil thermal --out` writes: the document, a model file, plots, and for triads autopilot parameter files.

PX4 subtracts offset = X0 + X1 d + X2 d² + X3 d³ with d = T - TREF and T held within TMIN and TMAX, in rad/s.
ArduPilot subtracts p(T - 35) and adds p(T_cal - 35), with p(d) = (GYR1 d + GYR2 d² + GYR3 d³) 1e-6 rad/s and both
temperatures held within TMIN and TMAX: the constant part is the gyro offset that its own calibration finds at T_cal.
Sources: PX4 developer guide, "Thermal Calibration and Compensation", and PX4 Tools/process_sensor_caldata.py;
ArduPilot libraries/AP_InertialSensor/AP_InertialSensor_tempcal.cpp.
"""

import json
from pathlib import Path

import numpy as np
from matplotlib.figure import Figure

from hil.analysis.thermal.choice import POLYNOMIALS
from hil.analysis.thermal.document import thermal_document
from hil.analysis.thermal.fit import ParameterFit, SensorFit, ThermalFit
from hil.campaign import Campaign, FloatArray
from hil.errors import InputError, worded
from hil.files.durable import write_result
from hil.files.figure import drawn, marked
from hil.files.page import filled
from hil.model import save_model
from hil.model.forms import bias_names

RAD_PER_S = np.pi / 180.0 / 3600.0
"""One deg/hr in rad/s."""

ARDUPILOT_REFERENCE_DEGC = 35.0
ARDUPILOT_LEAST_RANGE_DEGC = 10.0
CUBIC = POLYNOMIALS.index("cubic")


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
        contents |= {f"sensor-{fit.number}-{name}": text for name, text in autopilot_files(fit).items()}
    with worded(InputError, f"{folder}: cannot be written: ", OSError):
        folder.mkdir(parents=True, exist_ok=True)
        for name, text in contents.items():
            write_result(folder / name, text)
        save_model(model, folder / "model.yaml")
    return ["model.yaml", *contents]


def draw_fit(fit: SensorFit, campaign: Campaign) -> Figure:
    """Draw every parameter's values at each temperature, with their 95 % intervals, and the curve that was chosen."""
    columns = 2 if len(fit.parameters) < 9 else 3
    rows = -(-len(fit.parameters) // columns)
    figure = Figure(figsize=(4.6 * columns, 2.4 * rows + 0.4), layout="constrained")
    grid = np.linspace(*fit.layout.range_degC, 200)
    centre = fit.layout.stations.centre_degC
    for place, each in enumerate(fit.parameters.values(), 1):
        axes = figure.add_subplot(rows, columns, place)
        axes.errorbar(centre, each.values.values, yerr=each.values.half_width, fmt="o", color="#0072B2", capsize=2)
        axes.plot(grid, each.curve.at(grid), color="#D55E00", linestyle="--", linewidth=1.4, label=each.form)
        axes.set(ylabel=f"{each.name}, {each.unit}", xlabel="unit temperature, °C")
        axes.grid(visible=True, color="0.92")
        axes.legend(frameon=False, fontsize=8)
    title = f"{campaign.title}, sensor {fit.number}: free values (95 %) and chosen curves"
    figure.suptitle(marked(title, simulated=campaign.simulated), x=0.01, ha="left", fontsize=10, parse_math=False)
    return figure


def bias_polynomials(fit: SensorFit) -> tuple[FloatArray, list[str]]:
    """Return the biases of a triad as cubics in T less the range's middle, (3, 4), rad/s, lowest power first.

    And notes that say where a cubic is not what the data ask for.
    """
    sensor = fit.layout.collects.conditions.sensor
    by_axis = dict(zip(sensor.channels.values(), bias_names(sensor), strict=True))
    rows, notes = [], []
    for axis in sensor.axes:
        each = fit.parameters[by_axis[axis]]
        row, name = _cubic_or_lower(each, fit)
        rows.append(np.pad(row, (0, CUBIC + 1 - len(row))) * RAD_PER_S)
        if name != each.form:
            notes.append(
                f"{each.name}: {each.form} is what the data ask for; the best these files hold is {name}, held-out "
                f"error {each.choice.errors[name]:.3g} instead of {each.choice.errors[each.form]:.3g} deg/hr"
            )
        if each.finding == "undescribed":
            notes.append(f"{each.name}: differs between temperatures, and no form describes how; {name} is held here")
        elif each.finding == "modelled" and not each.is_confirmed:
            notes.append(f"{each.name}: temperatures that did not choose its form do not confirm it")
    return np.array(rows), notes


def _cubic_or_lower(each: ParameterFit, fit: SensorFit) -> tuple[FloatArray, str]:
    """Return the chosen polynomial, or of those up to a cubic the one that predicts best, fitted to the free values."""
    order = each.choice.form.order
    if order is not None and order <= CUBIC:
        return each.coefficients.values, each.form
    best = min(range(CUBIC + 1), key=lambda order: each.choice.errors.get(POLYNOMIALS[order], np.inf))
    centre = fit.layout.stations.centre_degC - fit.layout.middle_degC
    weight = np.sqrt(each.choice.weight)
    return np.asarray(np.polynomial.polynomial.polyfit(centre, each.values.values, best, w=weight)), POLYNOMIALS[best]


def autopilot_files(fit: SensorFit) -> dict[str, str]:
    """Return parameter files by name: QGroundControl's for PX4's gyro 0 (tab-separated), and ArduPilot's for IMU 1.

    In ArduPilot's is only what depends on temperature, and there is none where the range is under 10 °C, which it does
    not accept. Of a sensor that is no triad there are none.
    """
    sensor, (low, high) = fit.layout.collects.conditions.sensor, fit.layout.range_degC
    if not sensor.is_triad:
        return {}
    references = {"px4.params": fit.layout.middle_degC}
    if high - low >= ARDUPILOT_LEAST_RANGE_DEGC:
        references["ardupilot.parm"] = ARDUPILOT_REFERENCE_DEGC
    cubics, notes = bias_polynomials(fit)
    axes = ", ".join(f"{axis} is {letter}" for axis, letter in zip(sensor.axes, "XYZ", strict=True))
    said = f"axes: {axes}, as the unit reports them; acceleration sensitivity is not corrected by these parameters"
    made = {}
    for name, reference in references.items():
        shift = np.polynomial.Polynomial([reference - fit.layout.middle_degC, 1.0])
        about = [[*np.polynomial.Polynomial(row)(shift).coef, *np.zeros(CUBIC)] for row in cubics]
        known = {"low": low, "high": high, "reference": reference, "cubics": about, "remarks": [said, *notes]}
        made[name] = filled(__package__, f"{name}.j2", **known)
    return made
