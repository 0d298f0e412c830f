"""A model is a form, values for its parameters, and a list of named effects (schema hil.model/1).

    model = load_model("rd-gc-86-1-truth")
    model.base_at(sensor, temperature_degC)     # bias (n, c), K (n, c, 3), and their slopes by temperature
    model.rates(conditions)                     # R = B + K·f + w + every term, shape (n, c), deg/hr

The same file is what `hil reconcile` compares with, what it writes with a term added, and what drives the twin. A
built-in (`matrix-6`, `collins-4` …) is the same object without values: they are fitted to the data.
"""

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import replace
from itertools import chain
from pathlib import Path
from typing import Annotated, Any, Literal

import numpy as np
import yaml
from pydantic import AfterValidator, Field, FiniteFloat

from drivers.strict_yaml import check_schema
from hil.campaign import Campaign, Conditions, FloatArray, Sensor
from hil.errors import InputError, worded
from hil.files.durable import RealDisk, write_durably
from hil.files.strict import Section, find_config, near, parse_yaml, read_text, validated_inside
from hil.model.curve import Curve
from hil.model.effects.base import Base, Described, Effect
from hil.model.effects.catalogue import SERIES_EFFECTS, effect_by_id, known_by, variance_effect_by_id
from hil.model.effects.columns import column
from hil.model.effects.history import joined
from hil.model.effects.scatter import Scatter
from hil.model.equation import pickoff_rates
from hil.model.forms import MODEL_NAMES, PER_G, RATE, LinearForm, value_form
from hil.model.stated_noise import ScatterTerm, SensorNoise
from procedures.words import listed

SCHEMA = "hil.model/1"
_ROTOR = Sensor(0, ("A", "B", "S"), {"A": "A", "B": "B"})
_BETWEEN = 101
"""At how many temperatures of a range a size is asked for."""
_ROTOR_FORMS = frozenset({"matrix-6", "collins-4", "matrix-6-thermal"})


class Term(Section):
    """One named effect with values: on one sensor, or (`sensor` absent) on every sensor to which it applies.

    `added` says where it came from: campaign, date, probability, gap before and after, rivals; free, for people.
    """

    effect: Annotated[str, AfterValidator(known_by(effect_by_id))]
    sensor: int | None = None
    parameters: Mapping[str, Curve] = Field(default_factory=dict)
    shape: Mapping[str, FiniteFloat] = Field(default_factory=dict)
    added: Mapping[str, Any] = Field(default_factory=dict)

    def values_at(self, names: Sequence[str], temperature_degC: FloatArray) -> FloatArray:
        """Return what parameters of these names (p,) are at temperatures (n,), (n, p): 0 where none is given."""
        zero = np.zeros(len(temperature_degC))
        of_each = [self.parameters[name].at(temperature_degC) if name in self.parameters else zero for name in names]
        return np.stack(of_each, axis=1)


class InsideCollects(Section):
    """What was found inside a sensor's collects and leaves no trace in their averages, on record.

    It changes no average, so neither the solver nor the twin asks for it; a reconcile that finds it again says nothing.
    """

    effect: str
    sensor: int
    parameters: Mapping[str, Mapping[str, Any]] = Field(default_factory=dict)
    added: Mapping[str, Any] = Field(default_factory=dict)


