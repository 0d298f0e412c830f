"""What may be beside the base in one sensor, as its blocks of rows show it: effects, terms without a name, mistakes.

A term has columns in every block, a prior of its amplitudes, and odds before the data. An effect's are its class's; a
term of the second tier shares what is left for what nobody has described; rows, runs and labels that are wrong are
terms like any other, and compete with them.
"""

import itertools
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from hil.campaign import Conditions, FloatArray, IntArray
from hil.model.effects.data import OF_A_RUN, Mislabelled
from hil.model.effects.followed import driver_of
from hil.model.effects.prior import SECOND_TIER, UNSEEN, in_another, ladder, middle, name_odds
from hil.reconcile.search.candidates import POWERS, Candidate
from hil.reconcile.search.evidence import Amplitude
from hil.solve.causes import ODDS
from hil.solve.identifiability import kept_shares, orthonormal, project_out, unit_columns
from hil.solve.rows import Block

WRONG = {"row": ODDS["rate"] + ODDS["collect"], "run": ODDS["run"], Mislabelled.id: ODDS["exchanged"]}
"""Prior odds that a campaign has a wrong row, a wrong run, labels that are exchanged."""
PLAIN = 5.0  # a value that is one number is this many times as probable as one that follows temperature in some form
EXACT = 0.03
"""Deviation of an amplitude that is one or nothing: a model's columns are right to a few per cent.

Those of a mistake are what was measured, and as right as that."""
_AT_ONCE = 100  # candidates that are laid out side by side: of a life all of them would fill the memory
NO_NAME = "empirical"
"""What no effect describes counts as this one name, whatever it seems to follow: which curve fits best is no cause."""
IDENTICAL = 0.99
"""Columns beside the base of which the cosine is larger nobody can tell apart."""


@dataclass(frozen=True)
class Part:
    """What a term is in one block of N rows: which of its `parameters` (q,) act, by `values` (k, q) in some rows."""

    parameters: IntArray
    rows: IntArray
    values: FloatArray
    many: int

    @property
    def columns(self) -> FloatArray:
        """The columns (N, q): of what is wrong most is zero, and is not kept."""
        out = np.zeros((self.many, len(self.parameters)))
        out[self.rows] = self.values
        return out


@dataclass(frozen=True)
class Term:
    """Something that may be beside the base of one sensor. `parts` has one entry per block, None where it has none.

    Columns are of unit size, so that no unit matters: `scale` (p,) is what those of the candidate were divided by.
    `log_odds` are those of this very shape and form against nothing; `ties`: a parameter acts on several blocks. Else
    it may be in some blocks alone: from each it is `absent` with this probability. What happens, and may again, is one
    `event` wherever it does.
    """

    name: str
    tier: int
    candidate: Candidate
    parts: Sequence[Part | None]
    amplitudes: tuple[tuple[Amplitude, ...], ...]
    scale: FloatArray
    log_odds: float
    ties: bool = False
    absent: float = 0.0
    event: tuple[object, ...] | None = None

    @cached_property
    def follows(self) -> str:
        """What it follows: its effect's driver, a nameless term's condition; temperature where that moves it."""
        if self.candidate.form != "constant":
            return "temperature"
        effect = self.candidate.effect
        return driver_of(self.candidate.driver) if effect is None or self.tier != 1 else effect.follows

    @cached_property
    def called(self) -> str:
        """The name that it counts under: its own, or that of all that has none; empty of a mistake."""
        return "" if self.is_mistake else self.name if self.tier == 1 else NO_NAME

    @property
    def shared(self) -> str:
        """Under which name several sensors have it together; none of a mistake that is in one alone.

        Labels are a collect's, which all sensors have in common, and so are rates of one under another.
        """
        shape = self.candidate.shape
        if not self.is_mistake:
            return self.name
        exchange = shape.get("exchange", OF_A_RUN)
        return f"{self.name} {shape['run']:g} {exchange:g}" if exchange > OF_A_RUN else ""

    @property
    def is_mistake(self) -> bool:
        """Whether it is a mistake in the data, which no model should learn."""
        return self.tier == 0


