"""One sensor's chapter of the report: its pictures, its means by temperature, every self-calibration, the scatter."""

import math
from collections.abc import Iterator, Mapping, Sequence
from itertools import groupby
from typing import Any

import numpy as np

from hil.analysis.published.printed import SEVEN
from hil.analysis.published.reproduction import CONTRACTORS
from hil.campaign.stand_ins import WIDEST_DEGC
from hil.files.numbers import WHOSE, decimals_for, degrees, estimate, number
from hil.files.page import inline_svg
from hil.report.content import SensorContent
from hil.report.plots import Line, draw_against_temperature
from hil.solve import RunSolution
from hil.solve.uncertain import MeanAt
from procedures.verdict import NOT_GOOD, Verdict
from procedures.words import counted, numbered

_ROOM_DEGC = 20.0
_MOST_SENSORS = 3  # beside each other in one look

# Table 1 of the report has these in this order; GSA and GSB, which it never gives, follow.
_TABLE_1 = ("MUA", "MUB", "BA", "BB", "GSA", "GSB")

_FIGURES = {
    "BA": "Figure 2's layout: bias A, eq. (5)",
    "BB": "Figure 3's layout: bias B, eq. (6)",
    "MUA": "Figure 4's layout: MUA, eq. (11)",
    "MUB": "Figure 5's layout: MUB, eq. (12)",
}


def sensor_view(sensor: SensorContent, *, published: bool = False) -> dict[str, Any]:
    """Return what the template shows of one sensor; `published`: the report speaks RD-GC-86-1's words."""
    found = sensor.reproduction
    return {
        "number": sensor.number,
        "not_published": published and sensor.is_rotor and not sensor.has_contractor,
        "table": _by_temperature(sensor),
        "figures": list(_figures(sensor)) if len(sensor.shown.means) > 1 else [],
        "published": sensor.has_contractor,
        "runs": _runs(sensor),
        "contractor": _contractors_verdicts(sensor),
        "seven": SEVEN,
        "found": found,
        "errors": [] if found is None else list(_worst(found)),
        "whose": WHOSE.get(sensor.shown.told_by or "", ""),
        "scatter": sensor.shown.document()["run_to_run"],
        "shown": sensor.shown.sentences(),
    }


def in_words(name: str) -> str:
    """Say what a parameter is: its symbol alone tells those who know it already."""
    if name.startswith(("GS", "MU")):
        return f"drift per g {'across' if name.startswith('GS') else 'along'} the spin axis"
    return f"bias of channel {name[1:].lstrip('_')}" if name.startswith("B") else "drift per g"


def key_numbers(sensors: Sequence[SensorContent]) -> dict[str, Any]:
    """The numbers in one look: each parameter nearest to room temperature, and between which it lies over all."""
    shown = [each for each in sensors if each.shown.means][:_MOST_SENSORS]
    nearest = [min(each.shown.means, key=_from_room) for each in shown]
    units = {name: unit for sensor in shown for name, unit in _units(sensor.solutions).items()}
    rows = []
    for name, unit in units.items():
        cells = []
        for sensor, at in zip(shown, nearest, strict=True):
            one = at.values.get(name)
            digits = decimals_for([None if one is None else one.sd])
            over = [each.values[name].value for each in sensor.shown.means if name in each.values]
            span = f"{number(min(over), digits)} … {number(max(over), digits)}" if over else number(None)
            value, error = estimate(one, digits)
            told = [f"{error} {unit}", *_other_runs(sensor, at, sensor.shown.runs_of(at, name))]
            cells.append((value, ", ".join(told), span, len(sensor.shown.means) > 1))
        rows.append((f"{in_words(name)}, {name}", cells))
    heads = [
        (
            s.number,
            ", ".join(filter(None, [degrees(at.temperature_degC, s.shown.told_by), _unit(at)])),
            len(s.shown.means),
            ", ".join(_doubtful(s, at.runs)),
        )
        for s, at in zip(shown, nearest, strict=True)
    ]
    doubtful = any(_doubtful(sensor, at.runs) for sensor in shown for at in sensor.shown.means)
    every = {"repeated": all(sensor.shown.scatter_included for sensor in shown), "left": len(sensors) - len(shown)}
    return {"heads": heads, "rows": rows, "doubtful": doubtful, **every}


