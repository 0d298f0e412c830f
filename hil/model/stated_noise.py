"""What a model states of a sensor's noise: its noise section, in numbers that were measured or found; its covariance.

One thing has one name: `angle_random_walk` is the catalogue's `arw`, `bias_instability` its `flicker`,
`rate_random_walk` its `rrw`, and a `run_to_run` of MUA and MUB alike its `MU_rr`. They are older than the catalogue's
scatter, and files that have them keep them; whatever else scatters stands in `scatter` by its id.
"""

from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import Annotated, Any

import numpy as np
from pydantic import AfterValidator, Field, FiniteFloat

from hil.campaign import Conditions, FloatArray, Sensor
from hil.errors import InputError
from hil.files.strict import Section
from hil.model.curve import Constant, Curve, Polynomial, Table
from hil.model.effects.base import VarianceEffect
from hil.model.effects.catalogue import known_by, variance_effect_by_id
from hil.model.effects.columns import HOUR_S
from hil.model.effects.scatter import Scatter
from hil.model.forms import LinearForm

_OLDER = {
    key: variance_effect_by_id(identifier)
    for key, identifier in (("angle_random_walk", "arw"), ("bias_instability", "flicker"), ("rate_random_walk", "rrw"))
}
_UNITS = {key: effect.parameters[0].unit for key, effect in _OLDER.items()}


def _none(key: str) -> Any:
    return Field(default_factory=lambda: Constant(unit=_UNITS[key], value=0.0))


class ScatterTerm(Section):
    """One named effect that scatters averages, with the value of its size; `added` says where it came from.

    `channels` are those that it scatters, without any all of the sensor.
    """

    effect: Annotated[str, AfterValidator(known_by(variance_effect_by_id))]
    parameters: Mapping[str, Curve] = Field(default_factory=dict, max_length=1)
    shape: Mapping[str, FiniteFloat] = Field(default_factory=dict)
    channels: tuple[str, ...] = ()
    added: Mapping[str, Any] = Field(default_factory=dict)

    def of_unit_size(self, conditions: Conditions) -> Sequence[Scatter]:
        """Return the independent parts of it, of unit size, in the channels that it scatters."""
        parts = variance_effect_by_id(self.effect).scatter(conditions, self.shape)
        return [part.within(self.channels, conditions.sensor) for part in parts]

    def size_at(self, temperature_degC: FloatArray) -> FloatArray:
        """Return its size at temperatures (n,), °C; raise `InputError` where one is NaN or it is negative."""
        (curve,) = self.parameters.values()
        return _at(curve, temperature_degC, self.effect)


