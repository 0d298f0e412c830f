"""What of a night is compared: means over its places, by part, place and name, of what is known of every collect.

Everything about averages is what the model's form, fitted to that very night, leaves: so whatever the fit takes with it
is taken from the simulated nights too.
"""

import json
from collections.abc import Iterator, Mapping, Sequence
from typing import Any

import numpy as np

from hil.campaign import Campaign, Conditions, FloatArray
from hil.campaign.data import known_mean
from hil.model import Model
from hil.model.effects.history import collect_interval_s, place_in_run
from hil.model.effects.series import blocked
from hil.reconcile.search.problem import SensorProblem, fitted_sensors
from hil.solve.identifiability import orthonormal
from hil.solve.temperatures import level_degC, same_temperature

_Quantity = tuple[str, str, FloatArray, str]  # part, name, (n,) values of each collect, at which places it is compared
PARTS = ("averages", "run_scatter", "series", "conditions")
RESOLUTION: Mapping[str, float] = {"degC": 0.5, "min": 0.05, "s": 60.0, "se": 0.03}
"""Differences that count as none, by the unit that ends a name: no bench repeats its conditions better."""

_CONDITIONS = ("temperature_degC", "dTdt_degC_per_min")
_OF_A_BENCH = ("chamber_degC", "case_degC")  # which that of a campaign folder is not known to have
_INSIDE = ("slope", "size of slope", "head", "log steps", "lag", "kurtosis")
NORMAL = 2.0 / 3.0  # to this power a size is nearly normal (Wilson, Hilferty)
_FEWEST = 8  # blocks of a series
_STILL = 1e-9  # of a condition's size: what differs by less was only reckoned so, and nothing follows it


def features(
    campaign: Campaign, form: Model, *, calibrated: bool, levels_degC: Sequence[float | None] = ()
) -> dict[str, float]:
    """Return every compared number of a night by JSON of [part, place, name].

    `form` is the model without its values; `calibrated` says that they are fitted at each temperature. Temperatures are
    called as in the measured night, `levels_degC`, coldest first (its own where that is not given).
    """
    called = levels_degC or levels(campaign)
    out: dict[str, float] = {}
    for number, problem in fitted_sensors(campaign, form).items():
        rows = campaign.sensors[number].conditions  # what stands in for a temperature is compared once
        left, errors = residuals(problem, calibrated=calibrated), problem.collects.rates_se_deg_per_hr
        known = (*_CONDITIONS, *(_OF_A_BENCH if campaign.folder is None else ()), "duration_s")
        columns = {"duration_s": rows.duration_s, **rows.columns}
        told = [("conditions", name, columns[name], "by temperature") for name in known if name in columns]
        begins_s = rows.start_s[np.unique(rows.run, return_index=True)[1]]
        times_s = {  # as they mostly were: where a night was interrupted, no model says that it would be
            "from collect to collect_s": collect_interval_s(rows),
            "from run to run_s": float(np.median(np.diff(begins_s))) if len(begins_s) > 1 else np.nan,
            "since the setpoint_s": float(np.median(rows.columns.get("time_since_setpoint_s", np.nan))),
        }
        told += [("conditions", name, np.full(len(rows), value), "once") for name, value in times_s.items()]
        places = {how: list(_places(rows, called, how)) for how in ("once", "by temperature", "everywhere")}
        asked: list[tuple[dict[str, Any], list[_Quantity]]] = [
            ({"sensor": number}, [*told, *_along(rows, np.nan_to_num(left))])
        ]
        for k, channel in enumerate(rows.sensor.channels):
            at = {"sensor": number, "channel": channel}
            asked.append((at, [*_of_channel(rows, left[:, k], errors[:, k]), *_inside(campaign, rows, k)]))
        for at, quantities in asked:
            for part, name, values, how in quantities:
                for where, here in places[how]:
                    mean = known_mean(values[here])
                    if np.isfinite(mean):
                        out[json.dumps([part, {**at, **where}, name])] = mean
    return out


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


def levels(campaign: Campaign) -> list[float | None]:
    """Return the temperatures of a campaign, coldest first, in whole °C; one that has no name where nothing tells."""
    rows = next(iter(campaign.sensors.values())).conditions
    level, station = level_degC(rows), same_temperature(rows)
    if level is None:
        return [None]
    return [round(float(np.nanmean(level[station == k]))) for k in np.unique(station[station >= 0])]


