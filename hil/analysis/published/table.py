"""A published table of parameters as a campaign: what the printed means say that the collects must have been.

    campaign = read_published_table(Path("table1.csv"))

Table 1 of RD-GC-86-1 prints no rates. It prints two biases per channel and temperature: the matrix solution's, which
is the mean of Collects 1 and 2 (eqs. 9, 10), and the contractor's, which is Collect 3 (eqs. 5, 6). With G = (1, 0, 0)
these are the rates that Collects 1 and 2 have in common and the rate of Collect 3. What the table does not determine
(GSA, GSB, earth rate) is taken as zero and said so. Printed digits are kept; flagged cells, and cells that contradict
each other, are named in the notes, which stay with the campaign.
"""

from pathlib import Path

import numpy as np

from hil.analysis.published.audit import Audit
from hil.analysis.published.printed import check_sizes, check_units
from hil.campaign import Campaign, Collects, Conditions, FloatArray, Sensor
from hil.campaign.table import ABSOLUTE_ZERO_DEGC, Table
from hil.errors import InputError
from hil.files.strict import find_config
from procedures.words import listed

_COLUMNS = ("temperature_C", "parameter", "mean_printed", "sigma_printed", "n_stated")
_BIASES = {"RA": ("BA2_matrix", "BA2_collins"), "RB": ("BB2_matrix", "BB2_collins")}
_SENSOR = Sensor(2, ("A", "B", "S"), {"RA": "A", "RB": "B"})
_COLLECT_F = {"1": (-1.0, 0.0, 0.0), "2": (1.0, 0.0, 0.0), "3": (0.0, 0.0, 1.0)}
_NOT_PRINTED = ("GSA", "GSB")
_REPEAT_S = 3 * 3600.0  # how far the temperatures lie apart is not printed; only their order matters
_NOTE = (
    "Rebuilt from printed means: Collects 1 and 2 share the matrix bias, Collect 3 is the contractor's bias. GSA, GSB "
    "and the earth rate are not printed and taken as zero; G = (1, 0, 0); when the collects were made is not known. "
    "Each rate is a mean of the printed number of runs, with the standard error of that mean; the printed sigma of MU "
    "is not used: standard errors of collects cannot say that the two biases scatter together."
)


def read_published_table(table: Path) -> Campaign:
    """Read a table in the layout of Table 1, one row per parameter and temperature, as a campaign of one sensor.

    `table` is a path, or the name of a table that ships (rd-gc-86-1-table-1).

    One run per temperature, three collects each; standard errors are the printed sigmas over root n. Raises
    `InputError` naming file, row and column.
    """
    path = find_config("tables", table)
    lines, means, sigmas, counts, flags = _read(path)
    temperatures = sorted({temperature for temperature, _ in lines})
    rates, errors = [], []
    for temperature in temperatures:
        for label in _COLLECT_F:
            names = [both[label == "3"] for both in _BIASES.values()]
            if lacking := [name for name in names if (temperature, name) not in lines]:
                raise InputError(f"{path}: the table has no {lacking[0]} at {temperature:g} °C")
            found = [lines[temperature, name] for name in names]
            rates.append(means[found])
            # Collects 1 and 2 share one mean: each is less certain than their mean by root two.
            spread = 1.0 if label == "3" else np.sqrt(2.0)
            errors.append(spread * sigmas[found] / np.sqrt(counts[found]))
    flagged: dict[tuple[float, str], list[str]] = {}
    for (temperature, parameter), line in sorted(lines.items()):
        if (flag := flags[line] or "ok") != "ok":
            flagged.setdefault((temperature, flag), []).append(parameter)
    kept = [f"at {degC:g} °C flagged {flag}, kept as printed: {listed(of)}" for (degC, flag), of in flagged.items()]
    repeat = len(_COLLECT_F)
    n = repeat * len(temperatures)
    start_s = (np.arange(len(temperatures))[:, None] * _REPEAT_S + np.arange(repeat) * 300.0).ravel()
    conditions = Conditions(
        sensor=_SENSOR,
        collect=np.arange(1, n + 1),
        run=np.repeat(np.arange(1, len(temperatures) + 1), repeat),
        position=np.array(list(_COLLECT_F) * len(temperatures)),
        start_s=start_s,
        duration_s=np.full(n, 60.0),
        f_g=np.array(list(_COLLECT_F.values()) * len(temperatures)),
        w_deg_per_hr=np.zeros((n, 3)),
        columns={"temperature_degC": np.repeat(np.array(temperatures), repeat)},
    )
    return Campaign(
        title=f"{path.stem}, rebuilt from printed means",
        source=f"{path.name}, a published table",
        sensors={2: Collects(conditions, np.array(rates), np.array(errors))},
        notes="\n".join([_NOTE, *(f"{path.name}: {each}" for each in (*kept, _audited(path)))]),
        rebuilt=True,
        taken_as_zero=_NOT_PRINTED,
    )


def _audited(path: Path) -> str:
    try:
        return f"hil audit: {Audit(path).summary()}"
    except InputError as error:
        return f"hil audit: {str(error).removeprefix(f'{path}: ')}"


def _read(path: Path) -> tuple[dict[tuple[float, str], int], FloatArray, FloatArray, FloatArray, list[str]]:
    """Return the line of each temperature and parameter; and of each line mean, sigma, runs, (n,) each, and flag."""
    table = Table(path)
    table.require(_COLUMNS)
    check_units(table)
    temperatures, means, sigmas = (table.numbers(name, required=True) for name in _COLUMNS[:1] + _COLUMNS[2:4])
    for name, values in (("mean_printed", means), ("sigma_printed", sigmas)):
        check_sizes(table, name, values)
    counts = table.numbers("n_stated", required=True)
    if "n_inferred" in table.header:
        inferred = table.numbers("n_inferred")
        counts = np.where(np.isnan(inferred), counts, inferred)
    for wrong in np.flatnonzero((counts < 1) | (counts != np.round(counts))):
        raise table.complaint(int(wrong), "n_stated", f"{counts[wrong]:g} is not a number of runs")
    flags = table.texts("flag") if "flag" in table.header else [""] * len(table)
    lines: dict[tuple[float, str], int] = {}
    for line, parameter in enumerate(table.texts("parameter")):
        key = float(temperatures[line]), parameter
        if key[0] < ABSOLUTE_ZERO_DEGC:
            raise table.complaint(line, "temperature_C", f"{key[0]:g} °C is below absolute zero")
        if sigmas[line] <= 0.0:
            raise table.complaint(line, "sigma_printed", "sigma must be positive")
        if key in lines:
            raise table.complaint(line, "parameter", f"{parameter} at {key[0]:g} °C stands there twice")
        lines[key] = line
    if not lines:
        raise InputError(f"{path}: the table has no rows")
    return lines, means, sigmas, counts, flags
