"""Nights that a model simulates, through bytes, with values drawn from what is known of them; kept for another time.

A draw is a file of numbers in the folder `keep`, made under a seed of its own by one process for each core. One that is
there already and was made alike is not made again, so that whoever was interrupted goes on.
"""

import json
import os
import tempfile
from collections.abc import Callable, Mapping
from dataclasses import replace
from functools import partial
from hashlib import sha256
from pathlib import Path
from typing import Any

import numpy as np
import yaml

from hil.campaign import Campaign
from hil.campaign.stand_ins import with_stand_ins
from hil.config.recorded import configuration_of
from hil.errors import InputError
from hil.files.durable import RealDisk, write_durably
from hil.files.processes import processes
from hil.files.strict import read_text
from hil.likeness.again import configuration
from hil.likeness.features import features, levels
from hil.likeness.verdict import verdict
from hil.model import Model
from hil.model.curve import Constant, Table
from hil.model.model_file import save_model
from hil.model.stated_noise import SensorNoise
from hil.night import start_night
from hil.reconcile.outcome.improve import improved
from hil.reconcile.search.problem import fitted_sensors
from hil.records.export import open_source
from hil.solve.temperatures import same_temperature

SCHEMA = "hil.twin/1"
FEWEST = 3
_ASSUMED = 10.0  # times as much may conditions differ where chamber and unit are assumed
_WHITE = "deg/sqrt(hr)"
_ANGLE_RANDOM_WALK = 0.12  # deg/√hr, of a campaign that states no errors


class Agrees:
    """Who stands at the simulated bench, and lays the unit as asked."""

    def put(self, question: str, timeout_s: float, *, wants_words: bool) -> None:
        """Hear the question."""

    def answer(self) -> bool | str | None:
        """Return that it is done."""
        return True

    def settle(self, how: str) -> None:
        """Hear how it ended."""


def likeness(
    folder: Path,
    model: Model,
    *,
    draws: int = 20,
    seed: int = 1,
    keep: Path,
    calibrated: bool | None = None,
    workers: int | None = None,
    done: Callable[[int], None] = lambda _: None,
) -> dict[str, Any]:
    """Return hil.twin/1: whether nights simulated with `model` can be told from the night or campaign in `folder`.

    A built-in is fitted first; at each temperature where `calibrated`, else as one set. `keep` is the folder of draws,
    `workers` how many processes make them (one for each core), `done` is told how many there are. Raises `InputError`
    where the night cannot be carried out again, or a draw does not end.
    """
    if draws < FEWEST:
        raise InputError(f"--draws {draws}: {FEWEST} at least; 20 tell at a level of 5 %")
    source = open_source(folder)
    sensors = [rows.conditions.sensor for rows in source.campaign.sensors.values()]
    for sensor in sensors:
        model.check_sensor(sensor)
    own = [curve for sensor in sensors for curve in model.sensors.get(sensor.number, {}).values()]
    follows = any(curve.depends_on_temperature for curve in own) if calibrated is None else calibrated
    follows &= all(same_temperature(rows.conditions).max() > 0 for rows in source.campaign.sensors.values())
    form = model.model_copy(update={"sensors": {}})
    known = model if own else fitted(source.campaign, form, calibrated=follows)
    known = with_white_noise(known, source.campaign)
    document, assumed = configuration(source)
    nights = [features(source, form, calibrated=follows)]
    told = json.dumps([document, known.model_dump(mode="json"), follows, seed, sorted(nights[0])])
    keep.mkdir(parents=True, exist_ok=True)
    alike = sha256(told.encode()).hexdigest()
    make = partial(_drawn, document, known, source.campaign, form, follows, seed, keep, alike)
    count = min(workers or os.cpu_count() or 1, draws)
    with processes(count) as mapped:
        for number, night in enumerate(mapped(make, range(draws))):
            nights.append(night)
            done(number + 1)
    head = {"schema": SCHEMA, "campaign": source.campaign.title, "simulated": source.campaign.simulated}
    asked = {"model": model.full_title, "draws": draws, "seed": seed}
    return {**head, **asked, **verdict(nights, _ASSUMED if assumed else 1.0)}


def fitted(campaign: Campaign, form: Model, *, calibrated: bool) -> Model:
    """Return a form with the values that fit a campaign, at each temperature where `calibrated`."""
    sensors, _ = fitted_sensors(campaign, form)
    return improved(form, sensors, [], [], {}, frozenset(sensors if calibrated else ()))


