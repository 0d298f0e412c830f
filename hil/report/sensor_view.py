"""One sensor's chapter of the report: its pictures, its means by temperature, every self-calibration, the scatter."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from itertools import groupby
from typing import Any

import numpy as np

from hil.analysis.published.reproduction import CONTRACTORS, SEVEN, Reproduction
from hil.files.grid import Cell, Grid, decimals_for, degrees, estimate, number, text
from hil.files.page import inline_svg
from hil.report.content import Repeat, ReportContent, SensorContent
from hil.report.figures import Line, draw_against_temperature
from hil.solve import RunSolution
from hil.solve.repeats import MeanAt, Uncertain
from hil.solve.temperatures import WIDEST_DEGC
from procedures.verdict import Judgement, Verdict
from procedures.words import numbered

_RATE, _PER_G = "deg/hr", "deg/hr/g"
_ROOM_DEGC = 20.0

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
    ("Figure 2's layout: bias A, eq. (5)", "BA", _RATE),
    ("Figure 3's layout: bias B, eq. (6)", "BB", _RATE),
    ("Figure 4's layout: MUA, eq. (11)", "MUA", _PER_G),
    ("Figure 5's layout: MUB, eq. (12)", "MUB", _PER_G),
)

_NO_CONTRACTOR = (
    "The contractor's solution is made from the report's three orientations, which this sensor's collects are not."
)


def sensor_view(sensor: SensorContent, *, published: bool = False) -> dict[str, Any]:
    """Return what the template shows of one sensor; `published`: the report speaks RD-GC-86-1's words."""
    found = sensor.reproduction
    return {
        "number": sensor.number,
        "note": _NO_CONTRACTOR if published and sensor.is_rotor and not sensor.has_contractor else "",
        "table": _by_temperature(sensor),
        "figures": list(_figures(sensor)) if len(sensor.repeats) > 1 else [],
        "published": sensor.has_contractor,
        "runs": _runs(sensor),
        "contractor": _contractors_verdicts(sensor),
        "seven": None if found is None else _table_a1(sensor.number, found),
        "errors": None if found is None else _contractor_errors(sensor.number, found),
        "scatter": _scatter(sensor),
        "shown": sensor.shown.sentences(),
    }


def in_words(name: str) -> str:
    """Say what a parameter is: its symbol alone tells those who know it already."""
    if name.startswith(("GS", "MU")):
        return f"drift per g {'across' if name.startswith('GS') else 'along'} the spin axis"
    return f"bias of channel {name[1:].lstrip('_')}" if name.startswith("B") else "drift per g"


def key_numbers(content: ReportContent) -> Grid | None:
    """The numbers in one look: each parameter nearest to room temperature, and between which it lies over all."""
    sensors = [each for each in content.sensors if each.repeats][:_MOST_SENSORS]
    if not sensors:
        return None
    heads, columns = [Cell("parameter", kind="text")], []
    for sensor in sensors:
        room = min(sensor.repeats, key=_from_room)
        heads.append(Cell(f"sensor {sensor.number}, {degrees(room.temperature_degC)}"))
        columns.append((sensor, room.matrix.values))
        heads += [Cell(f"lowest … highest, {len(sensor.repeats)} temperatures")] * (len(sensor.repeats) > 1)
    units = {name: unit for sensor in sensors for name, unit in _units(sensor.solutions).items()}
    rows = []
    for name, unit in units.items():
        cells = [Cell(f"{in_words(name)}, {name}", kind="text")]
        for sensor, at_room in columns:
            one = at_room.get(name)
            digits = decimals_for([None if one is None else one.sd])
            cells.append(_bold(one, digits, unit))
            all_of = [each.matrix.values[name].value for each in sensor.repeats if name in each.matrix.values]
            if len(sensor.repeats) > 1:
                cells.append(Cell(f"{min(all_of):.{digits}f} … {max(all_of):.{digits}f}" if all_of else "–"))
        rows.append(cells)
    left = len(content.sensors) - len(sensors)
    more = f" {left} more sensors are below." if left > 0 else ""
    return Grid("numbers", f"Means, ± their standard uncertainty, scatter from run to run included.{more}", heads, rows)


_MOST_SENSORS = 3  # beside each other in one look


def _from_room(repeat: Repeat) -> float:
    return 0.0 if repeat.temperature_degC is None else abs(repeat.temperature_degC - _ROOM_DEGC)


def _bold(one: Uncertain | None, digits: int, unit: str) -> Cell:
    if one is None:
        return number(None)
    shown = estimate(one.value, one.sd, digits)
    return Cell(shown.text, f"{shown.below} {unit}" if shown.below else unit, "bold")


