"""The posterior over sets of terms in all sensors: grown from the likeliest, weighed by one evidence."""

from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property, lru_cache
from itertools import product

import numpy as np

from hil.campaign import FloatArray
from hil.model.effects.base import VarianceEffect
from hil.model.effects.prior import SCATTER, in_another, log_sum, scatter_log_odds
from hil.reconcile.search.lookalikes import exchanged, lookalikes
from hil.reconcile.search.sets import SensorSearch, Set
from hil.reconcile.search.terms import Term
from hil.reconcile.search.together import log_prior, same_states

WIDTH = (8, 5, 4, 3, 2)  # how many sets are grown further, at none, one, two … terms
NARROW = (2, 2, 2, 1, 1)  # and where it is only asked what sets come to, about
FEW = 8  # sets that each then grows into
GROWTH = 8  # how many names each of them is tried with
PER_NAME = 3  # shapes of one name among these: what a name's best shapes cannot do its others cannot
WORTH = 7.0  # sets this much (log) below the best of their sensor are not combined over sensors
EVENTS = 4  # so many, of those that explain most, are asked whether they happened again
TIMES = 4  # and so many times

OTHERS = 16
"""Likely sets of a sensor in which, too, what looks the same as a member of the likeliest is tried in its place."""


@dataclass(frozen=True)
class Found:
    """One set over all sensors: places of terms by sensor, what scatters, and the log of its posterior weight."""

    terms: Mapping[int, Set]
    scatter: frozenset[str]
    log_weight: float


@dataclass(frozen=True)
class Posterior:
    """Sets with their log weights (normalised), most probable first, and the log evidence of all of them.

    Each is made of one of the `lists` of each sensor.
    """

    searches: Mapping[int, SensorSearch]
    lists: Mapping[int, Sequence[Set]]
    sets: Sequence[Found]
    log_odds: float
    log_evidence: float

    def term(self, number: int, place: int) -> Term:
        """Return a term of a sensor by its place."""
        return self.searches[number].terms[place]

    def members(self, found: Found) -> list[Term]:
        """Return the terms of a set."""
        return [self.term(number, place) for number, places in found.terms.items() for place in places]

    def mistakes(self, found: Found) -> list[Term]:
        """Return the mistakes in the data that are in a set."""
        return [term for term in self.members(found) if term.is_mistake]

    def names(self, found: Found) -> frozenset[str]:
        """Return the names in a set: of what moves averages, all without a name as one, and of what scatters them."""
        return found.scatter | {term.called for term in self.members(found)} - {""}

    @cached_property
    def likely(self) -> Mapping[str, float]:
        """How probable each name is that is in any of the sets."""
        out: dict[str, float] = {}
        for found in self.sets:
            out |= {name: out.get(name, 0.0) + float(np.exp(found.log_weight)) for name in self.names(found)}
        return out

    @cached_property
    def scatter(self) -> Mapping[str, VarianceEffect]:
        """The effects on the scatter that were asked about, by id."""
        return scatter_asked(self.searches.values())


def likely_sets(search: SensorSearch, *, serve: bool) -> list[Set]:
    """Return the sets of one sensor that are worth anything, grown term by term from the likeliest.

    From none, and by itself from where the search starts, which hides none of those: two mistakes that hide each other
    are found by no single one. To `serve` them the noise is looked at anew beside whichever leads, until one leads that
    was looked at: beside much that is missing noise seems to wander that does not, and what one more term would explain
    is taken for it.
    """
    widths = WIDTH if serve else NARROW
    known = _grown(search, [()], widths)
    for start in search.starts:
        known |= _grown(search, [start, *(start[:k] + start[k + 1 :] for k in range(len(start)))], widths)
    if serve:
        known |= _alone(search, list(_again(search, max(known, key=lambda s: known[s]))))
    looked_at = set[Set]()
    while serve and (lead := max(known, key=lambda s: known[s])) not in looked_at:
        looked_at.add(lead)
        fewer = [lead[:k] + lead[k + 1 :] for k in range(len(lead))]
        search.serve([lead, *fewer])
        known = _alone(search, [s for s in known if known[s] > known[lead] - 2.0 * WORTH or s == ()])
        known |= _alone(search, [*({*fewer} - {*known}), *_further(search, lead, known)])
    best = max(known.values())
    return [s for s in sorted(known, key=lambda s: -known[s]) if known[s] > best - 2.0 * WORTH or s == ()]


def _grown(search: SensorSearch, layer: Sequence[Set], widths: Sequence[int]) -> dict[Set, float]:
    """Return sets, and those that grow from them, with their log posterior weights in one sensor by itself."""
    known = _alone(search, layer)
    for width in widths:
        leading = sorted(layer, key=lambda s: -known[s])[:width]
        most = FEW if widths is NARROW else None
        grown = list(dict.fromkeys(s for given in leading for s in _further(search, given, known)[:most]))
        if not grown:
            break
        known |= _alone(search, grown)
        # What came first may be what a later one does better: of the likeliest each member is tried without.
        likely = sorted(grown, key=lambda s: -known[s])[:width]
        fewer = {s[:k] + s[k + 1 :] for s in likely for k in range(len(s))} - known.keys()
        known |= _alone(search, list(fewer))
        layer = [*grown, *fewer]
        if max(known[s] for s in layer) < max(known.values()) - WORTH:
            break
    return known


