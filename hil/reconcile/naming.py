"""From evidence to a name: how probable, which rivals, and when the honest word is "ambiguous" or "empirical".

The data weigh names by their evidence; the physical prior weighs them by the size they would need: a name whose typical
range would have to be exceeded by decades is less plausible, and where columns are identical that is all that ranks
them. Identical columns are never resolved silently.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy.special import softmax

from hil.campaign import FloatArray
from hil.model.effects.base import Effect
from hil.model.effects.catalogue import effect_by_id
from hil.reconcile.search.candidates import POWERS
from hil.reconcile.search.fit import Added, BlockNoise, Fit, chosen_units, refit
from hil.reconcile.search.scan import Scan
from hil.solve.identifiability import orthonormal, share_within
from hil.solve.rows import Block

NAMED = 0.8
SAME = 0.95
_IDENTICAL = 0.995
_DECADES = 0.4  # a size this many decades beyond the typical range is one standard deviation implausible
_FLOOR = 5.0
_IMPOSSIBLE = 50.0  # a size this many times beyond the typical range is no physics, whatever the algebra says
_UNDETERMINED = 0.4  # a switch whose size has a larger error may be on or off
_SPAN_DEGC = 40.0  # a coefficient per degree is judged by what it makes over this span
_NEGLIGIBLE = 0.15
_CLOSE = 4.0  # log evidence within which two names explain the data equally
_NEARLY = 7.0  # and within which a usual term withholds the name from an unusual one
_SLIVER = 0.04
IDEAL = 0.04  # a catalogue's column is an idealisation: the true one differs from it by so much of its norm
LARGE = 3.0
_TYPICAL = 1.5
_MENTIONED = 0.01
_CONTENDS = 0.2  # a rival of this probability may lead in place of an implausibly large one
_HOPELESS = 6.4  # a misfit, in units of the noise, that no plausibility of sizes makes up for
_WITHHOLDS = 0.05  # a rival that reproduces all of the leader withholds the name from this probability on
_SHOWS = 5.0  # norm in units of the noise from which an effect shows on a sensor


@dataclass(frozen=True)
class Weighed:
    """One name in one scan: its probability, its fit alone on top of the base, and how it compares with the leader.

    `same_on` are the sensors of several on which it cannot be told from the leader, `remedy` what
    would let it be asked about, where this data does not; `norm` is the leader's, beside the base, in its noise.
    """

    name: str
    tier: int
    title: str
    probability: float
    log_evidence: float
    excess: float
    overlap: float
    added: Added
    fit: Fit
    same_on: tuple[int, ...] = ()
    remedy: str = ""
    norm: float = 0.0

    @property
    def effect(self) -> Effect | None:
        """The effect of the catalogue that it is named after; None for a term of the second tier."""
        if self.tier != 1:
            return None
        hypothesis = self.added.hypothesis
        return hypothesis.effect if hypothesis.name == self.name else effect_by_id(self.name)

    @property
    def odds(self) -> float:
        """How many times as probable as any other name it is before the data."""
        return 1.0 if self.effect is None else self.effect.odds

    @property
    def incidental(self) -> bool:
        """Whether it imitates others only by how these collects were taken."""
        return self.effect is not None and self.effect.incidental


@dataclass(frozen=True)
class Naming:
    """The outcome of one step: `kind` is named, ambiguous or empirical; rivals in order of probability."""

    kind: str
    leader: Weighed
    rivals: Sequence[Weighed]


def weigh(scan: Scan, blocks: Sequence[Block], noise: Sequence[BlockNoise], limit: int = 60) -> Naming:
    """Name what a scan found: evidence times the plausibility of the fitted sizes, then look for the same columns."""
    names = list(scan.shares)
    strongest = _fitted(names[0], scan, blocks, noise)
    norm = _norm(strongest, blocks, noise)
    least = scan.shares[names[0]] * float(np.exp(-0.5 * (_HOPELESS + IDEAL * norm) ** 2))
    first_tier = [n for n in names if scan.shares[n] > least and scan.best(n)[0].tier == 1][:limit]
    others = [name for name in dict.fromkeys([*names[:12], *first_tier]) if name != names[0]]
    weighed = forgiving([strongest, *(_fitted(name, scan, blocks, noise) for name in others)], norm)
    logs = np.array([w.log_evidence + plausibility(w.excess) + np.log(w.odds) for w in weighed])
    ranked = sorted(
        (replace(w, probability=float(p)) for w, p in zip(weighed, softmax(logs), strict=True)),
        key=lambda w: -w.probability,
    )
    leader, kind = _lead(ranked, blocks, noise)
    leader = _more_plausible(leader, ranked, blocks, noise)
    rivals = [replace(w, overlap=_overlap(leader, w, blocks, noise)) for w in ranked if w.name != leader.name]
    if leader.tier == 1:
        rivals = [_by_sensor(leader, w, blocks, noise) if w.tier == 1 else w for w in rivals]
        same = [w for w in rivals if w.same_on or (w.tier == 1 and _same(leader, w, blocks, noise))]
        stronger = [w for w in rivals if w.tier == 1 and w.overlap > SAME and w.probability > leader.probability]
        same += [w for w in stronger if w not in same]
        withholds = _MENTIONED if leader.excess >= LARGE else _WITHHOLDS
        same += [w for w in rivals if w.tier == 1 and w.overlap > SAME and w.probability > withholds and w not in same]
        same += [w for w in rivals if w not in same and _usual_and_as_good(leader, w)]
        possible = [w for w in same if _is_possible(leader, w) and not _only_incidental(leader, w)]
        stated = leader.probability * certainty(scan)
        withheld = bool(possible) or stated < NAMED or leader.excess > _IMPOSSIBLE
        kind = "ambiguous" if withheld else "named"
        alike = [w for w in rivals if w.tier == 1 and w.overlap > SAME and _as_good(leader, w)]
        shown = [w for w in rivals if w in same or w in alike or w.probability > 0.005]
    else:
        shown = [w for w in rivals if w.probability > 0.01]
    return Naming(kind, replace(leader, norm=norm), shown[:8])


def _norm(weighed: Weighed, blocks: Sequence[Block], noise: Sequence[BlockNoise]) -> float:
    """Norm of a fitted effect beside the base, in units of the noise."""
    return float(np.linalg.norm(_shown(weighed.fit, blocks, noise)))


def forgiving(weighed: Sequence[Weighed], norm: float) -> list[Weighed]:
    """Raise the evidence of the catalogue's names by what columns that are only nearly true cost them, of norm `norm`.

    What a column that is off by a share s leaves of an effect of norm d is s d: as much misfit is forgiven.
    """
    most = max(w.log_evidence for w in weighed)

    def forgiven(w: Weighed) -> Weighed:
        misfit = float(np.sqrt(2.0 * (most - w.log_evidence)))
        return replace(w, log_evidence=most - 0.5 * max(misfit - IDEAL * norm, 0.0) ** 2)

    return [forgiven(w) if w.tier == 1 else w for w in weighed]


def _more_plausible(
    leader: Weighed, ranked: Sequence[Weighed], blocks: Sequence[Block], noise: Sequence[BlockNoise]
) -> Weighed:
    """Give the lead to a name that reproduces an implausibly large leader at a size that is typical."""
    if leader.tier != 1 or leader.excess < LARGE:
        return leader
    for rival in ranked:
        small = rival.tier == 1 and rival.excess < _TYPICAL and rival.probability > _CONTENDS
        if small and rival.name != leader.name and _overlap(leader, rival, blocks, noise) > SAME:
            return rival
    return leader


def certainty(scan: Scan) -> float:
    """Probability that anything is missing at all, at even odds beforehand."""
    return 1.0 / (1.0 + float(np.exp(-max(scan.statistic, -30.0))))


def prior_weight(weighed: Weighed) -> float:
    """Log weight of a name before the data: how usual it is, and how usual its fitted size."""
    return plausibility(weighed.excess) + float(np.log(weighed.odds))


def with_rivals(naming: Naming, share: float, others: Sequence[Weighed]) -> Naming:
    """Return a naming that holds only so far (`share`), with what else there may be among its rivals."""
    leader = replace(naming.leader, probability=naming.leader.probability * share)
    kind = "ambiguous" if naming.kind == "named" and leader.probability < NAMED else naming.kind
    present = {rival.name for rival in naming.rivals}
    new = [other for other in others if other.name not in present and other.probability > _MENTIONED]
    rivals = sorted([*naming.rivals, *new], key=lambda rival: -rival.probability)
    return Naming(kind, leader, rivals)


def _is_possible(leader: Weighed, rival: Weighed) -> bool:
    """Whether a rival that reproduces the leader could be it; one that is only nearly the same must be probable."""
    if rival.overlap < _IDENTICAL and rival.probability < _MENTIONED:
        return False
    return rival.excess < _IMPOSSIBLE or leader.excess > LARGE


def _only_incidental(leader: Weighed, rival: Weighed) -> bool:
    """Whether a rival is improbable, and the same only because of how these collects were taken."""
    return rival.incidental and not leader.incidental and rival.probability < _NEGLIGIBLE


def _same(leader: Weighed, rival: Weighed, blocks: Sequence[Block], noise: Sequence[BlockNoise]) -> bool:
    return rival.overlap > SAME and _as_narrow(leader, rival, blocks, noise)


def _usual_and_as_good(leader: Weighed, rival: Weighed) -> bool:
    """Whether a term of the standard model, at a usual size, reproduces an unusual leader nearly as probably."""
    usual = rival.odds > 1.0 >= leader.odds and rival.excess < _TYPICAL
    return usual and rival.overlap > SAME and leader.log_evidence - rival.log_evidence < _NEARLY


def _as_good(leader: Weighed, rival: Weighed) -> bool:
    return leader.log_evidence - rival.log_evidence < _CLOSE


def _as_narrow(leader: Weighed, rival: Weighed, blocks: Sequence[Block], noise: Sequence[BlockNoise]) -> bool:
    """Whether the rival explains as much with no more freedom: a broad effect around a narrow one is not the same."""
    if not _as_good(leader, rival):
        return False
    return bool(_span(rival.added, blocks, noise).shape[1] <= _span(leader.added, blocks, noise).shape[1])


def _stacked(added: Added, blocks: Sequence[Block], noise: Sequence[BlockNoise]) -> FloatArray:
    """Whitened columns of an effect beside the base, all blocks one under the other, relative to their own norms."""
    parts, norms = [], []
    for b, block in enumerate(blocks):
        columns = np.hstack(
            [
                unit.columns[unit.blocks.index(b)]
                if b in unit.blocks
                else np.zeros((len(block.y), unit.columns[0].shape[1]))
                for unit in added.units
            ]
        )
        parts.append(noise[b].beside(block.base, columns))
        norms.append(np.sum((noise[b].whitening @ columns) ** 2, axis=0))
    size = np.sqrt(np.sum(norms, axis=0))
    return np.asarray(np.vstack(parts) / np.where(size > 0, size, 1.0))


def _span(added: Added, blocks: Sequence[Block], noise: Sequence[BlockNoise]) -> FloatArray:
    """An orthonormal basis of what an effect has beside the base; slivers of a column do not count."""
    return orthonormal(_stacked(added, blocks, noise), _SLIVER, scale=1.0)


def _lead(ranked: Sequence[Weighed], blocks: Sequence[Block], noise: Sequence[BlockNoise]) -> tuple[Weighed, str]:
    """The most probable name of the most probable class, in the tier that holds more than half.

    Names of one effect that share its evidence do not lose to an odd one that has none to share with.
    """
    catalogue = [w for w in ranked if w.tier == 1]
    if not catalogue or sum(w.probability for w in catalogue) < 0.5:
        return next(w for w in ranked if w.tier == 2), "empirical"
    likely = [w for w in catalogue if w.probability > _WITHHOLDS] or catalogue[:1]

    def with_its_class(one: Weighed) -> float:
        same = [w for w in likely if min(_overlap(one, w, blocks, noise), _overlap(w, one, blocks, noise)) > SAME]
        return sum(w.probability for w in same)

    return max(likely, key=with_its_class), "named"


def _fitted(name: str, scan: Scan, blocks: Sequence[Block], noise: Sequence[BlockNoise]) -> Weighed:
    """Fit a name alone, at the most probable of its shapes and forms, the sizes they ask for included."""
    forms = scan.forms(name)
    log_evidence = float(np.logaddexp.reduce([value for value, _, _ in forms]))
    found: list[tuple[float, Weighed]] = []
    for value, hypothesis, units in forms:
        if found and value < max(found, key=_first)[0]:
            break  # in order of evidence: none that follows could do better, however plausible its size
        added = chosen_units(hypothesis, units)
        fit = refit(blocks, noise, [added])
        excess = _excess(added, fit, blocks, noise) if hypothesis.tier == 1 else 1.0
        title, share = hypothesis.candidate.title, scan.shares[name]
        weighed = Weighed(name, hypothesis.tier, title, share, log_evidence, excess, 1.0, added, fit)
        found.append((value + plausibility(excess), weighed))
    return max(found, key=_first)[1]


def _first(pair: tuple[float, Weighed]) -> float:
    return pair[0]


def _excess(added: Added, fit: Fit, blocks: Sequence[Block], noise: Sequence[BlockNoise]) -> float:
    """How many times the fitted sizes exceed their typical ranges (1 where they do not).

    The sizes are those of the most plausible combination that reproduces the fitted effect beside the base to within
    the noise. A parameter whose only typical value is one (a sign that is wrong or right) is implausible at any
    other.
    """
    seen, target, typical, switch = [], [], [], []
    for b, block in enumerate(blocks):
        columns = np.zeros((len(block.y), len(fit.owner)))
        for place, (_, u, k) in enumerate(fit.owner):
            unit = added.units[u]
            if b in unit.blocks:
                columns[:, place] = unit.columns[unit.blocks.index(b)][:, k]
        white = noise[b].beside(block.base, np.column_stack([columns, fit.effect[b]]))
        seen.append(white[:, :-1])
        target.append(white[:, -1])
    for _, u, k in fit.owner:
        candidate = added.units[u].candidate
        number = added.units[u].parameters[k]
        low, high = candidate.parameters[number].typical
        power = number // (candidate.size // POWERS[candidate.form]) if candidate.form in POWERS else 0
        typical.append((high if 0 < high < np.inf else 1.0) * _SPAN_DEGC**-power)
        switch.append(low == high and power == 0)
    design = np.vstack(seen) * np.array(typical)
    # a ridge at the level of the noise: only what the data insist on counts
    gram = design.T @ design
    inverse = np.linalg.pinv(gram + 1e-3 * np.eye(len(typical)), rcond=1e-12)
    sizes = inverse @ (design.T @ np.concatenate(target))
    errors = np.sqrt(np.clip(np.diag(inverse @ gram @ inverse), 0.0, None))
    worst = 1.0
    for size, error, is_switch in zip(sizes, errors, switch, strict=True):
        if is_switch and error < _UNDETERMINED:
            away = min(abs(abs(size) - 1.0), abs(size)) / float(np.hypot(error, IDEAL))
            worst = max(worst, min(10.0 ** (_DECADES * max(away - 1.0, 0.0)), 2.0 * _IMPOSSIBLE))
        elif not is_switch and abs(size) > 3.0 * error:
            worst = max(worst, float(abs(size) - error))
    return worst


def plausibility(excess: float) -> float:
    """Log prior weight of a fitted size that exceeds its typical range `excess` times."""
    if excess > _IMPOSSIBLE:
        return -2.0 * _FLOOR
    return -min(0.5 * float(np.log10(max(excess, 1.0)) / _DECADES) ** 2, _FLOOR)


def _overlap(leader: Weighed, rival: Weighed, blocks: Sequence[Block], noise: Sequence[BlockNoise]) -> float:
    """How much of the leader's fitted effect the rival's columns reproduce beside the base, 0 to 1."""
    return share_within(_span(rival.added, blocks, noise), _shown(leader.fit, blocks, noise))


def _shown(fit: Fit, blocks: Sequence[Block], noise: Sequence[BlockNoise]) -> FloatArray:
    """A fitted effect beside the base in units of the noise, all blocks one after the other."""
    parts = zip(fit.effect, blocks, noise, strict=True)
    return np.concatenate([loud.beside(block.base, effect) for effect, block, loud in parts])


def _by_sensor(leader: Weighed, rival: Weighed, blocks: Sequence[Block], noise: Sequence[BlockNoise]) -> Weighed:
    """State on which sensors of several the rival is the leader: another sensor cannot speak for them."""
    numbers = sorted({block.sensor for block in blocks})
    if len(numbers) < 2:
        return rival
    found, largest = [], rival.overlap
    for number in numbers:
        own = [b for b, block in enumerate(blocks) if block.sensor == number]
        target = np.concatenate([noise[b].beside(blocks[b].base, leader.fit.effect[b]) for b in own])
        theirs, ours = _on_sensor(rival.added, own), _on_sensor(leader.added, own)
        if float(target @ target) < _SHOWS**2 or not theirs.units or not ours.units:
            continue
        here, loud = [blocks[b] for b in own], [noise[b] for b in own]
        span, mine = _span(theirs, here, loud), _span(ours, here, loud)
        alike = share_within(span, target)
        if alike > SAME and span.shape[1] <= mine.shape[1]:
            found.append(number)
            largest = max(largest, alike)
    return replace(rival, same_on=tuple(found), overlap=largest)


def _on_sensor(added: Added, own: Sequence[int]) -> Added:
    """The units of an effect that act in the blocks `own`, renumbered; all of its units there, touched or not."""
    units = [
        replace(unit, blocks=tuple(own.index(b) for b in unit.blocks))
        for unit in added.hypothesis.units
        if all(b in own for b in unit.blocks)
    ]
    return replace(added, units=tuple(units))
