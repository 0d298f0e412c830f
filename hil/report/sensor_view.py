"""One sensor's chapter of the report: Table 1's layout, Figures 2-5, every self-calibration, Table A-1, the scatter."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from typing import Any

import numpy as np

from hil.analysis.published.reproduction import CONTRACTORS, SEVEN, Reproduction
from hil.report.content import Mean, Repeat, SensorContent
from hil.report.figures import Line, draw_against_temperature, inline_svg
from hil.report.grid import Cell, Grid, decimals_for, degrees, estimate, number, text
from hil.solve import RunSolution
from hil.solve.temperatures import WIDEST_DEGC
from procedures.verdict import Judgement, Verdict
from procedures.words import numbered

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
    ("Figure 4's layout: MUA", "MUA", _PER_G, "MUA, eq. (11): what the contractor took for zero."),
    ("Figure 5's layout: MUB", "MUB", _PER_G, "MUB, eq. (12): what the contractor took for zero."),
)

_NO_CONTRACTOR = (
    "The contractor's solution is made from the report's three orientations, which this sensor's collects are not."
)


def sensor_view(sensor: SensorContent) -> dict[str, Any]:
    """Return what the template shows of one sensor."""
    found = sensor.reproduction
    return {
        "number": sensor.number,
        "note": _NO_CONTRACTOR if sensor.is_rotor and not sensor.has_contractor else "",
        "table": _table_1(sensor),
        "figures": list(_figures(sensor)) if len(sensor.repeats) > 1 else [],
        "runs": _runs(sensor),
        "reasons": list(_reasons(sensor)),
        "contractor": _contractors_verdicts(sensor),
        "seven": None if found is None else _table_a1(sensor.number, found),
        "errors": None if found is None else _contractor_errors(sensor.number, found),
        "scatter": _scatter(sensor),
        "shown": sensor.shown.sentences(),
    }


def _table_1(sensor: SensorContent) -> Grid:
    if sensor.is_rotor:
        rows = [row for row in _TABLE_1 if row[2] == "matrix" or sensor.has_contractor]
    else:
        units = {name: each.unit for solution in sensor.solutions for name, each in solution.parameters.items()}
        rows = [(name, name, "matrix", unit) for name, unit in units.items()]
    heads = [Cell("parameter", kind="text")]
    for repeat in sensor.repeats:
        at = repeat.temperature_degC
        heads.append(Cell(degrees(at), "" if at is None else f"{at * 1.8 + 32.0:.1f} °F{_unit(at, repeat)}"))
    doubtful = [_doubtful(sensor, repeat) for repeat in sensor.repeats]
    return Grid(
        f"table-1-sensor-{sensor.number}",
        f"Table 1's layout: mean over the self-calibrations at each temperature and, below it, {_sigmas(sensor)}."
        + (" The means hold the runs that are INCONCLUSIVE or FAIL, too." if any(doubtful) else ""),
        heads,
        [
            [
                Cell("runs", kind="text"),
                *(number(len(each.runs), 0, told) for each, told in zip(sensor.repeats, doubtful, strict=True)),
            ],
            *(
                [Cell(label, unit, "text"), *_means([_of(repeat, model).get(name) for repeat in sensor.repeats])]
                for label, name, model, unit in rows
            ),
        ],
    )


def _unit(at_degC: float, repeat: Repeat) -> str:
    """Say what the unit's own thermometer showed where that was another temperature, or moved by more than one."""
    low, high = repeat.unit_degC or (at_degC, at_degC)
    moved = max(high - at_degC, at_degC - low) > WIDEST_DEGC
    return f"\nunit {low:.1f} to {high:.1f} °C" if moved else ""


def _doubtful(sensor: SensorContent, repeat: Repeat) -> str:
    """Say how many runs of a mean must not be relied upon, a line for each verdict."""
    found = [each.verdict for each in sensor.solutions if each.runs[0] in repeat.runs]
    return "\n".join(f"{found.count(v)} {v}" for v in (Verdict.FAIL, Verdict.INCONCLUSIVE) if v in found)


