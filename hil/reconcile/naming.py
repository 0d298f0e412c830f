"""What is read off the posterior: what is missing, what it is called, what else it may be, and what it follows."""

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from types import MappingProxyType

import numpy as np

from hil.campaign import Conditions
from hil.model.effects.base import Described
from hil.model.effects.catalogue import Unasked
from hil.reconcile.follows import Follows, own_share, unasked, what_it_follows
from hil.reconcile.rivals import CERTAIN, LEAST, Rival
from hil.reconcile.search.fitted import Fitted, fitted
from hil.reconcile.search.posterior import Found, Posterior
from hil.reconcile.search.terms import NO_NAME, Term
from hil.solve.explained import CERTAIN as DONE
from hil.solve.uncertain import RARE

LIKELY = 0.5
"""And from which a row is left out where nothing else may be missing: more probable than not."""
WANDERS = 2.0
"""How much likelier than nothing at all it may be that averages only scatter: Ville's bound is loose by more there."""
Names = tuple[frozenset[str], frozenset[str]]
"""What moves averages in a set, and what scatters them beyond ordinary noise."""
_Weighed = tuple[frozenset[str], float, Found]  # the names in a set, how probable it is, and the set


@dataclass(frozen=True)
class Named:
    """One name among the leading ones. `terms` are its places by sensor; none for an effect on the scatter.

    `probability` is that it is there, in whichever sensor; `of_sensor` that it is in this one.
    """

    name: str
    kind: str
    probability: float
    rivals: Sequence[Rival]
    terms: Mapping[int, Sequence[int]]
    effect: Described | None
    acts_on: str
    of_sensor: Mapping[int, float] = field(default_factory=dict)


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
    follows: Follows
    mistakes: Sequence[Term]


def read(posterior: Posterior, alpha: float) -> Reading:
    """Read the posterior; `alpha` is the rate at which anything is called missing where nothing is.

    Of data without a missing effect at most a share alpha can reach odds of (1 - alpha)/alpha against it (Ville), so
    that these odds are asked for: of anything at all, and of every further name beside the others.
    """
    sets = [(posterior.names(f), float(np.exp(f.log_weight)), f) for f in posterior.sets]
    chance = float(1.0 / (1.0 + np.exp(min(posterior.log_odds, 700.0))))
    every: dict[Names, float] = {}
    for own, weight, f in sets:
        every[own - f.scatter, f.scatter] = every.get((own - f.scatter, f.scatter), 0.0) + weight
    beside = unasked(posterior)
    lead = leading(every, alpha, {name: own_share(beside, name) for name in beside})
    unnamed = [f for own, _, f in sets if not own]
    # Where something has to be missing, a row may only stand in its place: it is asked for whatever else is there.
    among, sure = (unnamed, LIKELY) if chance > alpha else (posterior.sets, DONE)
    unnamed = _surely_wrong(posterior, unnamed, among, sure)
    right = [f for f in unnamed if all(term.name == "row" for term in posterior.members(f))]
    as_filed = right[0] if right else Found(dict.fromkeys(posterior.searches, ()), frozenset(), -np.inf)
    of_lead = [f for own, _, f in sets if own == lead]
    first = _surely_wrong(posterior, of_lead, among, sure) or of_lead  # where none leaves less out, the likeliest
    found = first[0] if first and (lead or chance <= alpha) else as_filed
    fit = fitted(posterior, found)
    names = [_named(fit, sets, name, lead, beside) for name in sorted(lead)]
    # Of what is as sure, that which moves averages comes first.
    names = sorted(names, key=lambda named: (-round(named.probability, 2), named.acts_on, -named.probability))
    mended = unnamed[0] if unnamed else as_filed
    follows = what_it_follows(posterior, beside) if lead else Follows()
    return Reading(found, as_filed, mended, names, chance, follows, posterior.mistakes(found))


def _surely_wrong(posterior: Posterior, sets: Sequence[Found], among: Sequence[Found], sure: float) -> list[Found]:
    """Return those of some sets that leave out no more rows and runs than are wrong among others, so `sure` it is."""

    def left_out(found: Found) -> int:
        return sum(term.is_mistake and term.candidate.effect is None for term in posterior.members(found))

    counts = np.array([left_out(f) for f in among])
    weights = np.exp([f.log_weight for f in among])
    most = [k for k in range(1, int(counts.max(initial=0)) + 1) if weights[counts >= k].sum() >= sure * weights.sum()]
    return [f for f in sets if left_out(f) <= max(most, default=0)]


