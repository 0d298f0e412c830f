"""Effects linear in acceleration: GS, MU, their temperature dependence, anisotropy, and a triad's full matrix."""

from collections.abc import Mapping, Sequence
from dataclasses import replace
from types import MappingProxyType
from typing import ClassVar

import numpy as np

from hil.campaign import Conditions, FloatArray, Sensor
from hil.campaign.stand_ins import WIDEST_DEGC
from hil.model.effects.base import Base, Effect, Parameter, ShapeParameter, VarianceEffect, required_base
from hil.model.effects.columns import LEVEL, REFERENCE_DEGC, above_reference, channel_labels, column, visit_of_rows
from hil.model.effects.scatter import Scatter
from hil.model.forms import bias_columns, gs_columns, mu_columns, sensitivity_columns, sensitivity_names

_MU_TYPICAL = {"DTG": (0.1, 5.0), "FOG": (0.0, 0.01), "MEMS": (3.0, 100.0)}
_MATRIX_TYPICAL = {"RLG": (0.0, 0.01), "FOG": (0.0, 0.01), "DTG": (0.5, 20.0), "MEMS": (10.0, 500.0)}


class Bias(Effect):
    """The bias of each channel: part of every model."""

    id = "bias"
    title = "Bias"
    equation = "R += B"
    per_channel = True
    parameters = (
        Parameter("B", "deg/hr", (5.0, 50.0), {"RLG": (0.005, 0.1), "FOG": (0.1, 10.0), "MEMS": (50.0, 5000.0)}),
    )
    signature = "The same in every position."
    confusable_with = ("bias_T", "turnon", "k2")
    known_as = "bias_T"
    in_every_model = True
    series_in_temperature = True
    may_follow_temperature = True
    experiment = "Any collects that do not all stand the same way up."

    def columns(self, conditions: Conditions, base: Base | None, shape: Mapping[str, float]) -> FloatArray:
        return bias_columns(conditions)


class RotorSensitivity(Effect):
    """Lateral-acceleration drift of a rotor sensor: one complex number, in phase and in quadrature."""

    id = "GS"
    title = "Lateral-acceleration drift (GSA, GSB)"
    equation = "RA += GSA fA + GSB fB; RB += GSA fB - GSB fA"
    rotor_only = True
    parameters = (Parameter("GSA", "deg/hr/g", (20.0, 200.0)), Parameter("GSB", "deg/hr/g", (5.0, 100.0)))
    signature = "Collects 1 and 2 move oppositely, the bias stays."
    confusable_with = ("earth", "mag", "convection", "drift")
    known_as = "GS_T"
    may_follow_temperature = True
    experiment = "Collects 1 and 2 give it; another heading parts it from earth rate and magnetics."

    def columns(self, conditions: Conditions, base: Base | None, shape: Mapping[str, float]) -> FloatArray:
        return gs_columns(conditions)


class AxialDrift(Effect):
    """Drift proportional to the acceleration along the spin axis: easily taken for zero, and then it is in the bias."""

    id = "MU_real"
    title = "Axial-acceleration drift (MUA, MUB)"
    equation = "RA += MUB fS; RB -= MUA fS"
    rotor_only = True
    parameters = tuple(Parameter(name, "deg/hr/g", (2.0, 40.0), _MU_TYPICAL) for name in ("MUA", "MUB"))
    signature = "Only the collect with the spin axis vertical moves; a bias solved without MU is off by +MUB, -MUA."
    confusable_with = ("k2", "MU_rr", "tilt", "index", "earth", "convection", "settle", "mag")
    may_follow_temperature = True
    odds = 5.0
    experiment = "Collect 4, spin axis down: a linear MU changes sign, even terms do not."

    def columns(self, conditions: Conditions, base: Base | None, shape: Mapping[str, float]) -> FloatArray:
        return mu_columns(conditions)


class _FollowsTemperature(Effect):
    """The two coefficients of another effect, each with a linear and a quadratic term about 25 °C."""

    of: ClassVar[Effect]
    rotor_only = True
    follows = "temperature"
    needs = frozenset({"temperature_degC"})

    def columns(self, conditions: Conditions, base: Base | None, shape: Mapping[str, float]) -> FloatArray:
        delta = np.nan_to_num(above_reference(conditions))[:, None, None]
        columns = self.of.columns(conditions, base, shape)
        return np.concatenate([columns * delta, columns * delta**2], -1)


