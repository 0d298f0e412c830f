"""The findings of a search in the words and numbers of the result: verdict, effects, gap, places, origin."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from datetime import UTC
from typing import Any

import numpy as np

from drivers.clock import SystemClock
from hil.campaign import Campaign, Conditions
from hil.model import Model
from hil.model.effects.base import Effect
from hil.model.model_file import InsideCollects
from hil.reconcile.bad_data.exchanges import Exchange
from hil.reconcile.explanations import Step
from hil.reconcile.naming import Weighed, certainty
from hil.reconcile.outcome.improve import described_parameters
from hil.reconcile.proof.held_out import HeldOut
from hil.reconcile.result import Disagreement, FoundEffect, Gap, Rival, runs_in_words, without_collects
from hil.reconcile.search.fit import BlockNoise, Fit
from hil.solve.rows import Block

NOT_HELD_OUT = (
    "no run could be held out: each temperature has one, and its values belong to it alone; the gap is that of the fit"
)


def gap_of(
    proof: tuple[HeldOut, HeldOut] | None,
    noise: Sequence[BlockNoise],
    blocks: Sequence[Block],
    *,
    unjudged: bool,
    swapped: Sequence[Exchange],
    rng: np.random.Generator,
) -> Gap:
    """Return the held-out gap before and after.

    Exchanged labels show in one fold, which sign flips by fold cannot tell from chance: their own chance counts too.
    """
    if proof is None:
        rows = sum(len(block.y) for block in blocks)
        floor = float(np.sqrt(sum(np.trace(n.covariance) for n in noise) / max(rows, 1)))
        return Gap(np.nan, np.nan, floor, "too few rows to hold any out", np.nan, np.nan, 1.0)
    runs, contiguous = proof
    floor = runs.floor
    before, after = runs.rms
    scaled_before, scaled_after = runs.standardised
    folds = len(runs.rows)
    if unjudged:
        nothing = "not held out (one run per temperature): residuals of the fit itself"
        # As many values as rows leave nothing but rounding.
        values = (before, after, scaled_before, scaled_after)
        before, after, scaled_before, scaled_after = (round(value, 6) for value in values)
        return Gap(before, after, floor, nothing, scaled_before, scaled_after, np.nan)
    kind = "run" if len(np.unique(blocks[0].run)) >= 4 else "collect"
    return Gap(
        before=before,
        after=after,
        noise_floor=floor,
        held_out=f"leave-one-{kind}-out, {folds} folds, selection repeated in every fold",
        standardised_before=scaled_before,
        standardised_after=scaled_after,
        improved_p_value=min([runs.improvement_p_value(rng), *(e.chance for e in swapped)]),
        blocks={"before": contiguous.rms[0], "after": contiguous.rms[1]},
    )


def verdict_of(steps: Sequence[Step], inside: Sequence[FoundEffect], *, unresolved: bool, swapped: bool) -> str:
    """Return the verdict of all that was found, in averages and inside collects: the least certain kind among them."""
    kinds = {step.naming.kind for step in steps} | {effect.kind for effect in inside}
    if unresolved:
        return "unresolved"
    if not kinds:
        return "named" if swapped else "none"
    for kind in ("ambiguous", "empirical"):
        if kind in kinds:
            return kind
    return "named"


def channels_touched(
    blocks: Sequence[Block], noise: Sequence[BlockNoise], conditions: Mapping[int, Conditions], fit: Fit, p_value: float
) -> list[Disagreement]:
    """Where an effect is everywhere a little and nowhere enough for a place of its own: the channels it acts on."""
    out = []
    for b, block in enumerate(blocks):
        effect = fit.effect[b]
        if np.any(effect):
            score = float(np.linalg.norm(noise[b].beside(block.base, effect)))
            size = float(np.sqrt(np.mean(effect**2)))
            channels = list(conditions[block.sensor].sensor.channels)
            where = {"sensor": block.sensor, "channel": channels[int(block.channel[0])]}
            out.append((score, Disagreement(where, size, size / max(score, 1e-9), p_value)))
    return [d for _, d in sorted(out, key=lambda pair: -pair[0])]


def described(index: int, step: Step, fit: Fit, conditions: Mapping[int, Conditions]) -> FoundEffect:
    """Return one found effect for the result."""
    leader = step.naming.leader
    candidate = leader.added.hypothesis.candidate
    effect = candidate.effect
    return FoundEffect(
        id=leader.name if leader.tier == 1 else f"empirical: {leader.name}",
        title=candidate.title,
        equation=candidate.equation,
        parameters=described_parameters(index, step.added, fit, conditions),
        probability=_stated(step, leader),
        confusable_with=[_rival(step, rival) for rival in step.naming.rivals],
        kind=step.naming.kind,
        shape=candidate.shape,
        sensors=sorted({unit.candidate.sensor for unit in step.added.units}),
        physics=_physics(effect),
        experiment=effect.experiment if effect is not None else "Vary the driver alone.",
    )


def _stated(step: Step, weighed: Weighed) -> float:
    """The probability of a name, that nothing is missing at all included among the alternatives."""
    return weighed.probability * certainty(step.scan)


def _rival(step: Step, rival: Weighed) -> Rival:
    name = rival.name if rival.tier == 1 else f"empirical: {rival.name}"
    return Rival(name, _stated(step, rival), rival.overlap, rival.title, rival.same_on)


def _physics(effect: Effect | None) -> str:
    if effect is None:
        return "No effect of the catalogue behaves like this; what is certain is what it follows, not what causes it."
    text = " ".join((type(effect).__doc__ or "").split())
    return f"{text} {effect.signature}".strip()


def swap_findings(found: Sequence[Exchange]) -> list[FoundEffect]:
    """Return exchanged labels as found effects: each is certain and already mended."""
    return [
        FoundEffect(
            id="swap",
            title="Mislabelled collect",
            equation=f"run {e.run}: collects at positions {e.positions[0]} and {e.positions[1]} exchanged",
            parameters=[
                {"name": "swapped", "value": 1.0, "se": 0.0, "unit": "1", "at": f"run {e.run}", "sensor": e.sensor}
            ],
            probability=float(1.0 / (1.0 + np.exp(6.0 - e.gain))),
            confusable_with=[],
            kind="named",
            shape={"run": float(e.run)},
            sensors=(e.sensor,),
            physics="Two collects of one run carry each other's label; exchanged back, both fit the rest.",
            experiment="Look at the accelerometers of that run: they show which way it stood.",
        )
        for e in found
    ]


def look_up(found: Sequence[Exchange]) -> dict[str, Any] | None:
    """The experiment for exchanged labels: what was recorded of the run settles them, no further collect is needed."""
    if not found:
        return None
    which = runs_in_words(e.run for e in found)
    return without_collects(
        f"confirms swap: look at the accelerometers and the log of {which}; no further collect is needed"
    )


def labels_to_correct(found: Sequence[Exchange]) -> list[str]:
    """Say which rows of the file carry each other's labels, one sentence for each pair."""
    return [
        f"sensor {e.sensor}, run {e.run}: correct the labels of collects {e.collects[0]} (position {e.positions[0]}) "
        f"and {e.collects[1]} (position {e.positions[1]}) in collects.csv, they carry each other's; the model is not "
        "changed by this"
        for e in found
    ]