def _places(rows: Conditions, called: Sequence[float | None], how: str) -> Iterator[tuple[dict[str, Any], FloatArray]]:
    """Yield places of a night, each with its rows, (n,) true where they are."""
    if how == "once":
        yield {}, np.ones(len(rows), dtype=bool)
        return
    station, labels = same_temperature(rows), dict.fromkeys(rows.position.tolist()) if how == "everywhere" else ()
    for label in labels:
        yield {"position": label}, rows.position == label
    for k, degC in enumerate(called):
        at = {} if degC is None else {"temperature_degC": degC}
        yield at, station == k
        for label in labels:
            yield {**at, "position": label}, (station == k) & (rows.position == label)


def _along(rows: Conditions, left: FloatArray) -> Iterator[_Quantity]:
    """Yield which share of what is left, (n, c), follows the pose, the time or a condition: where an effect shows."""
    interval_s = collect_interval_s(rows)
    place = place_in_run(rows, interval_s) if interval_s > 0.0 else np.zeros(len(rows))
    stepped = np.append(0.0, np.sign(np.diff(same_temperature(rows))))
    said = {"f": rows.f_g, "f squared": rows.f_g**2, "time": rows.start_s, "place in the run": place}
    for name, values in {**said, "a step of the temperature": stepped, **rows.columns}.items():
        x = np.nan_to_num(np.stack([values, values**2], 1) if values.ndim == 1 else values)
        spread = x.std(axis=0)
        x = (x - x.mean(axis=0)) / np.where(spread > _STILL * np.abs(x).max(axis=0), spread, np.inf)
        share = np.sum((orthonormal(x - x.mean(axis=0)).T @ left) ** 2) / max(float(np.sum(left**2)), 1e-9)
        called = f"share along {name.replace('_', ' ')}"  # its unit is not the condition's
        yield "averages", called, np.full(len(rows), share), "once"


def _of_channel(rows: Conditions, left: FloatArray, errors: FloatArray) -> Iterator[_Quantity]:
    """Yield what is compared of a channel's rates: what is left of them, (n,), and their errors."""
    yield "averages", "mean", left, "everywhere"
    scale = max(float(np.sqrt(known_mean(left**2))), 1e-9)
    _, run = np.unique(rows.run, return_inverse=True)
    of_run = (np.bincount(run, np.nan_to_num(left)) / np.maximum(np.bincount(run, np.isfinite(left)), 1))[run]
    yield "run_scatter", "size", np.abs(left) ** NORMAL, "everywhere"
    yield "run_scatter", "size of runs", np.abs(of_run) ** NORMAL, "once"
    yield "run_scatter", "size within runs", np.abs(left - of_run) ** NORMAL, "once"
    yield "run_scatter", "mean size over rms", np.abs(left) / scale, "once"  # of tails, nearly normal (Geary)
    for what, values, lag in (("collects", left, 1), ("runs", of_run, int(np.sum(run == run[0])))):
        yield "run_scatter", f"likeness of neighbouring {what}", values * np.roll(values, lag) / scale**2, "once"
    yield "series", "log_se", np.log(np.maximum(errors, 1e-9)), "everywhere"


def _inside(campaign: Campaign, rows: Conditions, channel: int) -> Iterator[_Quantity]:
    table = np.full((len(rows), len(_INSIDE)), np.nan)
    for row, collect in enumerate(rows.collect.tolist()):
        series = campaign.series(collect)
        rates = np.empty(0) if series is None else blocked(series, channel)[1]
        if len(rates) >= _FEWEST and np.ptp(rates) > 0.0:
            x = np.linspace(-1.0, 1.0, len(rates))
            slope = float(rates @ x / (x @ x))
            left = rates - rates.mean() - slope * x
            square = max(float(left @ left), 1e-12)
            steps, lag, fourth = np.diff(rates).var(), left[1:] @ left[:-1] / square, left**2 @ left**2 / square**2
            head, kurtosis = left[: len(left) // 6].mean(), fourth * len(left)
            table[row] = slope, abs(slope), head, np.log(steps + 1e-12), lag, kurtosis
    for name, values in zip(_INSIDE, table.T, strict=True):
        yield "series", name, values, "once"
