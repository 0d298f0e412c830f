"""The findings of a search in the words and numbers of the result: verdict, effects, gap, mistakes, places, origin."""

from collections.abc import Mapping, Sequence
from dataclasses import replace
from datetime import UTC
from typing import Any

import numpy as np

from drivers.clock import SystemClock
from hil.campaign import Campaign
from hil.files.document import picked
from hil.model import Model
from hil.model.effects.base import Described, Effect
from hil.model.effects.catalogue import named as known_as
from hil.model.effects.catalogue import over_temperature
from hil.model.effects.document import shape_in_words
from hil.model.model_file import InsideCollects
from hil.reconcile.naming import Named
from hil.reconcile.outcome.improve import described_parameters
from hil.reconcile.outcome.scatter import FoundScatter
from hil.reconcile.proof.held_out import HeldOut
from hil.reconcile.result import FoundEffect, Gap, Shape
from hil.reconcile.rivals import LEAST
from hil.reconcile.search.candidates import Candidate
from hil.reconcile.search.fitted import Fitted, Values, fitted
from hil.reconcile.search.noise import FEWEST_RUNS
from hil.reconcile.search.problem import SensorProblem
from hil.reconcile.search.terms import NO_NAME
from procedures.words import listed

FEWEST_REPEATS = 30  # degrees of freedom from which repeats measure the noise to an eighth


def gap_of(proof: HeldOut | None, fit: Fitted, before: Fitted, chance: float) -> Gap:
    """Return the held-out gap before and after; that of the fits themselves where nothing can be held out.

    `chance` is that of nothing missing at all.
    """
    noise = _noise(fit)
    if proof is None:
        sizes = [np.concatenate([f.residual(block) for block in f.blocks]) for f in (before, fit)]
        rms = [round(float(np.sqrt(np.mean(r**2))), 6) for r in sizes]
        scaled = [round(v**2 / max(noise, 1e-9) ** 2, 6) for v in rms]
        nothing = "not held out (one run per temperature): residuals of the fit itself"
        return Gap(rms[0], rms[1], min(noise, *rms), nothing, scaled[0], scaled[1], np.nan)
    (raw_before, raw_after), (scaled_before, scaled_after) = proof.rms, proof.standardised
    kind = "run" if len(np.unique(fit.blocks[0].search.block.run)) >= FEWEST_RUNS else "collect"
    return Gap(
        before=raw_before,
        after=raw_after,
        noise_floor=min(noise, raw_before, raw_after),
        held_out=f"leave-one-{kind}-out, {len(proof.rows)} folds, selection repeated in every fold",
        standardised_before=scaled_before,
        standardised_after=scaled_after,
        improved_p_value=max(proof.improvement_p_value(), min(chance, 1.0)),
        log_score={"before": proof.log_score[0], "after": proof.log_score[1]},
        each=kind,
    )


def _noise(fit: Fitted) -> float:
    """Return the rms of the noise, deg/hr: what repeats show by themselves, whatever the model, or what was fitted.

    Repeats are rows in one pose at one temperature; what the set explains of them is taken off. The smaller of the two
    is nearer: a model that lacks something takes it for noise, and so do repeats that something moves.
    """
    squares, free, known = 0.0, 0, []
    for block in fit.blocks:
        own = block.search.block
        known.append(block.variance)
        of = block.search.noise.conditions
        alike = np.column_stack([own.station, own.channel, of.f_g[own.rows], of.w_deg_per_hr[own.rows]])
        _, group = np.unique(np.round(alike, 3), axis=0, return_inverse=True)
        left = own.y - fit.effect(block)
        mean = np.bincount(group, left) / np.bincount(group)
        squares += float(np.sum((left - mean[group]) ** 2))
        free += len(left) - len(mean)
    fitted_rms = float(np.sqrt(np.mean(np.concatenate(known))))
    return fitted_rms if free < FEWEST_REPEATS else min(fitted_rms, float(np.sqrt(squares / free)))