class SensorNoise(Section):
    """What a sensor scatters by, beside the model. Curves are evaluated at the sensor's temperature.

    `run_to_run` gives the standard deviation of a base parameter from one self-calibration to the next, `correlation`
    pairs of those parameters ("BA MUB") with their correlation; `collect_to_collect` that from one collect to the next,
    which shows in no collect's own samples; `scatter` effects of the catalogue by their ids.
    """

    angle_random_walk: Curve = _none("angle_random_walk")
    bias_instability: Curve = _none("bias_instability")
    rate_random_walk: Curve = _none("rate_random_walk")
    resolution_deg_per_hr: Annotated[FiniteFloat, Field(ge=0.0)] = 0.0
    run_to_run: Mapping[str, Curve] = Field(default_factory=dict)
    correlation: Mapping[str, FiniteFloat] = Field(default_factory=dict)
    collect_to_collect: Mapping[str, Curve] = Field(default_factory=dict)
    scatter: tuple[ScatterTerm, ...] = ()

    def scatter_for(self, sensor: Sensor, *, slow: bool = False) -> tuple[tuple[ScatterTerm, VarianceEffect], ...]:
        """Return the named effects that scatter this sensor, each with its values; `slow`: the older keys' too.

        Of these not the angle random walk, which shows inside the collects, and so in their standard errors.
        """
        older = [
            ScatterTerm(effect=effect.id, parameters={effect.parameters[0].name: getattr(self, key)})
            for key, effect in _OLDER.items()
            if slow and effect.id != "arw" and key in self.model_fields_set
        ]
        pairs = ((term, variance_effect_by_id(term.effect)) for term in (*older, *self.scatter))
        return tuple((term, effect) for term, effect in pairs if effect.applies_to(sensor))

    def correlation_factor(self) -> FloatArray:
        """Return L of the correlation L·Lᵀ of what varies from run to run, in the order of its sorted names, (k, k)."""
        names = sorted(self.run_to_run)
        matrix = np.eye(len(names))
        for pair, value in self.correlation.items():
            first, second = (names.index(name) for name in pair.split())
            matrix[first, second] = matrix[second, first] = value
        return np.asarray(np.linalg.cholesky(matrix))

    def parts(self, conditions: Conditions, form: LinearForm) -> Sequence[Scatter]:
        """Return what scatters n collects beside their standard errors, deg/hr; see `Model.stated_scatter`.

        Raises `InputError` where a size follows a temperature that rows lack, or is negative at one that they have.
        """
        temperature = conditions.columns.get("temperature_degC", np.full(len(conditions), np.nan))
        groups = {"run_to_run": conditions.run, "collect_to_collect": np.arange(len(conditions))}
        out = []
        for key, group in groups.items():
            sizes: Mapping[str, Curve] = getattr(self, key)
            names = sorted(sizes)
            columns = form.columns(conditions)[:, :, [form.names.index(name) for name in names]]
            for place, name in enumerate(names):
                columns[:, :, place] *= _at(sizes[name], temperature, name)[:, None]
            columns = columns @ self.correlation_factor() if key == "run_to_run" else columns
            out += [Scatter(columns, group=group)] if names else []
        for term, effect in self.scatter_for(conditions.sensor, slow=True):
            size = term.size_at(temperature)
            if size.any():
                common = effect.id if effect.common_to_sensors else ""
                out += [
                    replace(part, columns=size[:, None, None] * part.columns, common=common)
                    for part in term.of_unit_size(conditions)
                ]
        return out

    def white(self, conditions: Conditions) -> FloatArray:
        """Return what the angle random walk scatters n averages by, deg/hr, (n,); raises `InputError` as `parts`."""
        temperature = conditions.columns.get("temperature_degC", np.full(len(conditions), np.nan))
        walk = _at(self.angle_random_walk, temperature, "angle_random_walk")
        return np.asarray(walk / np.sqrt(conditions.duration_s / HOUR_S))

    def mistake(self, units: Mapping[str, str], temperatures_degC: Sequence[float]) -> str:
        """Say what is wrong with the older keys, or with the size of a named effect, "key: what"; empty if nothing is.

        `units` are those of the base parameters by name; empty where the file does not tell which there are.
        `temperatures_degC` (n,) are some at which no size may be negative, beside those that the file gives.
        """
        given = {key: (getattr(self, key), unit) for key, unit in _UNITS.items()}
        for key in ("run_to_run", "collect_to_collect"):
            for name, curve in getattr(self, key).items():
                if units and name not in units:
                    return f"{key}.{name}: there is no such base parameter; there are {', '.join(units)}"
                given[f"{key}.{name}"] = (curve, units.get(name, curve.unit))
        for key, (curve, unit) in given.items():
            if curve.unit != unit:
                return f"{key}: unit: {curve.unit} given, {unit} needed (values are not converted)"
        sizes = {key: curve for key, (curve, _) in given.items()}
        for index, term in enumerate(self.scatter):
            sizes |= {f"scatter.{index}.parameters.{name}": curve for name, curve in term.parameters.items()}
        for key, curve in sizes.items():
            if said := _negative(curve, temperatures_degC):
                return f"{key}: {said}"
        for pair in self.correlation:
            names = pair.split()
            if len(names) != 2 or names[0] == names[1] or not set(names) <= set(self.run_to_run):
                there = ", ".join(sorted(self.run_to_run)) or "none"
                return f"correlation.{pair}: write two different names of run_to_run ({there}), as in BA MUB"
        try:
            self.correlation_factor()
        except np.linalg.LinAlgError:
            return "correlation: no scatter has these correlations together; make them smaller"
        return ""


def _negative(curve: Curve, temperatures_degC: Sequence[float]) -> str:
    """Say that a size is less than nothing, and what to write: of a polynomial at its range's ends, or temperatures."""
    if not isinstance(curve, Polynomial):
        least = min(curve.table.value) if isinstance(curve, Table) else curve.value
        sign = f"{least:g} {curve.unit} given: a deviation is 0 or more; write it without its sign"
        return sign if least < 0.0 else ""
    low, high = curve.valid_degC or (-np.inf, np.inf)
    at = np.array(
        [*(curve.valid_degC or (curve.reference_degC,)), *(min(max(t, low), high) for t in temperatures_degC)]
    )
    sizes = curve.at(at)
    said = f"{sizes.min():.3g} {curve.unit} at {at[sizes.argmin()]:.4g} °C: a deviation is 0 or more; "
    return said + "write a table of what it is at each temperature" if sizes.min() < 0.0 else ""


def _at(curve: Curve, temperature_degC: FloatArray, what: str) -> FloatArray:
    if curve.depends_on_temperature and np.isnan(temperature_degC).any():
        raise InputError(f"scatter {what} depends on temperature_degC, which some rows lack")
    sizes = curve.at(temperature_degC)
    if np.any(sizes < 0.0):
        where = temperature_degC[np.argmin(sizes)]
        raise InputError(
            f"scatter {what} is {sizes.min():.3g} {curve.unit} at {where:.4g} °C: a deviation is 0 or more"
        )
    return sizes
