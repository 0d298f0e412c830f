"""RD-GC-86-1 reproduced: Table 1, Figures 2-5 and Table A-1 from one's own night, beside what was printed.

    found = reproduce(campaign)
    found.table_1                # six rows of cells: mean, sigma, runs; beside each the printed ones
    found.table_a1               # the bias BA seven ways, eqs. (A-27)-(A-33), run by run; and the printed rows
    found.contractor_errors      # what taking MU for zero does to the contractor's four, exactly, run by run

Printed digits stay as they are; a cell whose identities do not close is marked with what the audit says of it. The
contractor's error has the G3 terms that the report's text leaves out: BA is off by MUB (G1 + G3²/G1) + MUA G2 G3/G1,
GSA by -MUB G3/G1, which at a tilt of 16 milliradians is 0.4 deg/hr/g for the MUB of 19.7 °F.
"""

import math
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass
from typing import Any

import numpy as np

from drivers.strict_yaml import packaged
from hil.analysis.published import Audit, audit_table
from hil.analysis.published.closed_forms import contractor_error, contractor_solution, matrix_solution, seven_biases
from hil.campaign import Campaign, Collects, FloatArray
from hil.errors import InputError
from hil.files.document import picked, plain
from hil.files.units import TEMPERATURE, to_number
from hil.model.equation import RD_GC_86_1_SENSOR_2
from hil.model.forms import MATRIX_6
from hil.solve.contractor import report_collects
from hil.solve.temperatures import nearest, runs_by_temperature

SCHEMA = "hil.reproduction/1"
SEVEN = tuple(f"A-{number}" for number in range(27, 34))
CONTRACTORS = MATRIX_6[:4]

_PRINTED = packaged("hil.analysis.published", "printed.yaml")


@dataclass(frozen=True)
class Printed:
    """A printed cell: mean, one sigma, the number of runs as stated, and what the audit says where it is doubtful."""

    mean: float
    sigma: float | None
    runs: int | None
    doubt: str | None


@dataclass(frozen=True)
class Cell:
    """One cell of Table 1 as measured: mean and sigma (n - 1; None for one run) over `runs`, beside the printed one."""

    mean: float
    sigma: float | None
    runs: int
    printed: Printed | None


@dataclass(frozen=True)
class Row:
    """One line of Table 1: a parameter over the temperatures."""

    label: str
    unit: str
    cells: tuple[Cell, ...]


@dataclass(frozen=True)
class SevenBiases:
    """One row of Table A-1: BA by eqs. (A-27)-(A-33) in deg/hr, and what follows: MUB G1, MUB G3, G3/G1."""

    label: str
    biases: Mapping[str, float]

    @property
    def mub_g1(self) -> float:
        """MUB·G1 = (A-30) - (A-33)."""
        return self.biases["A-30"] - self.biases["A-33"]

    @property
    def mub_g3(self) -> float:
        """MUB·G3 = (A-28) - (A-31)."""
        return self.biases["A-28"] - self.biases["A-31"]

    @property
    def g3_over_g1(self) -> float:
        """The tilt in the 1-3 plane, radian: NaN where MUB is nothing."""
        return self.mub_g3 / self.mub_g1 if self.mub_g1 else math.nan


@dataclass(frozen=True)
class ContractorError:
    """The contractor's less the matrix parameters of one run: as found, by the closed form, and by its G1 term alone.

    Each (4,) in the order BA, BB, GSA, GSB.
    """

    run: int
    found: FloatArray
    closed_form: FloatArray
    g1_only: FloatArray


@dataclass(frozen=True)
class Reproduction:
    """Everything of the report that a night gives again."""

    sensor: int
    simulated: bool
    temperatures_degC: tuple[float | None, ...]
    printed_temperatures: tuple[str | None, ...]
    table_1: tuple[Row, ...]
    table_a1: tuple[SevenBiases, ...]
    printed_a1: tuple[SevenBiases, ...]
    contractor_errors: tuple[ContractorError, ...]

    def document(self) -> dict[str, Any]:
        """Return what `hil reproduce --json` prints."""
        return {
            "schema": SCHEMA,
            **picked(self, "sensor simulated temperatures_degC printed_temperatures"),
            "table_1": [asdict(row) for row in self.table_1],
            "figures": [
                {"title": title, "unit": unit, "lines": [self._line(label, row) for label, row in lines.items()]}
                for title, unit, lines in _PRINTED["figures"]
            ],
            "table_a1": [_seven_entry(each) for each in self.table_a1],
            "printed_a1": [_seven_entry(each) for each in self.printed_a1],
            "contractor_errors": [
                {name: of if name == "run" else dict(zip(CONTRACTORS, plain(of), strict=True)) for name, of in said}
                for said in (vars(each).items() for each in self.contractor_errors)
            ],
        }

    def _line(self, label: str, row: int) -> dict[str, Any]:
        """Return a line of a figure: a row of Table 1 against temperature, null where there is nothing."""
        cells = self.table_1[row].cells
        return {
            "label": label,
            "temperature_degC": list(self.temperatures_degC),
            "mean": [cell.mean for cell in cells],
            "sigma": [cell.sigma for cell in cells],
            "printed_mean": [cell.printed and cell.printed.mean for cell in cells],
            "printed_sigma": [cell.printed and cell.printed.sigma for cell in cells],
        }