def _further(search: SensorSearch, given: Set, known: Mapping[Set, float]) -> list[Set]:
    """Return the sets with one term more that may be worth as much as those that are known."""
    scores = search.scan(given) + search.odds_beside(given)
    least = max(known.values()) - known[given] - WORTH if given else -np.inf
    further = (tuple(sorted((*given, j))) for j in _best(search, scores, given) if scores[j] > least)
    return [s for s in further if s not in known]


def _again(search: SensorSearch, lead: Set) -> Iterator[Set]:
    """Yield the likeliest set with what may have happened several times: alone, each is hidden by the others' noise.

    In the order in which they leave least of all squares: in that noise none of them is larger than others by chance.
    """
    scores = search.scan(lead) + search.log_odds
    for own in sorted(search.events.values(), key=lambda own: -scores[own].max())[:EVENTS]:
        grown = tuple(j for j in lead if j not in own)
        for _ in range(min(TIMES, len(own) // 2)):
            less = search.explained(own, grown)
            less[np.isin(own, grown)] = -np.inf
            grown = tuple(sorted((*grown, own[int(np.argmax(less))])))
            yield grown


def _best(search: SensorSearch, scores: FloatArray, given: Set) -> Iterator[int]:
    """Yield the places of the terms that do most, a few shapes of each name, and more names than that."""
    present = {t.name for j in given if not (t := search.terms[j]).is_mistake and t.event is None}
    count: dict[str, int] = {}
    first: dict[str, float] = {}
    for j in np.argsort(-scores.round(9), kind="stable").tolist():  # not rounding tells alike ones apart
        name = search.terms[j].name
        if name in present or j in given or not np.isfinite(scores[j]):
            continue
        count[name] = count.get(name, 0) + 1
        if count[name] > PER_NAME or scores[j] < first.setdefault(name, scores[j]) - WORTH:
            continue
        yield j
        if len(count) >= GROWTH:
            return


def served(posterior: Posterior) -> float:
    """Return the log evidence of the likeliest set in the noise that is probable beside it, sensor by sensor."""
    total = 0.0
    for number, chosen in posterior.sets[0].terms.items():
        posterior.searches[number].serve([chosen])
        total += _alone(posterior.searches[number], [chosen])[chosen]
    return total


def _alone(search: SensorSearch, sets: Sequence[Set]) -> dict[Set, float]:
    """Weigh sets in one sensor, and return their log posterior weights by itself."""
    if not sets:
        return {}
    sorts, log_sort = _log_sorts([search])
    by_sort = shared_evidence(search, sets, sorts) + log_sort
    odds = [sum(search.priced(chosen)) for chosen in sets]
    return dict(zip(sets, (np.logaddexp.reduce(by_sort, axis=1) + odds).tolist(), strict=True))


def scatter_asked(searches: Iterable[SensorSearch]) -> Mapping[str, VarianceEffect]:
    """Return the effects on the scatter that may be asked about, by id."""
    kinds = (kind for each in searches for block in each.blocks for kind in block.noise.kinds)
    return {kind.name: kind.effect for kind in kinds if kind.name}


def _log_sorts(searches: Sequence[SensorSearch]) -> tuple[list[frozenset[str]], FloatArray]:
    """Return what may scatter, (n,), ordinary noise alone first, and log priors."""
    odds = scatter_log_odds(scatter_asked(searches).values())
    sorts = list(dict.fromkeys(sort for each in searches for block in each.blocks for sort in block.noise.sorts))
    return sorts, np.array([sum(odds[name] for name in sort) for sort in sorts]) + np.log(1.0 - SCATTER * bool(odds))


def shared_evidence(search: SensorSearch, sets: Sequence[Set], sorts: Sequence[frozenset[str]]) -> FloatArray:
    """Log evidence of sets (m,) with what scatters in the sensors, (m, n): each block may have any of it or not."""
    out = np.zeros((len(sets), len(sorts)))
    for block, by_sort in zip(search.blocks, zip(*search.evidence(sets), strict=True), strict=True):
        has = tuple((kind.name, in_another(kind.effect)) for kind in block.noise.kinds)
        shares = _log_shares(tuple(block.noise.sorts), tuple(sorts), has)
        out += log_sum(np.array(by_sort).T[:, :, None] + shares[:, None])
    return out


@lru_cache(maxsize=64)
def _log_shares(
    here: Sequence[frozenset[str]], of: Sequence[frozenset[str]], has: Sequence[tuple[str, float]]
) -> FloatArray:
    """How probable it is (log) that a block has just what is `here` (m,) `of` what its unit scatters by, (m, n)."""
    share = dict(has)
    out = np.full((len(here), len(of)), -np.inf)
    for i, j in product(range(len(here)), range(len(of))):
        if here[i] <= of[j]:
            out[i, j] = sum(np.log(share[n] if n in here[i] else 1.0 - share[n]) for n in of[j] & share.keys())
    return out


def weigh(searches: Mapping[int, SensorSearch], *, serve: bool = True) -> Posterior:
    """Weigh the likely sets of all sensors together: an effect that one has the others probably have too.

    Without `serve`, of fewer sets, and at the points of the noise that were chosen before any was: so far, about.
    """
    likely = {n: likely_sets(search, serve=serve) for n, search in searches.items()}
    lists = {n: _with_the_others(n, searches, likely) for n in searches}
    return _posterior(searches, lists, dict.fromkeys(searches, ()))


def beside_lookalikes(posterior: Posterior) -> Posterior:
    """Weigh what looks the same as a member of the likeliest set, too, and keep it whatever it is worth."""
    searches, lead = posterior.searches, posterior.sets[0].terms
    alike = {n: lookalikes(search, lead[n]) for n, search in searches.items()}
    same = {n: [lead[n], *exchanged([lead[n]], alike[n])] for n in searches}
    if all(len(own) == 1 for own in same.values()):
        return posterior
    lists = {n: [*dict.fromkeys([*s, *same[n], *exchanged(s[:OTHERS], alike[n])])] for n, s in posterior.lists.items()}
    return _posterior(searches, lists, same)


def _posterior(
    searches: Mapping[int, SensorSearch], lists: Mapping[int, Sequence[Set]], same: Mapping[int, Sequence[Set]]
) -> Posterior:
    """Return how probable sets of all sensors are: likely ones, and all of `same` with the likeliest scatter."""
    weights, sorts = log_weights(searches, lists)
    nothing, kept = np.arange(len(sorts)) == 0, np.arange(len(sorts)) == weights.argmax() % len(sorts)
    for n, sets in lists.items():
        rows = [all(searches[n].terms[j].name == "row" for j in chosen) for chosen in sets]
        nothing = nothing[..., None, :] & np.array(rows)[:, None]
        kept = kept[..., None, :] & np.array([chosen in same[n] for chosen in sets])[:, None]
    log_odds = float(np.logaddexp.reduce(weights[~nothing]) - np.logaddexp.reduce(weights[nothing]))
    total = float(np.logaddexp.reduce(weights, axis=None))
    kept |= weights > total - 3.0 * WORTH
    order = np.argsort(-weights, axis=None, kind="stable")
    found = []
    for i in order[kept.ravel()[order]].tolist():
        *at, k = np.unravel_index(i, weights.shape)
        chosen = {n: sets[place] for (n, sets), place in zip(lists.items(), at, strict=True)}
        found.append(Found(chosen, sorts[k], float(weights.flat[i] - total)))
    return Posterior(searches, lists, found, log_odds, total)


def log_weights(
    searches: Mapping[int, SensorSearch], lists: Mapping[int, Sequence[Set]]
) -> tuple[FloatArray, list[frozenset[str]]]:
    """Return log weights, not normalised, of each sensor's sets together, (m, m', …, n), and what scatters in each."""
    sorts, log_sort = _log_sorts(list(searches.values()))
    weights = log_prior(searches, lists)[..., None] + log_sort
    for axis, (n, sets) in enumerate(lists.items()):
        along = [len(sets) if k == axis else 1 for k in range(len(lists))]
        weights = weights + shared_evidence(searches[n], sets, sorts).reshape(*along, -1)
    for name, effect in scatter_asked(searches.values()).items() if len(lists) > 1 else ():
        has = np.array([name in sort for sort in sorts])
        if effect.common_to_sensors and weights[..., has].max() > weights.max() - 3.0 * WORTH:
            *best, _ = np.unravel_index(np.argmax(np.where(has, weights, -np.inf)), weights.shape)
            chosen = {n: sets[int(place)] for (n, sets), place in zip(lists.items(), best, strict=True)}
            weights[..., has] += same_states(searches, chosen, name)
    return weights, sorts


def _with_the_others(
    number: int, searches: Mapping[int, SensorSearch], likely: Mapping[int, Sequence[Set]]
) -> list[Set]:
    """Return a sensor's likely sets that are worth combining; with several sensors fewer, for their product counts.

    And those with the mistakes that others have and it would have, too: by itself it may hardly show them.
    """
    sets = likely[number]
    most = 4000 if len(searches) == 1 else int(4000 ** (1.0 / len(searches)))
    sets = list(sets[:most] if () in sets[:most] else [*sets[: most - 1], ()])
    led = [searches[n].terms[j] for n, own in likely.items() if n != number for j in own[0]]
    theirs = {term.shared for term in led if term.is_mistake and term.shared}
    same = {j for j, term in enumerate(searches[number].terms) if term.is_mistake and term.shared in theirs}
    return list(dict.fromkeys([*sets, *(tuple(sorted({*chosen, *same})) for chosen in sets[:OTHERS])]))