class RotorSensitivityTemperature(_FollowsTemperature):
    """GS that follows temperature."""

    id = "GS_T"
    of = RotorSensitivity()
    title = "GSA, GSB temperature dependence"
    equation = "GS += GS1 (T - 25 degC) + GS2 (T - 25 degC)^2, for GSA and GSB"
    parameters = (
        Parameter("GSA1", "deg/hr/g/degC", (0.02, 0.8), power=1),
        Parameter("GSB1", "deg/hr/g/degC", (0.02, 0.8), power=1),
        Parameter("GSA2", "deg/hr/g/degC^2", (0.0004, 0.016), power=2),
        Parameter("GSB2", "deg/hr/g/degC^2", (0.0004, 0.016), power=2),
    )
    signature = "GSA and GSB change smoothly with temperature; MU follows only where tilt was not allowed for."
    confusable_with = ("phase", "scale", "convection", "mag")
    plain_form = "line"
    odds = 3.0
    experiment = "Report GSA and GSB of every run; modulus and angle tell gain from phase."


class _Gain(Effect):
    """What follows temperature in proportion: as a share of what it is at the middle of the collects' temperatures."""

    needs_base = True
    follows = "temperature"
    needs = frozenset({"temperature_degC"})
    parameters = (Parameter("a", "1/degC", (0.001, 0.004), power=1),)
    shapes = (ShapeParameter("about_degC", "degC", (REFERENCE_DEGC,), default=REFERENCE_DEGC),)

    def shapes_for(self, conditions: Conditions) -> tuple[ShapeParameter, ...]:
        """Return T0: values that are solved without it are those there."""
        known = column(conditions, "temperature_degC")
        known = known[np.isfinite(known)]
        return (replace(self.shapes[0], grid=(round(float(known.mean()), 1),)),) if len(known) else self.shapes

    def warmed(self, conditions: Conditions, rates: FloatArray, shape: Mapping[str, float]) -> FloatArray:
        """Return rates (n, c) times how far each collect is from T0, °C."""
        off = column(conditions, "temperature_degC") - shape.get("about_degC", REFERENCE_DEGC)
        return np.asarray(rates * np.nan_to_num(off)[:, None])


class RotorSensitivityGain(_Gain):
    """GS that follows temperature with its angle kept: a torquer or a magnet that weakens moves GSA and GSB alike."""

    id = "GS_gain"
    title = "GSA, GSB temperature dependence, both in proportion"
    equation = "GS *= 1 + a (T - T0), for GSA and GSB"
    rotor_only = True
    signature = "GSA and GSB change by the same share of themselves; neither MU nor the bias does."
    confusable_with = ("scale", "convection", "mag")
    known_as = "GS_T"
    experiment = "Report GSA and GSB of every run: their ratio stays."

    def columns(self, conditions: Conditions, base: Base | None, shape: Mapping[str, float]) -> FloatArray:
        lateral = conditions.f_g * (1.0, 1.0, 0.0)
        rates = np.einsum("nca,na->nc", required_base(self, base).k, lateral)
        return self.warmed(conditions, rates, shape)[..., None]


class AxialDriftTemperature(_FollowsTemperature):
    """MU that follows temperature."""

    id = "MU_T"
    of = AxialDrift()
    title = "MUA, MUB temperature dependence"
    equation = "MU += MU1 (T - 25 degC) + MU2 (T - 25 degC)^2, for MUA and MUB"
    parameters = (
        Parameter("MUA1", "deg/hr/g/degC", (0.05, 1.0), power=1),
        Parameter("MUB1", "deg/hr/g/degC", (0.05, 1.0), power=1),
        Parameter("MUA2", "deg/hr/g/degC^2", (0.001, 0.02), power=2),
        Parameter("MUB2", "deg/hr/g/degC^2", (0.001, 0.02), power=2),
    )
    signature = "MU changes smoothly with temperature while bias and GS do not."
    confusable_with = ("tilt", "MU_rr", "convection", "vre")
    searched, known_as = False, "MU_real"  # of which it is a form: its values follow temperature
    experiment = "Collect 4 at every temperature, each visited twice."