def _by_temperature(sensor: SensorContent) -> Grid:
    if sensor.has_contractor:
        rows: Sequence[tuple[str, str, str, str]] = _TABLE_1
    else:
        rows = [(name, name, "matrix", unit) for name, unit in _units(sensor.solutions).items()]
    heads = [Cell("parameter", kind="text")]
    for repeat in sensor.repeats:
        at = repeat.temperature_degC
        fahrenheit = f"{at * 1.8 + 32.0:.1f} °F" if at is not None and sensor.has_contractor else ""
        heads.append(Cell(degrees(at), "\n".join(filter(None, [fahrenheit, _unit(repeat)]))))
    doubtful = [_doubtful(sensor, repeat) for repeat in sensor.repeats]
    caption = "Mean over the self-calibrations at each temperature, ± its standard uncertainty, as the bars above"
    if sensor.has_contractor:
        caption = (
            f"Table 1's layout. {caption}; below it their one-sigma scatter σ (n − 1). The contractor took MU for zero"
        )
    return Grid(
        f"means-sensor-{sensor.number}",
        f"{caption}. The means hold the runs that are INCONCLUSIVE or FAIL, too." if any(doubtful) else f"{caption}.",
        heads,
        [
            [
                Cell("runs", kind="text"),
                *(number(len(each.runs), 0, told) for each, told in zip(sensor.repeats, doubtful, strict=True)),
            ],
            *(
                [
                    Cell(label, unit, "text"),
                    *_means([_of(repeat, model) for repeat in sensor.repeats], name, sensor.has_contractor),
                ]
                for label, name, model, unit in rows
            ),
        ],
    )


def _unit(repeat: Repeat) -> str:
    """Say what the unit's own thermometer showed where that was another temperature, or moved by more than one."""
    at_degC = repeat.temperature_degC
    if at_degC is None or repeat.matrix.unit_degC is None:
        return ""
    low, high = repeat.matrix.unit_degC
    moved = max(high - at_degC, at_degC - low) > WIDEST_DEGC
    return f"unit {low:.1f} to {high:.1f} °C" if moved else ""


def _doubtful(sensor: SensorContent, repeat: Repeat) -> str:
    """Say how many runs of a mean must not be relied upon, a line for each verdict."""
    found = [each.verdict for each in sensor.solutions if each.runs[0] in repeat.runs]
    return "\n".join(f"{found.count(v)} {v}" for v in (Verdict.FAIL, Verdict.INCONCLUSIVE) if v in found)


def _means(at_each: Sequence[MeanAt | None], name: str, with_scatter: bool) -> Iterator[Cell]:
    """Yield the means of one row, all with as many decimals as their usual uncertainty asks for."""
    found = [None if each is None else each.values.get(name) for each in at_each]
    sds = [each.sd for each in found if each is not None and np.isfinite(each.sd)]
    decimals = decimals_for([float(np.median(sds))] if sds else [])
    for at, each in zip(at_each, found, strict=True):
        if at is None or each is None:
            yield number(None)
            continue
        shown = estimate(each.value, each.sd, decimals)
        scatter = at.scatter[name] if with_scatter else np.nan
        below = [shown.below or "± not known", f"σ {scatter:.{decimals}f}" if np.isfinite(scatter) else ""]
        yield Cell(shown.text, "\n".join(filter(None, below)))


def _of(repeat: Repeat, model: str) -> MeanAt | None:
    return repeat.matrix if model == "matrix" else repeat.contractor


def _figures(sensor: SensorContent) -> Iterator[str]:
    """Yield pictures of the means against temperature: one for parameters of a kind, or the published four."""
    if any(repeat.temperature_degC is None for repeat in sensor.repeats):
        return
    if sensor.has_contractor:
        for title, name, unit in _FIGURES:
            lines = [_line("matrix (M)", sensor, name, "matrix", "matrix")]
            if name.startswith("B"):
                lines.append(_line("contractor (C)", sensor, name, "contractor", "contractor"))
            yield _figure(title, unit, lines, fahrenheit=True)
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
            f"{line.temperature_degC[place]:.1f} °C"
            for place in (0, -1)
        )
        for line in lines
        if len(line.mean)
    )
    figure = draw_against_temperature(title, unit, lines, fahrenheit=fahrenheit)
    return inline_svg(figure, f"{title} against temperature. {ends}.")


def _line(label: str, sensor: SensorContent, name: str, model: str, style: str) -> Line:
    means = [of for repeat in sensor.repeats if (of := _of(repeat, model)) is not None and name in of.values]
    known = [(of.temperature_degC, of.values[name].value, of.values[name].sd) for of in means]
    points = np.array(known, dtype=np.float64).reshape(-1, 3)
    return Line(label, points[:, 0], points[:, 1], points[:, 2], style)


