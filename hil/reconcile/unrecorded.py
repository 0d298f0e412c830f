"""Which names could not be asked about, for the campaign does not record what they follow.

A name is only as sure as its rivals could be tried. A bias that rises through the night is ageing or follows a
temperature; where no temperature was recorded, both explain it equally.
"""

from dataclasses import replace

from hil.model.effects.base import Effect
from hil.model.effects.catalogue import effect_by_id
from hil.reconcile.naming import Named
from hil.reconcile.rivals import Rival
from hil.reconcile.search.fitted import Fitted
from procedures.words import listed


def beside_unasked(named: Named, fit: Fitted) -> Named:
    """Share a name's probability with those of the same history in time that this data leaves unasked."""
    if not named.terms or not isinstance(named.effect, Effect):
        return named
    number, places = next(iter(named.terms.items()))
    here, own = fit.conditions[number], named.effect if named.name == named.effect.id else effect_by_id(named.name)
    kin = own.kin_for(here, fit.posterior.term(number, places[0]).candidate.shape)
    unasked: list[tuple[Effect, float, str]] = []
    for name, weight in kin.items():
        effect = effect_by_id(name)
        needs = effect.missing(here)
        if needs or not effect.shape_grid(here):
            record = [f"record {listed(need.replace('|', ' or ') for need in needs)}"] if needs else []
            unasked.append((effect, weight, record[0] if record else effect.experiment))
    aliases = own.aliases_for(here).items()
    unasked += [(effect_by_id(name), weight, own.experiment) for name, weight in aliases]
    if not unasked:
        return named
    share = 1.0 / (1.0 + sum(weight for _, weight, _ in unasked))
    others = [
        Rival(effect.id, named.probability * share * weight, 1.0, effect.title, 1.0, weight, remedy=remedy)
        for effect, weight, remedy in unasked
    ]
    rivals = sorted([*named.rivals, *others], key=lambda r: -r.probability)
    of_sensor = {n: own * share for n, own in named.of_sensor.items()}
    return replace(named, probability=named.probability * share, of_sensor=of_sensor, rivals=rivals, kind="ambiguous")
