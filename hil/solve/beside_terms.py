"""Solving beside a model file: what its named terms explain is taken off the rates, the rest is solved for.

    solutions = solve_beside(campaign, load_model("model.yaml"))

So the improved model that reconcile writes gives parameters that are no longer bent by the effect it names.
"""

from dataclasses import replace

from hil.campaign import Campaign, Collects, Conditions
from hil.campaign.stand_ins import with_stand_ins
from hil.errors import InputError
from hil.model import Model
from hil.solve.runs import RunSolution, solve_campaign


def solve_beside(campaign: Campaign, model: Model) -> list[RunSolution]:
    """Solve every run for the model's form, after its terms (their values are the model's, not refitted).

    Raises `InputError` where a term needs a column that the data lacks, or the model has no values for a sensor on
    which it has a term.
    """
    return [
        replace(each, model=model.full_title, assumed=(*each.assumed, *_assumed(campaign, each, model)))
        for each in solve_campaign(less_terms(campaign, model), model.form)
    ]


def less_terms(campaign: Campaign, model: Model) -> Campaign:
    """Return the campaign with what the model's terms make taken off the rates; raises `InputError` as above."""
    asked = {number: rows.conditions for number, rows in with_stand_ins(campaign).sensors.items()}
    less = {number: _less(rows, asked[number], model) for number, rows in campaign.sensors.items()}
    return replace(campaign, sensors=less)


def _less(rows: Collects, conditions: Conditions, model: Model) -> Collects:
    sensor = conditions.sensor
    if not model.terms_for(sensor):
        return rows
    if not model.has_values(sensor):
        raise InputError(
            f"model {model.title}: it has named terms but no values for sensor {sensor.number}; its terms cannot be "
            "taken off the rates"
        )
    terms = model.rates(conditions) - model.base_for(conditions).rates
    return replace(rows, rates_deg_per_hr=rows.rates_deg_per_hr - terms)


def _assumed(campaign: Campaign, solution: RunSolution, model: Model) -> tuple[str, ...]:
    terms = model.terms_for(campaign.sensors[solution.sensor].conditions.sensor)
    return tuple(f"{term.effect} as model {model.title} has it" for term, _ in terms)