def described(named: Named, fit: Fitted, scatter: Sequence[FoundScatter]) -> FoundEffect:
    """Return one found effect for the result."""
    pairs = [(n, j) for n, places in named.terms.items() for j in places]
    over_shapes = {(n, j): _over_shapes(fit, n, j) for n, j in pairs}
    several = {n for n, places in named.terms.items() if len(places) > 1}
    of_terms = {(n, j): dict(fit.posterior.term(n, j).candidate.shape) for n, j in pairs}
    parameters = [
        {**p, "when": when} if n in several and (when := shape_in_words(of_terms[n, j], {})) else p
        for n, j in pairs
        for p in described_parameters(
            fit.posterior.term(n, j).candidate,
            fit.of_term(n, j),
            fit.conditions[n],
            [(weight, values) for weight, _, values in over_shapes[n, j]],
        )
    ]
    parameters += [
        picked(f.parameter, "name unit typical")
        | picked(f, "value se")
        | {**f.interval, "at": "", "sensor": f.sensor, "channels": f.some}
        for f in scatter
    ]
    shapes = {f.sensor: Shape(dict(f.shape)) for f in reversed(scatter)}
    for n, j in reversed(pairs):
        asked = [fit.posterior.term(n, k).candidate.shape for weight, k, _ in over_shapes[n, j] if weight > LEAST]
        every = {name: [of[name] for of in asked] for name in (asked[0] if asked else ())}
        may_be = {name: [min(of), max(of)] for name, of in every.items() if min(of) < max(of)}
        shapes[n] = Shape(of_terms[n, j], may_be, (of, *of.more) if (of := shapes.get(n)) else ())
    first = fit.posterior.term(*pairs[0]).candidate if pairs else named.effect
    nameless = nameless_of(named, fit)
    told: Sequence[object] = nameless if nameless else [first]
    effect = getattr(first, "effect", None)
    if effect is not None and {"degC" in each["unit"] for each in parameters} == {True}:
        told = [over_temperature(effect)]  # the model has the values, and lacks that they follow temperature
    return FoundEffect(
        id=id_of(named, fit),
        title=listed([getattr(each, "title", named.name) for each in told]),
        equation="; ".join(getattr(each, "equation", "") for each in told),
        parameters=parameters,
        probability=named.probability,
        of_sensor=named.of_sensor,
        confusable_with=named.rivals,
        kind=named.kind,
        shapes=dict(sorted(shapes.items())),
        sensors=sorted(named.terms) or sorted({f.sensor for f in scatter}),
        physics=physics(named.effect if named.name != NO_NAME else None),
        experiment=getattr(named.effect, "experiment", "") or "Vary the driver alone.",
        acts_on=named.acts_on,
        follows=frozenset(fit.posterior.term(n, j).follows for n, j in pairs),
    )


def nameless_of(named: Named, fit: Fitted) -> list[Candidate]:
    """Return what it is that has no name: one or more, of which each follows something; none of what has one."""
    every = [fit.posterior.term(n, j).candidate for n, places in named.terms.items() for j in places]
    return list({each.name: each for each in every if each.tier != 1}.values())


def id_of(named: Named, fit: Fitted) -> str:
    """Return the id of what was found: its name, or whatever without one follows what."""
    nameless = [each.name for each in nameless_of(named, fit)]
    return f"{NO_NAME}: {', '.join(nameless)}" if nameless else named.name


def _over_shapes(fit: Fitted, number: int, place: int) -> list[tuple[float, int, Values]]:
    """Return how probable each shape of a term is beside the other terms, its place, and what the values are in it."""
    search, term, terms = fit.posterior.searches[number], fit.posterior.term(number, place), fit.found.terms
    others = tuple(j for j in terms[number] if j != place)
    own = [term.name, term.candidate.form, term.candidate.kept]
    alike = [j for j, t in enumerate(search.terms) if [t.name, t.candidate.form, t.candidate.kept] == own]
    log_weight = (search.scan(others) + search.log_odds)[alike]
    weights = np.exp(log_weight - np.logaddexp.reduce(log_weight)).tolist()
    out = []
    for j, weight in zip(alike, weights, strict=True):
        if j == place:
            out.append((weight, j, fit.of_term(number, j)))
        elif weight > LEAST:
            of_shape = replace(fit.found, terms={**terms, number: tuple(sorted((*others, j)))})
            out.append((weight, j, fitted(fit.posterior, of_shape).of_term(number, j)))
    return out


def laws_that_fail(fit: Fitted, sensors: Mapping[int, SensorProblem]) -> list[str]:
    """Say of which sensors the values follow temperature in another way than their form states."""
    laws = {b.search.block.sensor: sensors[b.search.block.sensor].form for b in fit.blocks if b.calibrated}
    return [
        f"sensor {number}: its values are no {form.reason}, as {form.name} takes them to be; they were calibrated at "
        "each temperature"
        for number, form in sorted(laws.items())
        if form.reference_degC is not None
    ]


def physics(effect: Described | None) -> str:
    """Return what the class of an effect says of it."""
    if effect is None:
        return "No effect of the catalogue behaves like this; what is certain is what it follows, not what causes it."
    called = known_as(effect) if isinstance(effect, Effect) else effect
    return f"{' '.join((type(called).__doc__ or '').split())} {called.signature}"