def exchange_places(found: Sequence[Exchange], campaign: Campaign) -> list[Disagreement]:
    """Return where exchanged labels showed: by how much each channel's rate moves when they are put right."""
    out = []
    for e in found:
        collects = campaign.sensors[e.sensor]
        here, there = e.rows
        moves = np.nan_to_num(collects.rates_deg_per_hr[here] - collects.rates_deg_per_hr[there])
        errors = np.hypot(*np.nan_to_num(collects.rates_se_deg_per_hr[[here, there]]))
        for channel, move, error in zip(collects.conditions.sensor.channels, moves, errors, strict=True):
            for position, sign in zip(e.positions, (1.0, -1.0), strict=True):
                where = {"sensor": e.sensor, "channel": channel, "position": position, "runs": [e.run]}
                out.append(Disagreement(where, sign * float(move), float(error), e.chance))
    return sorted(out, key=lambda place: -abs(place.size_deg_per_hr))


def with_inside(model: Model, version: int, found: Sequence[FoundEffect], campaign: Campaign) -> Model:
    """Return the model, as `version`, with what was found inside the collects; the same model where nothing was."""
    if not found:
        return model
    date = SystemClock().utc().astimezone(UTC).date().isoformat()
    new = [
        InsideCollects(
            effect=effect.id,
            sensor=effect.sensors[0],
            parameters={p["name"]: {"value": p["value"], "unit": p["unit"]} for p in effect.parameters},
            added={
                "campaign": campaign.title,
                "simulated": campaign.simulated,
                "date": date,
                "probability": round(effect.probability, 4),
                "where": effect.parameters[0]["at"] if effect.parameters else "",
            },
        )
        for effect in found
    ]
    return model.model_copy(update={"inside_collects": (*model.inside_collects, *new), "version": version})


