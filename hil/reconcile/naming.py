"""What is read off the posterior: what is missing, what it is called, what else it may be, and what it follows.

    reading = read(posterior, alpha)
    reading.kind            # "none", "named", "ambiguous", "empirical"
    reading.names           # one Named per effect: probability, rivals, what data and what physics say

What no effect describes counts as one name whatever it seems to follow: which of many curves fits best is no cause.
"""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from hil.model.effects.base import Described, VarianceEffect
from hil.reconcile.search.fitted import Fitted, fitted
from hil.reconcile.search.posterior import Found, Posterior
from hil.reconcile.search.terms import IDENTICAL, Term
from hil.solve.identifiability import SAME_CLASS

CERTAIN = 0.8
"""Probability from which a name is stated as the name."""
LIKELY = 0.5
"""And from which a row is left out where nothing else may be missing: more probable than not."""
BY_CHANCE = 0.01
"""How often noise may get the name of what moves averages: so probable it may be that nothing stands in its place."""
WANDERS = 2.0
"""How much likelier than nothing at all it may be that averages only scatter: Ville's bound is loose by more there."""
EXCLUDED = 0.001
"""What is identical in these collects is told apart where the data themselves make one so much less probable."""
LEAST = 0.01
"""Rivals less probable are not listed, unless they look the same, and shapes add nothing to an interval."""
NO_NAME = "empirical"
Names = tuple[frozenset[str], str]
"""What moves averages in a set, and what scatters them ("": nothing but ordinary noise)."""


@dataclass(frozen=True)
class Also:
    """Another name in the place of one: its probability, overlap, and the factors of data and of physics against it.

    `bayes_factor` is what the data say of the rival against the leader, `prior_odds` what was known before. A `likely`
    cause is in the sensor itself and no accident of the order or the heading: identical, it withholds the name.
    """

    name: str
    title: str
    probability: float
    overlap: float
    bayes_factor: float
    prior_odds: float
    terms: Mapping[int, int]
    remedy: str = ""
    likely: bool = True


@dataclass(frozen=True)
class Named:
    """One name among the leading ones. `terms` are its places by sensor; none for an effect on the scatter."""

    name: str
    kind: str
    probability: float
    rivals: Sequence[Also]
    terms: Mapping[int, Sequence[int]]
    effect: Described | None
    acts_on: str


@dataclass(frozen=True)
class Reading:
    """What the posterior comes to: the leading set, its names, the chance of a false alarm, what the data follow.

    `nothing` is the most probable set of nothing but wrong rows, `mended` that with all mistakes in the data.
    """

    found: Found
    nothing: Found
    mended: Found
    names: Sequence[Named]
    chance: float
    follows: Sequence[tuple[str, float]]
    mistakes: Sequence[tuple[int, Term]]

    @property
    def kind(self) -> str:
        """The verdict: that of the least certain name."""
        kinds = {named.kind for named in self.names}
        return next((k for k in ("ambiguous", NO_NAME, "named") if k in kinds), "none")


def read(posterior: Posterior, alpha: float) -> Reading:
    """Read the posterior; `alpha` is the rate at which anything is called missing where nothing is.

    Of data without a missing effect at most a share alpha can reach odds of (1 - alpha)/alpha against it (Ville), so
    that these odds are asked for: of anything at all, and of every further name beside the others.
    """
    classes = {id(f): classes_of(posterior, f) for f in posterior.sets}
    chance = float(1.0 / (1.0 + np.exp(min(posterior.log_odds, 700.0))))
    every: dict[Names, float] = {}
    for f in posterior.sets:
        together = classes[id(f)] - {f.kind}, f.kind
        every[together] = every.get(together, 0.0) + float(np.exp(f.log_weight))
    lead = leading(every, alpha)
    unnamed = [f for f in posterior.sets if not classes[id(f)]]
    # Where something has to be missing, a row may only stand in its place: it is asked for whatever else is there.
    among, sure = (unnamed, LIKELY) if chance > alpha else (posterior.sets, CERTAIN)
    unnamed = _surely_wrong(posterior, unnamed, among, sure)
    right = [
        f for f in unnamed if all(posterior.term(n, j).name == "row" for n, places in f.terms.items() for j in places)
    ]
    as_filed = right[0] if right else Found(dict.fromkeys(posterior.searches, ()), "", -np.inf)
    of_lead = [f for f in posterior.sets if classes[id(f)] == lead]
    own = _surely_wrong(posterior, of_lead, among, sure) or of_lead  # where none of them leaves less out, the likeliest
    found = own[0] if own and (lead or chance <= alpha) else as_filed
    mistakes = [(n, t) for n, places in found.terms.items() for j in places if (t := posterior.term(n, j)).is_mistake]
    values = fitted(posterior, found)
    names = [_named(posterior, classes, name, lead, found, values) for name in sorted(lead)]
    # Of what is as sure, that which moves averages comes first.
    names = sorted(names, key=lambda named: (-round(named.probability, 2), named.acts_on, -named.probability))
    return Reading(
        found,
        as_filed,
        unnamed[0] if unnamed else as_filed,
        names,
        chance,
        _follows(posterior) if lead else (),
        mistakes,
    )


