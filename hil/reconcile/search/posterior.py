"""The posterior over sets of terms in all sensors: grown from the likeliest, weighed by one evidence.

posterior = weigh(searches, kinds)
posterior.sets[0]                   # the most probable: terms by sensor, and its probability
posterior.of_name("supply")         # how probable it is that the name is among the terms
"""

import itertools
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from math import log

import numpy as np

from hil.campaign import FloatArray
from hil.reconcile.search.sets import SensorSearch, Set
from hil.reconcile.search.terms import Term

WIDTH = (8, 5, 4, 3, 2)
"""How many sets are grown further, at none, one, two … terms."""
GROWTH = 10
"""How many terms each of them is tried with."""
PER_NAME = 3
"""Shapes of one name among these: what a name's best shapes cannot do its others cannot."""
WORTH = 7.0
"""Sets this much (log) below the best of their sensor are not combined over sensors."""
ROUGH = 2.0
"""How far (log) a scan at some points of the noise may be off what weighing at all of them gives."""
SCATTER = 0.25
"""Prior of any scatter beyond the ordinary: correlated bias is in every gyro."""
SHARED = 0.75
"""How probably an effect that one sensor (or channel) has is in another."""
COMMON = 0.97
"""And one that is common to sensors."""


@dataclass(frozen=True)
class Found:
    """One set over all sensors: places of terms by sensor, its kind of scatter, and the log of its posterior weight."""

    terms: Mapping[int, Set]
    kind: str
    log_weight: float


@dataclass(frozen=True)
class Posterior:
    """Sets with their log weights (normalised), most probable first, and the log evidence of all of them."""

    searches: Mapping[int, SensorSearch]
    sets: Sequence[Found]
    log_odds: float
    log_evidence: float

    def names(self, found: Found) -> frozenset[str]:
        """Return the names in a set that are no mistakes in the data, the scatter's included."""
        names = {t.name for n, chosen in found.terms.items() for j in chosen if not (t := self.term(n, j)).is_mistake}
        return frozenset(names | ({found.kind} if found.kind else set()))

    def term(self, number: int, place: int) -> Term:
        """Return a term of a sensor by its place."""
        return self.searches[number].terms[place]

    def of_name(self, name: str) -> float:
        """Return the probability that a name is among the terms."""
        return self.where(lambda names: name in names)

    def where(self, holds: object) -> float:
        """Return the probability of the sets of whose names `holds` is true."""
        return float(sum(np.exp(f.log_weight) for f in self.sets if holds(self.names(f))))  # type: ignore[operator]


def likely_sets(search: SensorSearch) -> list[Set]:
    """Return the sets of one sensor that are worth anything, grown term by term from the likeliest."""
    known: dict[Set, float] = {(): _alone(search, ())}
    layer: list[Set] = [()]
    for width in WIDTH:
        leading = _different(search, sorted(layer, key=lambda s: -known[s]), width)
        grown: set[Set] = set()
        for given in leading:
            scores = search.scan(given) + search.log_odds
            least = max(known.values()) - known[given] - WORTH - ROUGH if given else -np.inf
            for j in _best(search, scores, given):
                further = tuple(sorted((*given, j)))
                if further not in known and scores[j] > least:
                    grown.add(further)
        search.weigh(grown)
        for further in grown:
            known[further] = _alone(search, further)
        layer = list(grown)
        best = max(known.values())
        if not layer or max(known[s] for s in layer) < best - WORTH:
            break
    best = max(known.values())
    return [s for s in sorted(known, key=lambda s: -known[s]) if known[s] > best - 2.0 * WORTH or s == ()]


def _different(search: SensorSearch, sets: Sequence[Set], width: int) -> list[Set]:
    """Return the first sets of different names: what the best shapes of some names lack others of them lack too."""
    chosen: dict[tuple[str, ...], Set] = {}
    for s in sets:
        chosen.setdefault(tuple(sorted(search.terms[j].name for j in s)), s)
    return list(chosen.values())[:width]


def _best(search: SensorSearch, scores: FloatArray, given: Set) -> Iterator[int]:
    """Yield the places of the terms that do most, a few shapes of each name, and more names than that."""
    present = {t.name for j in given if not (t := search.terms[j]).is_mistake and not t.recurring}
    count: dict[str, int] = {}
    first: dict[str, float] = {}
    for j in np.argsort(-scores).tolist():
        name = search.terms[j].name
        if name in present or j in given or not np.isfinite(scores[j]):
            continue
        count[name] = count.get(name, 0) + 1
        if count[name] > PER_NAME or scores[j] < first.setdefault(name, scores[j]) - WORTH:
            continue
        yield j
        if len(count) >= GROWTH:
            return


def _alone(search: SensorSearch, chosen: Set) -> float:
    """Log posterior weight of a set in one sensor by itself."""
    return sum(search.terms[j].log_odds for j in chosen) + float(np.logaddexp.reduce(_kinds(search, chosen)))


def _kinds(search: SensorSearch, chosen: Set) -> FloatArray:
    """Log weight of a set by kind of scatter, (names + 1,): ordinary first, each kind with its odds."""
    names, odds = scatter_odds([search])
    shares = shared_evidence(search, chosen, names)
    return np.asarray(shares + np.log(np.array([1.0 - SCATTER, *(SCATTER * o for o in odds)])))