def reproduce(campaign: Campaign, sensor: int = 2) -> Reproduction:
    """Return the report's tables and figures from the runs of a campaign that have its three collects.

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
    audit = audit_table("rd-gc-86-1-table-1")
    groups = [
        (temperature, [solved[run] for run in runs if run in solved])
        for temperature, runs in runs_by_temperature(rows.conditions)
    ]
    groups = [(temperature, runs) for temperature, runs in groups if runs]
    labels = [_printed_temperature(audit, temperature) for temperature, _ in groups]
    table = tuple(
        Row(
            label,
            unit,
            tuple(
                _cell(runs, name, _printed(audit, at, axis, role)) for (_, runs), at in zip(groups, labels, strict=True)
            ),
        )
        for label, unit, name, axis, role in _PRINTED["rows"]
    )
    return Reproduction(
        sensor,
        campaign.simulated,
        tuple(temperature for temperature, _ in groups),
        tuple(labels),
        table,
        tuple(each.seven for each in solved.values()),
        _printed_seven(),
        tuple(each.error for each in solved.values()),
    )


@dataclass(frozen=True)
class _Run:
    """One run by the report's closed forms."""

    parameters: Mapping[str, float]
    seven: SevenBiases
    error: ContractorError


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
    matrix = matrix_solution(rates, gravity, earth)
    contractor = contractor_solution(rates, gravity, earth)
    named = dict(zip(MATRIX_6, matrix.tolist(), strict=True))
    seven = seven_biases(rates, gravity, earth, named["GSA"], named["GSB"], named["MUB"])
    level = np.array([1.0, 0.0, 0.0])
    return _Run(
        {**named, "BA Collins": float(contractor[0]), "BB Collins": float(contractor[1])},
        SevenBiases(f"run {run}", dict(zip(SEVEN, seven.tolist(), strict=True))),
        ContractorError(
            run,
            contractor - matrix[:4],
            contractor_error(gravity, named["MUA"], named["MUB"]),
            contractor_error(gravity[0] * level, named["MUA"], named["MUB"]),
        ),
    )


def _cell(runs: Sequence[_Run], name: str, printed: Printed | None) -> Cell:
    values = np.array([run.parameters[name] for run in runs])
    sigma = float(values.std(ddof=1)) if len(values) > 1 else None
    return Cell(float(values.mean()), sigma, len(values), printed)


def _printed_temperature(audit: Audit, temperature_degC: float | None) -> str | None:
    """Return the printed temperature that this one is, as it is printed."""
    printed = {to_number(row.group, TEMPERATURE): row.group for row in audit.table.rows}
    match = nearest(temperature_degC, list(printed))
    return None if match is None else printed[match]


def _printed(audit: Audit, group: str | None, axis: str, role: str) -> Printed | None:
    row = next((each for each in audit.table.rows if each.group == group and each.axis == axis), None)
    if row is None or role not in row.cells:
        return None
    sigma = row.cells.get(f"sigma_{role}")
    doubts = [
        f"{each.identity.name}: {each.residual:+.4f} is {each.verdict}"
        for each in audit.findings
        if each.row is row and each.verdict != "ok" and {role, f"sigma_{role}"} & set(each.identity.roles)
    ]
    return Printed(
        row.cells[role].value, None if sigma is None else sigma.value, row.n_stated, "; ".join(doubts) or None
    )


def _printed_seven() -> tuple[SevenBiases, ...]:
    rows = audit_table("rd-gc-86-1-table-a1").table.rows
    return tuple(SevenBiases(str(row.label), {role: row.cells[role].value for role in SEVEN}) for row in rows)


def _seven_entry(each: SevenBiases) -> dict[str, Any]:
    return picked(each, "row=label biases_deg_per_hr=biases MUB_G1=mub_g1 MUB_G3=mub_g3 G3_over_G1=g3_over_g1")