def terms(
    candidates: Sequence[Candidate],
    blocks: Sequence[Block],
    conditions: Conditions,
    noise_deg_per_hr: float,
    known: Mapping[str, Sequence[tuple[float, FloatArray, FloatArray]]],
    *,
    calibrated: bool = False,
) -> list[Term]:
    """Return the terms of one sensor's candidates; `noise_deg_per_hr` is what a collect scatters by.

    `known` are amplitudes that physics fixes, by effect: weight, mean (p,) and deviation (p,).
    With a base that is `calibrated` at each temperature, what such values can do, or all but do, is no term: how far
    the unit was off each temperature's mean tells no law of it.
    """
    bases = [
        orthonormal(np.hstack([block.base, block.at_each_temperature(block.values)]) if calibrated else block.base)
        for block in blocks
    ]
    if not candidates:
        return []
    few = (candidates[first : first + _AT_ONCE] for first in range(0, len(candidates), _AT_ONCE))
    least = float(np.sqrt(1.0 - IDENTICAL**2)) if calibrated else UNSEEN
    laid = [each for several in few for each in _laid(several, blocks, bases, least)]
    values = {id(c.effect): any(parts) for c, _, parts in laid if c.effect is not None and c.form == "constant"}
    seen = [
        (c, scale, parts)
        for c, scale, parts in laid
        if any(parts) and (c.form != "table" or values.get(id(c.effect), False))  # else it is no law of temperature
    ]
    out = []
    for (candidate, scale, parts), odds in zip(seen, _prior_odds([c for c, _, _ in seen], conditions), strict=True):
        amplitudes = _amplitudes(candidate, scale, noise_deg_per_hr, known.get(candidate.name, ()))
        acts = [np.zeros(0, np.int64) if part is None else part.parameters for part in parts]
        own = tuple(
            tuple(replace(a, deviation=a.deviation[k], mean=a.mean[k]) for a in amplitudes) if len(k) else ()
            for k in acts
        )
        acting = [set(k.tolist()) for k in acts if len(k)]
        shared, sized = any(a & b for a, b in itertools.combinations(acting, 2)), not _is_exact(candidate)
        ties, apart, log_odds = shared and sized, len(acting) > 1 and sized and not shared, float(np.log(odds))
        absent = 1.0 - in_another(candidate.effect) if apart and candidate.tier else 0.0
        event = candidate.effect.happens(conditions, candidate.shape) if candidate.effect else None
        told = None if event is None else (candidate.name, candidate.form, event)
        out.append(Term(candidate.name, candidate.tier, candidate, parts, own, scale, log_odds, ties, absent, told))
    return _undescribed(out, bases)


def _laid(
    candidates: Sequence[Candidate], blocks: Sequence[Block], bases: Sequence[FloatArray], least: float
) -> Iterator[tuple[Candidate, FloatArray, tuple[Part | None, ...]]]:
    """Yield candidates with the sizes (p,) of their columns, and what they are in each block."""
    every = np.concatenate([candidate.columns for candidate in candidates], axis=2)
    ends = np.cumsum([len(c.parameters) for c in candidates])[:-1]
    squares = np.mean(every**2, axis=0)
    rms = np.sqrt(np.mean(squares, axis=0))
    rms[rms == 0.0] = 1.0
    largest, scales = np.sqrt(squares.max(axis=0)) / rms, np.split(rms, ends)
    by_block = []
    for block, base in zip(blocks, bases, strict=True):
        by_block.append(list(_parts(block.select(every) / rms, largest, ends, base, least)))
    yield from zip(candidates, scales, zip(*by_block, strict=True), strict=True)


def _undescribed(found: Sequence[Term], bases: Sequence[FloatArray]) -> list[Term]:
    """Leave out terms of the second tier whose columns are those of an effect that follows the same."""
    drivers = {term.follows for term in found if term.tier == 1}
    described = {}
    for driver, b in itertools.product(drivers, range(len(bases))):
        own = [p.columns for t in found if t.tier == 1 and t.follows == driver and (p := t.parts[b]) is not None]
        if own:
            described[driver, b] = unit_columns(project_out(bases[b], np.hstack(own)))

    def known(term: Term) -> bool:
        parts = [(described.get((term.follows, b)), b, part) for b, part in enumerate(term.parts) if part is not None]
        return all(
            own is not None
            and np.abs(own.T @ unit_columns(project_out(bases[b], part.columns))).max(axis=0).min() > IDENTICAL
            for own, b, part in parts
        )

    return [term for term in found if term.tier != 2 or not known(term)]


