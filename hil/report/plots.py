"""Plots of the report and for analysis: parameters against temperature, samples of a collect, a night's temperatures.

    figure = draw_series(collect_series(Path("night-014"), sensor=2, run=7, position="3"))

Every axis has its unit, every line a colour and a style or marker of its own, and what is simulated says so.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.figure import Figure

from hil.campaign import Campaign, FloatArray, Series
from hil.errors import InputError
from hil.files.figure import LOOKS, blank, marked
from hil.model.effects.series import blocked
from hil.records.export import open_source
from hil.records.reader import JOURNAL_NAME, is_night
from hil.report.night import NightContent, night_content
from procedures.words import ranges

_COLORS = ("#0072B2", "#D55E00", "#009E73")
_TRACES = {"0.35": ":", "#0072B2": "-", "#D55E00": "--", "#009E73": "-.", "#CC79A7": (0, (5, 1))}  # colour and dash
_NUMBERED = 40  # more events than this are marked without their numbers, which could not be read


@dataclass(frozen=True)
class CollectSeries:
    """One collect of one sensor: its samples, and the averages and standard errors that the campaign has, deg/hr.

    `means` has them by channel, in the order of the samples' columns.
    """

    title: str
    simulated: bool
    series: Series
    means: Mapping[str, tuple[float, float]]


def collect_series(
    folder: Path,
    *,
    sensor: int | None = None,
    collect: int | None = None,
    run: int | None = None,
    position: str | None = None,
) -> CollectSeries:
    """Read the samples of one collect of a night, or the series of a campaign folder.

    It is named by its number, or by run and position. Raises `InputError` saying what there is to choose from.
    """
    campaign = open_source(folder)
    number = which_sensor(folder, campaign, sensor)
    rows = campaign.sensors[number]
    conditions = rows.conditions
    meant = np.ones(len(conditions), dtype=bool)
    for wanted, column in ((collect, conditions.collect), (run, conditions.run), (position, conditions.position)):
        if wanted is not None:
            meant &= column == wanted
    if meant.sum() != 1:
        every, positions = conditions.collect.tolist(), ", ".join(dict.fromkeys(conditions.position.tolist()))
        choose = "choose one collect with --collect, or --run and --position"
        raise InputError(
            f"{folder}: {choose if meant.any() else f'sensor {number} has no such collect'}; there are {len(every)} "
            f"from {min(every)} to {max(every)}, runs {ranges(conditions.run.tolist())}, positions {positions}"
        )
    row = int(np.argmax(meant))
    chosen = int(conditions.collect[row])
    series = campaign.samples(chosen)
    if series is None:
        raise InputError(f"{folder}: collect {chosen} of sensor {number} was kept as an average only, no series")
    return CollectSeries(
        f"{campaign.title}, collect {chosen}: sensor {number}, run {conditions.run[row]}, "
        f"position {conditions.position[row]}",
        campaign.simulated,
        series,
        {
            name: (float(rows.rates_deg_per_hr[row, place]), float(rows.rates_se_deg_per_hr[row, place]))
            for place, name in enumerate(conditions.sensor.channels)
        },
    )


def which_sensor(folder: Path, campaign: Campaign, sensor: int | None) -> int:
    """Return the sensor that is meant: the only one, or `sensor`; raise `InputError` saying which there are."""
    numbers = ", ".join(map(str, campaign.sensors))
    if sensor is None:
        if len(campaign.sensors) > 1:
            raise InputError(f"{folder}: choose a sensor with --sensor; there are {numbers}")
        return next(iter(campaign.sensors))
    if sensor not in campaign.sensors:
        raise InputError(f"{folder}: there is no sensor {sensor}; there are {numbers}")
    return sensor


def draw_series(collect: CollectSeries) -> Figure:
    """Draw every sample, means over a sixtieth of the collect, and the average with its standard error as a band."""
    series = collect.series
    panels = len(collect.means) + (series.temperature_degC is not None)
    figure = Figure(figsize=(8.0, 1.2 + 2.0 * panels), layout="constrained")
    every = figure.subplots(panels, 1, sharex=True, squeeze=False)[:, 0]
    for k, (axes, (name, (mean, se)), color) in enumerate(zip(every, collect.means.items(), _COLORS, strict=False)):
        rates = series.rates_deg_per_hr[:, k]
        average = f"average {mean:.2f} ±{se:.2f} deg/hr".replace("-", "\N{MINUS SIGN}")
        axes.plot(series.t_s, rates, ".", color="0.7", markersize=2, label="sample", rasterized=len(rates) > 5000)
        axes.plot(*blocked(series, k), "o-", color=color, markersize=3, linewidth=1.0, label="short means")
        axes.axhline(mean, color="black", linewidth=1.0, linestyle="--", label=average)
        if np.isfinite(se):
            axes.axhspan(mean - se, mean + se, color="0.85", zorder=0)
        axes.set_ylabel(f"{name}, deg/hr", parse_math=False)
        axes.legend(frameon=False, fontsize=8, ncols=3, loc="upper right")
    if series.temperature_degC is not None:
        every[-1].plot(series.t_s, series.temperature_degC, color="black", linewidth=1.0)
        every[-1].set_ylabel("unit, °C")
    every[-1].set_xlabel("time since the collect began, s")
    every[0].set_title(marked(collect.title, simulated=collect.simulated), loc="left", fontsize=10, parse_math=False)
    for axes in every:
        axes.grid(visible=True, color="0.92")
    return figure


def draw_temperatures(folder: Path) -> Figure:
    """Draw chamber, setpoint and unit temperature through a night, as the report does.

    Raises `InputError` where the folder holds no night, or one without temperatures yet.
    """
    if not is_night(folder):
        raise InputError(f"{folder}: temperatures through the night are in a night's folder (no {JOURNAL_NAME} here)")
    night = night_content(folder)
    if len(night.hours) < 2:
        raise InputError(f"{folder}: the night is {night.state}; no temperatures were recorded yet")
    figure = draw_night(night)
    figure.subplots_adjust(top=0.84)
    figure.suptitle(
        marked(folder.resolve().name, simulated=night.simulated), x=0.01, ha="left", fontsize=10, parse_math=False
    )
    return figure


def draw_parameters(folder: Path, campaign: Campaign, sensor: int | None) -> Figure:
    """Draw every parameter of a sensor against temperature, as `hil thermal` does.

    Raises `InputError` where there are too few temperatures for a curve.
    """
    from hil.analysis.thermal.files import draw_fit
    from hil.analysis.thermal.fit import fit_thermal

    number = which_sensor(folder, campaign, sensor)
    one = replace(campaign, sensors={number: campaign.sensors[number]})
    return draw_fit(fit_thermal(one).sensors[number], one)


@dataclass(frozen=True)
class Line:
    """One line graph: mean and one sigma against temperature, each of shape (t,), with its legend entry."""

    label: str
    temperature_degC: FloatArray
    mean: FloatArray
    sigma: FloatArray  # NaN where it is not known
    style: str = "matrix"  # a key of LOOKS


def draw_against_temperature(title: str, unit: str, lines: Sequence[Line], *, fahrenheit: bool = True) -> Figure:
    """Draw parameters against temperature, °C below; with °F above it is the layout of the report's Figures 2-5."""
    figure, axes = blank(*((5.2, 2.5) if fahrenheit else (4.4, 2.6)))
    for line in lines:
        look: Any = {"capsize": 3, "markersize": 5, "linewidth": 1.4, **LOOKS[line.style]}
        axes.errorbar(line.temperature_degC, line.mean, np.nan_to_num(line.sigma), label=line.label, **look)
    axes.axhline(0.0, color="0.6", linewidth=0.8, zorder=0)
    axes.set(xlabel="temperature, °C", ylabel=unit)
    axes.set_title(title, loc="left", fontsize=10, pad=8)
    if fahrenheit:
        both: Any = (lambda celsius: celsius * 1.8 + 32.0, lambda fahrenheit: (fahrenheit - 32.0) / 1.8)
        above = axes.secondary_xaxis("top", functions=both)
        above.set_xlabel("temperature, °F", labelpad=3, fontsize=8)
        above.tick_params(labelsize=8)
    else:
        figure.subplots_adjust(top=0.88)
    if len(lines) > 1:
        axes.legend(frameon=False, fontsize=8)
    return figure