def _from_room(mean: MeanAt) -> float:
    return math.inf if mean.temperature_degC is None else abs(mean.temperature_degC - _ROOM_DEGC)


def _at(sensor: SensorContent, at_degC: float | None) -> str:
    """Say at which temperature a mean or a run is; whose it is stands above them all."""
    return degrees(at_degC, sensor.shown.told_by if at_degC is None else None)


def _by_temperature(sensor: SensorContent) -> dict[str, Any]:
    """Means and their uncertainty by temperature; in Table 1's layout, with their scatter, where that is published."""
    rows = [(name, name, "matrix", unit) for name, unit in _units(sensor.solutions).items()]
    if sensor.has_contractor:
        rows = [(f"{name}, {model}", name, model, _unit_of(name)) for name in _TABLE_1 for model in _models(name)]
    heads = []
    for repeat in sensor.shown.means:
        at = repeat.temperature_degC
        fahrenheit = f"{at * 1.8 + 32.0:.1f} °F" if at is not None and sensor.has_contractor else ""
        heads.append((_at(sensor, at), list(filter(None, [fahrenheit, _unit(repeat)]))))
    return {
        "heads": heads,
        "runs": [(len(repeat.runs), _doubtful(sensor, repeat.runs)) for repeat in sensor.shown.means],
        "rows": [(label, unit, list(_means(sensor, name, model))) for label, name, model, unit in rows],
    }


def _unit(repeat: MeanAt) -> str:
    """Say what the unit's own thermometer showed where that was another temperature, or moved by more than one."""
    at_degC = repeat.temperature_degC
    if at_degC is None or repeat.unit_degC is None:
        return ""
    low, high = repeat.unit_degC
    moved = max(high - at_degC, at_degC - low) > WIDEST_DEGC
    where = f"at {low:z.1f} °C" if f"{low:z.1f}" == f"{high:z.1f}" else f"from {low:z.1f} to {high:z.1f} °C"
    return f"unit {where}" if moved else ""


def _doubtful(sensor: SensorContent, runs: Sequence[int]) -> list[str]:
    found = [each.verdict for each in sensor.solutions if each.runs[0] in runs]
    return [f"{found.count(v)} {v}" for v in NOT_GOOD if v in found]


def _other_runs(sensor: SensorContent, mean: MeanAt, held: Sequence[int]) -> list[str]:
    """Say how many runs a parameter's mean holds, where some of those that were made there could not tell it."""
    fewer = 0 < len(held) < len(mean.runs)
    return [f"of {counted(len(held), 'run')}", *_doubtful(sensor, held)] if fewer else []


def _means(sensor: SensorContent, name: str, model: str) -> Iterator[tuple[str, str, list[str]]]:
    """Yield value, ±, and below them scatter where that is published, and how many runs tell it, in usual decimals."""
    shown, at_each = sensor.shown if model == "matrix" else sensor.contractor_shown, _of(sensor, model)
    found = [None if each is None else each.values.get(name) for each in at_each]
    sds = [each.sd for each in found if each is not None and np.isfinite(each.sd)]
    decimals = decimals_for([float(np.median(sds))] if sds else [])
    for mean, at, each in zip(sensor.shown.means, at_each, found, strict=True):
        value, error = estimate(each, decimals)
        scatter = at.scatter.get(name, np.nan) if at is not None and sensor.has_contractor else np.nan
        below = [f"σ {scatter:.{decimals}f}"] if np.isfinite(scatter) else []
        if shown is not None:
            below += _other_runs(sensor, mean, shown.runs_of(mean, name))
        yield value, error or ("± not known" if each else ""), below


def _of(sensor: SensorContent, model: str) -> list[MeanAt | None]:
    return [each if model == "matrix" else sensor.contractors(each) for each in sensor.shown.means]


def _figures(sensor: SensorContent) -> Iterator[str]:
    """Yield pictures of the means against temperature: one for parameters of a kind, or the published four."""
    if any(repeat.temperature_degC is None for repeat in sensor.shown.means):
        return
    if sensor.has_contractor:
        for name, title in _FIGURES.items():
            lines = [_line(f"{model} ({model[0].upper()})", sensor, name, model, model) for model in _models(name)]
            yield _figure(title, _unit_of(name), lines[::-1], fahrenheit=True)
        return
    styles = ("matrix", "contractor", "single")
    units = _units(sensor.solutions)
    for kind, names in groupby(units, key=lambda name: name[0] if name.startswith("B") else name[:-1]):
        own = list(names)
        what = "bias" if kind == "B" else in_words(own[0])
        lines = [_line(n, sensor, n, "matrix", style) for n, style in zip(own, styles, strict=False)]
        yield _figure(f"{what}: {', '.join(own)}", units[own[0]], lines)