def classes_of(posterior: Posterior, found: Found) -> frozenset[str]:
    """Return the names in a set, those without a name as one."""
    names = {t.name if t.tier == 1 else NO_NAME for _, t in _members(posterior, found)}
    return frozenset(names | ({found.kind} if found.kind else set()))


def _members(posterior: Posterior, found: Found) -> list[tuple[int, Term]]:
    pairs = [(n, posterior.term(n, j)) for n, places in found.terms.items() for j in places]
    return [(n, t) for n, t in pairs if not t.is_mistake]


def _left_out(posterior: Posterior, found: Found) -> int:
    """Return how many rows and runs a set leaves out."""
    terms = (posterior.term(n, j) for n, places in found.terms.items() for j in places)
    return sum(term.is_mistake and term.candidate.effect is None for term in terms)


def _surely_wrong(posterior: Posterior, sets: Sequence[Found], among: Sequence[Found], sure: float) -> list[Found]:
    """Return those of some sets that leave out no more rows and runs than are wrong among others, so `sure` it is."""
    counts = np.array([_left_out(posterior, f) for f in among])
    weights = np.exp([f.log_weight for f in among])
    most = [k for k in range(1, int(counts.max(initial=0)) + 1) if weights[counts >= k].sum() >= sure * weights.sum()]
    return [f for f in sets if _left_out(posterior, f) <= max(most, default=0)]


def _mass(posterior: Posterior, holds: Callable[[Found], bool]) -> float:
    return float(sum(np.exp(f.log_weight) for f in posterior.sets if holds(f)))


def leading(every: Mapping[Names, float], alpha: float) -> frozenset[str]:
    """The most probable names together, less those beside which nothing more would have been called missing.

    `every` has each set's probability by what moves averages in it, and what scatters them. What moves them must stand
    against what only scatters, too: noise that wanders looks like much.
    """
    weights = every
    while True:
        names, kind = max(weights, key=lambda key: weights[key], default=(frozenset[str](), ""))
        left = {kind: _mass_of(every, names, ("",))} if kind else {}
        for name in names:
            others = names - {name}
            left[name] = max(_mass_of(every, others, ("", kind)), _mass_of(every, others) / WANDERS)
        weakest = max(left, key=lambda name: left[name], default="")
        if not weakest or left[weakest] <= alpha:
            return names | ({kind} if kind else set())
        others = names - {weakest}
        weights = {k: w for k, w in weights.items() if k[0] <= others and (k[1] != weakest or weakest in names)}


def _mass_of(weights: Mapping[Names, float], names: frozenset[str], kinds: Sequence[str] | None = None) -> float:
    """How probable it is that nothing but `names` moves averages, with one of some kinds of scatter or with any."""
    return sum(w for (own, kind), w in weights.items() if own <= names and (kinds is None or kind in kinds))