class Model(Section):
    """A measurement model, with or without values. See the module for what it can be asked."""

    schema_: Literal["hil.model/1"] = Field(alias="schema")
    title: str
    form: str
    version: int = 1
    source: str = ""
    sensors: Mapping[int, Mapping[str, Curve]] = Field(default_factory=dict)
    terms: tuple[Term, ...] = ()
    inside_collects: tuple[InsideCollects, ...] = ()
    noise: Mapping[int, SensorNoise] = Field(default_factory=dict)

    @property
    def full_title(self) -> str:
        """The title with every effect that the model has beside its form: collins-4 with MU_real and MU_rr."""
        scatter = [entry.effect for noise in self.noise.values() for entry in noise.scatter]
        names = dict.fromkeys([*(t.effect for t in self.terms), *scatter, *(f.effect for f in self.inside_collects)])
        return f"{self.title} with {listed(list(names))}" if names else self.title

    def has_values(self, sensor: Sensor) -> bool:
        """Whether the file gives this sensor's parameters; otherwise they are fitted to the data."""
        return sensor.number in self.sensors

    def knows_inside(self, effect: str, sensors: Sequence[int]) -> bool:
        """Whether an effect inside these sensors' collects is on record already."""
        return all(any((known.effect, known.sensor) == (effect, n) for known in self.inside_collects) for n in sensors)

    def moves_inside(self, sensor: Sensor) -> bool:
        """Whether what it states of a sensor, terms or scatter, goes on changing while a collect lasts."""
        noise = self.noise.get(sensor.number, SensorNoise())
        return any(
            effect.moves_inside for _, effect in (*self.terms_for(sensor), *noise.scatter_for(sensor, slow=True))
        )

    def terms_for(self, sensor: Sensor) -> tuple[tuple[Term, Effect], ...]:
        """Return the terms that act on a sensor, each with its effect."""
        pairs = ((term, effect_by_id(term.effect)) for term in self.terms if term.sensor in (None, sensor.number))
        return tuple((term, effect) for term, effect in pairs if effect.applies_to(sensor))

    def stated_scatter(self, conditions: Conditions) -> Sequence[Scatter]:
        """Return what n collects scatter by beside their own standard errors, deg/hr, as independent parts.

        All that the noise section states but the angle random walk, which shows inside the collects and so in their
        errors. Raises `InputError` where a size follows a temperature that rows lack.
        """
        noise = self.noise.get(conditions.sensor.number)
        return () if noise is None else noise.parts(conditions, value_form(self.form, conditions.sensor))

    def white_noise(self, conditions: Conditions) -> FloatArray | None:
        """Return what the stated angle random walk scatters n averages by, deg/hr, (n,); None where none is stated.

        Raises `InputError` where it follows a temperature that rows lack.
        """
        noise = self.noise.get(conditions.sensor.number, SensorNoise())
        errors = noise.white(conditions)
        return errors if np.all(errors > 0.0) else None

    def base_at(self, sensor: Sensor, temperature_degC: FloatArray) -> Base:
        """Return base terms and their slopes at temperatures (n,), °C; `rates` is zero, for it needs an orientation.

        Raises `InputError` where the model has no values for the sensor, or they depend on a temperature that is NaN.
        """
        if not self.has_values(sensor):
            raise InputError(f"model {self.title}: it has no values for sensor {sensor.number}")
        curves = self.sensors[sensor.number]
        temperatures = np.atleast_1d(np.asarray(temperature_degC, dtype=np.float64))
        varying = [name for name, curve in curves.items() if curve.depends_on_temperature]
        if varying and not np.all(np.isfinite(temperatures)):
            raise InputError(
                f"model {self.title}: {', '.join(varying)} of sensor {sensor.number} depend on temperature, "
                "and the data has rows without temperature_degC"
            )
        form = value_form(self.form, sensor)
        units = dict(zip(form.names, form.units, strict=True))
        _check_base(f"model {self.title}: sensors.{sensor.number}", self.form, units, curves)
        per_bias, per_k = unit_terms(form, sensor)
        values = np.stack([curves[name].at(temperatures) for name in form.names], -1)
        slopes = np.stack([curves[name].slope_at(temperatures) for name in form.names], -1)
        bias, k = values @ per_bias.T, np.einsum("cap,np->nca", per_k, values)
        return Base(bias, k, np.zeros_like(bias), slopes @ per_bias.T, np.einsum("cap,np->nca", per_k, slopes))

    def base_for(self, conditions: Conditions) -> Base:
        """Return the base at each row of `conditions`, with its rates B + K·f + w."""
        base = self.base_at(conditions.sensor, column(conditions, "temperature_degC"))
        rates = pickoff_rates(base.bias, base.k, conditions.f_g, conditions.w_channels_deg_per_hr)
        return Base(base.bias, base.k, rates, base.bias_slope, base.k_slope)

    def rates(self, conditions: Conditions, history: Conditions | None = None) -> FloatArray:
        """Return the rates of n collects (or samples: duration 0), shape (n, c), deg/hr, terms and earth rate included.

        `history` are earlier rows, decimated as one likes, for effects that remember (hysteresis, a setpoint's step).
        Raises `InputError` where the model has no values for the sensor, or the data lacks what a term needs.
        """
        rows = conditions if history is None else joined(history, conditions)
        base = self.base_for(rows)
        rates = base.rates.copy()
        for term, effect in self.terms_for(conditions.sensor):
            rates += _contribution(self.title, term, effect, rows, base)
        return rates[len(rows) - len(conditions) :]