def _runs(sensor: SensorContent) -> Grid:
    """Every self-calibration: each parameter of the matrix solution, then of the contractor's, with its uncertainty."""
    temperature = {run: degrees(repeat.temperature_degC) for repeat in sensor.repeats for run in repeat.runs}
    own = [("", each) for each in _units(sensor.solutions).items()]
    beside = [("contractor\n", each) for each in _units(list(sensor.contractor.values())).items()]
    digits = {
        name: decimals_for(each.parameters[name].se for each in sensor.solutions if name in each.parameters)
        for name in _units(sensor.solutions)
    }
    heads = [Cell("run"), Cell("at"), Cell("verdict", kind="text")]
    heads += [Cell(name, whose + unit) for whose, (name, unit) in [*own, *beside]]
    rows, shown = [], sensor.contractor_shown
    others = {} if shown is None else {run: shown.of_run(each) for run, each in sensor.contractor.items()}
    for solution in sensor.solutions:
        uncertain = sensor.shown.of_run(solution)
        run = "all" if solution.run is None else str(solution.run)
        cells = [
            Cell(run),
            Cell(temperature.get(solution.runs[0], "")),
            Cell(str(solution.verdict), kind=solution.verdict),
        ]
        for whose, (name, _) in [*own, *beside]:
            found = (uncertain if not whose else others.get(solution.run, {})).get(name)
            cells.append(number(None) if found is None else estimate(found.value, found.sd, digits.get(name, 2)))
        rows.append(cells)
    said = " The contractor's four take MU for zero, eqs. (A-13)–(A-16)." if beside else ""
    models = ", ".join(dict.fromkeys(each.model for each in sensor.solutions))
    values = "value ± its standard uncertainty"
    caption = f"Every self-calibration of sensor {sensor.number}, model {models}: {values}.{said}"
    return Grid(f"runs-sensor-{sensor.number}", caption, heads, rows)


def _units(solutions: Sequence[RunSolution]) -> dict[str, str]:
    return {name: each.unit for solution in solutions for name, each in solution.parameters.items()}


def reasons(sensors: Sequence[SensorContent]) -> Iterator[dict[str, str]]:
    """Yield each reason once, with its verdict and the sensors and runs that it holds for; the worst come first."""
    groups: dict[tuple[int, str, str], dict[int, list[int]]] = {}
    for solution in (each for sensor in sensors for each in sensor.solutions):
        key = (-Judgement(solution.verdict, solution.reason).severity, str(solution.verdict), solution.reason)
        groups.setdefault(key, {}).setdefault(solution.sensor, []).extend(solution.runs)
    for (_, verdict, reason), of in sorted(groups.items(), key=lambda each: each[0]):
        where = "; ".join(f"sensor {number}, {numbered('run', runs)}" for number, runs in of.items())
        yield {"verdict": verdict, "runs": where, "reason": reason}


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


def _table_a1(sensor: int, found: Reproduction) -> Grid:
    heads = [Cell("run", kind="text"), *(Cell(f"({name})", _RATE) for name in SEVEN)]
    heads += [Cell("MUB·G1", _RATE), Cell("MUB·G3", _RATE), Cell("G3/G1", "rad")]
    return Grid(
        f"table-a-1-sensor-{sensor}",
        "Table A-1's layout: the bias BA seven ways, eqs. (A-27)–(A-33). Without noise (A-27) and (A-31)–(A-33) are "
        "BA, (A-28) and (A-29) are off by ±MUB·G3, and (A-30), the contractor's, by MUB·G1.",
        heads,
        [
            [
                text(each.label.removeprefix("run ")),
                *(number(each.biases[name], 2) for name in SEVEN),
                number(each.mub_g1, 2),
                number(each.mub_g3, 2),
                number(each.g3_over_g1, 4),
            ]
            for each in found.table_a1
        ],
    )


def _contractor_errors(sensor: int, found: Reproduction) -> Grid:
    rows = []
    for place, name in enumerate(CONTRACTORS):
        worst = max(found.contractor_errors, key=lambda each: abs(each.found[place]))
        values = (worst.found[place], worst.closed_form[place], worst.g1_only[place])
        unit = _RATE if name.startswith("B") else _PER_G
        rows.append([Cell(name, unit, "text"), number(worst.run), *(number(float(value), 2) for value in values)])
    return Grid(
        f"contractor-sensor-{sensor}",
        "What taking MU for zero does to the contractor's four: contractor's less matrix, the largest of all runs.",
        [
            Cell("parameter", kind="text"),
            Cell("in run"),
            Cell("as found"),
            Cell("by the closed form", "G1 and G3 terms"),
            Cell("by the G1 term alone", "as the report's text has it"),
        ],
        rows,
    )


def _scatter(sensor: SensorContent) -> Grid | None:
    """How much parameters change from run to run; None where nothing was repeated."""
    shown = sensor.shown.document()["run_to_run"]
    if not shown:
        return None
    heads = [Cell("parameter", kind="text"), Cell("from run to run", "one σ"), Cell("of it", "not in standard errors")]
    heads.append(Cell("degrees of freedom"))
    rows = [
        [
            Cell(name, each["unit"], "text"),
            number(each["sd"], 2),
            number(each["beyond_standard_errors"], 2),
            number(each["degrees_of_freedom"], 0),
        ]
        for name, each in shown.items()
    ]
    caption = "Repeatability: standard deviation of single runs at one temperature, all temperatures together."
    return Grid(f"scatter-sensor-{sensor.number}", caption, heads, rows)
