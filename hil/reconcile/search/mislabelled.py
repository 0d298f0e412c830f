"""Labels that may be exchanged, what is known of them before the search, and what `hil solve` does about rows.

solved = AsSolved.of(campaign, 2)
found = exchanges(sensor, blocks, solved)       # one candidate per exchange in one run
terms = as_told(terms, collects, exchanged)     # with odds by accelerometers, and by what hardly ever changes
solved.among(terms)                             # the terms that are the answer of `hil solve`: a set to start from
"""

from __future__ import annotations

from collections.abc import Collection, Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np

from hil.campaign import BoolArray, Campaign, Collects, FloatArray, IntArray
from hil.model.effects.data import OTHER_SENSOR, Mislabelled
from hil.model.forms import default_form
from hil.reconcile.search.candidates import Candidate
from hil.reconcile.search.problem import SensorProblem
from hil.reconcile.search.spoiled import MANY, runs_to_ask
from hil.reconcile.search.terms import Term
from hil.solve.rows import Block
from hil.solve.temperatures import same_temperature
from hil.solve.whitened import CHANGES
from hil.solve.wrong_rows import MENDED, USED, Wrong, alike, beside, wrong_rows

SEEN = float(np.log(1e4))
"""Log odds that labels are exchanged where the unit's accelerometers say so, rather than that these are wrong."""


@dataclass(frozen=True)
class AsSolved:
    """What `hil solve` makes of one sensor's rates (n, c): as they are `filed`, and `laid`, by `rows` that say why.

    What it is not certain of, and so leaves as it is filed, is among them: a search knows more.

    `others` are those of another sensor in the same collects, NaN where there is none, or it took others.
    """

    filed: Collects
    laid: FloatArray
    others: FloatArray
    rows: Sequence[Wrong]

    @classmethod
    def of(cls, campaign: Campaign, number: int) -> AsSolved:
        """Ask it of a sensor."""
        filed, solved = campaign.sensors[number], wrong_rows(campaign)[number]
        rows = [row for row in (*solved.rows, *solved.may_be) if row.done != USED]
        return cls(filed, solved.likeliest.rates_deg_per_hr, beside(filed, alike(campaign, number)), rows)

    @property
    def named(self) -> BoolArray:
        """Which collects (n,) it changes or leaves out."""
        rates = self.filed.rates_deg_per_hr
        return np.asarray(np.any(np.isfinite(rates) & (rates != self.laid), axis=1))

    def among(self, terms: Sequence[Term]) -> tuple[int, ...]:
        """Return the places of the terms that do the same: put right what it does, and leave out what it does."""
        mistakes = [(j, term.candidate) for j, term in enumerate(terms) if term.is_mistake]
        exchanged = [(j, of.columns[..., 0]) for j, of in mistakes if of.effect is not None]
        spoiled = [(j, np.any(of.columns != 0.0, axis=2)) for j, of in mistakes if of.effect is None]
        conditions, rates = self.filed.conditions, self.filed.rates_deg_per_hr
        chosen = set[int]()
        for row in self.rows:
            there = np.isin(conditions.collect, row.collects)[:, None] & np.isfinite(rates)
            there &= np.isin(list(conditions.sensor.channels), row.channels)
            if row.done == MENDED:
                by = np.where(there, np.nan_to_num(rates - self.laid), 0.0)
                chosen.update([j for j, columns in exchanged if np.allclose(columns, by)][:1])
                continue
            for j, here in sorted(spoiled, key=lambda each: -each[1].sum()):
                if here[there].any() and not here[~there].any():
                    chosen.add(j)
                    there &= ~here
        return tuple(sorted(chosen))