def drawn_model(model: Model, campaign: Campaign, form: Model, rng: np.random.Generator, *, calibrated: bool) -> Model:
    """Return the model with values as probable as its own: those that fit a campaign drawn from it.

    Terms, and sizes of scatter, are drawn by their standard errors.
    """
    base = fitted(night_of_averages(campaign, model, rng), form, calibrated=calibrated).sensors
    document = model.model_copy(update={"sensors": {**model.sensors, **base}}).model_dump(
        by_alias=True, exclude_unset=True
    )
    drawn = {key: _drawn_values(document.get(key, {}), rng, size=key == "noise") for key in ("terms", "noise")}
    return Model.model_validate({**document, **drawn, "terms": tuple(drawn["terms"])})


def _drawn_values(entry: Any, rng: np.random.Generator, *, size: bool) -> Any:
    """Return a part of a model file with all that has a standard error drawn anew; a `size` stays positive."""
    if isinstance(entry, list | tuple):
        return [_drawn_values(each, rng, size=size) for each in entry]
    if not isinstance(entry, Mapping):
        return entry
    out = {key: _drawn_values(each, rng, size=size) for key, each in entry.items()}
    if entry.get("se") is not None:
        key = "value" if "value" in entry else "polynomial"
        value, error = np.asarray(entry[key]), np.asarray(entry["se"]) * rng.standard_normal(np.shape(entry[key]))
        relative = np.exp(error / np.maximum(np.abs(value), 1e-12))
        out[key] = (value * relative if size else value + error).tolist()
    return out


def night_of_averages(campaign: Campaign, model: Model, rng: np.random.Generator) -> Campaign:
    """Return the campaign with rates drawn from a model, with all noise that it and the standard errors state."""
    sensors = {}
    for number, rows in with_stand_ins(campaign).sensors.items():
        own, errors = rows.conditions, np.nan_to_num(rows.rates_se_deg_per_hr)
        noise = errors * rng.standard_normal(errors.shape) + sum(s.draw(own, rng) for s in model.stated_scatter(own))
        rates = np.where(np.isfinite(rows.rates_deg_per_hr), model.rates(own) + noise, np.nan)
        sensors[number] = replace(rows, rates_deg_per_hr=rates)
    return replace(campaign, sensors=sensors)


def with_white_noise(model: Model, campaign: Campaign) -> Model:
    """Return the model with the white noise that the standard errors show, where it states none."""
    noise, called = dict(model.noise), levels(campaign)
    for number, rows in campaign.sensors.items():
        stated, own = noise.get(number, SensorNoise()), rows.conditions
        if "angle_random_walk" in stated.model_fields_set:
            continue
        white = np.nan_to_num(rows.rates_se_deg_per_hr * np.sqrt(own.duration_s / 3600.0)[:, None])
        white = np.median(np.where(white > 0.0, white, _ANGLE_RANDOM_WALK), axis=1)
        station = same_temperature(own)
        at = {float(each): float(np.median(white[station == k])) for k, each in enumerate(called) if k in station}
        curve = Constant(unit=_WHITE, value=float(np.median(white)))
        told = Table(unit=_WHITE, table={"temperature_degC": [*at], "value": [*at.values()]}) if len(at) > 1 else curve
        noise[number] = stated.model_copy(update={"angle_random_walk": told})
    return model.model_copy(update={"noise": noise})


def _drawn(
    document: Mapping[str, Any],
    model: Model,
    campaign: Campaign,
    form: Model,
    calibrated: bool,
    seed: int,
    keep: Path,
    alike: str,
    number: int,
) -> dict[str, float]:
    """Return the numbers of a draw, simulated unless the folder has them."""
    path = keep / f"draw-{number + 1:04d}.json"
    if path.is_file():
        made = json.loads(read_text(path))
        if made.get("of") == alike:
            return dict(made["numbers"])
    rng = np.random.default_rng([seed, number])
    values = drawn_model(model, campaign, form, rng, calibrated=calibrated)
    with tempfile.TemporaryDirectory(prefix="hil-") as name:
        folder = Path(name)
        save_model(values, folder / "model.yaml")
        text = yaml.safe_dump({**document, "model": read_text(folder / "model.yaml")}, sort_keys=False)
        bench, sweep = configuration_of(text, folder / "files")
        own = int(rng.integers(2**31))
        ended = start_night(folder / "night", sweep, bench, seed=own, terminal=Agrees(), who="the twin")
        if ended.exit_status != 0:
            raise InputError(f"the simulated night {number + 1} did not end well: {ended.reason}")
        source = open_source(folder / "night")
        found = features(source, form, calibrated=calibrated, levels_degC=levels(campaign))
    made = {"simulated": True, "of": alike, "numbers": found}
    write_durably(RealDisk(), path, json.dumps(made).encode())
    return found