def _sigmas(sensor: SensorContent) -> str:
    """Say what stands behind ± and what bars show: scatter where runs were repeated, else what one run tells."""
    single = [len(repeat.runs) == 1 for repeat in sensor.repeats]
    scatter = "their one-sigma scatter (n − 1)"
    alone = "standard deviation (s.d.)"
    if not any(single):
        return scatter
    return f"as there is one at each, its {alone}" if all(single) else f"{scatter}; where there is one, its {alone}"


def _means(at_each: Sequence[Mean | None]) -> Iterator[Cell]:
    """Yield the means of one row, all with as many decimals as their usual sigma asks for."""
    sigmas = [each.scatter for each in at_each if each is not None and np.isfinite(each.scatter)]
    decimals = decimals_for([float(np.median(sigmas))] if sigmas else [])
    for each in at_each:
        if each is None:
            yield number(None)
        elif each.runs > 1:
            yield estimate(each.value, each.scatter, decimals)
        else:
            yield number(each.value, decimals, f"±{each.sd:.{decimals}f} s.d." if np.isfinite(each.sd) else "no s.d.")


def _of(repeat: Repeat, model: str) -> Mapping[str, Mean]:
    return repeat.matrix if model == "matrix" else repeat.contractor


def _figures(sensor: SensorContent) -> Iterator[dict[str, str]]:
    if any(repeat.temperature_degC is None for repeat in sensor.repeats):
        return
    bars = f"Mean over the self-calibrations at each temperature; bars: {_sigmas(sensor)}."
    if sensor.is_rotor:
        for title, name, unit, caption in _FIGURES:
            lines = [_line("matrix (M)", sensor, name, "matrix"), _line("contractor (C)", sensor, name, "contractor")]
            if name in {"MUA", "MUB"} or not sensor.has_contractor:
                lines, caption = lines[:1], caption.split(";")[0].rstrip(".") + "."
            yield _figure(title, unit, [line for line in lines if len(line.mean)], f"{caption} {bars}")
        return
    for name, each in sensor.solutions[0].parameters.items():
        line = _line(name, sensor, name, "matrix")
        yield _figure(name, each.unit, [line], f"{name} against temperature. {bars}")


def _figure(title: str, unit: str, lines: Sequence[Line], caption: str) -> dict[str, str]:
    """Return a figure and its caption; its text for ears has the numbers at both ends of each line."""
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
    svg = inline_svg(draw_against_temperature(title, unit, lines), f"{title} against temperature. {ends}.")
    return {"svg": svg, "caption": caption}


def _line(label: str, sensor: SensorContent, name: str, model: str) -> Line:
    known = [(r.temperature_degC, _of(r, model)[name]) for r in sensor.repeats if name in _of(r, model)]
    points = np.array([(at, each.value, each.scatter) for at, each in known], dtype=np.float64).reshape(-1, 3)
    return Line(label, points[:, 0], points[:, 1], points[:, 2], model)


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
    values = "value ± one standard deviation, what repeats show included"
    caption = f"Every self-calibration of sensor {sensor.number}, model {models}: {values}.{said}"
    return Grid(f"runs-sensor-{sensor.number}", caption, heads, rows)


def _units(solutions: Sequence[RunSolution]) -> dict[str, str]:
    return {name: each.unit for solution in solutions for name, each in solution.parameters.items()}


def _reasons(sensor: SensorContent) -> Iterator[dict[str, str]]:
    """Yield each reason once, with its verdict and the runs that it holds for; the worst verdicts first."""
    groups: dict[tuple[int, str, str], list[int]] = {}
    for solution in sensor.solutions:
        groups.setdefault(
            (-Judgement(solution.verdict, solution.reason).severity, str(solution.verdict), solution.reason), []
        ).extend(solution.runs)
    for (_, verdict, reason), runs in sorted(groups.items()):
        yield {"verdict": verdict, "runs": numbered("run", runs), "reason": reason}


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