def _figure(title: str, unit: str, lines: Sequence[Line], *, fahrenheit: bool = False) -> str:
    """Return a figure; its text for ears has the numbers at both ends of each line."""
    ends = "; ".join(
        f"{line.label}: "
        + ", ".join(
            f"{line.mean[place]:.1f}{f' ±{line.sigma[place]:.1f}' if np.isfinite(line.sigma[place]) else ''} {unit} at "
            f"{line.temperature_degC[place]:z.1f} °C"
            for place in (0, -1)
        )
        for line in lines
        if len(line.mean)
    )
    figure = draw_against_temperature(title, unit, lines, fahrenheit=fahrenheit)
    return inline_svg(figure, f"{title} against temperature. {ends}.")


def _line(label: str, sensor: SensorContent, name: str, model: str, style: str) -> Line:
    means = [of for of in _of(sensor, model) if of is not None and name in of.values]
    known = [(of.temperature_degC, of.values[name].value, of.values[name].sd) for of in means]
    points = np.array(known, dtype=np.float64).reshape(-1, 3)
    return Line(label, points[:, 0], points[:, 1], points[:, 2], style)


def _runs(sensor: SensorContent) -> dict[str, Any]:
    """Every self-calibration: each parameter of the matrix solution, then of the contractor's, with its uncertainty."""
    heads = [(name, "", unit) for name, unit in _units(sensor.solutions).items()]
    digits = {
        name: decimals_for(each.parameters[name].se for each in sensor.solutions if name in each.parameters)
        for name, _, _ in heads
    }
    heads += [(name, "contractor", unit) for name, unit in _units(list(sensor.contractor.values())).items()]
    shown, rows = sensor.contractor_shown, []
    others = {} if shown is None else {run: shown.of_run(each) for run, each in sensor.contractor.items()}
    for solution in sensor.solutions:
        own, beside = sensor.shown.of_run(solution), others.get(solution.run, {})
        found = [((beside if whose else own).get(name), digits.get(name, 2)) for name, whose, _ in heads]
        cells = [estimate(each, decimals) for each, decimals in found]
        run = "all" if solution.run is None else str(solution.run)
        rows.append((run, _at(sensor, sensor.shown.temperature_degC.get(solution.runs[0])), solution.verdict, cells))
    models = ", ".join(dict.fromkeys(each.model for each in sensor.solutions))
    return {"heads": heads, "rows": rows, "models": models}


def _units(solutions: Sequence[RunSolution]) -> dict[str, str]:
    return {name: each.unit for solution in solutions for name, each in solution.parameters.items()}


def _unit_of(name: str) -> str:
    return "deg/hr" if name.startswith("B") else "deg/hr/g"


def _models(name: str) -> Sequence[str]:
    """Return whose solutions have a rotor's parameter, in the order of Table 1: the contractor's has biases alone."""
    return ("contractor", "matrix") if name.startswith("B") else ("matrix",)


def _contractors_verdicts(sensor: SensorContent) -> str:
    """Say in which runs the residuals contradict the contractor's model, of which it leaves two."""
    groups: dict[Verdict, list[int]] = {}
    for solution in sensor.contractor.values():
        groups.setdefault(solution.verdict, []).extend(solution.runs)
    words = {Verdict.FAIL: "contradicted", Verdict.MARGINAL: "strained", Verdict.PASS: "not contradicted"}
    told = [
        f"{verdict} ({words[verdict]}) in {numbered('run', groups[verdict])}" for verdict in words if verdict in groups
    ]
    return f"The contractor's model, MU = 0: {'; '.join(told)}." if told else ""


def _worst(found: Mapping[str, Any]) -> Iterator[tuple[str, str, int, list[float]]]:
    """Yield of each of the contractor's four its unit, the run in which it is farthest off, and by how much."""
    for name in CONTRACTORS:
        worst = max(found["contractor_errors"], key=lambda each: abs(each["found"][name]))
        values = [worst[by][name] for by in ("found", "closed_form", "g1_only")]
        yield name, _unit_of(name), worst["run"], values