def leading(
    every: Mapping[Names, float], alpha: float, own: Mapping[str, float] = MappingProxyType({})
) -> frozenset[str]:
    """The most probable names together, less those beside which nothing more would have been called missing.

    `every` has each set's probability by what moves averages in it, and what scatters them. What moves them must stand
    against what only scatters, too: noise that wanders looks like much. Of names `own` is the part that is theirs.
    """

    def named(key: Names) -> float:
        return weights[key] * float(np.prod([own.get(name, 1.0) for name in key[0] | key[1]]))

    weights = every
    while True:
        names, scatter = max(weights, key=lambda key: weights[key], default=(frozenset[str](), frozenset[str]()))
        if names | scatter:  # what has no name has nobody to share with
            names, scatter = max((key for key in weights if key[0] | key[1]), key=named)
        left = {kind: _mass_of(every, names, scatter - {kind}) for kind in scatter}
        for name in names:
            others = names - {name}
            left[name] = max(_mass_of(every, others, scatter), _mass_of(every, others) / WANDERS)
        weakest = max(left, key=lambda name: left[name], default="")
        if not weakest or left[weakest] <= alpha:
            return _likelier(weights, names, scatter, own)
        others = names - {weakest}  # what moves averages may have the name of what scatters them, and only one goes
        weights = {k: w for k, w in weights.items() if k[0] <= others and (weakest in names or weakest not in k[1])}


def _likelier(
    weights: Mapping[Names, float], names: frozenset[str], scatter: frozenset[str], own: Mapping[str, float]
) -> frozenset[str]:
    """Return the names, each exchanged for what is likelier by all sets and may stand in its place beside the others.

    The most probable set need not have the most probable name: what is as good may be in more sets.
    """
    shares: dict[str, float] = {}
    for (moving, scattering), weight in weights.items():
        for name in moving | scattering:
            shares[name] = shares.get(name, 0.0) + weight * own.get(name, 1.0)
    lead = [names, scatter]
    for side, other in ((0, 1), (1, 0)):
        for name in sorted(lead[side]):
            others = lead[side] - {name}
            beside = [key[side] - others for key in weights if key[other] == lead[other] and key[side] > others]
            may = {name, *(of for of, *more in map(sorted, beside) if not more and of != NO_NAME)}
            # Of what is as probable as makes no difference, what has a name comes first.
            lead[side] = others | {max(sorted(may), key=lambda of: (round(shares[of], 2), of != NO_NAME, shares[of]))}
    return lead[0] | lead[1]


def _mass_of(weights: Mapping[Names, float], names: frozenset[str], scatter: frozenset[str] | None = None) -> float:
    """How probable it is that nothing but `names` moves averages, and only `scatter` scatters them, if given."""
    return sum(w for (own, kinds), w in weights.items() if own <= names and (scatter is None or kinds <= scatter))


def _named(
    fit: Fitted,
    sets: Sequence[_Weighed],
    name: str,
    lead: frozenset[str],
    beside: Mapping[str, Sequence[Unasked]],
) -> Named:
    """One name with its rivals: what stands in its place where it is not."""
    posterior = fit.posterior
    probability = posterior.likely[name]
    known = {n: [j for j in js if posterior.term(n, j).called == name] for n, js in fit.found.terms.items()}
    own = {number: places for number, places in known.items() if places}
    first = next((posterior.term(n, places[0]) for n, places in own.items()), None)
    effect: Described | None = posterior.scatter[name] if first is None else first.candidate.effect
    instead = in_its_place([each for each in sets if name not in each[0]], lead, moves=bool(own))
    rivals, before = dict[str, Rival](), set[int]()
    for rival in sorted(instead, key=lambda each: -sum(weight for _, weight, _ in instead[each])):
        without = sum(weight for _, weight, f in instead[rival] if id(f) not in before)
        before |= {id(f) for _, _, f in instead[rival]}
        rivals[rival] = replace(_rival(fit, name, effect, probability, rival, instead[rival], own), alone=without)
    nothing_there = sum(weight for names, weight, f in sets if name not in names and names - f.scatter <= lead)
    sure = probability >= CERTAIN and not (own and nothing_there > RARE)
    named = sure and name not in beside and not any(rival.withholds for rival in rivals.values())
    kind = NO_NAME if name == NO_NAME else "named" if named else "ambiguous"
    share = own_share(beside, name)
    of_sensor = {  # what scatters does so in all of them
        n: share
        * sum(
            w for _, w, f in sets if name in f.scatter or any(posterior.term(n, j).called == name for j in f.terms[n])
        )
        for n in own
    }
    told = [
        Rival(of.effect.id, share * of.weight * probability, 1.0, of.effect.title, 1.0, of.weight, remedy=of.remedy)
        for of in beside.get(name, ())
    ]
    for rival, of in rivals.items():
        part = own_share(beside, rival)
        told.append(_as_part(of, part, share))
        for untried in beside.get(rival, ()):
            other = replace(of, id=untried.effect.id, title=untried.effect.title, terms={}, remedy=untried.remedy)
            told.append(_as_part(other, part * untried.weight, share))
    listed: dict[str, Rival] = {}
    for each in sorted(told, key=lambda r: -r.probability):
        if each.probability >= LEAST or each.alike:
            listed.setdefault(each.id, each)
    acts_on = "mean" if own else "scatter"
    return Named(name, kind, share * probability, [*listed.values()], own, effect, acts_on, of_sensor)


