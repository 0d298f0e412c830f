"""The scatter signatures of a printed table: what its standard deviations of C, M and MU tell."""

from __future__ import annotations

from pathlib import Path

from hil.analysis.published import audit_table
from hil.analysis.published.printed import TABLE_1
from hil.analysis.scatter.signature import ScatterSignature, repeats_of_sigmas
from hil.analysis.scatter.sources import signatures_by_channel
from hil.errors import InputError
from hil.files.units import TEMPERATURE, to_number

_SIGMAS = ("sigma_contractor", "sigma_matrix", "sigma_mu")


def published_signatures(name: str | Path) -> tuple[ScatterSignature, ...]:
    """Return the signatures of a printed table in Table 1's layout, by path or by the name of one that ships.

    The collects are taken to have been made in the order 1-2-3 with a noise of 0.9 deg/hr each; the number of runs is
    the stated one, or what the printed digits tell where they contradict it. Raises `InputError` where the table has no
    standard deviations.
    """
    audit = audit_table(name)
    if audit.table.layout != TABLE_1 or not all(set(_SIGMAS) <= set(row.cells) for row in audit.table.rows):
        raise InputError(
            f"{audit.table.path}: the standard deviations of C, M and MU (column sigma_printed) are needed"
        )
    groups = []
    for row in audit.table.rows:
        told, stated = audit.runs_told.get(row.group), row.n_stated
        runs = told if told is not None and (stated is None or stated % told) else stated
        if runs is None or runs < 2:
            raise InputError(
                f"{audit.table.path}: {row.label}: how many runs it is the scatter of is not stated (n_stated)"
            )
        c, m, mu = (row.cells[role].value for role in _SIGMAS)
        at = to_number(row.group, TEMPERATURE)
        groups.append(repeats_of_sigmas(row.axis, c, m, mu, runs, temperature_degC=at))
    return tuple(signatures_by_channel(sorted(groups, key=lambda group: group.axis)))
