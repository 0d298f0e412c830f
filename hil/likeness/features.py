"""What of a night is compared: numbers by part, place and name, from averages, scatter, series and conditions.

Everything about averages is what the model's form, fitted to that very night, leaves: so whatever the fit takes with it
is taken from the simulated nights too.
"""

from __future__ import annotations

import json
from collections.abc import Iterator, Mapping, Sequence
from typing import Any

import numpy as np

from hil.campaign import Campaign, Collects, Conditions, FloatArray
from hil.model import Model
from hil.model.effects.history import collect_interval_s, place_in_run
from hil.model.effects.series import blocked
from hil.reconcile.search.problem import SensorProblem, pose
from hil.records.export import Source
from hil.records.reader import is_night
from hil.solve.identifiability import orthonormal
from hil.solve.temperatures import level_degC, same_temperature

PARTS = ("averages", "run_scatter", "series", "conditions")
RESOLUTION: Mapping[str, float] = {"degC": 0.5, "min": 0.05, "s": 60.0, "hr": 0.02, "se": 0.03}
"""Differences that count as none, by the unit that ends a name: no bench repeats its conditions better."""

_CONDITIONS = ("temperature_degC", "dTdt_degC_per_min", "time_since_setpoint_s")
_OF_A_BENCH = ("chamber_degC", "case_degC")  # which a campaign's is not known to have
_NORMAL = 2.0 / 3.0  # to this power a root mean square is nearly normal (Wilson, Hilferty)
_FEWEST = 8  # blocks of a series


def features(
    source: Source, form: Model, *, calibrated: bool, levels_degC: Sequence[float] | None = None
) -> dict[str, float]:
    """Return every compared number of a night by JSON of [part, place, name].

    `form` is the model without its values; `calibrated` says that they are fitted at each temperature. Temperatures are
    called as in the measured night, `levels_degC`, coldest first (its own where that is not given).
    """
    called = levels(source.campaign) if levels_degC is None else levels_degC
    out: dict[str, float] = {}
    for number, problem in pose(source.campaign, form, ()).sensors.items():
        rows = problem.collects.conditions
        left = residuals(problem, calibrated=calibrated)
        for k, channel in enumerate(rows.sensor.channels):
            at = {"sensor": number, "channel": channel}
            found = [
                *_averages(problem.collects, left[:, k], k, called),
                *_scatter(rows, left[:, k]),
                *_inside(source, rows, k),
            ]
            for part, where, name, value in found:
                out[json.dumps([part, {**at, **where}, name])] = value
        for name, value in _along(rows, np.nan_to_num(left)):
            out[json.dumps(["averages", {"sensor": number}, name])] = value
        for where, name, value in _conditions(rows, called, _OF_A_BENCH if is_night(source.folder) else ()):
            out[json.dumps(["conditions", {"sensor": number, **where}, name])] = value
    return {key: float(value) for key, value in out.items() if np.isfinite(value)}


def residuals(problem: SensorProblem, *, calibrated: bool) -> FloatArray:
    """Return what the form and its terms leave of the rates, (n, c), deg/hr; NaN where nothing was measured."""
    rows = problem.collects.conditions
    columns = problem.form.columns(rows)
    if calibrated:
        steps = same_temperature(rows)[:, None] == np.unique(same_temperature(rows))
        columns = np.einsum("ncp,nk->ncpk", columns, steps).reshape(*columns.shape[:2], -1)
    columns = np.concatenate([columns, problem.term_columns], axis=2)
    rates = problem.collects.rates_deg_per_hr - problem.known_rates()
    measured = np.isfinite(rates)
    fit = np.linalg.lstsq(columns[measured], rates[measured], rcond=1e-6)[0]
    return np.asarray(rates - columns @ fit)


def levels(campaign: Campaign) -> list[float]:
    """Return the temperatures of a campaign, coldest first, in whole °C."""
    rows = next(iter(campaign.sensors.values())).conditions
    level, station = level_degC(rows), same_temperature(rows)
    known = np.zeros(len(rows)) if level is None else level
    return [round(float(np.nanmean(known[station == k]))) for k in np.unique(station[station >= 0])]


def _places(rows: Conditions, called: Sequence[float]) -> Iterator[tuple[dict[str, Any], FloatArray]]:
    """Yield the places of a night, each with its rows, (n,) true where they are."""
    station = same_temperature(rows)
    for k, at in enumerate(called):
        yield {"temperature_degC": at}, station == k
    for label in dict.fromkeys(rows.position.tolist()):
        yield {"position": label}, rows.position == label


