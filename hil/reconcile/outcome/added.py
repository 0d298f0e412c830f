"""What is found, added: the model that knows it, what it makes of each parameter, and how the rest solves."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from hil.model import Model
from hil.model.effects.catalogue import SERIES_EFFECTS
from hil.reconcile.inside import named_within
from hil.reconcile.outcome import findings, scatter, stated
from hil.reconcile.outcome.answer import Answer
from hil.reconcile.outcome.improve import improved
from hil.reconcile.outcome.values import before_and_after
from hil.reconcile.result import FoundEffect
from hil.reconcile.wander import Wander


@dataclass(frozen=True)
class Added:
    """The model with what it lacked.

    `within` are the effects that show inside the collects, `values` what each parameter is without what was found and
    with it; `wanders` is what noise is coloured inside the collects, `noise` what averages scatter by beyond it.
    """

    model: Model
    within: Sequence[FoundEffect]
    values: Sequence[Mapping[str, Any]]
    noise: Sequence[Mapping[str, Any]]
    wanders: Mapping[int, Wander]


def added(found: Answer, inside: Sequence[dict[str, Any]]) -> Added:
    """Add to the model what was found in averages, and what was found `inside` the collects."""
    model, sizes = found.problem.model, scatter.pooled(found.scatter)
    after, values = model, []
    if found.names:
        record = {each.name: findings.origin(found.campaign, each, found.gap_of_names) for each in found.names}
        after = improved(model, found.sensors, found.terms, sizes, record, found.calibrated)
        values = before_and_after(model, after, found.sensors, found.terms, found.calibrated, found.alike)
    wanders = stated.wanders(after, found.problem.campaign, found.noise, inside)
    noise = stated.beside(found.noise, wanders)
    after = stated.with_ordinary(after, noise, found.fit.conditions)
    sensors = {number: rows.conditions.sensor for number, rows in found.campaign.sensors.items()}
    moving = {number for number, sensor in sensors.items() if number in wanders or model.moves_inside(sensor)}
    moving |= {n for each in found.names if getattr(each.effect, "moves_inside", False) for n in each.terms or sensors}
    named = named_within(inside, SERIES_EFFECTS, found.alpha, moving)
    within = [effect for effect in named if not model.knows_inside(effect.id, effect.sensors)]
    after = findings.with_inside(after, within, found.campaign)
    if after != model or wanders:
        after = stated.with_white_noise(after, found.campaign, wanders=wanders)
        after = after.model_copy(update={"version": model.version + 1})
    return Added(after, within, values, noise, wanders)
