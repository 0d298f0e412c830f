"""Find, name, add, prove: the discrepancy workflow on one campaign.

    result = reconcile(read_campaign("my-campaign"), "collins-4")
    result.verdict                       # "named", "ambiguous", "empirical", "unresolved" or "none"
    write_result(result, Path("out"))    # reconciliation.json, model.yaml, reconciliation.html

One posterior over sets of effects, of scatter and of mistakes in the data says what is missing and what it is called.
The rest only reads it: what the model becomes, whether it predicts what it has not seen, where the disagreement was,
and what should be measured next.
"""

from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import Any

import numpy as np

from hil.campaign import Campaign
from hil.campaign.plausibility import usable
from hil.errors import InputError
from hil.model import Model, fitting
from hil.model.effects.base import Effect, VarianceEffect
from hil.model.effects.catalogue import BASE_EFFECTS, EFFECTS, SERIES_EFFECTS, VARIANCE_EFFECTS
from hil.model.effects.prior import ALPHA
from hil.reconcile.inside import named_within, within_collects
from hil.reconcile.naming import Named, Reading, read
from hil.reconcile.outcome import findings, mistakes, scatter
from hil.reconcile.outcome.improve import improved
from hil.reconcile.outcome.sentences import scatter_in_words, stated_in_words, values_off
from hil.reconcile.outcome.values import before_and_after, taken_out
from hil.reconcile.proof.experiment import next_experiment
from hil.reconcile.proof.held_out import HeldOut, by_run, held_out, in_blocks
from hil.reconcile.proof.places import channels_touched, places
from hil.reconcile.result import FoundEffect, Reconciliation, Solved, without_collects
from hil.reconcile.search.fitted import Fitted, fitted
from hil.reconcile.search.layout import may_be_calibrated, searches, values_follow
from hil.reconcile.search.posterior import Posterior, weigh
from hil.reconcile.search.problem import Problem, pose
from hil.reconcile.search.terms import PLAIN
from hil.reconcile.unrecorded import beside_unasked, with_stand_ins
from hil.solve.both_sensors import BothSensors, common_and_differential
from hil.solve.omissions import in_words, otherwise, without
from hil.solve.wrong_rows import pooled
from procedures.verdict import NOT_GOOD

_CERTAIN = 0.1  # of alpha: a chance below it is a disagreement, whatever is not predicted
_FEW = 4  # runs are told why they do not agree even with what is known taken off
_INSIDE = 0.2  # share of the rate of false alarms that the series' tests have, where there are series


def reconcile(
    campaign: Campaign,
    model: Model | str,
    *,
    alpha: float = ALPHA,
    catalogue: Sequence[Effect] | None = None,
    scattering: Sequence[VarianceEffect] = VARIANCE_EFFECTS,
    prove: bool = True,
) -> Reconciliation:
    """Compare a campaign with a model, and find, name, add and prove what the model lacks.

    `alpha` is the false-alarm rate of the whole search on data without a missing effect; `prove=False` leaves the
    held-out comparison out (a screening). Raises `InputError` where the model does not fit the campaign.
    """
    if not 0.0 < alpha < 0.5:
        raise InputError(f"alpha {alpha}: the false-alarm rate must lie between 0 and 0.5")
    chosen = fitting(model, [collects.conditions.sensor for collects in campaign.sensors.values()])
    effects = (*BASE_EFFECTS, *EFFECTS) if catalogue is None else tuple(catalogue)
    beside, both = without(campaign), common_and_differential(campaign)
    campaign = with_stand_ins(pooled(campaign))
    inside = within_collects(campaign, SERIES_EFFECTS, _INSIDE * alpha)
    found = searched(campaign, chosen, effects, scattering, alpha, prove=prove)
    return _result(campaign, chosen, *found, inside, beside, both, alpha, prove=prove)


def searched(
    campaign: Campaign,
    model: Model,
    effects: Sequence[Effect],
    scattering: Sequence[VarianceEffect],
    alpha: float,
    *,
    prove: bool = True,
) -> tuple[Problem, Posterior, Reading, tuple[HeldOut, HeldOut] | None, Sequence[Named]]:
    """Find, name and prove: what is asked, what is probable, what that comes to, its proof, and what that took back.

    The search over averages and the tests inside the collects share `alpha`, the stated rate of false alarms.
    """
    problem = pose(usable(campaign), model, effects)
    posterior, reading = _weighed(problem, scattering, (1.0 - _INSIDE) * alpha if campaign.series_files else alpha)
    proof = _proof(posterior, reading) if prove else None
    reading, reverted = _kept(posterior, reading, proof)
    return problem, posterior, reading, proof, reverted