class _AnewInEachRun(VarianceEffect):
    """The coefficients of another effect, drawn anew for each self-calibration, or for each visit to a temperature."""

    of: ClassVar[Effect]
    follows = "run"
    rotor_only = True
    shapes = (ShapeParameter("of_visit", "", (0.0, 1.0), default=0.0),)

    def shapes_for(self, conditions: Conditions) -> tuple[ShapeParameter, ...]:
        """Return whether a visit's runs are alike: asked where some are several, and a temperature was gone to again.

        Else that is what follows temperature.
        """
        visit = visit_of_rows(conditions)
        several, first = np.unique(visit, return_index=True)
        runs = len(np.unique(np.column_stack([visit, conditions.run]), axis=0))
        new = np.diff(np.sort(column(conditions, LEVEL)[first])) > WIDEST_DEGC
        again = runs > len(several) and not np.all(new)
        return self.shapes if again else (replace(self.shapes[0], grid=(0.0,)),)

    def scatter(self, conditions: Conditions, shape: Mapping[str, float]) -> tuple[Scatter, ...]:
        """Return independent coefficients of unit deviation per run, or per visit."""
        group = visit_of_rows(conditions) if shape.get("of_visit") else conditions.run
        return (Scatter(self.of.columns(conditions, None, {}), group=group),)


class AxialDriftScatter(_AnewInEachRun):
    """MU that differs from one self-calibration to the next: balls reseat in the bearing."""

    id = "MU_rr"
    of = AxialDrift()
    title = "Run-to-run MU change"
    equation = "MU of run (or visit) k = MU(T) + N(0, s_mu)"
    parameters = (Parameter("s_mu", "deg/hr/g", (0.8, 6.0), {"DTG": (0.05, 1.0)}),)
    signature = "MU and a bias solved without it scatter equally, one beside it is quiet: sigmas 1 : 0 : 1."
    confusable_with = ("index", "settle", "jump", "drift")
    kin = MappingProxyType({"MU_T": 1.0})
    experiment = "Repeat collect 3 three times without indexing between, then with."


class RotorSensitivityScatter(_AnewInEachRun):
    """GS that differs from one self-calibration to the next: a magnet, a flexure or an index that does not come back.

    The report does not list it, nor say what GS was; sizes are assumed.
    """

    id = "GS_rr"
    of = RotorSensitivity()
    title = "Run-to-run GS change"
    equation = "GSA, GSB of run (or visit) k = GS(T) + N(0, s_gs)"
    parameters = (Parameter("s_gs", "deg/hr/g", (0.5, 5.0), {"DTG": (0.02, 0.5)}),)
    signature = "Collects 1 and 2 of a run move oppositely, those of the next by another amount; bias and MU stay."
    confusable_with = ("base", "arw", "MU_rr")
    kin = MappingProxyType({"GS_T": 1.0})
    odds = 1.0 / 1.5  # the published list of effects lacks it
    experiment = "Repeat collects 1 and 2 three times without indexing between, then with."


class AnisotropicSensitivity(Effect):
    """GS that is not the same for both axes, against the rotor's isotropy."""

    id = "noniso"
    title = "Anisotropy of GS"
    equation = "RA += d fA; RB -= e fA"
    rotor_only = True
    parameters = (Parameter("d", "deg/hr/g", (1.0, 10.0)), Parameter("e", "deg/hr/g", (1.0, 10.0)))
    signature = "None while the index axis stays level: fB is nearly zero, so GS absorbs it."
    confusable_with = ("GS",)
    experiment = "Roll the unit by 90 deg so that the B axis carries gravity, and repeat."

    def columns(self, conditions: Conditions, base: Base | None, shape: Mapping[str, float]) -> FloatArray:
        f_a = conditions.f_g[:, 0]
        zero = np.zeros_like(f_a)
        return np.stack([np.stack([f_a, zero], -1), np.stack([zero, -f_a], -1)], -2)


