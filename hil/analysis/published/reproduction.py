"""RD-GC-86-1 reproduced: Table 1, Figures 2-5 and Table A-1 from one's own night, beside what was printed.

    found = reproduce(campaign)     # hil.reproduction/1
    found["table_1"]                # six rows of cells: mean, sigma, runs; beside each the printed ones
    found["table_a1"]               # the bias BA seven ways, eqs. (A-27)-(A-33), run by run; and the printed rows
    found["contractor_errors"]      # what taking MU for zero does to the contractor's four, exactly, run by run

Printed digits stay as they are; a cell whose identities do not close is marked with what the audit says of it. The
contractor's error has the G3 terms that the report's text leaves out, which at a tilt of 16 milliradians are 0.4
deg/hr/g of GSA for the MUB of 19.7 °F. Solutions are the solver's; what it has not has the report's closed forms here.

Misprints in RD-GC-86-1; the corrected form is followed here:

- eqs. (7)-(10): "+ 2" is a lost division, "/ 2"; as printed they do not even have one dimension;
- eq. (7): its last term, -W1, is right only once the division is restored;
- the matrix equation, row 6 of the left-hand side: RA_2(C3) - W_2 stands for RB_2(C3) - W_2 (C6 has it right);
- the matrix equation, row 6 of the unknowns: MU_SA2 stands for GSB_2;
- the text gives only the G1 term of the contractor's error; `contractor_error` has the G3 terms, too.
"""

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from drivers.strict_yaml import packaged
from hil.analysis.published.audit import Audit
from hil.analysis.published.identities import tilt_of_a1
from hil.analysis.published.printed import SEVEN
from hil.campaign import Campaign, Collects, FloatArray
from hil.errors import InputError
from hil.files.document import plain
from hil.files.units import TEMPERATURE, to_number
from hil.model.equation import RD_GC_86_1_SENSOR_2
from hil.model.forms import MATRIX_6, named_form
from hil.solve.contractor import report_collects, solve_as_contractor
from hil.solve.runs import solve_rates
from hil.solve.temperatures import nearest, runs_by_temperature

CONTRACTORS = MATRIX_6[:4]

_PRINTED = packaged("hil.analysis.published", "printed.yaml")
_LEVEL = np.array([1.0, 0.0, 0.0])

_Run = tuple[dict[str, float], dict[str, Any], dict[str, Any]]
"""Parameters of one run as the report solves it, its entries in Table A-1 and among the contractor's errors."""


def reproduce(campaign: Campaign, sensor: int = 2) -> dict[str, Any]:
    """Return the report's tables and figures from the runs of a campaign that have its three collects.

    A cell of Table 1 has mean and sigma (n - 1; None for one run) over `runs`, and the printed cell with what the audit
    says where it is doubtful. The contractor's errors are found, by the closed form, and by its G1 term alone.
    Raises `InputError` where the sensor is not there, or none of its runs has Collects 1, 2 and 3.
    """
    if sensor not in campaign.sensors:
        raise InputError(
            f"{campaign.title}: there is no sensor {sensor}; there are {', '.join(map(str, campaign.sensors))}"
        )
    rows = campaign.sensors[sensor]
    solved = {run: found for run in np.unique(rows.conditions.run).tolist() if (found := _run(rows, run)) is not None}
    if not solved:
        raise InputError(f"{campaign.title}: no run of sensor {sensor} has the report's Collects 1, 2 and 3")
    audit = Audit("rd-gc-86-1-table-1")
    groups = {
        temperature: own
        for temperature, runs in runs_by_temperature(rows.conditions)
        if (own := [solved[run] for run in runs if run in solved])
    }
    as_printed: dict[float | None, str] = {to_number(row.group, TEMPERATURE): row.group for row in audit.table.rows}
    labels = [as_printed.get(nearest(temperature, as_printed)) for temperature in groups]
    table = [
        {
            "label": label,
            "unit": unit,
            "cells": [
                _cell(runs, name, _printed(audit, at, axis, role))
                for runs, at in zip(groups.values(), labels, strict=True)
            ],
        }
        for label, unit, name, axis, role in _PRINTED["rows"]
    ]
    printed = Audit("rd-gc-86-1-table-a1").table.rows
    return {
        "schema": "hil.reproduction/1",
        "sensor": sensor,
        "simulated": campaign.simulated,
        "temperatures_degC": plain([*groups]),
        "printed_temperatures": labels,
        "table_1": table,
        "figures": [
            {"title": title, "unit": unit, "lines": [_line(label, table[row], [*groups]) for label, row in of.items()]}
            for title, unit, of in _PRINTED["figures"]
        ],
        "table_a1": [seven for _, seven, _ in solved.values()],
        "printed_a1": [_seven(str(row.label), row.values()) for row in printed],
        "contractor_errors": [error for _, _, error in solved.values()],
    }


def _line(label: str, row: Mapping[str, Any], temperatures_degC: Sequence[float | None]) -> dict[str, Any]:
    cells = row["cells"]
    return {
        "label": label,
        "temperature_degC": temperatures_degC,
        "mean": [cell["mean"] for cell in cells],
        "sigma": [cell["sigma"] for cell in cells],
        "printed_mean": [cell["printed"] and cell["printed"]["mean"] for cell in cells],
        "printed_sigma": [cell["printed"] and cell["printed"]["sigma"] for cell in cells],
    }