def scatter_odds(searches: Sequence[SensorSearch]) -> tuple[list[str], list[float]]:
    """Return the effects on the scatter that may be asked about, and how they share their prior."""
    effects = {k.effect.id: k.effect for s in searches for b in s.blocks for k in b.noise.kinds}
    total = sum(effect.odds for effect in effects.values())
    return list(effects), [effect.odds / total for effect in effects.values()]


def shared_evidence(search: SensorSearch, chosen: Set, names: Sequence[str]) -> FloatArray:
    """Log evidence of a set by kind, ordinary noise first, (n,): each block may have a kind or not."""
    out = np.zeros(len(names) + 1)
    for block, by_kind in zip(search.blocks, search.evidence(chosen), strict=True):
        ordinary = by_kind[0]
        out[0] += ordinary
        for v, name in enumerate(names):
            own = [by_kind[k + 1] for k, kind in enumerate(block.noise.kinds) if kind.effect.id == name]
            here = float(np.logaddexp.reduce(own)) if own else -np.inf
            common = any(k.effect.id == name and k.effect.common_to_sensors for k in block.noise.kinds)
            rho = COMMON if common else SHARED
            out[v + 1] += np.logaddexp(np.log(rho) + here, np.log(1.0 - rho) + ordinary) if own else ordinary
    return out


def weigh(searches: Mapping[int, SensorSearch]) -> Posterior:
    """Weigh the likely sets of all sensors together: an effect that one has the others probably have too."""
    names, odds = scatter_odds(list(searches.values()))
    log_kind = np.log(np.array([1.0 - SCATTER, *(SCATTER * o for o in odds)])) if names else np.zeros(1)
    lists = {n: _with_the_others(n, searches) for n in searches}
    evidences = {n: {s: shared_evidence(searches[n], s, names) for s in sets} for n, sets in lists.items()}
    askable = {n: {t.name for t in search.terms} for n, search in searches.items()}
    found: list[Found] = []
    own = {n: {s: _Names.of(searches[n], s) for s in sets} for n, sets in lists.items()}
    for combination in itertools.product(*lists.values()):
        chosen = dict(zip(lists, combination, strict=True))
        log_prior = _log_prior({n: own[n][s] for n, s in chosen.items()}, askable)
        by_kind = log_kind + log_prior + sum(evidences[n][s] for n, s in chosen.items())
        found += [Found(chosen, name, float(w)) for name, w in zip(["", *names], by_kind, strict=True)]
    weights = np.array([f.log_weight for f in found])
    nothing = np.array([_is_nothing(f, searches) for f in found])
    log_odds = float(np.logaddexp.reduce(weights[~nothing]) - np.logaddexp.reduce(weights[nothing]))
    total = np.logaddexp.reduce(weights)
    order = [int(i) for i in np.argsort(-weights) if weights[i] > total - 3.0 * WORTH]
    sets = [Found(found[i].terms, found[i].kind, float(weights[i] - total)) for i in order]
    return Posterior(searches, sets, log_odds, float(total))


def _with_the_others(number: int, searches: Mapping[int, SensorSearch]) -> list[Set]:
    """Return a sensor's sets that are worth combining; with several sensors fewer, for their product is what counts."""
    search = searches[number]
    sets = likely_sets(search)
    most = 4000 if len(searches) == 1 else int(4000 ** (1.0 / len(searches)))
    return sets[:most] if () in sets[:most] else [*sets[: most - 1], ()]


@dataclass(frozen=True)
class _Names:
    """The names in a set of one sensor, each with its log odds, and what all else in the set costs (log)."""

    odds: Mapping[str, float]
    rest: float
    common: frozenset[str]

    @classmethod
    def of(cls, search: SensorSearch, chosen: Set) -> "_Names":
        odds: dict[str, float] = {}
        rest, common = 0.0, set()
        for term in (search.terms[j] for j in chosen):
            if term.is_mistake or term.name in odds:
                rest += term.log_odds
            else:
                odds[term.name] = term.log_odds
                common |= {term.name} if term.candidate.effect and term.candidate.effect.common_to_sensors else set()
        return cls(odds, rest, frozenset(common))


def _log_prior(chosen: Mapping[int, _Names], askable: Mapping[int, set[str]]) -> float:
    """Log prior odds of a combination: one price for a name, and whether each sensor that may have it does."""
    total = sum(own.rest for own in chosen.values())
    for name in dict.fromkeys(name for own in chosen.values() for name in own.odds):  # the same sum in every process
        total += max(own.odds[name] for own in chosen.values() if name in own.odds)
        rho = COMMON if any(name in own.common for own in chosen.values()) else SHARED
        could = [name in own.odds for number, own in chosen.items() if name in askable[number]]
        total += sum(log(rho if has else 1.0 - rho) for has in could) if len(could) > 1 else 0.0
    return float(total)


def _is_nothing(found: Found, searches: Mapping[int, SensorSearch]) -> bool:
    return not found.kind and all(
        searches[n].terms[j].name == "row" for n, places in found.terms.items() for j in places
    )
