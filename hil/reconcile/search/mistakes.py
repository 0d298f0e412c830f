"""Mistakes that there may be in the data: rows and runs that are spoiled, labels that are exchanged.

Each competes with every effect. Of a year of nights those are asked about that differ most from their neighbours; of a
run with which nothing can be compared, what `hil solve` says of it.
"""

import itertools
from collections.abc import Collection, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cache, partial

import numpy as np

from hil.campaign import BoolArray, Campaign, Collects, Conditions, FloatArray, IntArray
from hil.model.effects.base import Parameter
from hil.model.effects.data import OTHER_SENSOR, Mislabelled
from hil.model.forms import default_form
from hil.reconcile.search.candidates import MANY, Candidate
from hil.reconcile.search.problem import SensorProblem
from hil.reconcile.search.terms import Term
from hil.solve.asked import OtherSensor
from hil.solve.causes import AS_IT_LAY
from hil.solve.identifiability import kept_shares, orthonormal
from hil.solve.rows import Block
from hil.solve.temperatures import runs_by_temperature
from hil.solve.wrong_rows import MENDED, USED, Wrong, wrong_rows

EXACTLY = 1e-6  # of its size: what is left of a column that is another's
NEIGHBOURS = 4  # rows to either side, in the same position, that say what a row should be


def may_be_wrong(
    number: int, blocks: Sequence[Block], conditions: Conditions, solved: "AsSolved"
) -> Iterator[Candidate]:
    """Yield one candidate per rate, one per collect, and one per run and block: what is there says nothing.

    Where there are very many, of collects that `hil solve` names and of those that differ most from their neighbours.
    """
    shape = (len(conditions), len(conditions.sensor.channels))
    odd = _odd(blocks, conditions, solved.named)
    rows = np.unique(np.concatenate([block.rows for block in blocks]))
    rows = rows[np.isin(conditions.run[rows], solved.told)]
    for row in sorted(rows[np.argsort(-odd[rows], kind="stable")][:MANY].tolist()):
        every = np.arange(shape[1])
        yield _wrong("row", number, shape, np.full(len(every), row), every, {"row": float(row)})
        for channel in every.tolist():
            of_channel = np.array([row]), every[channel : channel + 1]
            yield _wrong("row", number, shape, *of_channel, {"row": float(row), "channel": channel})
    odd_runs = runs_to_ask(blocks, conditions, solved, MANY)
    for block in blocks:
        for run in np.unique(block.run[np.isin(conditions.run[block.rows], odd_runs)]).tolist():
            here = np.flatnonzero(block.run == run)
            if not 1 < len(here) < 0.5 * len(block.y):
                continue
            of_block = {"number": float(conditions.run[block.rows[here[0]]]), "channel": float(block.channel[0])}
            yield _wrong("run", number, shape, block.rows[here], block.channel[here], of_block)


def runs_to_ask(blocks: Sequence[Block], conditions: Conditions, solved: "AsSolved", most: int) -> IntArray:
    """Return the numbers of so many runs (k,): all that are named, and those that differ most from neighbours."""
    odd, runs = _odd(blocks, conditions, solved.named), np.array(solved.told, dtype=np.int64)
    of_run = np.array([odd[conditions.run == run].mean() for run in runs.tolist()])
    return np.asarray(np.sort(runs[np.argsort(-of_run, kind="stable")[: max(most, np.isinf(of_run).sum())]]))


def _odd(blocks: Sequence[Block], conditions: Conditions, named: BoolArray) -> FloatArray:
    """How far each collect (n,) is off the median of its neighbours in the same position, in units of the noise.

    That is in the worst of its channels; and further than all where `named`.
    """
    out = np.where(named, np.inf, 0.0)
    for block in blocks:
        left = (block.y - block.base @ np.linalg.lstsq(block.base, block.y, rcond=None)[0]) / block.sigma
        for channel, position in itertools.product(np.unique(block.channel), np.unique(conditions.position)):
            here = np.flatnonzero((block.channel == channel) & (conditions.position[block.rows] == position))
            if len(here) > NEIGHBOURS:
                padded = np.pad(left[here], NEIGHBOURS, mode="reflect")
                around = np.lib.stride_tricks.sliding_window_view(padded, 2 * NEIGHBOURS + 1)
                np.maximum.at(out, block.rows[here], np.abs(left[here] - np.median(around, axis=1)))
    return out


