"""Turn a report's content into one self-contained HTML file."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from jinja2 import Environment, PackageLoader, StrictUndefined

from hil.campaign import FloatArray
from hil.files import RealDisk, write_durably
from hil.report.content import NightContent, Repeat, ReportContent, SensorContent
from hil.report.figures import Line, Trace, against_temperature, through_the_night
from procedures.verdict import Verdict

_RATE, _PER_G = "deg/hr", "deg/hr/g"

# Table 1 of the report has these six rows, in this order; GSA and GSB, which it never gives, follow.
_TABLE_1 = (
    ("MUA, matrix", "MUA", "matrix", _PER_G),
    ("MUB, matrix", "MUB", "matrix", _PER_G),
    ("BA, contractor", "BA", "contractor", _RATE),
    ("BA, matrix", "BA", "matrix", _RATE),
    ("BB, contractor", "BB", "contractor", _RATE),
    ("BB, matrix", "BB", "matrix", _RATE),
    ("GSA, matrix", "GSA", "matrix", _PER_G),
    ("GSB, matrix", "GSB", "matrix", _PER_G),
)

_FIGURES = (
    ("Figure 2's layout: bias A", "BA", _RATE, "Bias A; the contractor's is eq. (5) with MU taken as zero."),
    ("Figure 3's layout: bias B", "BB", _RATE, "Bias B; the contractor's is eq. (6) with MU taken as zero."),
    ("Figure 4's layout: MUA", "MUA", _PER_G, "MUA: what the contractor took for zero."),
    ("Figure 5's layout: MUB", "MUB", _PER_G, "MUB: what the contractor took for zero."),
)

_WANDER = (
    "the noise within a collect is seen within it: a wander slower than about a tenth of the collect is not in the "
    "standard errors (the scatter from run to run shows it)"
)

_NO_CONTRACTOR = (
    "The contractor's solution is made from the report's three orientations, which this sensor's collects are not."
)

_UNCERTAINTY = (
    "Standard errors come from the samples within the collects, correlation allowed for; the scatter from run to run "
    "is in the table above."
)

_THREE_COLLECTS = (
    "Six equations, six unknowns: no residual is left, so these collects cannot contradict the model.",
    (
        "What is alike in all positions is called bias; what changes sign between Collects 1 and 2 is called GS; what "
        "appears in Collect 3 alone is called MU, be it settling, an index error times GS, a drift, or an even g² term."
    ),
    "The B direction is hardly excited (G2 is nearly zero): that GSA and GSB are alike for both channels is assumed.",
    (
        "A fourth collect, spin axis down (index 180°), gives the first residual: a linear MU changes sign there, an "
        "even g² term does not."
    ),
)


@dataclass(frozen=True)
class _Cell:
    mean: str
    sigma: str


def render(content: ReportContent) -> str:
    """Return the report as HTML. Nothing in it needs a network."""
    environment = Environment(
        loader=PackageLoader("hil.report", "."), autoescape=True, undefined=StrictUndefined, trim_blocks=True
    )
    return environment.get_template("report.html.j2").render(r=_page(content))


def write_page(content: ReportContent, path: Path) -> None:
    """Write the report to `path`, whole or not at all."""
    write_durably(RealDisk(), path, render(content).encode())


def _page(content: ReportContent) -> dict[str, Any]:
    campaign, night = content.campaign, content.night
    solutions = [each for sensor in content.sensors for each in sensor.solutions]
    units = {name: found.unit for each in solutions for name, found in each.parameters.items()}
    return {
        "title": campaign.title,
        "subtitle": campaign.source,
        "simulated": campaign.simulated,
        "headline": headline(content),
        "summary": list(_summary(content)),
        # The report's own sensor, beside which the contractor's solution stands, before any other.
        "sensors": [_sensor(sensor) for sensor in sorted(content.sensors, key=lambda each: not each.has_contractor)],
        "night_svg": _night_svg(night),
        "parameters": [{"name": name, "unit": unit} for name, unit in units.items()],
        "runs": list(_runs(content, list(units))),
        "uncertainty_note": _UNCERTAINTY,
        "missing": list(night.missing) if night else [],
        "warnings": [*campaign.warnings, *campaign.notes.splitlines()],
        "events": [
            {"when": when, "kind": kind, "message": message} for when, kind, message in (night.events if night else ())
        ],
        "assumed": _assumed(content),
        "cannot_tell": _cannot_tell(content),
        "provenance": list(night.provenance) if night else [("campaign", str(campaign.folder or ""))],
    }


def headline(content: ReportContent) -> str:
    """Say in one sentence what was done and whether it is good."""
    runs = {each.run for sensor in content.sensors for each in sensor.solutions}
    temperatures = max((len(sensor.repeats) for sensor in content.sensors), default=0)
    counts = content.verdict_counts()
    what = (
        f"{len(runs)} self-calibration{'s' * (len(runs) != 1)} at {temperatures} temperature{'s' * (temperatures != 1)}"
    )
    verdicts = ", ".join(f"{number} {verdict}" for verdict, number in counts.items())
    state = (
        "" if content.night is None or content.night.state == "complete" else f" The night is {content.night.state}."
    )
    sensors = f"{len(content.sensors)} sensor{'s' * (len(content.sensors) != 1)}"
    return f"{what}, {sensors}: {verdicts or 'nothing solved'}.{state}"


def _summary(content: ReportContent) -> Iterator[str]:
    for sensor in content.sensors:
        if not sensor.has_contractor:
            continue
        sizes = [
            (abs(float(np.mean(repeat.matrix[name]))), name, float(np.mean(repeat.matrix[name])), repeat)
            for repeat in sensor.repeats
            for name in ("MUA", "MUB")
            if name in repeat.matrix and np.isfinite(repeat.matrix[name]).all()
        ]
        if sizes:
            _, name, value, repeat = max(sizes, key=lambda each: each[0])
            bias = "BB" if name == "MUA" else "BA"
            yield (
                f"Sensor {sensor.number}: the largest term that the contractor's model leaves out is {name} = "
                f"{value:+.1f} deg/hr/g at {_degrees(repeat)}; taking it for zero moves {bias} by as much, in deg/hr."
            )
    for verdict in (Verdict.FAIL, Verdict.INCONCLUSIVE, Verdict.MARGINAL):
        found = [e for s in content.sensors for e in s.solutions if content.judgement(e).verdict is verdict]
        if found:
            names = ", ".join(f"run {each.run} sensor {each.sensor}" for each in found[:6])
            more = f" and {len(found) - 6} more" if len(found) > 6 else ""
            yield f"{verdict}: {names}{more}. The reasons are in the list of self-calibrations."


def _sensor(sensor: SensorContent) -> dict[str, Any]:
    figures = list(_figures(sensor)) if len(sensor.repeats) > 1 else []
    note = _NO_CONTRACTOR if sensor.is_rotor and not sensor.has_contractor else ""
    return {"number": sensor.number, "note": note, "table": _table(sensor), "figures": figures}


def _table(sensor: SensorContent) -> dict[str, Any] | None:
    if sensor.is_rotor:
        rows = [row for row in _TABLE_1 if row[2] == "matrix" or sensor.has_contractor]
    else:
        units = {name: each.unit for solution in sensor.solutions for name, each in solution.parameters.items()}
        rows = [(name, name, "matrix", unit) for name, unit in units.items()]
    return {
        "temperatures": [_degrees(repeat) for repeat in sensor.repeats],
        "rows": [
            {"label": label, "unit": unit, "cells": [_cell(_of(repeat, model).get(name)) for repeat in sensor.repeats]}
            for label, name, model, unit in rows
        ],
    }


def _of(repeat: Repeat, model: str) -> Mapping[str, FloatArray]:
    return repeat.matrix if model == "matrix" else repeat.contractor


def _cell(values: FloatArray | None) -> _Cell:
    known = np.empty(0) if values is None else values[np.isfinite(values)]
    if len(known) == 0:
        return _Cell("–", "")
    sigma = f"±{np.std(known, ddof=1):.2f}" if len(known) > 1 else "single"
    return _Cell(f"{np.mean(known):.2f}", sigma)


def _figures(sensor: SensorContent) -> Iterator[dict[str, str]]:
    if any(repeat.temperature_degC is None for repeat in sensor.repeats):
        return
    if sensor.is_rotor:
        for title, name, unit, caption in _FIGURES:
            lines = [_line("matrix (M)", sensor, name, "matrix"), _line("contractor (C)", sensor, name, "contractor")]
            if name in {"MUA", "MUB"} or not sensor.has_contractor:
                lines, caption = lines[:1], caption.split(";")[0].rstrip(".") + "."
            svg = against_temperature(title, unit, [line for line in lines if len(line.mean)])
            yield {"svg": svg, "caption": f"{caption} Bars: one sigma of the self-calibrations at that temperature."}
        return
    for name, estimate in sensor.solutions[0].parameters.items():
        svg = against_temperature(name, estimate.unit, [_line(name, sensor, name, "matrix")])
        yield {"svg": svg, "caption": f"{name} against temperature."}


def _line(label: str, sensor: SensorContent, name: str, model: str) -> Line:
    points = [(r.temperature_degC, _of(r, model)[name]) for r in sensor.repeats if name in _of(r, model)]
    points = [(t, values[np.isfinite(values)]) for t, values in points if np.isfinite(values).any()]
    return Line(
        label,
        np.array([t for t, _ in points], dtype=np.float64),
        np.array([np.mean(values) for _, values in points]),
        np.array([np.std(values, ddof=1) if len(values) > 1 else np.nan for _, values in points]),
        model,
    )


def _degrees(repeat: Repeat) -> str:
    if repeat.temperature_degC is None:
        return "all runs"
    return f"{repeat.temperature_degC:.1f} °C / {repeat.temperature_degC * 1.8 + 32.0:.1f} °F"


def _runs(content: ReportContent, names: Sequence[str]) -> Iterator[dict[str, Any]]:
    temperature = {
        (run, sensor.number): _degrees(repeat)
        for sensor in content.sensors
        for repeat in sensor.repeats
        for run in repeat.runs
    }
    every = [each for sensor in content.sensors for each in sensor.solutions]
    for solution in sorted(every, key=lambda each: (each.runs[0], each.sensor)):
        judged = content.judgement(solution)
        cells = []
        for name in names:
            found = solution.parameters.get(name)
            value = "–" if found is None or found.value is None else f"{found.value:.2f}"
            cells.append({"value": value, "se": "" if found is None or found.se is None else f"±{found.se:.2f}"})
        yield {
            "run": solution.run if solution.run is not None else "all",
            "sensor": solution.sensor,
            "temperature": temperature.get((solution.runs[0], solution.sensor), "").split(" / ")[0],
            "cells": cells,
            "verdict": str(judged.verdict),
            "reason": judged.reason,
        }


def _assumed(content: ReportContent) -> list[str]:
    found = [text for sensor in content.sensors for each in sensor.solutions for text in each.assumed]
    site = content.campaign.site
    told = [f"site: {', '.join(f'{name} {value:g}' for name, value in site.items())}"] if site else []
    return list(dict.fromkeys([*told, *found, _WANDER]))


def _cannot_tell(content: ReportContent) -> list[str]:
    solutions = [each for sensor in content.sensors for each in sensor.solutions]
    told = [f"run {each.run}, sensor {each.sensor}: {text}" for each in solutions for text in each.unobservable]
    if any(sensor.is_rotor for sensor in content.sensors) and all(each.degrees_of_freedom == 0 for each in solutions):
        told = [*_THREE_COLLECTS, *told]
    if any(len(sensor.repeats) > 1 and _visited_once(sensor) for sensor in content.sensors):
        told.append(
            "Each temperature was visited once, so temperature cannot be told from elapsed time, history and power "
            "cycle; a second visit from the other direction could."
        )
    return told or ["nothing that the model asks for is left open by these collects"]


def _visited_once(sensor: SensorContent) -> bool:
    """Whether no temperature was come back to after another: the runs of each follow one another."""
    order = sorted(run for repeat in sensor.repeats for run in repeat.runs)
    return all(
        order.index(repeat.runs[-1]) - order.index(repeat.runs[0]) < len(repeat.runs) for repeat in sensor.repeats
    )


def _night_svg(night: NightContent | None) -> str:
    if night is None or len(night.hours) < 2:
        return ""
    traces = [Trace(label, night.hours, values) for label, values in night.temperatures.items()]
    return through_the_night(traces, night.collect_hours)
