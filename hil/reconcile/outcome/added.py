"""What is found, added: the model that knows it, what it makes of each parameter, and how the rest solves."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from hil.model import Model
from hil.model.effects.catalogue import SERIES_EFFECTS
from hil.reconcile.inside import named_within
from hil.reconcile.outcome import findings, mistakes, scatter
from hil.reconcile.outcome.answer import Answer
from hil.reconcile.outcome.improve import improved
from hil.reconcile.outcome.values import before_and_after, taken_out
from hil.reconcile.result import FoundEffect, Solved


@dataclass(frozen=True)
class Added:
    """A model with what it lacked.

    `within` are the effects that show inside the collects, `values` what each parameter is without what was found and
    with it; `solved` is what `hil solve` says of the campaign, and `left` what it would say with that taken off.
    """

    before: Model
    model: Model
    within: Sequence[FoundEffect]
    values: Sequence[Mapping[str, Any]]
    solved: Solved
    left: Solved


def added(model: Model, found: Answer, inside: Sequence[dict[str, Any]]) -> Added:
    """Add to a model what was found in averages, and what was found `inside` the collects."""
    fit, wrong = found.fit, found.reading.mistakes
    within = [
        effect
        for effect in named_within(inside, SERIES_EFFECTS, found.alpha, [named.name for named in found.names])
        if not model.knows_inside(effect.id, effect.sensors)
    ]
    by_sensor = scatter.pooled(found.scatter)
    after, values = model, []
    if found.names:
        record = {named.name: findings.origin(found.campaign, named, found.gap_of_names) for named in found.names}
        after = improved(model, found.sensors, found.terms, by_sensor, record, found.calibrated)
        values = before_and_after(found.sensors, found.terms, found.calibrated)
    after = scatter.with_ordinary(after, found.noise, fit.conditions) if found.tested else after
    after = findings.with_inside(after, within, found.campaign)
    if after != model:
        after = scatter.with_white_noise(after, found.campaign).model_copy(update={"version": model.version + 1})
    left = solved = Solved.of(found.campaign)
    if found.names or wrong or model.terms or model.noise:
        sure = mistakes.mended(found.problem.sensors, mistakes.certain(wrong, fit, found.campaign))
        left = Solved.of(taken_out(found.problem, sure, found.terms, by_sensor))
    return Added(model, after, within, values, solved, left)