def _as_part(rival: Rival, part: float, share: float) -> Rival:
    """Return a rival as probable as its own `part` is, beside a name of which a `share` is the name's own."""
    odds = None if rival.prior_odds is None else rival.prior_odds * part / share
    return replace(rival, probability=rival.probability * part, alone=rival.share * part, prior_odds=odds)


def in_its_place(sets: Sequence[_Weighed], lead: frozenset[str], *, moves: bool) -> Mapping[str, Sequence[_Weighed]]:
    """Return by rival the sets in which it stands for a name that is missing, and that `moves` averages or scatters."""
    out: dict[str, list[_Weighed]] = {}
    for each in sets:
        names, _, f = each
        # What scatters stands in for what moves, and the reverse, where nothing of that sort is there beside the lead.
        sort = names - f.scatter if moves else f.scatter
        for rival in (sort - lead) or (names - lead):
            out.setdefault(rival, []).append(each)
    return out


def _rival(
    fit: Fitted,
    name: str,
    named: Described | None,
    share: float,
    rival: str,
    instead: Sequence[_Weighed],
    own: Mapping[int, Sequence[int]],
) -> Rival:
    """One rival: the sets that have it in the place of the name, which has a `share` and its `own` places."""
    posterior, found = fit.posterior, instead[0][2]
    probability = sum(weight for _, weight, _ in instead)
    terms = {n: j for n, places in found.terms.items() for j in places if posterior.term(n, j).called == rival}
    overlap, factor, before = 0.0, None, None
    if not own and rival in posterior.scatter:
        overlap = fit.scatter_overlap(name, rival)
    if own and terms:
        overlap = min((fit.overlap(n, own[n], terms[n]) for n in own if n in terms), default=0.0)
    if bool(own) == bool(terms):  # what scatters pays for no value, so that its likelihood is of another sort
        other = fitted(posterior, found)
        factor = float(np.exp(np.clip(other.information - fit.information, -600.0, 600.0)))
        factor = 1.0 if overlap > 0.999 else factor
        before = probability / max(share, 1e-300) / max(factor, 1e-300)
    term = next((posterior.term(n, j) for n, j in terms.items()), None)
    effect = posterior.scatter.get(rival) if term is None else term.candidate.effect
    title, remedy = getattr(effect if term is None else term.candidate, "title", ""), ""
    if term is not None and NO_NAME in {rival, name}:
        follows = next((posterior.term(n, places[0]).follows for n, places in own.items()), "time")
        remedy = told_apart_by(term.follows, follows)
        if rival == NO_NAME:
            rival = f"{NO_NAME}: {term.name}"
            overlap = 0.0 if term.follows == follows else overlap  # a curve over the same says nothing else
    likely = effect is not None and as_usual(effect, named, fit.conditions.values())
    return Rival(rival, probability, overlap, title, factor, before, terms, remedy, likely)


def as_usual(rival: Described, named: Described | None, conditions: Iterable[Conditions]) -> bool:
    """Whether a rival is a usual cause somewhere, or as usual as the name, and no accident of the order or heading."""
    least = [(here, 1.0 if named is None else min(named.odds_for(here), 1.0)) for here in conditions]
    return not rival.incidental and any(rival.odds_for(here) >= odds for here, odds in least)


def told_apart_by(follows: str, other: str) -> str:
    """Say what to do to tell what follows one thing from what follows another, or from a curve over the same.

    >>> told_apart_by("time", "temperature")
    'let time go in another order than temperature'
    >>> told_apart_by("temperature", "temperature")
    'measure at other values of temperature, too'
    """
    return (
        f"measure at other values of {other}, too"
        if follows == other
        else f"let {follows} go in another order than {other}"
    )