def _weighed(problem: Problem, scattering: Sequence[VarianceEffect], alpha: float) -> tuple[Posterior, Reading]:
    """Weigh and read what may be missing beside the form's values, or beside values that follow temperature.

    The more probable of the two is read: a smooth curve with a roughness, of all of the base's values, against as many
    laws of temperature as the form's own need. Nobody asks where they explain nothing, and a form in which values stand
    is as much more probable before the data as a value that is one number.
    """
    plain = weigh(searches(problem, EFFECTS, scattering))
    reading = read(plain, alpha)
    if not may_be_calibrated(problem) or not values_follow(problem, plain.searches, reading.found.terms):
        return plain, reading
    calibrated = weigh(searches(problem, EFFECTS, scattering, calibrated=True))
    stands = plain.log_evidence + np.log(PLAIN) >= calibrated.log_evidence
    return (plain, reading) if stands else (calibrated, read(calibrated, alpha))


def _proof(posterior: Posterior, reading: Reading) -> tuple[HeldOut, HeldOut] | None:
    runs, blocks = held_out(posterior, reading.nothing, reading.found, by_run, in_blocks)
    return None if runs is None else (runs, blocks or runs)


def _kept(
    posterior: Posterior, reading: Reading, proof: tuple[HeldOut, HeldOut] | None
) -> tuple[Reading, Sequence[Named]]:
    """Take back what does not predict held-out rows better, by the log score that serves mean and scatter alike.

    What is wrong with the data without those names stands, and is in what is fitted.
    """
    if not reading.names or proof is None or proof[0].log_score[1] > proof[0].log_score[0]:
        return reading, ()
    mended = reading.mended
    return replace(reading, names=(), found=mended, mistakes=posterior.mistakes(mended)), reading.names


def _result(
    campaign: Campaign,
    model: Model,
    problem: Problem,
    posterior: Posterior,
    reading: Reading,
    proof: tuple[HeldOut, HeldOut] | None,
    reverted: Sequence[Named],
    inside: Sequence[dict[str, Any]],
    beside: Mapping[str, Any],
    both: BothSensors | None,
    alpha: float,
    *,
    prove: bool,
) -> Reconciliation:
    fit, before = fitted(posterior, reading.found), fitted(posterior, reading.nothing)
    names = [beside_unasked(named, fit) for named in reading.names]
    of_scatter = {n.name: scatter.found_scatter(fit, n.name) for n in names if n.acts_on == "scatter"}
    over_sensors = {name: scatter.pooled(found) for name, found in of_scatter.items()}
    scattered = [each for found in over_sensors.values() for each in found]
    under = [model.title, *(n.name for n in names if n.acts_on == "mean")]
    noise = scatter.ordinary(fit, [f for found in of_scatter.values() for f in found], under)
    gap = findings.gap_of(proof, fit, before, reading.chance)
    results = [findings.described(n, fit, over_sensors.get(n.name, ())) for n in names]
    wrong = mistakes.mistakes_found(reading.mistakes, fit, campaign, reading.chance)
    within = [
        effect
        for effect in named_within(inside, SERIES_EFFECTS, alpha, [n.name for n in names])
        if not model.knows_inside(effect.id, effect.sensors)
    ]
    verdict = findings.verdict_of(
        names, [*wrong, *within], unresolved=bool(reverted) and reading.chance < _CERTAIN * alpha
    )
    standing = findings.as_it_stands(model, problem.campaign, reading.mistakes)
    terms = [{(n, j) for n, js in named.terms.items() for j in js} for named in names if named.terms]
    where = (places(fit, terms, reading.chance, alpha) or channels_touched(fit, reading.chance)) if terms else []
    after, values, added = model, [], []
    sensors = mistakes.mended(problem.sensors, reading.mistakes)
    if names:
        of_names = _proof(posterior, replace(reading, nothing=reading.mended)) if reading.mistakes and proof else proof
        own = findings.gap_of(of_names, fit, before, reading.chance)
        record = {named.name: findings.origin(campaign, named, own) for named in names}
        added = [
            (posterior.term(n, j).candidate, fit.of_term(n, j, alone=True))
            for named in names
            for n, js in named.terms.items()
            for j in js
        ]
        calibrated = frozenset(b.search.block.sensor for b in fit.blocks if b.calibrated)
        after = improved(model, sensors, added, scattered, record, calibrated)
        values = before_and_after(sensors, added, calibrated)
    solved = Solved.of(campaign)
    known = added or scattered or reading.mistakes or model.terms or model.noise
    sure = mistakes.mended(problem.sensors, mistakes.certain(reading.mistakes, fit, campaign))
    left = Solved.of(taken_out(problem, sure, added, scattered)) if known else solved
    tested = any(search.terms for search in posterior.searches.values())
    after = scatter.with_ordinary(after, noise if tested else (), fit.conditions)
    after = findings.with_inside(after, within, campaign)
    if after != model:
        after = scatter.with_white_noise(after, campaign).model_copy(update={"version": model.version + 1})
    notes = [*campaign.warnings, *in_words(beside), *problem.notes]
    outliers = mistakes.outliers_found(fit)
    rows = mistakes.rows_found(reading.mistakes, fit, campaign, outliers)
    notes += in_words({"rows": rows}, searched=True)
    notes += findings.laws_that_fail(fit, problem.sensors)
    why = [f"what is known taken off: {each}" for each in left.reasons if each not in solved.reasons]
    notes += [] if both is None else both.together
    notes += [*why[:_FEW], *[f"what is known taken off: {len(why) - _FEW} more such runs"][: len(why) > _FEW]]
    notes += [f"{n.name}: the gap on held-out data did not shrink, so it was not added" for n in reverted]
    notes += [findings.NOT_HELD_OUT] if prove and proof is None and names else []
    notes += [*values_off(standing, gap), *((*scatter_in_words(noise), *stated_in_words(noise)) if tested else ())]
    outliers += mistakes.at_limits(campaign, problem)
    notes += otherwise(campaign, rows)
    return Reconciliation(
        campaign=campaign.title,
        model_before=model.title,
        verdict=verdict,
        disagreements=[
            *mistakes.mistake_places(reading.mistakes, fit, reading.chance),
            *where,
            *scatter.places(of_scatter, reading.chance),
        ],
        effects=[*wrong, *results, *within],
        gap=gap,
        false_alarm_rate=alpha,
        p_value=reading.chance,
        next_experiment=_next(names, fit, problem) or _between(within) or mistakes.look_up(reading.mistakes),
        model_after=after,
        input_model=model,
        outliers=outliers,
        within_collects=inside,
        as_it_stands=standing,
        notes=notes,
        simulated=campaign.simulated,
        calibration="per temperature" if any(b.calibrated for b in fit.blocks) else "one set",
        picture=findings.picture(fit, before, proof),
        follows=reading.follows,
        noise=noise,
        rows=rows,
        tested=tested,
        contradicted=sorted({run for run, _ in campaign.contradicted}),
        doubtful=_doubtful(campaign),
        without=beside,
        solved=solved,
        left=left,
        both=both,
        values=values,
    )