def with_inside(model: Model, found: Sequence[FoundEffect], campaign: Campaign) -> Model:
    """Return the model with what was found inside the collects; the same model where nothing was."""
    if not found:
        return model
    new = [
        InsideCollects(
            effect=effect.id,
            sensor=effect.sensors[0],
            parameters={p["name"]: {"value": p["value"], "unit": p["unit"]} for p in effect.parameters},
            added={
                **_made(campaign),
                "probability": round(effect.probability, 4),
                "where": effect.parameters[0]["at"] if effect.parameters else "",
            },
        )
        for effect in found
    ]
    return model.model_copy(update={"inside_collects": (*model.inside_collects, *new)})


def origin(campaign: Campaign, named: Named, gap: Gap) -> dict[str, Any]:
    """Return where a term came from, for the model file."""
    of_sensor = named.of_sensor if len(named.of_sensor) > 1 else {}
    return {
        **_made(campaign),
        "verdict": named.kind,
        "name": named.name,
        "probability": round(named.probability, 4),
        **({"probability_of_sensor": {str(n): round(p, 4) for n, p in of_sensor.items()}} if of_sensor else {}),
        "rivals": {rival.id: round(rival.probability, 4) for rival in named.rivals},
        **{
            f"{name}_deg_per_hr": round(size, 4) if np.isfinite(size) else None
            for name, size in (("gap_before", gap.before), ("gap_after", gap.after), ("noise_floor", gap.noise_floor))
        },
    }


def _made(campaign: Campaign) -> dict[str, Any]:
    """Return which campaign something was found in, and when."""
    date = SystemClock().utc().astimezone(UTC).date().isoformat()
    return {**picked(campaign, "campaign=title simulated"), "date": date}


def picture(fit: Fitted, before: Fitted, proof: HeldOut | None) -> dict[str, Any]:
    """Residuals by row before and after, for the page; minutes from one collect to the next.

    `held_*` are those of held-out rows (of the fit where nothing is held out), `noise_after` what they may scatter by,
    `left` what values at each temperature leave of a residual, and `effect` what was added makes beside the base.
    """
    rows, minutes = [], []
    for b, (block, plain) in enumerate(zip(fit.blocks, before.blocks, strict=True)):
        own, known = block.search.block, block.search.noise.conditions
        inner = [plain.beside_values(before.residual(plain)), block.beside_values(fit.residual(block))]
        errors = inner if proof is None else proof.errors[b]
        held = [np.where(np.isfinite(e), e, i) for e, i in zip(errors, inner, strict=True)]
        added = fit.effect(block)
        added -= own.base @ np.linalg.lstsq(own.base, added, rcond=1e-9)[0]
        temperature = known.columns.get("temperature_degC")
        steps = np.diff(known.start_s)[np.diff(known.run) == 0]
        minutes += [float(np.median(steps)) / 60.0] if len(steps) else []
        names = ("held_before", "held_after", "noise_after", "left", "effect")
        columns = dict(zip(names, (*held, np.sqrt(block.variance), inner[1], added), strict=True))
        for i, row in enumerate(own.rows):
            rows.append(
                {
                    "sensor": own.sensor,
                    "channel": list(known.sensor.channels)[own.channel[i]],
                    "run": int(known.run[row]),
                    "position": str(known.position[row]),
                    "temperature_degC": None if temperature is None else float(temperature[row]),
                    **{name: float(of[i]) for name, of in columns.items()},
                }
            )
    return {"rows": rows, "minutes_per_collect": float(np.median(minutes)) if minutes else None}


def as_it_stands(model: Model, sensors: Mapping[int, SensorProblem], fit: Fitted) -> dict[str, Any] | None:
    """How far rates that are right are from a model's values, and by its noise would be; None for a built-in."""
    squares, rows, worst = 0.0, 0, 0.0
    for collects in (sensor.collects for sensor in sensors.values()):
        if not model.has_values(collects.conditions.sensor):
            return None
        error = collects.rates_deg_per_hr - model.rates(collects.conditions)
        error = error[np.isfinite(error)]
        squares, rows = squares + float(error @ error), rows + len(error)
        worst = max(worst, float(np.abs(error).max(initial=0.0)))
    known = [block.search.block.sigma**2 + block.search.noise.stated_variance() for block in fit.blocks]
    return {
        "rms_deg_per_hr": float(np.sqrt(squares / max(rows, 1))),
        "noise_deg_per_hr": float(np.sqrt(np.mean(np.concatenate(known)))),
        "largest_deg_per_hr": worst,
        "rows": rows,
    }
