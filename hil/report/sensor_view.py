"""One sensor's chapter of the report: Table 1's layout, Figures 2-5, every self-calibration, Table A-1, the scatter."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from typing import Any

import numpy as np

from hil.analysis.published.reproduction import CONTRACTORS, SEVEN, Reproduction
from hil.analysis.scatter.signature import HYPOTHESES, Interval
from hil.analysis.scatter.sources import overall
from hil.campaign import FloatArray
from hil.report.content import Repeat, SensorContent
from hil.report.figures import Line, draw_against_temperature, inline_svg
from hil.report.grid import Cell, Grid, decimals_for, degrees, estimate, number, text, wrap
from hil.solve import RunSolution
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
        "signature": [f"channel {each.axis}: {each.sentence}" for each in overall(sensor.scatter)],
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
        heads.append(Cell(degrees(at), "" if at is None else f"{at * 1.8 + 32.0:.1f} °F"))
    doubtful = [_doubtful(sensor, repeat) for repeat in sensor.repeats]
    return Grid(
        f"table-1-sensor-{sensor.number}",
        "Table 1's layout: mean over the self-calibrations at each temperature and, below it, their one-sigma scatter "
        "(n − 1)." + (" The means hold the runs that are INCONCLUSIVE or FAIL, too." if any(doubtful) else ""),
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


def _doubtful(sensor: SensorContent, repeat: Repeat) -> str:
    """Say how many runs of a mean must not be relied upon, a line for each verdict."""
    found = [each.verdict for each in sensor.solutions if each.runs[0] in repeat.runs]
    return "\n".join(f"{found.count(v)} {v}" for v in (Verdict.FAIL, Verdict.INCONCLUSIVE) if v in found)


def _means(at_each: Sequence[FloatArray | None]) -> Iterator[Cell]:
    """Yield the means of one row, all with as many decimals as its usual scatter asks for."""
    known = [np.empty(0) if values is None else values[np.isfinite(values)] for values in at_each]
    sigmas = [float(np.std(values, ddof=1)) for values in known if len(values) > 1]
    decimals = decimals_for([float(np.median(sigmas))] if sigmas else [])
    for values in known:
        if len(values) > 1:
            yield estimate(float(np.mean(values)), float(np.std(values, ddof=1)), decimals)
        else:
            yield number(float(values[0]), decimals, "single") if len(values) else number(None)


def _of(repeat: Repeat, model: str) -> Mapping[str, FloatArray]:
    return repeat.matrix if model == "matrix" else repeat.contractor


def _figures(sensor: SensorContent) -> Iterator[dict[str, str]]:
    if any(repeat.temperature_degC is None for repeat in sensor.repeats):
        return
    bars = "Bars: one sigma of the self-calibrations at that temperature."
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
        f"{line.label}: {line.mean[0]:.1f} {unit} at {line.temperature_degC[0]:.1f} °C, {line.mean[-1]:.1f} {unit} at "
        f"{line.temperature_degC[-1]:.1f} °C"
        for line in lines
        if len(line.mean)
    )
    svg = inline_svg(draw_against_temperature(title, unit, lines), f"{title} against temperature. {ends}.")
    return {"svg": svg, "caption": caption}


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
    rows = []
    for solution in sensor.solutions:
        run = "all" if solution.run is None else str(solution.run)
        cells = [
            Cell(run),
            Cell(temperature.get(solution.runs[0], "")),
            Cell(str(solution.verdict), kind=solution.verdict),
        ]
        for whose, (name, _) in [*own, *beside]:
            of = solution if not whose else sensor.contractor.get(solution.run)
            found = of.parameters.get(name) if of is not None else None
            cells.append(number(None) if found is None else estimate(found.value, found.se, digits.get(name, 2)))
        rows.append(cells)
    said = " The contractor's four take MU for zero, eqs. (A-13)–(A-16)." if beside else ""
    models = ", ".join(dict.fromkeys(each.model for each in sensor.solutions))
    caption = f"Every self-calibration of sensor {sensor.number}, model {models}: value ± standard error.{said}"
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
    """How repeats scattered, channel by channel; None where nothing was repeated."""
    if not sensor.scatter:
        return None
    heads = [Cell("channel", kind="text"), Cell("at"), Cell("runs"), Cell("σ of C", _RATE), Cell("σ of M", _RATE)]
    heads += [Cell("σ of MU·1 g", _RATE), Cell("correlation", "of C with M"), Cell("what changes", kind="text")]
    rows = []
    for each in sensor.scatter:
        pooled = each.temperature_degC is None
        at = f"{each.temperatures} temperatures" if pooled else degrees(each.temperature_degC)
        spread = (each.sigma_c, each.sigma_m, each.sigma_mu, each.correlation)
        rows.append([text(each.axis), Cell(at), number(each.runs), *map(_interval, spread), wrap(_what(each.verdict))])
    caption = (
        "Repeatability and scatter signature: C is the contractor's bias (Collect 3), M the matrix bias (the mean of "
        "Collects 1 and 2), MU their difference; below each its 95 % interval."
    )
    return Grid(f"scatter-sensor-{sensor.number}", caption, heads, rows)


def _interval(found: Interval) -> Cell:
    known = found.low is not None and found.high is not None
    return number(found.value, 2, f"{found.low:.2f} to {found.high:.2f}" if known else "")


def _what(verdict: str | None) -> str:
    return "cannot tell" if verdict is None else HYPOTHESES[verdict]