def _doubtful(campaign: Campaign) -> dict[str, list[int]]:
    """Return the runs whose measurement failed, or of which nobody can tell, by verdict."""
    there = {run for rows in campaign.sensors.values() for run in rows.conditions.run.tolist()}
    judged = {run: each.verdict for run, each in campaign.verdicts.items() if run in there}
    found = {str(verdict): sorted(run for run in judged if judged[run] is verdict) for verdict in NOT_GOOD}
    return {verdict: runs for verdict, runs in found.items() if runs}


def _next(names: Sequence[Named], fit: Fitted, problem: Problem) -> dict[str, Any] | None:
    """The experiment for the first effect whose name is not settled."""
    for named in names:
        if named.kind != "ambiguous" or not named.terms:
            continue
        rival = next((r for r in named.rivals if r.terms or r.remedy), None)
        shared = [n for n in named.terms if rival is not None and n in rival.terms]
        number = shared[0] if shared else next(iter(named.terms))
        places = named.terms[number]
        candidate = fit.posterior.term(number, places[0]).candidate
        values = np.zeros(candidate.size)
        for column, (value, _) in fit.of_term(number, places[0]).items():
            values[column] = value
        sigma = float(np.sqrt(np.mean([np.median(b.variance) for b in fit.blocks])))
        other = fit.posterior.term(number, rival.terms[number]).candidate if rival and shared else None
        other = other if other is not None and other.effect is not None else None
        return next_experiment((candidate, values), other, rival, problem.sensors[number], sigma)
    return None


def _between(inside: Sequence[FoundEffect]) -> dict[str, Any] | None:
    """The experiment for what shows inside collects under a name that is not settled: no further collect parts it."""
    for effect in inside:
        if effect.kind == "ambiguous":
            rivals = " or ".join(rival.id for rival in effect.confusable_with) or "chance"
            return without_collects(f"separates {effect.id} from {rivals}: {effect.experiment}")
    return None