def _wrong(
    name: str, number: int, size: tuple[int, int], rows: IntArray, channels: IntArray, shape: Mapping[str, float]
) -> Candidate:
    columns = partial(_each_rate, size, rows, channels)
    return Candidate(name, 0, number, columns, _each_off(len(rows)), shape=shape, title=f"A {name} that is wrong")


@cache
def _each_off(many: int) -> tuple[Parameter, ...]:
    return tuple(Parameter(f"off_{k}", "deg/hr", (1.0, 100.0)) for k in range(many))


def _each_rate(size: tuple[int, int], rows: IntArray, channels: IntArray) -> FloatArray:
    """Return a column (n, c, p) for each of some rates."""
    out = np.zeros((*size, len(rows)))
    out[rows, channels, np.arange(len(rows))] = 1.0
    return out


@dataclass(frozen=True)
class AsSolved:
    """What `hil solve` makes of one sensor's rates (n, c): as they are `filed`, and `laid`, by `rows` that say why.

    What it is not certain of, and so leaves as it is filed, is among them: a search knows more.

    `other` is what another sensor shows in the same collects. `alone` are the runs that it cannot compare with others,
    `doubted` are rows that do not agree with others and that it uses all the same, `another` by parameter the runs of
    which that was another.
    """

    filed: Collects
    laid: FloatArray
    other: OtherSensor | None
    rows: Sequence[Wrong]
    alone: Collection[int] = ()
    doubted: Sequence[Wrong] = ()
    another: Mapping[str, Collection[int]] = field(default_factory=dict)

    @classmethod
    def of(cls, campaign: Campaign, number: int) -> "AsSolved":
        """Ask it of a sensor."""
        filed, solved = campaign.sensors[number], wrong_rows(campaign)[number]
        every = (*solved.rows, *solved.may_be)
        rows, doubted = ([row for row in every if (row.done == USED) is used] for used in (False, True))
        laid, alone = solved.likeliest.rates_deg_per_hr, solved.not_compared
        return cls(filed, laid, solved.other, rows, alone, doubted, solved.another)

    @property
    def told(self) -> list[int]:
        """The runs of which something tells: others, what its own rates leave over, or what it changes in them.

        A run that is the only one at its temperature may differ from others by nothing but that.
        """
        conditions, many = self.filed.conditions, len(default_form(self.filed.conditions).names)
        single = {runs[0] for _, runs in runs_by_temperature(conditions) if len(runs) == 1}.intersection(self.alone)
        known = np.isfinite(self.filed.rates_deg_per_hr)
        return [
            run
            for run, rows in conditions.of_each_run.items()
            if run not in single or known[rows].sum() > many or self.named[rows].any()
        ]

    @property
    def named(self) -> BoolArray:
        """Which collects (n,) it changes or leaves out."""
        rates = self.filed.rates_deg_per_hr
        return np.asarray(np.any(np.isfinite(rates) & (rates != self.laid), axis=1))

    def _farthest_off(self, run: int) -> int:
        """Return the channel in which a run is farthest off all rates in its positions, by what is usual there."""
        conditions, rates = self.filed.conditions, self.filed.rates_deg_per_hr
        off = np.zeros_like(rates)
        for label in np.unique(conditions.position):
            own = conditions.position == label
            away = np.abs(np.nan_to_num(rates[own]) - np.median(np.nan_to_num(rates[own]), axis=0))
            off[own] = away / np.maximum(np.median(away, axis=0), 1e-9)
        return int(np.argmax(off[conditions.run == run].mean(axis=0)))

    def among(self, terms: Sequence[Term]) -> list[tuple[int, ...]]:
        """Return the places of the terms that do the same: put right what it does, and leave out what it does.

        And with runs left out whole that it puts right or doubts, or with what such a run had of its own: of several
        that are wrong alike no single one shows by itself.
        """
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
        right = {j for j, _ in exchanged}
        whole = self._whole([(j, of) for j, of in mistakes if j not in right], [terms[j] for j in chosen & right])
        every = (chosen, whole | chosen - right, chosen.union(self._of_their_own(terms)))
        return list(dict.fromkeys(tuple(sorted(each)) for each in every if each))

    def _of_their_own(self, terms: Sequence[Term]) -> Iterator[int]:
        """Yield the places of the effects, the likeliest each, that make one parameter another in one run alone."""
        conditions, events = self.filed.conditions, [(j, t) for j, t in enumerate(terms) if t.tier == 1 and t.event]
        form, rows = default_form(conditions), self.filed.rates_deg_per_hr.size
        does = [(j, orthonormal(t.candidate.columns.reshape(rows, -1))) for j, t in events if self.another]
        for name, run in ((name, run) for name, runs in self.another.items() for run in runs):
            own = form.columns(conditions)[..., form.names.index(name)] * (conditions.run == run)[:, None]
            these = [j for j, basis in does if kept_shares(basis, own.reshape(-1, 1))[0] < EXACTLY]
            yield from sorted(these, key=lambda j: -terms[j].log_odds)[:1]

    def _whole(self, spoiled: Sequence[tuple[int, Candidate]], put_right: Sequence[Term]) -> set[int]:
        """Return the places of what leaves out, in a channel, each run that it puts right, or each that it doubts."""
        asked = {
            (term.candidate.shape["run"], channel)
            for term in put_right
            for channel in np.flatnonzero(term.candidate.columns.any(axis=(0, 2))).tolist()
        }
        if not any(row.done == MENDED for row in self.rows):
            asked = {(float(row.run), self._farthest_off(row.run)) for row in self.doubted}
        return {j for j, of in spoiled if (of.shape.get("number"), of.shape.get("channel")) in asked}