class LinearSensitivity(Effect):
    """The full acceleration-sensitivity matrix, not symmetric; a rotor's GS and MU are what its isotropy leaves."""

    id = "g_sensitivity"
    title = "Linear acceleration sensitivity"
    equation = "R += G f"
    parameters = (Parameter("G", "deg/hr/g", (10.0, 200.0), _MATRIX_TYPICAL),)
    accepted = r"G.*"
    signature = "Rates follow the direction of gravity in every orientation, of either sign."
    confusable_with = ("earth", "misalign", "mag")
    may_follow_temperature = True
    odds = 3.0
    experiment = (
        "Two headings, and orientations that turn the vertical axis: earth rate's vertical part is along gravity."
    )

    def labels_for(self, conditions: Conditions) -> Sequence[str]:
        """Return XX, XY, … of GXX, GXY, …: row by channel, column by axis."""
        return [name[1:] for name in sensitivity_names(conditions.sensor)]

    def beside_form(self, parameters: Sequence[str], sensor: Sensor) -> bool:
        """Not beside a rotor's GS: its isotropy says what else there is."""
        return not (sensor.is_rotor and any(name.startswith("GS") for name in parameters))

    def columns(self, conditions: Conditions, base: Base | None, shape: Mapping[str, float]) -> FloatArray:
        return sensitivity_columns(conditions)


class LinearSensitivityScatter(_AnewInEachRun):
    """G of a triad that differs from one self-calibration to the next; a rotor's has effects of its own, GS and MU.

    The report does not list it; sizes are assumed.
    """

    id = "G_rr"
    of = LinearSensitivity()
    rotor_only, triad_only = False, True
    title = "Run-to-run change of the acceleration sensitivity"
    equation = "G of run (or visit) k = G(T) + N(0, s_g), of every axis of a channel"
    parameters = (Parameter("s_g", "deg/hr/g", (0.5, 5.0), {"DTG": (0.02, 0.5), "MEMS": (0.5, 20.0)}),)
    signature = "Opposite orientations of a run move oppositely, those of the next by another amount; bias stays."
    confusable_with = ("base", "arw", "g_sensitivity")
    kin = MappingProxyType({"g_sensitivity_T": 1.0})
    odds = 1.0 / 1.5  # the published list of effects lacks it
    experiment = "Repeat two opposite orientations three times without moving the unit between, then with."


class LinearSensitivityTemperature(LinearSensitivity):
    """G that follows temperature linearly."""

    id = "g_sensitivity_T"
    follows = "temperature"
    title = "Acceleration sensitivity's temperature dependence"
    equation = "R += G1 f (T - 25 degC)"
    parameters = (Parameter("G1", "deg/hr/g/degC", (0.02, 0.8), {"DTG": (0.001, 0.1), "MEMS": (0.01, 2.0)}),)
    needs = frozenset({"temperature_degC"})
    signature = "The response to gravity changes with temperature while the bias does not."
    confusable_with = ("g_sensitivity", "scale", "bias_T")
    searched, known_as = False, "g_sensitivity"  # of which it is a form
    experiment = "The same orientations at two temperatures at least, revisited."

    def labels_for(self, conditions: Conditions) -> Sequence[str]:
        """Return _XX, _XY, … of G1_XX, G1_XY, …: row by channel, column by axis."""
        return [f"_{row}{axis}" for row in channel_labels(conditions.sensor) for axis in conditions.sensor.axes]

    def columns(self, conditions: Conditions, base: Base | None, shape: Mapping[str, float]) -> FloatArray:
        return super().columns(conditions, base, shape) * np.nan_to_num(above_reference(conditions))[:, None, None]


class LinearSensitivityGain(_Gain):
    """G that follows temperature in proportion: what loads a channel, or reads it, changes by a share for all axes."""

    id = "g_gain"
    title = "Acceleration sensitivity's temperature dependence, in proportion"
    equation = "G *= 1 + a (T - T0), of each channel"
    triad_only = True
    per_channel = True
    signature = "A channel's response to gravity changes by the same share in every orientation; its bias does not."
    confusable_with = ("scale", "g_sensitivity_T")
    known_as = "g_sensitivity"
    experiment = "The same orientations at two temperatures at least, revisited: the ratios within a row of G stay."

    def columns(self, conditions: Conditions, base: Base | None, shape: Mapping[str, float]) -> FloatArray:
        rates = np.einsum("nca,na->nc", required_base(self, base).k, conditions.f_g)
        return self.warmed(conditions, rates, shape)[:, :, None] * np.eye(rates.shape[1])