def _averages(
    collects: Collects, left: FloatArray, channel: int, called: Sequence[float]
) -> Iterator[tuple[str, dict[str, Any], str, float]]:
    rows, errors = collects.conditions, collects.rates_se_deg_per_hr[:, channel]
    station = same_temperature(rows)
    for where, here in _places(rows, called):
        yield "averages", where, "mean deg_per_hr", _mean(left[here])
        for label in dict.fromkeys(rows.position[here].tolist()) if "temperature_degC" in where else ():
            yield "averages", {**where, "position": label}, "mean", _mean(left[here & (rows.position == label)])
        yield "series", where, "log_se", _mean(np.log(np.maximum(errors[here], 1e-9)))
        yield "run_scatter", where, "rms", _rms(left[here])
    interval_s = collect_interval_s(rows)
    place = place_in_run(rows, interval_s) if interval_s > 0.0 else np.zeros(len(rows))
    for k in np.unique(place):
        yield "averages", {}, f"mean at place {k:g}", _mean(left[place == k])
    warmer = np.append(0.0, np.sign(np.diff(station)))
    yield "averages", {}, "after a step of the temperature", _mean(left * warmer)


def _along(rows: Conditions, left: FloatArray) -> Iterator[tuple[str, float]]:
    """Yield which share of what is left, (n, c), follows the pose, the time or a condition: where an effect shows."""
    said = {"f": rows.f_g, "f squared": rows.f_g**2, "time": rows.start_s, **rows.columns}
    for name, values in said.items():
        x = np.nan_to_num(np.stack([values, values**2], 1) if values.ndim == 1 else values)
        x = (x - x.mean(axis=0)) / np.maximum(x.std(axis=0), 1e-9)
        x = orthonormal(x - x.mean(axis=0))
        yield f"share along {name}", float(np.sum((x.T @ left) ** 2) / max(float(np.sum(left**2)), 1e-9))


def _scatter(rows: Conditions, left: FloatArray) -> Iterator[tuple[str, dict[str, Any], str, float]]:
    runs = dict.fromkeys(rows.run.tolist())
    means = np.array([_mean(left[rows.run == run]) for run in runs])
    within = left - np.array([means[list(runs).index(run)] for run in rows.run.tolist()])
    yield "run_scatter", {}, "rms", _rms(left)
    yield "run_scatter", {}, "rms of runs", _rms(means)
    yield "run_scatter", {}, "rms within runs", _rms(within)
    for name, values in (("runs", means), ("collects", left)):
        total = max(float(np.nansum(values**2)), 1e-12)
        yield (
            "run_scatter",
            {},
            f"correlation of neighbouring {name}",
            float(np.nansum(values[1:] * values[:-1])) / total,
        )
    yield (
        "run_scatter",
        {},
        "largest over rms",
        float(np.nanmax(np.abs(left))) / max(float(np.sqrt(_mean(left**2))), 1e-9),
    )


def _inside(source: Source, rows: Conditions, channel: int) -> Iterator[tuple[str, dict[str, Any], str, float]]:
    found = []
    for collect in rows.collect.tolist():
        series = source.series(collect) if collect in source.recorded else None
        rates = np.empty(0) if series is None else blocked(series, channel)[1]
        if len(rates) >= _FEWEST and np.ptp(rates) > 0.0:
            x = np.linspace(-1.0, 1.0, len(rates))
            slope = float(rates @ x / (x @ x))
            left = rates - rates.mean() - slope * x
            head = float(left[: len(left) // 6].mean())
            steps, lag = np.diff(rates), float(left[1:] @ left[:-1] / max(float(left @ left), 1e-12))
            kurtosis = float(np.mean(left**4) / max(float(np.mean(left**2)) ** 2, 1e-12))
            found.append([slope, head, np.log(float(steps.var()) + 1e-12), lag, kurtosis, abs(slope)])
    table = np.array(found).reshape(-1, 6)
    for name, values in zip(("slope", "head", "log steps", "lag", "kurtosis", "size of slope"), table.T, strict=True):
        yield "series", {}, name, _mean(values)


def _conditions(
    rows: Conditions, called: Sequence[float], also: Sequence[str]
) -> Iterator[tuple[dict[str, Any], str, float]]:
    for where, here in _places(rows, called):
        if "temperature_degC" in where:
            for name in {*_CONDITIONS, *also} & set(rows.columns):
                yield where, name, _mean(rows.columns[name][here])
            yield where, "duration_s", _mean(rows.duration_s[here])
    yield {}, "the whole night_hr", float(np.ptp(rows.start_s)) / 3600.0
    yield {}, "from collect to collect_s", collect_interval_s(rows)


def _mean(values: FloatArray) -> float:
    known = values[np.isfinite(values)]
    return float(known.mean()) if len(known) else np.nan


def _rms(values: FloatArray) -> float:
    return float(_mean(values**2) ** (0.5 * _NORMAL))