def built_in_model(name: str) -> Model:
    """Return a built-in by name, without values; raise `InputError` naming the ones that exist."""
    if name not in MODEL_NAMES:
        raise InputError(f"model {name}: no built-in has this name{near(name, MODEL_NAMES)}")
    return Model(schema=SCHEMA, title=name, form=name)


def load_model(path_or_name: str | Path) -> Model:
    """Load a model file, or a built-in or shipped model by its name; raise `InputError` naming file and key."""
    name = str(path_or_name)
    if name in MODEL_NAMES:
        return built_in_model(name)
    with worded(InputError, "model ", InputError):
        path = find_config("models", name, built_in=MODEL_NAMES)
    document = parse_yaml(read_text(path), str(path))
    check_schema(document, SCHEMA, str(path))
    with worded(InputError, f"{path}: "):
        model = validated_inside(Model, document, str(path))
    _check(path, model)
    return model


def fitting(model: Model | str | Path, sensors: Sequence[Sensor], temperatures_degC: Iterable[float] = ()) -> Model:
    """Return a model, read where its file or its name is given, that fits sensors of these layouts.

    Raises `InputError`, naming file and key, where it does not: names, units, shapes, effects, terms or noise of a
    sensor that nobody has, and noise that is negative between the lowest and the highest of the temperatures. (One of
    several sensors has the values of those that are not here.)
    """
    chosen = model if isinstance(model, Model) else load_model(model)
    built = isinstance(model, Model) or str(model) in MODEL_NAMES
    where = f"model {chosen.title}" if built else str(find_config("models", str(model)))
    of = {f"terms.{k}.sensor": term.sensor for k, term in enumerate(chosen.terms) if term.sensor is not None}
    there = [sensor.number for sensor in sensors]
    for key, number in (of | {f"noise.{number}": number for number in chosen.noise}).items():
        if number not in {*there, *chosen.sensors}:
            raise InputError(f"{where}: {key}: there is no sensor {number}; there are {listed(there)}")
    for k, term in enumerate(chosen.terms if {*chosen.sensors} <= {*there} else ()):
        if not any(effect_by_id(term.effect).applies_to(sensor) for sensor in sensors):
            raise InputError(f"{where}: terms.{k}.effect: {term.effect} can be in no sensor that is here; take it out")
    known = [each for each in temperatures_degC if np.isfinite(each)]
    between = np.linspace(min(known), max(known), _BETWEEN).tolist() if known else ()
    for sensor in sensors:
        _check_layout(where, chosen, sensor, exact=True, temperatures_degC=between)
    return chosen


def fitting_campaign(model: Model | str | Path, campaign: Campaign) -> Model:
    """Return a model that fits a campaign's sensors at their temperatures; raise `InputError` as `fitting` does."""
    return fitting_conditions(model, [each.conditions for each in campaign.sensors.values()])


