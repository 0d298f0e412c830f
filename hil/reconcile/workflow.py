"""Find, name, add, prove: the discrepancy workflow on one campaign.

    result = reconcile(read_campaign("my-campaign"), load_model("collins-4"))
    result.verdict                       # "named", "ambiguous", "empirical", "unresolved" or "none"
    write_result(result, Path("out"))    # reconciliation.json, model.yaml, reconciliation.html

The order is that of the questions: which rows can be believed; is anything missing, at a stated rate of false alarms;
what is it called, with a stated probability; what does the model become; does it predict what it has not seen; where
was the disagreement; what should be measured next.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import Any

import numpy as np

from hil.campaign import Campaign, FloatArray
from hil.errors import InputError
from hil.model import Model, load_model
from hil.model.effects.base import Effect
from hil.model.effects.catalogue import BASE_EFFECTS, EFFECTS, SERIES_EFFECTS
from hil.reconcile.bad_data.exchanges import as_labelled, exchanges, mended
from hil.reconcile.bad_data.rows import find_outliers, left_out
from hil.reconcile.bad_data.runs import bad_runs, rows_of
from hil.reconcile.explanations import CERTAIN, Branch, Step, joined_columns, other_calibration, posed, pursue
from hil.reconcile.inside import named_within, within_collects
from hil.reconcile.outcome.findings import (
    NOT_HELD_OUT,
    as_it_stands,
    channels_touched,
    described,
    exchange_places,
    gap_of,
    labels_to_correct,
    look_up,
    origin,
    outlier_found,
    picture,
    swap_findings,
    verdict_of,
    with_inside,
)
from hil.reconcile.outcome.improve import improved
from hil.reconcile.outcome.runs import run_experiment, run_findings, run_notes, run_places
from hil.reconcile.proof.cells import disagreements
from hil.reconcile.proof.experiment import next_experiment
from hil.reconcile.proof.held_out import HeldOut, by_run, held_out, in_blocks, in_sample, noise_points
from hil.reconcile.proof.places import places
from hil.reconcile.result import FoundEffect, Reconciliation, values_off, without_collects
from hil.reconcile.search.calibration import ONE_SET
from hil.reconcile.search.fit import BlockNoise, Fit, estimate_noise, refit
from hil.reconcile.search.hypotheses import hypotheses
from hil.reconcile.search.problem import Problem
from hil.reconcile.search.scan import Scan, Search
from hil.reconcile.unrecorded import beside_unasked, with_stand_ins
from hil.solve.identifiability import smallest_fit
from hil.solve.rows import Block

_DRAWS = 300
_INSIDE = 0.2  # share of the rate of false alarms that the series' tests have, where there are series


def reconcile(
    campaign: Campaign,
    model: Model | str,
    *,
    alpha: float = 0.05,
    catalogue: Sequence[Effect] | None = None,
    draws: int = _DRAWS,
    seed: int = 0,
    prove: bool = True,
) -> Reconciliation:
    """Compare a campaign with a model, and find, name, add and prove what the model lacks.

    `alpha` is the false-alarm rate of the whole search on data without a missing effect, `draws` the simulated data
    sets behind it; `prove=False` leaves the held-out comparison out (a screening). Raises `InputError` where the
    model does not fit the campaign. Source: reference algorithm of the discrepancy workflow, steps 0 to 10.
    """
    if not 0.0 < alpha < 0.5:
        raise InputError(f"alpha {alpha}: the false-alarm rate must lie between 0 and 0.5")
    chosen = load_model(model) if isinstance(model, str) else model
    for sensor in campaign.sensors.values():
        chosen.check_sensor(sensor.conditions.sensor, model if isinstance(model, str) else "")
    effects = (*BASE_EFFECTS, *EFFECTS) if catalogue is None else tuple(catalogue)
    rng = np.random.default_rng(seed)
    campaign = with_stand_ins(campaign)
    clean, problem, search, faults = _prepare(campaign, chosen, effects)
    conditions = {number: sensor.collects.conditions for number, sensor in problem.sensors.items()}
    # The search over averages and the tests inside the collects share the stated rate of false alarms.
    inside = within_collects(campaign, SERIES_EFFECTS, _INSIDE * alpha)
    of_averages = (1.0 - _INSIDE) * alpha if campaign.series_files else alpha
    branch = _choose(pursue(problem, search, of_averages, draws, rng), clean, chosen, effects, of_averages, draws, rng)
    problem, search = branch.problem, branch.search
    steps: Sequence[Step] = [replace(s, naming=beside_unasked(s.naming, conditions)) for s in branch.steps]
    first, threshold, chance = branch.first, branch.threshold, branch.chance
    blocks = list(search.blocks)
    swapped = faults["exchanges"]
    labelled = as_labelled(blocks, swapped, clean)
    noise = _final_noise(search, steps)
    proofs = _prove(search, steps, noise, first) if prove else []
    as_filed = _prove(search, steps, noise, first, labelled)[0] if proofs and swapped else None
    steps, unpaid = _paid(steps, proofs)
    proof = proofs[max(len(steps), 1) - 1] if proofs else None
    unjudged = proof is not None and len(proof[0].rows) == 0
    if unjudged:
        fitted = in_sample(blocks, noise, [step.added for step in steps])
        proof = (fitted, fitted)
        as_filed = (in_sample(labelled, noise, []),) * 2 if swapped else None
    noise = _final_noise(search, steps) if unpaid else noise
    spoiled = proof[0].spoiling_fold() if steps and proof is not None else None
    if proof is not None and spoiled is not None:
        proof = (proof[0].without(spoiled), proof[1])
        as_filed = None if as_filed is None else (as_filed[0].without(spoiled), as_filed[1])
    reverted = bool(steps) and proof is not None and not _shrank(proof)
    if reverted and proof is not None:
        proof = (proof[0].taken_back(), proof[1].taken_back())
    notes = [*campaign.warnings, *problem.notes, *labels_to_correct(swapped), *_about(branch)]
    notes += run_notes(faults["runs"], campaign)
    if first is None:
        counts = "; ".join(f"sensor {b.sensor}: {len(b.y)} rates for {b.base.shape[1]} values" for b in blocks)
        notes.append(f"nothing could be tested, so that none means nothing: {counts} of the model. Take more runs")
    if unjudged and steps:
        notes.append(NOT_HELD_OUT)
    if reverted or unpaid:
        names = ", ".join(step.naming.leader.name for step in [*(steps if reverted else []), *unpaid])
        notes.append(f"{names}: the gap on held-out data did not shrink, so it was not added")
    if spoiled is not None:
        notes.append(
            f"held-out fold {spoiled + 1} is not counted: the change itself lies there, and no other shows where"
        )
    kept = [] if reverted else steps
    final = refit(blocks, noise, [step.added for step in kept])
    certain = reverted and first is not None and first.statistic > threshold + CERTAIN
    found = disagreements(blocks, noise, conditions, alpha, rng) if certain else []
    found = found or places(blocks, noise, conditions, [step.added for step in kept], final, chance, alpha)
    found = found or channels_touched(blocks, noise, conditions, final, chance)
    named_inside = [
        effect
        for effect in named_within(inside, SERIES_EFFECTS, [s.naming.leader.name for s in kept])
        if not chosen.knows_inside(effect.id, effect.sensors)
    ]
    by_runs = run_findings(faults["runs"], campaign)
    verdict = verdict_of(kept, [*by_runs, *named_inside], unresolved=certain, swapped=bool(swapped))
    of_steps = gap_of(proof, noise, blocks, unjudged=unjudged, swapped=(), rng=rng)
    gap = of_steps
    if proof is not None and as_filed is not None:
        whole = (proof[0].starting_from(as_filed[0]), proof[1].starting_from(as_filed[1]))
        gap = gap_of(whole, noise, blocks, unjudged=unjudged, swapped=swapped, rng=rng)
    results = [described(i, step, final, conditions) for i, step in enumerate(kept)]
    results = [*swap_findings(swapped), *by_runs, *results, *named_inside]
    experiment = _next(kept, problem, noise, blocks) or _between(named_inside) or look_up(swapped)
    experiment = run_experiment(faults["runs"], experiment)
    standing = as_it_stands(chosen, mended(campaign, swapped))
    notes += values_off(standing, gap)
    after = chosen
    if kept:
        record = [origin(campaign, step, of_steps) for step in kept]
        after = improved(
            chosen, problem.sensors, [s.added for s in kept], final, _base_values(problem, kept, final), record
        )
    after = with_inside(after, chosen.version + 1, named_inside, campaign)
    return Reconciliation(
        campaign=campaign.title,
        model_before=chosen.title,
        verdict=verdict,
        disagreements=[*exchange_places(swapped, campaign), *run_places(faults["runs"], campaign), *found],
        effects=results,
        gap=gap,
        false_alarm_rate=alpha,
        p_value=min([chance, *(exchange.chance for exchange in swapped)]),
        next_experiment=experiment,
        model_after=after,
        input_model=chosen,
        outliers=[outlier_found(o, clean) for o in faults["outliers"]],
        within_collects=inside,
        as_it_stands=standing,
        notes=notes,
        simulated=campaign.simulated,
        calibration=branch.calibration,
        picture=picture(blocks, noise, conditions, final, refit(labelled, noise, [])),
    )


def _choose(
    plain: Branch,
    campaign: Campaign,
    model: Model,
    effects: Sequence[Effect],
    alpha: float,
    draws: int,
    rng: np.random.Generator,
) -> Branch:
    """Take the more probable of the calibrations, each with what was found beside it."""
    other = other_calibration(plain, campaign, model, effects, alpha, draws, rng)
    return plain.preferred(other)


def _about(branch: Branch) -> list[str]:
    """What is to be said about the calibration."""
    if branch.calibration == ONE_SET:
        return []
    said = [
        (
            "the model's parameters differ from temperature to temperature in no simple way: they were calibrated at "
            "each temperature, and what is reported is what the model's form lacks beside that"
        )
    ]
    if not branch.is_repeated:
        said.append(
            "one run per temperature: how far a value repeats is known from the stated standard errors only, "
            "and the finding rests on them"
        )
    return said


def _prepare(
    campaign: Campaign, model: Model, effects: Sequence[Effect]
) -> tuple[Campaign, Problem, Search, dict[str, Any]]:
    """Pose the problem; mend exchanged labels, leave outliers out, and pose it again where that changed anything."""
    problem, tables, rich = posed(campaign, model, effects)
    swapped = exchanges(campaign, problem.blocks, tables)
    clean = mended(campaign, swapped)
    if swapped:
        problem, tables, rich = posed(clean, model, effects)
    bad = bad_runs(clean, problem.blocks, problem.candidates)
    if bad:
        clean = left_out(clean, rows_of(bad))
        problem, tables, rich = posed(clean, model, effects)
    outliers = find_outliers(problem.blocks, tables, rich)
    if outliers:
        clean = left_out(clean, outliers)
        problem, tables, rich = posed(clean, model, effects)
    search = Search(problem.blocks, tables, rich, hypotheses(problem.candidates, problem.blocks))
    return clean, problem, search, {"outliers": outliers, "exchanges": swapped, "runs": bad}


def _final_noise(search: Search, steps: Sequence[Step]) -> list[BlockNoise]:
    """The noise as estimated with everything that was found in the base."""
    full = search.with_base(joined_columns([s.added for s in steps], len(search.blocks)))
    return [estimate_noise(block, table) for block, table in zip(full.blocks, full.noise, strict=True)]


def _prove(
    search: Search,
    steps: Sequence[Step],
    noise: Sequence[BlockNoise],
    first: Scan | None,
    labelled: Sequence[Block] | None = None,
) -> list[tuple[HeldOut, HeldOut]]:
    """Held-out comparisons by run and by contiguous block, with one effect, two, … of `steps`; none without rows.

    With `labelled`, the same folds under the same noise on these blocks instead, with nothing searched for.
    """
    if first is None:
        return []
    full = search.with_base(joined_columns([step.added for step in steps], len(search.blocks)))
    points = [
        noise_points((with_all, block), table)
        for with_all, block, table in zip(full.blocks, search.blocks, search.noise, strict=True)
    ]
    runs = [block.run for block in search.blocks]
    arguments = (
        search.blocks if labelled is None else labelled,
        search.noise,
        noise,
        search.hypotheses if labelled is None else (),
        len(steps) if labelled is None else 0,
        points,
        [block.base for block in full.blocks],
    )
    one_by_one = held_out(by_run(search.blocks, runs), *arguments)
    return list(zip(one_by_one, held_out(in_blocks(search.blocks, runs), *arguments), strict=True))


def _paid(steps: Sequence[Step], proofs: Sequence[tuple[HeldOut, HeldOut]]) -> tuple[Sequence[Step], Sequence[Step]]:
    """Split the steps into those that are kept and the last ones, with which held-out rows are predicted no better."""
    count = len(steps)
    while proofs and count > 1 and len(proofs[0][0].rows):
        if proofs[count - 1][0].standardised[1] < proofs[count - 2][0].standardised[1]:
            break
        count -= 1
    return steps[:count], steps[count:]


def _shrank(proof: tuple[HeldOut, HeldOut]) -> bool:
    """Whether held-out rows are predicted better, in units of their noise and in deg/hr."""
    (before, after), (raw_before, raw_after) = proof[0].standardised, proof[0].rms
    return after < before and raw_after < raw_before


def _next(
    steps: Sequence[Step], problem: Problem, noise: Sequence[BlockNoise], blocks: Sequence[Block]
) -> dict[str, Any] | None:
    """The experiment for the first effect whose name is not settled."""
    sigma = {
        number: float(
            np.sqrt(
                np.mean(
                    [np.median(np.diag(n.covariance)) for n, b in zip(noise, blocks, strict=True) if b.sensor == number]
                )
            )
        )
        for number in {block.sensor for block in blocks}
    }
    for step in steps:
        if step.naming.kind == "ambiguous":
            return next_experiment(step.naming, problem.sensors, sigma)
    return None


def _between(inside: Sequence[FoundEffect]) -> dict[str, Any] | None:
    """The experiment for what shows inside collects under a name that is not settled: no further collect parts it."""
    for effect in inside:
        if effect.kind == "ambiguous":
            rivals = " or ".join(rival.id for rival in effect.confusable_with) or "chance"
            return without_collects(f"separates {effect.id} from {rivals}: {effect.experiment}")
    return None


def _base_values(problem: Problem, steps: Sequence[Step], fit: Fit) -> dict[int, FloatArray]:
    """Refit the base parameters of every sensor to what the added effects leave."""
    out = {}
    for number, sensor in problem.sensors.items():
        rates = sensor.collects.rates_deg_per_hr - sensor.known_rates()
        target = rates.copy()
        for b, block in enumerate(problem.blocks):
            if block.sensor == number and steps:
                target[block.rows, block.channel] -= fit.effect[b]
        design = np.concatenate([sensor.form.columns(sensor.collects.conditions), sensor.term_columns], axis=2)
        measured = np.isfinite(target)
        out[number] = smallest_fit(design[measured], target[measured], 1e-6)[: len(sensor.form.names)]
    return out