def outlier_found(outlier: Mapping[str, Any], campaign: Campaign) -> dict[str, Any]:
    """Return one row that was left out, by the campaign's own names."""
    conditions = campaign.sensors[outlier["sensor"]].conditions
    row = outlier["row"]
    return {
        "sensor": outlier["sensor"],
        "channel": list(conditions.sensor.channels)[outlier["channel"]],
        "collect": int(conditions.collect[row]),
        "run": int(conditions.run[row]),
        "position": str(conditions.position[row]),
        "size_deg_per_hr": outlier["size_deg_per_hr"],
        "score": outlier["score"],
    }


def origin(campaign: Campaign, step: Step, gap: Gap) -> dict[str, Any]:
    """Return where a term came from, for the model file."""
    leader = step.naming.leader
    return {
        "campaign": campaign.title,
        "simulated": campaign.simulated,
        "date": SystemClock().utc().astimezone(UTC).date().isoformat(),
        "verdict": step.naming.kind,
        "name": leader.name,
        "probability": round(_stated(step, leader), 4),
        "rivals": {rival.name: round(_stated(step, rival), 4) for rival in step.naming.rivals},
        "gap_before_deg_per_hr": _number(gap.before),
        "gap_after_deg_per_hr": _number(gap.after),
        "noise_floor_deg_per_hr": _number(gap.noise_floor),
    }


def _number(value: float) -> float | None:
    return round(float(value), 4) if np.isfinite(value) else None


def picture(
    blocks: Sequence[Block], noise: Sequence[BlockNoise], conditions: Mapping[int, Conditions], after: Fit, before: Fit
) -> dict[str, Any]:
    """Standardised residuals by row, before and after, for the page."""
    rows = []
    for b, block in enumerate(blocks):
        known = conditions[block.sensor]
        sigma = np.sqrt(np.diag(noise[b].covariance))
        temperature = known.columns.get("temperature_degC")
        for i, row in enumerate(block.rows):
            rows.append(
                {
                    "sensor": block.sensor,
                    "channel": list(known.sensor.channels)[block.channel[i]],
                    "run": int(known.run[row]),
                    "position": str(known.position[row]),
                    "temperature_degC": None if temperature is None else float(temperature[row]),
                    "before": float(before.residual[b][i] / sigma[i]),
                    "after": float(after.residual[b][i] / sigma[i]),
                    "before_deg_per_hr": float(before.residual[b][i]),
                    "after_deg_per_hr": float(after.residual[b][i]),
                }
            )
    return {"rows": rows}


def as_it_stands(model: Model, campaign: Campaign) -> dict[str, Any] | None:
    """How far the rates are from a model with values, before anything is fitted; None for a built-in."""
    squares, rows, worst = 0.0, 0, 0.0
    for collects in campaign.sensors.values():
        if not model.has_values(collects.conditions.sensor):
            return None
        error = collects.rates_deg_per_hr - model.rates(collects.conditions)
        error = error[np.isfinite(error)]
        squares, rows = squares + float(error @ error), rows + len(error)
        worst = max(worst, float(np.abs(error).max(initial=0.0)))
    return {"rms_deg_per_hr": float(np.sqrt(squares / max(rows, 1))), "largest_deg_per_hr": worst, "rows": rows}
