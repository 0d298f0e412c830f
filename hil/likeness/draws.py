"""Nights that a model simulates, through bytes, with values drawn from what is known of them; kept for another time.

A draw is a file of numbers in the folder `keep`, made under a seed of its own by one process for each core. One that is
there already and was made alike is not made again, so that whoever was interrupted goes on.
"""

import json
import os
import tempfile
from collections.abc import Callable, Collection, Mapping, Sequence
from dataclasses import replace
from functools import partial
from hashlib import sha256
from itertools import compress
from pathlib import Path
from typing import Any

import numpy as np
import yaml

from hil.campaign import Campaign, Collects, Conditions
from hil.campaign.stand_ins import with_stand_ins
from hil.config.recorded import configuration_of
from hil.errors import InputError
from hil.files.durable import RealDisk, write_durably
from hil.files.processes import processes
from hil.files.strict import read_text
from hil.likeness.again import configuration
from hil.likeness.features import features, levels
from hil.likeness.verdict import verdict
from hil.model import Model, fitting_campaign
from hil.model.effects.scatter import drawn
from hil.model.model_file import save_model
from hil.night import start_night
from hil.reconcile.outcome.improve import improved
from hil.reconcile.outcome.stated import with_white_noise
from hil.reconcile.search.problem import fitted_sensors
from hil.records.export import open_source
from hil.records.reader import is_night
from hil.solve.omissions import what_is_wrong
from hil.solve.temperatures import same_temperature
from hil.solve.wrong_rows import LEFT_OUT, USED, pooled

FEWEST = 3
_ASSUMED = 10.0  # times as much may conditions differ where chamber and unit are assumed
_Kept = tuple[Collection[tuple[int, str, int]], Collection[str]]  # of a sensor: collects of the plan, columns
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


def _collects(rows: Conditions, *, as_listed: bool = False) -> list[tuple[int, str, int]]:
    """Return of each row its run (numbered `as_listed`, or as called), position, and how often that had been before."""
    runs = np.unique(rows.run, return_inverse=True)[1] + 1 if as_listed else rows.run
    places = list(zip(runs.tolist(), rows.position.tolist(), strict=True))
    return [(*place, places[:k].count(place)) for k, place in enumerate(places)]


def _as_measured(rows: Collects, kept: _Kept) -> Collects:
    """Return of a simulated sensor's rows the collects that were measured, with what was recorded of them."""
    own = rows.conditions
    known = replace(own, columns={name: each for name, each in own.columns.items() if name in kept[1]})
    return replace(rows, conditions=known).rows(np.array([each in kept[0] for each in _collects(own)]))