def draw_night(night: NightContent) -> Figure:
    """Draw the temperatures through a night: soaks shaded, a tick for every collect, a numbered mark for every event.

    The numbers are those of the list of events, from 1.
    """
    figure, axes = blank(10.0, 3.3)
    for (label, values), (color, dash) in zip(night.temperatures.items(), _TRACES.items(), strict=False):
        width = 1.2 if dash == ":" else 1.3
        axes.plot(night.hours, values, label=label, color=color, linestyle=dash, linewidth=width)
    for place, soak in enumerate(night.soaks):
        label = "_" if place else "restabilising"
        axes.axvspan(soak["began_h"], soak["ended_h"], color="0.9", linewidth=0.0, zorder=0, label=label)
    along, floor, top = axes.get_xaxis_transform(), 0.03, 1.02
    began = [each["began_h"] for each in night.collects]
    if began:
        axes.plot(began, [floor] * len(began), "|", transform=along, color="black", markersize=9, label="collect")
    if len(night.event_hours):
        heights = [top] * len(night.event_hours)
        axes.plot(
            night.event_hours, heights, "v", transform=along, color="black", markersize=5, clip_on=False, label="event"
        )
        last_h = -np.inf
        for number, hour in enumerate(night.event_hours.tolist(), start=1):
            # Events that come together share the place of one number: the list tells them apart.
            if len(night.event_hours) <= _NUMBERED and hour - last_h > 0.015 * (np.nanmax(night.hours) or 1.0):
                axes.annotate(str(number), (hour, top + 0.03), xycoords=along, ha="center", va="bottom", fontsize=7.5)
                last_h = hour
    axes.set(xlabel="time since the night began, hours", ylabel="temperature, °C")
    axes.margins(x=0.01)
    figure.subplots_adjust(bottom=0.22, top=0.89)
    figure.legend(frameon=False, fontsize=8, ncols=7, loc="lower center")
    return figure