def fitting_conditions(model: Model | str | Path, rows: Sequence[Conditions]) -> Model:
    """Return a model that fits the sensors of these rows, as `fitting_campaign` does."""
    known = chain.from_iterable(each.columns.get("temperature_degC", ()) for each in rows)
    return fitting(model, [each.sensor for each in rows], known)


def save_model(model: Model, path: Path) -> None:
    """Write a model file that `load_model` reads back as an equal model."""
    document = _plain(model.model_dump(by_alias=True, exclude_defaults=True))
    text = yaml.safe_dump(document, sort_keys=False, allow_unicode=True, width=120)
    write_durably(RealDisk(), path, text.encode())


def _plain(value: Any) -> Any:
    if isinstance(value, Mapping):
        return {key: _plain(item) for key, item in value.items()}
    return [_plain(item) for item in value] if isinstance(value, tuple | list) else value


def _check(path: Path, model: Model) -> None:
    if model.form not in MODEL_NAMES:
        raise InputError(f"{path}: form: unknown form {model.form}{near(model.form, MODEL_NAMES)}")
    for index, known in enumerate(model.inside_collects):
        if known.effect not in {effect.id for effect in SERIES_EFFECTS}:
            names = ", ".join(sorted({effect.id for effect in SERIES_EFFECTS}))
            raise InputError(f"{path}: inside_collects.{index}.effect: {known.effect} is not one of {names}")
    for index, term in enumerate(model.terms):
        if not effect_by_id(term.effect).in_models:
            raise InputError(f"{path}: terms.{index}.effect: {term.effect} is a mistake in a record; correct it there")
    _check_layout(str(path), model, _ROTOR if model.form in _ROTOR_FORMS else None)


def _check_layout(
    where: str, model: Model, sensor: Sensor | None, *, exact: bool = False, temperatures_degC: Sequence[float] = ()
) -> None:
    """Check what a sensor's layout decides: of that very sensor (`exact`), or of all by what the form tells of them."""
    units = {}
    if sensor is not None:
        form = value_form(model.form, sensor)
        units = dict(zip(form.names, form.units, strict=True))
        for number, curves in model.sensors.items():
            if not exact or number == sensor.number:
                _check_base(f"{where}: sensors.{number}", model.form, units, curves)
    own = sensor.number if exact and sensor is not None else None
    for index, term in enumerate(model.terms):
        if own is None or term.sensor in (None, own):
            _check_term(f"{where}: terms.{index}", term, effect_by_id(term.effect), sensor, exact=exact)
    for number, noise in model.noise.items():
        if own is None or number == own:
            here = f"{where}: noise.{number}"
            if mistake := noise.mistake(units, temperatures_degC):
                raise InputError(f"{here}.{mistake}")
            for index, scatter in enumerate(noise.scatter):
                effect = variance_effect_by_id(scatter.effect)
                _check_term(f"{here}.scatter.{index}", scatter, effect, sensor, exact=exact)


def _check_base(where: str, form: str, units: Mapping[str, str], curves: Mapping[str, Curve]) -> None:
    for name in curves:
        if name not in units:
            raise InputError(f"{where}.{name}: unknown key for {form}; it has {', '.join(units)}")
    for name, unit in units.items():
        if name not in curves:
            raise InputError(f"{where}.{name}: missing; {form} has {', '.join(units)}, in {RATE} or {PER_G}")
        _check_unit(f"{where}.{name}", curves[name].unit, unit)