def exchanges(sensor: SensorProblem, blocks: Sequence[Block], solved: AsSolved) -> Iterator[Candidate]:
    """Yield one candidate per exchange of labels in one run: each has what the other measured.

    Or should have measured, where that is missing. Of very many runs those are asked about that `hil solve` names, and
    that are odd.
    """
    conditions, rates, effect = sensor.collects.conditions, sensor.collects.rates_deg_per_hr, Mislabelled()
    grid, runs = list(effect.shape_grid(conditions)), len(conditions.of_each_run)
    asked = runs_to_ask(blocks, conditions, solved.named, MANY * runs // max(len(grid), 1)).tolist()
    laid = [(shape, effect.exchanged(conditions, rates, shape)) for shape in grid if shape["run"] in asked]
    for run in asked:
        own = conditions.run == run
        if np.isfinite(solved.others[own]).all():
            of_other = np.where(own[:, None], solved.others, rates)
            laid.append(({"run": float(run), "exchange": OTHER_SENSOR}, of_other))
    for shape, other in laid:
        if np.any(missing := np.isfinite(rates) & ~np.isfinite(other)):
            other = np.where(missing, sensor.predicted_from(other), other)
        columns = np.nan_to_num(rates - other)[..., None]
        if np.any(columns):
            yield Candidate(
                effect.id,
                0,
                sensor.number,
                columns,
                effect.parameters_for(conditions),
                shape=shape,
                effect=effect,
                title=effect.title,
                equation=effect.equation,
            )


def as_told(terms: Sequence[Term], collects: Collects, exchanged: Collection[tuple[int, int]]) -> list[Term]:
    """Return the terms, exchanges with odds by what is known of them: how the unit lay, and what hardly ever changes.

    `exchanged` are pairs of collects that lay as each other's label says, by the unit's accelerometers.
    """
    steady, out = _Steady(collects), []
    for term in terms:
        if term.is_mistake and term.candidate.effect is not None:
            rows = np.any(term.candidate.columns != 0.0, axis=(1, 2))
            seen = tuple(collects.conditions.collect[rows].tolist()) in exchanged
            term = replace(term, log_odds=SEEN if seen else term.log_odds - steady.further_by(term.candidate))
        out.append(term)
    return out


class _Steady:
    """What neither a bias nor MU moves, (p,) of each run: at another temperature it is another by little.

    No form of the search says so: one that has values at each temperature takes those of exchanged labels, too.
    """

    def __init__(self, collects: Collects) -> None:
        self._collects, conditions = collects, collects.conditions
        form = default_form(conditions)
        self._own = np.array([not name.startswith(("B", "MU")) for name in form.names])
        self._columns, self._inverse = form.columns(conditions), dict[bytes, FloatArray | None]()
        rates = collects.rates_deg_per_hr - conditions.w_channels_deg_per_hr
        self._of_run = {run: self._values(rows, rates)[0] for run, rows in conditions.of_each_run.items()}
        station = same_temperature(conditions)
        self._at = {run: int(station[rows[0]]) for run, rows in conditions.of_each_run.items()}
        self._usual: dict[int, FloatArray] = {}

    def further_by(self, candidate: Candidate) -> float:
        """Return by how much (log) less probable an exchange in a run takes its values from those elsewhere; 0 of less.

        Those of the runs at the other temperatures, most of which are right.
        """
        run = int(candidate.shape["run"])
        usual = self._elsewhere(self._at[run])
        moved, errors = self._values(self._collects.conditions.of_each_run[run], -candidate.columns[..., 0])
        within = np.hypot(errors, CHANGES * np.sqrt(np.mean(usual**2)))
        filed = (self._of_run[run] - usual) / within
        further = 0.5 * float(np.sum((filed + moved / within) ** 2 - filed**2))
        return further if further > 0.0 else 0.0  # NaN is nothing: no other tells

    def _elsewhere(self, at: int) -> FloatArray:
        if at not in self._usual:
            known = [
                values for run, values in self._of_run.items() if self._at[run] != at and np.isfinite(values).all()
            ]
            self._usual[at] = np.median(known, axis=0) if known else np.full(self._own.sum(), np.nan)
        return self._usual[at]

    def _values(self, rows: IntArray, rates: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Return the values of the rows of a run by rates (n, c), and their standard errors; NaN where not seen."""
        known = np.isfinite(self._collects.rates_deg_per_hr[rows])
        columns = self._columns[rows][known]
        if (key := columns.tobytes()) not in self._inverse:
            seen = np.linalg.matrix_rank(columns, 1e-3) == columns.shape[1]
            self._inverse[key] = np.linalg.pinv(columns)[self._own] if seen else None
        inverse = self._inverse[key]
        if inverse is None:
            unseen = np.full(self._own.sum(), np.nan)
            return unseen, unseen
        errors = np.nan_to_num(self._collects.rates_se_deg_per_hr[rows][known])
        return inverse @ rates[rows][known], np.sqrt(inverse**2 @ errors**2)
