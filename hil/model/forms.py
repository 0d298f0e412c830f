"""The named models as linear columns: what each parameter adds to each rate, given the conditions of a collect.

    form = named_form("matrix-6", conditions)
    form.names  # ("BA", "BB", "GSA", "GSB", "MUA", "MUB")
    form.columns(conditions)  # (n collects, c channels, p parameters)

The columns of bias, GS, MU and G stand here and nowhere else: the solver and the catalogue of effects call these
functions. Each is what the one equation gives for a unit of its parameter, signs and all (`hil.model.equation`).
"""

from collections.abc import Callable, Collection
from dataclasses import dataclass, replace
from functools import partial

import numpy as np

from hil.campaign import Conditions, FloatArray, Sensor
from hil.campaign.stand_ins import told
from hil.errors import InputError
from hil.files.strict import near
from hil.model.equation import pickoff_rates, rotor_matrix
from procedures.words import counted

MATRIX_6 = ("BA", "BB", "GSA", "GSB", "MUA", "MUB")
"""Order of the report's six parameters, everywhere."""

MODEL_NAMES = ("matrix-6", "collins-4", "matrix-6-thermal", "constant", "triad-12")

RATE = "deg/hr"
PER_G = "deg/hr/g"


def bias_names(sensor: Sensor) -> tuple[str, ...]:
    """Name the bias of each channel by its axis: BA, BB or BX, BY, BZ (by its channel where two share an axis)."""
    axes = list(sensor.channels.values())
    if len(set(axes)) == len(axes):
        return tuple(f"B{axis}" for axis in axes)
    return tuple(f"B_{channel}" for channel in sensor.channels)


def rotor_names(sensor: Sensor) -> tuple[str, ...]:
    """Name the six parameters of a two-channel rotor sensor: the report's names, whatever its axes are called.

    Raises `InputError` for another sensor.
    """
    if not sensor.is_rotor:
        fits = "triad-12" if sensor.is_triad else "constant"
        raise InputError(
            f"sensor {sensor.number}: it is not a two-channel rotor sensor, so it has no GS and MU; {fits} fits it"
        )
    return MATRIX_6


def sensitivity_names(sensor: Sensor) -> tuple[str, ...]:
    """Name the full matrix G row by channel, column by axis: GXY is the rate of channel GX per g along Y."""
    rows = [name[1:] for name in bias_names(sensor)]
    return tuple(f"G{row}{axis}" for row in rows for axis in sensor.axes)


def parameter_names(sensor: Sensor) -> tuple[str, ...]:
    """Name what the fullest of a sensor's built-in models has: the report's six, or bias and the full matrix G."""
    return rotor_names(sensor) if sensor.is_rotor else bias_names(sensor) + sensitivity_names(sensor)


def bias_columns(conditions: Conditions) -> FloatArray:
    """Columns of one bias per channel: 1 in its own channel, shape (n, c, c)."""
    channels = len(conditions.sensor.channels)
    return _columns(conditions, np.eye(channels), np.zeros((channels, channels, 3)))


def gs_columns(conditions: Conditions) -> FloatArray:
    """Columns of GSA and GSB, the isotropic pair: RA += GSA fA + GSB fB, RB += GSA fB - GSB fA; shape (n, 2, 2)."""
    return _columns(conditions, np.zeros(2), rotor_matrix(*np.eye(4)[:, :2]))


def mu_columns(conditions: Conditions) -> FloatArray:
    """Columns of MUA and MUB: RA += MUB fS, RB -= MUA fS; shape (n, 2, 2)."""
    return _columns(conditions, np.zeros(2), rotor_matrix(*np.eye(4)[:, 2:]))


def sensitivity_columns(conditions: Conditions) -> FloatArray:
    """Columns of the full matrix G, R += G f: channel c has f in columns 3c, 3c+1, 3c+2; shape (n, c, 3c)."""
    channels = len(conditions.sensor.channels)
    return _columns(conditions, np.zeros(channels), np.eye(3 * channels).reshape(-1, channels, 3))


def _columns(conditions: Conditions, bias: FloatArray, k: FloatArray) -> FloatArray:
    """Return the rates that B (p, c) and K (p, c, 3) of a unit of each parameter make at every f, shape (n, c, p)."""
    rates = pickoff_rates(bias, k, conditions.f_g[:, None, :], 0.0)
    return np.ascontiguousarray(np.swapaxes(rates, 1, 2))