def likeness(
    folder: Path,
    model: Model | str,
    *,
    draws: int = 20,
    seed: int = 1,
    keep: Path,
    calibrated: bool | None = None,
    workers: int | None = None,
    wrong: Sequence[Mapping[str, Any]] | None = None,
    done: Callable[[int], None] = lambda _: None,
) -> dict[str, Any]:
    """Return hil.twin/1: whether nights simulated with `model` can be told from the night or campaign in `folder`.

    What has no values, as a built-in, is fitted first; at each temperature where `calibrated`, else as one set. `keep`
    is the folder of draws, `workers` how many processes make them (one for each core), `wrong` is the key `rows` of who
    looked closer than every command, `done` is told how many there are. Raises `InputError` where the
    night cannot be carried out again, or a draw does not end.
    """
    if draws < FEWEST:
        raise InputError(f"--draws {draws}: {FEWEST} at least; 20 tell at a level of 5 %")
    campaign = open_source(folder)
    document, assumed = configuration(folder, campaign)
    left_out, taken = what_is_wrong(campaign), pooled(campaign)
    rows = [row for row in (left_out["rows"] if wrong is None else wrong) if row["done"] != USED]
    left_out |= {"rows": [{**row, "done": LEFT_OUT} for row in rows]}  # what others put right is compared with nothing
    off = {(row["sensor"], collect) for row in rows for collect in row["collects"]}
    kept, compared = {}, {}
    for number, every in campaign.sensors.items():
        used = np.isin(every.conditions.collect, taken.sensors[number].conditions.collect)
        good = used & [(number, collect) not in off for collect in every.conditions.collect.tolist()]
        used = good if good.any() else used
        collects = set(compress(_collects(every.conditions, as_listed=not is_night(folder)), used))
        kept[number], compared[number] = (collects, frozenset(every.conditions.columns)), every.rows(used)
    campaign = replace(taken, sensors=compared)
    sensors = [rows.conditions.sensor for rows in campaign.sensors.values()]
    model = fitting_campaign(model, campaign)
    own = [curve for sensor in sensors for curve in model.sensors.get(sensor.number, {}).values()]
    follows = any(curve.depends_on_temperature for curve in own) if calibrated is None else calibrated
    follows &= all(same_temperature(rows.conditions).max() > 0 for rows in campaign.sensors.values())
    form = model.model_copy(update={"sensors": {}})
    if not all(map(model.has_values, sensors)):
        values = fitted(campaign, form, calibrated=follows)
        model = values.model_copy(update={"sensors": {**values.sensors, **model.sensors}})
    known = with_white_noise(model, campaign, _ANGLE_RANDOM_WALK)
    nights = [features(campaign, form, calibrated=follows)]
    told = json.dumps([document, known.model_dump(mode="json"), follows, seed, sorted(nights[0]), left_out])
    keep.mkdir(parents=True, exist_ok=True)
    alike = sha256(told.encode()).hexdigest()
    there = [_made_before(keep, alike, number) for number in range(draws)]
    new = [number for number, numbers in enumerate(there) if numbers is None]
    make = partial(_drawn, document, known, campaign, kept, form, follows, seed, keep, alike)
    with processes(min(workers or os.cpu_count() or 1, max(len(new), 1))) as mapped:
        made = iter(mapped(make, new))
        for number, numbers in enumerate(there):
            nights.append(next(made) if numbers is None else numbers)
            done(number + 1)
    head = {"schema": "hil.twin/1", "campaign": campaign.title, "simulated": campaign.simulated}
    asked = {"model": model.full_title, "draws": draws, "seed": seed}
    return {**head, **asked, **left_out, **verdict(nights, _ASSUMED if assumed else 1.0)}


def fitted(campaign: Campaign, form: Model, *, calibrated: bool) -> Model:
    """Return a form with the values that fit a campaign, at each temperature where `calibrated`."""
    sensors = fitted_sensors(campaign, form)
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
    every = with_stand_ins(campaign).sensors
    known = [rows.conditions for rows in every.values()]
    scattered = drawn([model.stated_scatter(own) for own in known], known, rng)
    sensors = {}
    for (number, rows), scatter in zip(every.items(), scattered, strict=True):
        errors = np.nan_to_num(rows.rates_se_deg_per_hr)
        rates = model.rates(rows.conditions) + errors * rng.standard_normal(errors.shape) + scatter
        rates = np.where(np.isfinite(rows.rates_deg_per_hr), rates, np.nan)
        sensors[number] = replace(rows, rates_deg_per_hr=rates)
    return replace(campaign, sensors=sensors)


def _made_before(keep: Path, alike: str, number: int) -> dict[str, float] | None:
    path = _file(keep, number)
    made = json.loads(read_text(path)) if path.is_file() else {}
    return dict(made["numbers"]) if made.get("of") == alike else None


def _file(keep: Path, number: int) -> Path:
    return keep / f"draw-{number + 1:04d}.json"


def _drawn(
    document: Mapping[str, Any],
    model: Model,
    campaign: Campaign,
    kept: Mapping[int, _Kept],
    form: Model,
    calibrated: bool,
    seed: int,
    keep: Path,
    alike: str,
    number: int,
) -> dict[str, float]:
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
        night = open_source(folder / "night")
        sensors = {n: _as_measured(rows, kept[n]) for n, rows in night.sensors.items() if n in kept}
        found = features(replace(night, sensors=sensors), form, calibrated=calibrated, levels_degC=levels(campaign))
    made = {"simulated": True, "of": alike, "numbers": found}
    write_durably(RealDisk(), _file(keep, number), json.dumps(made).encode())
    return found
