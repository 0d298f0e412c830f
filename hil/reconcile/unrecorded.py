"""Which names could not be asked about, for the campaign does not record what they follow, or never repeats it.

A name is only as sure as its rivals could be tried. A bias that rises through the night is ageing or follows a
temperature; where no temperature was recorded, both explain it equally. And what is another in each run is another at
each temperature where none was met twice.
"""

from collections.abc import Iterable, Iterator, Mapping, Sequence

from hil.campaign import Conditions
from hil.model.effects.catalogue import Unasked, effect_by_id, of_its_history
from hil.reconcile.search.posterior import Posterior
from hil.reconcile.search.terms import Term
from hil.solve.temperatures import runs_by_temperature

AGAIN = "a second run at a temperature that has one"
"""What tells what changes from run to run from what follows temperature."""


def unasked(posterior: Posterior) -> dict[str, Sequence[Unasked]]:
    """Return by name what has the same history in these rows and could not be tried; nothing where all was."""
    conditions = {number: search.blocks[0].noise.conditions for number, search in posterior.searches.items()}
    first: dict[str, tuple[Term, Conditions]] = {}
    for found in posterior.sets:
        for number, places in found.terms.items():
            for term in (posterior.term(number, j) for j in places):
                first.setdefault(term.called, (term, conditions[number]))
    out = {name: [*_of_its_history(name, term, here)] for name, (term, here) in first.items()}
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


def _of_its_history(name: str, term: Term, here: Conditions) -> Iterator[Unasked]:
    """Yield what has a name's history in time and could not be tried."""
    effect = term.candidate.effect
    if name and effect is not None:
        own = effect if name == effect.id else effect_by_id(name)
        yield from of_its_history(own, here, term.candidate.shape)