def _named(
    posterior: Posterior,
    classes: Mapping[int, frozenset[str]],
    name: str,
    lead: frozenset[str],
    found: Found,
    values: Fitted,
) -> Named:
    """One name with its rivals: what stands in its place where it is not."""
    probability = _mass(posterior, lambda f: name in classes[id(f)])
    known = {n: [j for j in places if _is(posterior.term(n, j), name)] for n, places in found.terms.items()}
    own = {number: places for number, places in known.items() if places}
    without = [f for f in posterior.sets if name not in classes[id(f)]]
    instead: dict[str, list[Found]] = {}
    for f in without:
        # What scatters stands in for what moves, and the reverse, only where nothing else of that sort is there.
        sort = {f.kind} & classes[id(f)] if not own else classes[id(f)] - {f.kind}
        for rival in (sort or classes[id(f)]) - lead:
            instead.setdefault(rival, []).append(f)
    rivals = [_rival(posterior, classes, name, r, sets, own, values) for r, sets in instead.items()]
    told = [r for r in rivals if r.probability >= LEAST or r.overlap > SAME_CLASS]
    listed = sorted(told, key=lambda r: -r.probability)
    alike = [r for r in listed if r.overlap > IDENTICAL and not r.bayes_factor < EXCLUDED]
    withheld = [r for r in alike if r.likely or r.probability > 1.0 - CERTAIN]
    nothing_there = _mass(posterior, lambda f: name not in classes[id(f)] and classes[id(f)] - {f.kind} <= lead)
    sure = probability >= CERTAIN and not (own and nothing_there > BY_CHANCE)
    kind = "named" if sure and not withheld else "ambiguous"
    first = next((posterior.term(n, places[0]) for n, places in own.items()), None)
    if name == NO_NAME:
        kind = NO_NAME
    effect: Described | None = scatter_of(posterior)[name] if first is None else first.candidate.effect
    return Named(name, kind, probability, listed, own, effect, "mean" if own else "scatter")


def _rival(
    posterior: Posterior,
    classes: Mapping[int, frozenset[str]],
    name: str,
    rival: str,
    instead: Sequence[Found],
    own: Mapping[int, Sequence[int]],
    values: Fitted,
) -> Also:
    probability = float(sum(np.exp(f.log_weight) for f in instead))
    terms = {n: j for n, places in instead[0].terms.items() for j in places if _is(posterior.term(n, j), rival)}
    beside = [f for f in posterior.sets if name in classes[id(f)]]
    overlap, factor = 0.0, np.nan
    scatter = scatter_of(posterior)
    if not own and rival in scatter:
        overlap = values.scatter_overlap(name, rival)
    if own and terms:
        overlap = min((values.overlap(posterior, n, own[n], terms[n]) for n in own if n in terms), default=0.0)
    if beside:
        other = fitted(posterior, instead[0])
        factor = float(np.exp(np.clip(other.information - values.information, -600.0, 600.0)))
        factor = 1.0 if overlap > 0.999 else factor
    odds = probability / max(sum(float(np.exp(f.log_weight)) for f in beside), 1e-300)
    first = next(iter(terms.items()), None)
    title = getattr(scatter.get(rival), "title", "") if first is None else posterior.term(*first).candidate.title
    remedy, effect = "", scatter.get(rival) if first is None else posterior.term(*first).candidate.effect
    if first is not None and rival == NO_NAME:
        term = posterior.term(*first)
        follows = next((posterior.term(n, places[0]).follows for n, places in own.items()), "time")
        rival, remedy = f"{NO_NAME}: {term.name}", f"let {term.follows} go in another order than {follows}"
        overlap = 0.0 if term.follows == follows else overlap  # a curve over the same says nothing else
    return Also(
        rival,
        title,
        probability,
        overlap,
        factor,
        odds / max(factor, 1e-300),
        terms,
        remedy,
        effect is not None and not effect.incidental and effect.odds >= 1.0,
    )


def _is(term: Term, name: str) -> bool:
    return not term.is_mistake and (term.name if term.tier == 1 else NO_NAME) == name


def scatter_of(posterior: Posterior) -> dict[str, VarianceEffect]:
    """Return the effects on the scatter that were asked about, by id."""
    kinds = (kind for search in posterior.searches.values() for block in search.blocks for kind in block.noise.kinds)
    return {kind.effect.id: kind.effect for kind in kinds}


def _follows(posterior: Posterior) -> list[tuple[str, float]]:
    """What the disagreement follows, each driver with the probability that some term follows it, given that one is."""
    totals: dict[str, float] = {}
    any_of_them = 0.0
    scatter = scatter_of(posterior)
    for f in posterior.sets:
        drivers = dict.fromkeys(t.follows for _, t in _members(posterior, f))  # what moves averages comes first
        drivers |= dict.fromkeys(scatter[f.kind].follows for _ in f.kind[:1])
        weight = float(np.exp(f.log_weight))
        any_of_them += weight if drivers else 0.0
        for driver in drivers:
            totals[driver] = totals.get(driver, 0.0) + weight
    shares = [(driver, min(total / any_of_them, 1.0)) for driver, total in totals.items()]
    return sorted((s for s in shares if s[1] >= LEAST), key=lambda s: -round(s[1], 6))
