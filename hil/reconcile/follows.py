"""What a disagreement follows – time, temperature, its rate, its history, pose, supply, run – whatever its name is.

That is often settled when no name is. Where it is not, it may be settled that it follows one of a few, between which
the collects cannot decide: of two temperatures, say, the temperature or the way that led to it.

And a name is only as sure as its rivals could be tried. A bias that rises through the night is ageing or follows a
temperature; where no temperature was recorded, both explain it equally. And what is another in each run is another at
each temperature where none was met twice.
"""

from collections.abc import Collection, Iterable, Mapping, Sequence
from dataclasses import dataclass
from math import exp, prod
from typing import Any

from hil.campaign import Conditions
from hil.model.effects.catalogue import Unasked, effect_by_id, of_its_history, variance_effect_by_id
from hil.reconcile.rivals import CERTAIN, LEAST
from hil.reconcile.search.posterior import Posterior
from hil.reconcile.search.terms import Term
from hil.solve.temperatures import runs_by_temperature

AGAIN = "a second run at a temperature that has one"
"""What tells what changes from run to run from what follows temperature."""
MOST = 3
"""Drivers of which one is followed, names that may be right instead: of more nothing is said."""


@dataclass(frozen=True)
class Follows:
    """How probable it is that something follows a driver, given that anything is missing.

    `shares` (driver, probability), largest first; `one_of` the `drivers` that are not stated, as few as it takes, of
    which one is followed with a `probability` that is stated; none where there are no such few.
    """

    shares: Sequence[tuple[str, float]] = ()
    one_of: Mapping[str, Any] | None = None


def what_it_follows(posterior: Posterior, beside: Mapping[str, Sequence[Unasked]]) -> Follows:
    """Return what the sets of a posterior follow, that names share with what is `beside` them included."""
    names: dict[tuple[str, str], Mapping[str, float]] = {}
    weights: dict[frozenset[tuple[str, str]], float] = {}
    for f in posterior.sets:  # what moves averages comes first
        own = dict.fromkeys((term.called, term.follows) for term in posterior.members(f) if not term.is_mistake)
        own |= dict.fromkeys((name, posterior.scatter[name].follows) for name in sorted(f.scatter))
        for each in own:
            if each not in names:
                names[each] = _drivers(*each, beside)
        if own:
            weights[frozenset(own)] = weights.get(frozenset(own), 0.0) + exp(f.log_weight)
    whole = sum(weights.values())

    def share(drivers: Collection[str]) -> float:
        """How probable it is that any term of a set follows any of some drivers."""

        def none(own: Collection[tuple[str, str]]) -> float:
            return prod(1.0 - sum(names[each].get(driver, 0.0) for driver in drivers) for each in own)

        return min(sum(weight * (1.0 - none(own)) for own, weight in weights.items()) / whole, 1.0)

    of_each = [(driver, share([driver])) for driver in dict.fromkeys(d for own in names.values() for d in own)]
    shares = sorted((each for each in of_each if each[1] >= LEAST), key=lambda each: -round(each[1], 6))
    open_ones = [driver for driver, chance in shares if chance < CERTAIN]
    for many in range(2, 1 + min(len(open_ones), MOST)):
        if (chance := share(open_ones[:many])) >= CERTAIN:
            return Follows(shares, {"drivers": open_ones[:many], "probability": chance})
    return Follows(shares)


def _drivers(name: str, follows: str, beside: Mapping[str, Sequence[Unasked]]) -> dict[str, float]:
    """Return what a name follows, or what could not be tried in its place does, each with its part."""
    own = own_share(beside, name)
    parts = {follows: own}
    for each in beside.get(name, ()):
        parts[each.effect.follows] = parts.get(each.effect.follows, 0.0) + own * each.weight
    return parts


def unasked(posterior: Posterior) -> dict[str, Sequence[Unasked]]:
    """Return by name what has the same history in these rows and could not be tried; nothing where all was."""
    conditions = {number: search.blocks[0].noise.conditions for number, search in posterior.searches.items()}
    first: dict[str, tuple[Term, Conditions]] = {}
    for found in posterior.sets:
        for number, places in found.terms.items():
            for term in (posterior.term(number, j) for j in places):
                first.setdefault(term.called, (term, conditions[number]))
    out = dict[str, Sequence[Unasked]]()
    for name, (term, here) in first.items():
        if name and (effect := term.candidate.effect) is not None:
            own = effect if name == effect.id else effect_by_id(name)
            out[name] = [*of_its_history(own, here, term.candidate.shape)]
    alike: dict[str, dict[str, float]] = {}
    for block in (block for search in posterior.searches.values() for block in search.blocks):
        for name, weights in block.noise.alike.items():
            alike.setdefault(name, {}).update(weights)
    elsewhere = "the same collects at further temperatures, for longer, and in another order"  # one of it tells them
    for name, weights in alike.items():
        out[name] = [Unasked(variance_effect_by_id(n), weight, elsewhere) for n, weight in weights.items()]
    if not repeated(conditions.values()):
        kin = {name: effect.kin for name, effect in posterior.scatter.items() if effect.follows == "run"}
        out |= {name: [Unasked(effect_by_id(n), w, AGAIN) for n, w in own.items()] for name, own in kin.items()}
    return {name: of for name, of in out.items() if of}


def own_share(of: Mapping[str, Sequence[Unasked]], name: str) -> float:
    """Return which part of a name's probability is its own beside what could not be tried."""
    return 1.0 / (1.0 + sum(each.weight for each in of.get(name, ())))


def repeated(conditions: Iterable[Conditions]) -> bool:
    """Whether any run was made at a temperature that another has."""
    return any(len(runs) > 1 for here in conditions for _, runs in runs_by_temperature(here))