def _prior_odds(candidates: Sequence[Candidate], conditions: Conditions) -> list[float]:
    """Share the odds out: over tiers, over names by their class's odds, over the shapes and forms of a name."""
    within: dict[tuple[int, str], float] = {}
    for c in candidates:
        within[c.tier, c.name] = within.get((c.tier, c.name), 0.0) + _form_weight(c)
    nameless = [name for tier, name in within if tier == 2]
    of_names = name_odds((c.effect for c in candidates if c.tier == 1 and c.effect is not None), conditions)
    odds = (WRONG, of_names, dict.fromkeys(nameless, SECOND_TIER / max(len(nameless), 1)))
    return [odds[c.tier][c.name] * _form_weight(c) / within[c.tier, c.name] for c in candidates]


def _form_weight(candidate: Candidate) -> float:
    plain = "constant" if candidate.effect is None else candidate.effect.plain_form
    return PLAIN if candidate.form == plain else 1.0


def _parts(
    columns: FloatArray, largest: FloatArray, ends: IntArray, base: FloatArray, least: float
) -> Iterator[Part | None]:
    """Yield what each candidate is in a block: columns that act here and of which the base leaves more than `least`.

    `columns` (N, p) are those of all candidates, which end at `ends`; `largest` (p,) is what each is in any channel.
    """
    here = np.sqrt(np.mean(columns**2, axis=0))
    seen = (here > UNSEEN * largest) & (here > 0.0)
    seen[seen] = kept_shares(base, columns[:, seen]) > least
    begins = np.append(0, ends)
    there = np.pad(columns != 0.0, ((0, 0), (0, 1)))  # the last of all may have no column
    acting = np.ascontiguousarray(np.logical_or.reduceat(there, begins, axis=1).T)
    for begin, own, rows in zip(begins.tolist(), np.split(seen, ends), map(np.flatnonzero, acting), strict=True):
        parameters = np.flatnonzero(own)
        values = columns[rows[:, None], begin + parameters]
        yield Part(parameters, rows, values, len(columns)) if len(parameters) else None


def _is_exact(candidate: Candidate) -> bool:
    """Whether its amplitudes are one or nothing: a sign that is wrong or right, labels exchanged or not."""
    return all(p.typical[0] == p.typical[1] for p in candidate.parameters)


def _amplitudes(
    candidate: Candidate, rms: FloatArray, noise: float, known: Sequence[tuple[float, FloatArray, FloatArray]]
) -> list[Amplitude]:
    """Return the prior of all parameters of a candidate, times the root mean squares of its columns, `rms` (p,)."""
    count = len(candidate.parameters)
    if _is_exact(candidate):
        choices = [np.array(c) for c in itertools.product((0.0, 1.0), repeat=count) if any(c)]
        one, log_weight = np.ones(1), np.full(1, -np.log(len(choices)))
        right = EXACT if candidate.tier else noise / float(np.linalg.norm(candidate.columns))
        return [Amplitude(right * rms, one, log_weight, mean * rms) for mean in choices]
    if candidate.tier != 1:
        # Of what nobody has described, sizes from the noise up are as probable, order by order.
        typical = 0.5 * noise, 50.0 * noise
        # A curve of several columns is as large as one column would be.
        centre = np.full(count, np.sqrt(0.5 * 50.0 / max(count, 1)) * noise)
    else:
        typical = candidate.parameters[0].typical
        times = POWERS.get(candidate.form, 1)  # each power is as large as the value itself, over the campaign's range
        centre = np.array([middle(p) for p in candidate.parameters]) * np.tile(rms[: count // times], times)
    sizes, log_weights = ladder(typical)
    free = 1.0 - sum(weight for weight, _, _ in known)
    return [
        Amplitude(centre, sizes, log_weights + np.log(free), np.zeros(count)),
        *(Amplitude(deviation * rms, np.ones(1), np.log([weight]), mean * rms) for weight, mean, deviation in known),
    ]
