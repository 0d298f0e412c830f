"""Which names could not be asked about, for the campaign does not record what they follow, or never repeats it.

A name is only as sure as its rivals could be tried. A bias that rises through the night is ageing or follows a
temperature; where no temperature was recorded, both explain it equally. And what is another in each run is another at
each temperature where none was met twice.
"""

from collections.abc import Iterator
from dataclasses import replace

from hil.model.effects.base import Effect, VarianceEffect
from hil.model.effects.catalogue import effect_by_id
from hil.reconcile.naming import Named
from hil.reconcile.rivals import Rival
from hil.reconcile.search.fitted import Fitted
from hil.solve.temperatures import runs_by_temperature
from procedures.words import listed

AGAIN = "a second run at a temperature that has one"
"""What tells what changes from run to run from what follows temperature."""


def beside_unasked(named: Named, fit: Fitted) -> Named:
    """Share a name's probability with those of the same history in time that this data leaves unasked."""
    unasked: list[tuple[Effect, float, str]] = []
    if isinstance(named.effect, VarianceEffect) and named.effect.follows == "run" and not repeated(fit):
        unasked = [(effect_by_id(name), weight, AGAIN) for name, weight in named.effect.kin.items()]
    elif named.terms and isinstance(named.effect, Effect):
        unasked = [*_of_its_history(named, named.effect, fit)]
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


def repeated(fit: Fitted) -> bool:
    """Whether any run was made at a temperature that another has."""
    return any(len(runs) > 1 for here in fit.conditions.values() for _, runs in runs_by_temperature(here))


def _of_its_history(named: Named, effect: Effect, fit: Fitted) -> Iterator[tuple[Effect, float, str]]:
    """Yield what has a name's history in time and could not be tried, its weight, and what would tell it apart."""
    number, places = next(iter(named.terms.items()))
    here, own = fit.conditions[number], effect if named.name == effect.id else effect_by_id(named.name)
    kin = own.kin_for(here, fit.posterior.term(number, places[0]).candidate.shape)
    for name, weight in kin.items():
        other = effect_by_id(name)
        needs = other.missing(here)
        if needs or not other.shape_grid(here):
            record = [f"record {listed(need.replace('|', ' or ') for need in needs)}"] if needs else []
            yield other, weight, record[0] if record else other.experiment
    for name, weight in own.aliases_for(here).items():
        yield effect_by_id(name), weight, own.experiment