def exchanges(sensor: SensorProblem, blocks: Sequence[Block], solved: AsSolved) -> Iterator[Candidate]:
    """Yield one candidate per exchange of labels in one run: each has what the other measured.

    Or should have measured, where that is missing. Of very many runs those are asked about that `hil solve` names, and
    that are odd.
    """
    conditions, rates, effect = sensor.collects.conditions, sensor.collects.rates_deg_per_hr, Mislabelled()
    grid, runs = list(effect.shape_grid(conditions)), len(conditions.of_each_run)
    asked = runs_to_ask(blocks, conditions, solved, MANY * runs // max(len(grid), 1)).tolist()
    laid = [(shape, effect.exchanged(conditions, rates, shape)) for shape in grid if shape["run"] in asked]
    for run in asked:
        own = conditions.run == run
        if solved.other is not None and np.isfinite(solved.other.rates[own]).all():
            of_other = np.where(own[:, None], solved.other.rates, rates)
            laid.append(({"run": float(run), "exchange": OTHER_SENSOR}, of_other))
    for shape, other in laid:
        if np.any(missing := np.isfinite(rates) & ~np.isfinite(other)):
            other = np.where(missing, sensor.predicted_from(other), other)
        columns = np.nan_to_num(rates - other)[..., None]
        if np.any(columns):
            yield Candidate.of(effect, 0, conditions, columns, shape)


def as_told(terms: Sequence[Term], solved: AsSolved, exchanged: Collection[tuple[int, int]]) -> list[Term]:
    """Return the terms, exchanges with the odds that they have by how the unit lay, and by what another sensor shows.

    `exchanged` are pairs of collects that lay as each other's label says, by the unit's accelerometers. Rates that are
    another sensor's leave that one these, and are no likelier than these are there.
    """
    collect = solved.filed.conditions.collect

    def told(term: Term) -> Term:
        shape, rows = term.candidate.shape, np.any(term.candidate.columns != 0.0, axis=(1, 2))
        if solved.other is not None and shape.get("exchange") == OTHER_SENSOR:
            return replace(term, log_odds=term.log_odds + min(solved.other.instead(int(shape["run"])), 0.0))
        return replace(term, log_odds=AS_IT_LAY) if tuple(collect[rows].tolist()) in exchanged else term

    return [told(t) if t.is_mistake and t.candidate.effect is not None else t for t in terms]