@dataclass(frozen=True)
class LinearForm:
    """A named model of one sensor: its p parameters in order, their units, and its columns (n, c, p).

    `reason` says why this form and not a fuller one was taken (empty where there is nothing to say);
    `reference_degC` is the temperature about which thermal coefficients are expanded. The earth rate is no part of the
    columns: subtract `conditions.w_channels_deg_per_hr` from the rates.
    """

    name: str
    names: tuple[str, ...]
    units: tuple[str, ...]
    build: Callable[[Conditions], FloatArray]
    reason: str = ""
    reference_degC: float | None = None

    def columns(self, conditions: Conditions) -> FloatArray:
        """Return the partial derivatives of the rates by the parameters, shape (n, c, p)."""
        return self.build(conditions)

    def without(self, zero: Collection[str]) -> "LinearForm":
        """Return the form without some of its parameters, and without what they have of temperature."""
        kept = [p for p, name in enumerate(self.names) if name.partition("_per_")[0] not in zero]
        names, units = (tuple(of[p] for p in kept) for of in (self.names, self.units))
        return replace(self, names=names, units=units, build=lambda rows: self.build(rows)[..., kept])

    def terms(self, conditions: Conditions, values: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Return the bias (n, c) in deg/hr and K (n, c, 3) in deg/hr/g that `values`, shape (p,), mean at each row."""
        still = replace(conditions, f_g=np.zeros_like(conditions.f_g))
        bias = self.build(still) @ values
        k = np.zeros((*bias.shape, 3))
        for axis in range(3):
            pull = replace(conditions, f_g=np.broadcast_to(np.eye(3)[axis], conditions.f_g.shape))
            k[..., axis] = self.build(pull) @ values - bias
        return bias, k


def value_form(name: str, sensor: Sensor, reason: str = "") -> LinearForm:
    """Return the form whose parameters a model file gives values to; `InputError` where it is none of this sensor's.

    `constant` is one bias per channel, for any sensor; `matrix-6` the report's six parameters of a rotor sensor, and
    `collins-4` the contractor's four of them, MU taken as zero (eqs. (A-7)–(A-12)); `triad-12` bias and the full, not
    symmetric, acceleration-sensitivity matrix of a triad. `matrix-6-thermal` has the six names of matrix-6 here: their
    dependence on temperature is in the curves.
    """
    if name == "triad-12" and not sensor.is_triad:
        fits = "matrix-6" if sensor.is_rotor else "constant"
        raise InputError(
            f"sensor {sensor.number}: triad-12 needs one channel about each of the three axes; {fits} fits it"
        )
    if name in ("constant", "triad-12"):
        names = bias_names(sensor) + (sensitivity_names(sensor) if name == "triad-12" else ())
        parts = (bias_columns, sensitivity_columns)[: 1 + (name == "triad-12")]
    else:
        name = name if name == "collins-4" else "matrix-6"
        names = rotor_names(sensor)[: 4 if name == "collins-4" else 6]
        parts = (bias_columns, gs_columns, mu_columns)[: len(names) // 2]
    units = tuple(RATE if each.startswith("B") else PER_G for each in names)
    return LinearForm(name, names, units, lambda rows: np.concatenate([part(rows) for part in parts], -1), reason)


constant_form, matrix_6_form, collins_4_form, triad_12_form = (
    partial(value_form, name) for name in ("constant", "matrix-6", "collins-4", "triad-12")
)
"""The built-in forms of a sensor."""


def fullest_form(sensor: Sensor) -> LinearForm:
    """Return the built-in form of a sensor that has most parameters."""
    return value_form("matrix-6" if sensor.is_rotor else "triad-12" if sensor.is_triad else "constant", sensor)


def matrix_6_thermal_form(conditions: Conditions) -> LinearForm:
    """Each of the six parameters a quadratic in `temperature_degC`, about the mean temperature to a whole degree.

    The mean keeps value, slope and curvature apart.
    Coefficients follow their parameter: BA, BA_per_degC, BA_per_degC2, BB, ... Raises `InputError` where a row has no
    temperature, or the sensor is no rotor sensor.
    """
    form = matrix_6_form(conditions.sensor)
    where = f"sensor {conditions.sensor.number}: matrix-6-thermal"
    told_by, temperature = told(conditions)
    if np.all(np.isnan(temperature)):
        raise InputError(f"{where} needs the column temperature_degC, which this campaign lacks")
    if np.any(np.isnan(temperature)):
        raise InputError(f"{where} needs temperature_degC in every row; fill the empty cells or leave out the rows")
    reference = float(np.round(np.mean(temperature)))

    def build(rows: Conditions) -> FloatArray:
        delta = (told(rows)[1] - reference)[:, None, None, None]
        powers = np.concatenate([np.ones_like(delta), delta, delta**2], -1)
        return np.asarray((form.columns(rows)[..., None] * powers).reshape(len(rows), len(rows.sensor.channels), -1))

    return LinearForm(
        "matrix-6-thermal",
        tuple(f"{name}{power}" for name in form.names for power in ("", "_per_degC", "_per_degC2")),
        tuple(f"{unit}{power}" for unit in form.units for power in ("", "/degC", "/degC2")),
        build,
        f"quadratics in {told_by} about {reference:g} degC",
        reference,
    )


def named_form(name: str, conditions: Conditions) -> LinearForm:
    """Return the built-in model `name` for these collects; raise InputError where it does not fit the sensor."""
    if name not in MODEL_NAMES:
        raise InputError(f"model {name!r} is not built in{near(name, MODEL_NAMES)}")
    return matrix_6_thermal_form(conditions) if name == "matrix-6-thermal" else value_form(name, conditions.sensor)


def default_form(conditions: Conditions) -> LinearForm:
    """Return the fullest model that these collects are meant for: matrix-6, triad-12, or constant with the reason.

    A triad gets triad-12 where its positions excite bias and all three axes separately (four poses whose f do not lie
    in one plane); its condition number is then what the solution states.
    """
    sensor = conditions.sensor
    if sensor.is_rotor or (sensor.is_triad and excites_every_axis(conditions.f_g)):
        return fullest_form(sensor)
    about = f"channels about {', '.join(sensor.channels.values())}"
    why = f"{about} are neither a two-channel rotor sensor nor a three-axis triad"
    if sensor.is_triad:
        few = f"{counted(len(conditions), 'position')} cannot excite all three axes apart from the bias"
        why = f"{few} (triad-12 needs four poses or more whose f do not lie in one plane)"
    return constant_form(sensor, f"bias only: {why}")


def excites_every_axis(f_g: FloatArray) -> bool:
    """Tell whether bias and three acceleration sensitivities can be told apart at these f, shape (n, 3).

    True where f spreads about its mean by more than 0.01 g rms in its weakest direction: below that the setting of the
    poses is no better known than the difference between them.
    """
    if len(f_g) < 4:
        return False
    spread = np.linalg.svd(f_g - f_g.mean(axis=0), compute_uv=False)
    return bool(spread[-1] > 1e-2 * np.sqrt(len(f_g)))