def _check_term(
    where: str, term: Term | ScatterTerm, effect: Described, sensor: Sensor | None, *, exact: bool = False
) -> None:
    """Refuse a term that does not fit the sensor: the very one (`exact`), else what the form tells, if anything."""
    if sensor is not None and not effect.applies_to(sensor):
        if exact and isinstance(term, Term) and term.sensor is None:
            return
        channels = ", ".join(sensor.channels)
        raise InputError(f"{where}.effect: {effect.id} cannot be in a sensor with channels {channels}; take it out")
    columns = {name: np.zeros(4) for need in effect.needs for name in need.split("|")}
    sample = replace(_still_and_pulled(sensor or _ROTOR), columns=columns)
    units = {} if sensor is None else {each.name: each.unit for each in effect.parameters_for(sample)}
    if not term.parameters:
        known = units or {each.name: each.unit for each in effect.parameters}
        has = [f"{name} ({unit})" for name, unit in known.items()]
        has += [f"shape.{each.name} ({each.unit})" for each in effect.shapes_for(sample) if each.default is None]
        raise InputError(f"{where}.parameters: nothing is given; {effect.id} has {listed(has)}")
    usual = effect.parameters[0].unit if effect.named_by_data else ""
    for name, curve in term.parameters.items():
        if not effect.accepts(name) or (exact and name not in units and not effect.named_by_data):
            names = ", ".join(units or [each.name for each in effect.parameters])
            raise InputError(f"{where}.parameters.{name}: unknown key for effect {effect.id}; it has {names}")
        _check_unit(f"{where}.parameters.{name}", curve.unit, units.get(name, usual or curve.unit))
    own = [*sensor.channels] if sensor is not None and exact else []
    for channel in term.channels if own and isinstance(term, ScatterTerm) else ():
        if channel not in own:
            raise InputError(f"{where}.channels: there is no {channel}; the sensor has {listed(own)}")
    shapes = {shape.name: shape for shape in effect.shapes_for(sample)}
    for name, shape in shapes.items():
        if name not in term.shape and shape.default is None:
            unit = f", in {shape.unit}" if shape.unit else ""
            raise InputError(f"{where}.shape.{name}: missing; {effect.id} needs it{unit}")
    for name, value in term.shape.items():
        if name in shapes and shapes[name].continuous and value <= 0.0:
            raise InputError(f"{where}.shape.{name}: {value:g} {shapes[name].unit} given: it must be more than 0")
        if name not in shapes and value:
            there = ", ".join(shapes) or "none"
            raise InputError(f"{where}.shape.{name}: unknown key for effect {effect.id}; it has {there}")


def _check_unit(where: str, given: str, needed: str) -> None:
    if given != needed:
        raise InputError(f"{where}: unit: {given} given, {needed} needed (values are not converted)")


def unit_terms(form: LinearForm, sensor: Sensor) -> tuple[FloatArray, FloatArray]:
    """Return what a unit of each parameter adds to the bias (c, p) and to K (c, 3, p), from the form's own columns."""
    columns = form.columns(_still_and_pulled(sensor))
    return columns[0], np.moveaxis(columns[1:] - columns[0], 0, 1)


def _still_and_pulled(sensor: Sensor) -> Conditions:
    return Conditions(
        sensor,
        collect=np.arange(4),
        run=np.zeros(4, dtype=np.int64),
        position=np.array(["", "", "", ""]),
        start_s=np.zeros(4),
        duration_s=np.zeros(4),
        f_g=np.concatenate([np.zeros((1, 3)), np.eye(3)]),
        w_deg_per_hr=np.zeros((4, 3)),
    )


def _contribution(title: str, term: Term, effect: Effect, rows: Conditions, base: Base) -> FloatArray:
    # A column that is there but empty (no setpoint given yet) contributes nothing; one that is not there is an error.
    lacking = [need for need in sorted(effect.needs) if not set(need.split("|")) & set(rows.columns)]
    if lacking:
        raise InputError(f"model {title}: term {effect.id} needs {', '.join(lacking)}, which the data lacks")
    columns = effect.columns(rows, base, term.shape)
    temperatures = column(rows, "temperature_degC")
    if any(curve.depends_on_temperature for curve in term.parameters.values()) and np.isnan(temperatures).any():
        raise InputError(f"model {title}: term {effect.id} depends on temperature_degC, which some rows lack")
    values = term.values_at([each.name for each in effect.parameters_for(rows)], temperatures)
    return np.asarray(np.einsum("ncp,np->nc", columns, values))