def _seven(label: str, biases: Mapping[str, float]) -> dict[str, Any]:
    """Return one row of Table A-1: BA by eqs. (A-27)-(A-33) in deg/hr, and what follows: MUB G1, MUB G3, G3/G1."""
    tilt = {name: value for name, value in tilt_of_a1(biases).items() if name != "eps"}
    return {"row": label, "biases_deg_per_hr": {name: biases[name] for name in SEVEN}, **tilt}


def _run(collects: Collects, run: int) -> _Run | None:
    """Solve one run as the report does, each collect being the mean of those at its orientation."""
    of_run = collects.rows(collects.conditions.run == run)
    measured = of_run.rows(~np.any(np.isnan(of_run.rates_deg_per_hr), axis=1))
    kind = report_collects(measured.conditions.f_g)
    if not {1, 2, 3} <= set(kind.tolist()):
        return None
    chosen = [measured.rows(kind == number) for number in (1, 2, 3)]
    rates = np.array([each.rates_deg_per_hr.mean(axis=0) for each in chosen])
    axes = [RD_GC_86_1_SENSOR_2[label].axes for label in "123"]
    # G and W in the bench frame, as the three collects together give them.
    gravity = np.mean([of.T @ each.conditions.f_g.mean(axis=0) for of, each in zip(axes, chosen, strict=True)], axis=0)
    earth = np.mean(
        [of.T @ each.conditions.w_deg_per_hr.mean(axis=0) for of, each in zip(axes, chosen, strict=True)], axis=0
    )
    three = measured.rows(kind > 0)
    own = three.conditions
    less_earth = three.rates_deg_per_hr - own.w_channels_deg_per_hr
    matrix = solve_rates(named_form("matrix-6", own).columns(own), less_earth, None).values
    contractor = solve_as_contractor(three, None).values
    named = dict(zip(MATRIX_6, matrix.tolist(), strict=True))
    seven = seven_biases(rates, gravity, earth, named["GSA"], named["GSB"], named["MUB"])
    errors = {
        "found": contractor - matrix[:4],
        "closed_form": contractor_error(gravity, named["MUA"], named["MUB"]),
        "g1_only": contractor_error(gravity[0] * _LEVEL, named["MUA"], named["MUB"]),
    }
    return (
        {**named, "BA Collins": float(contractor[0]), "BB Collins": float(contractor[1])},
        _seven(f"run {run}", dict(zip(SEVEN, seven.tolist(), strict=True))),
        {"run": run, **{by: dict(zip(CONTRACTORS, plain(of), strict=True)) for by, of in errors.items()}},
    )


def _cell(runs: Sequence[_Run], name: str, printed: dict[str, Any] | None) -> dict[str, Any]:
    values = np.array([parameters[name] for parameters, _, _ in runs])
    sigma = float(values.std(ddof=1)) if len(values) > 1 else None
    return {"mean": float(values.mean()), "sigma": sigma, "runs": len(values), "printed": printed}


def _printed(audit: Audit, group: str | None, axis: str, role: str) -> dict[str, Any] | None:
    row = next((each for each in audit.table.rows if each.group == group and each.axis == axis), None)
    if row is None or role not in row.cells:
        return None
    sigma = row.cells.get(f"sigma_{role}")
    doubts = [
        f"{each.identity.name}: {each.residual:+.4f} is {each.verdict}"
        for each in audit.findings
        if each.row is row and each.verdict != "ok" and {role, f"sigma_{role}"} & set(each.identity.roles)
    ]
    said = {"mean": row.cells[role].value, "sigma": None if sigma is None else sigma.value}
    return said | {"runs": row.n_stated, "doubt": "; ".join(doubts) or None}


def contractor_error(G: FloatArray, mua: float, mub: float) -> FloatArray:
    """Return contractor's minus true BA, BB, GSA, GSB, (4,), where MU is not zero; `G` (3,) is (G1, G2, G3) in g.

    Exact: BA by MUB (G1 + G3²/G1) + MUA G2 G3/G1, BB by -MUA (G1 + G3²/G1) + MUB G2 G3/G1, GSA by -MUB G3/G1, GSB by
    -MUA G3/G1. With G3 = 0 that is the report's statement, the bias off by MUB G1 and -MUA G1.
    """
    g1, g2, g3 = G
    long, short = g1 + g3**2 / g1, g2 * g3 / g1
    return np.array([mub * long + mua * short, -mua * long + mub * short, -mub * g3 / g1, -mua * g3 / g1])


def seven_biases(rates: FloatArray, G: FloatArray, W: FloatArray, gsa: float, gsb: float, mub: float) -> FloatArray:
    """Return the bias BA seven ways, eqs. (A-27)-(A-33), for given GSA, GSB, MUB; shape (7,).

    `rates` (3, 2) are those of Collects 1, 2, 3 by (RA, RB), deg/hr; `G` (3,), g, and `W` (3,), deg/hr, lie along the
    bench axes. With true parameters and no noise they are BA + {0, MUB G3, -MUB G3, MUB G1, 0, 0, 0}.
    """
    ra1, ra2, ra3 = rates[:, 0]
    (g1, g2, g3), (w1, _, w3) = G, W
    from_1 = ra1 + gsa * g1 - gsb * g2 + w1
    from_2 = ra2 - gsa * g1 - gsb * g2 - w1
    from_3 = ra3 - gsa * g3 - gsb * g2 - w3  # the contractor's
    mean = (ra1 + ra2) / 2 - gsb * g2  # the matrix solution
    return np.array([mean, from_1, from_2, from_3, from_1 - mub * g3, from_2 + mub * g3, from_3 - mub * g1])
