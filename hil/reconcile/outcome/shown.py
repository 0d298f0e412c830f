"""The result: what was found, what was added, how much of the gap that closes, and what to measure next."""

from collections.abc import Iterator, Mapping, Sequence
from typing import Any

import numpy as np

from hil.campaign import Campaign
from hil.model import Model
from hil.model.effects.catalogue import SERIES_EFFECTS
from hil.model.effects.catalogue import named as known_as
from hil.model.effects.document import shape_in_words
from hil.reconcile.follows import unasked
from hil.reconcile.inside import named_within
from hil.reconcile.naming import LIKELY
from hil.reconcile.outcome import findings, mistakes, scatter, stated
from hil.reconcile.outcome.answer import Answer
from hil.reconcile.outcome.improve import improved
from hil.reconcile.outcome.sentences import values_off
from hil.reconcile.outcome.values import before_and_after
from hil.reconcile.proof.experiment import next_experiment
from hil.reconcile.proof.held_out import held_out
from hil.reconcile.proof.places import places
from hil.reconcile.result import Disagreement, FoundEffect, Reconciliation, Solved, without_collects
from hil.reconcile.search.terms import NO_NAME
from hil.solve.both_sensors import common_and_differential
from hil.solve.explained import LISTED
from hil.solve.omissions import in_words, otherwise, without
from hil.solve.temperatures import too_few
from procedures.verdict import NOT_GOOD
from procedures.words import listed, percent

_CERTAIN = 0.1  # of alpha: a chance below it is a disagreement, whatever is not predicted


def shown(campaign: Campaign, found: Answer) -> Reconciliation:
    """Return the result of a campaign as it was filed."""
    fit, reading, asked = found.fit, found.reading, found.campaign
    model, within, values = _added(found)
    wrong = mistakes.mistakes_found(reading.mistakes, fit, asked, reading.chance)
    sizes = scatter.pooled(found.scatter)
    results = [findings.described(n, fit, [size for size in sizes if size.effect.id == n.name]) for n in found.names]
    effects = [*wrong, *results, *within]
    verdict = next((k for k in ("ambiguous", "empirical", "named") if k in {of.kind for of in effects}), "none")
    certain = bool(found.reverted) and reading.chance < _CERTAIN * found.alpha
    beside, both = without(campaign), common_and_differential(campaign)
    # Of what scatters no rate can be rid.
    known = both is None or not both.look_for or any(each.effect.common_to_sensors for each in found.scatter)
    left = None if known else common_and_differential(found.taken_off)
    there = {run for rows in asked.sensors.values() for run in rows.conditions.run.tolist()}
    doubtful = {
        str(verdict): sorted(run for run in there & asked.verdicts.keys() if asked.verdicts[run].verdict is verdict)
        for verdict in NOT_GOOD
    }
    standing = findings.as_it_stands(found.problem.model, found.sensors, fit)
    notes = [*found.problem.campaign.warnings, *in_words(beside), *found.problem.notes]
    notes += in_words({"rows": found.rows}, searched=True)
    notes += findings.laws_that_fail(fit, found.problem.sensors)
    notes += [*_only_together(found), *_otherwise_asked(results, found.solved), *_at_an_end(found, results)]
    notes += [] if both is None else both.together
    notes += [f"what is known taken off: {each}" for each in found.left.reasons if found.left != found.solved]
    notes += [f"sensor {n}: {said}" for n, each in found.left.shown.items() for said in each.between.off_a_curve]
    notes += [f"{n.name}: the gap on held-out data did not shrink, so it was not added" for n in found.reverted]
    if found.proof is None and found.names and found.prove:
        every = "no run could be held out: each temperature has one, and its values belong to it alone"
        notes.append(f"{every}; the gap is that of the fit")
    notes += values_off(standing, found.gap)
    notes += [found.untold] if found.untold and not found.names else []
    notes += _may_be_too(found)
    notes += [*found.left.errors, *stated.scatter_in_words(found.noise)]
    notes += stated.stated_in_words(found.beyond_flicker, found.wanders)
    notes += otherwise(campaign, found.rows, found.taken_off)
    return Reconciliation(
        campaign=asked.title,
        source=asked.source,
        model_before=found.problem.model.title,
        verdict="unresolved" if certain else verdict,  # the least certain kind among them
        disagreements=_where(found),
        effects=effects,
        gap=found.gap,
        false_alarm_rate=found.alpha,
        p_value=reading.chance,
        next_experiment=_next(found) or _between(within) or mistakes.look_up(reading.mistakes, asked),
        model_after=model,
        input_model=found.problem.model,
        outliers=[*found.outliers, *mistakes.at_limits(asked, found.problem)],
        within_collects=found.inside,
        as_it_stands=standing,
        notes=notes,
        simulated=asked.simulated,
        calibration="per temperature" if found.calibrated else "one set",
        picture=findings.picture(fit, found.before, found.proof),
        follows=reading.follows.shares,
        follows_one_of=reading.follows.one_of,
        noise=found.noise,
        rows=found.rows,
        tested=any(search.terms for search in found.posterior.searches.values()),
        contradicted=sorted({run for run, _ in asked.contradicted}),
        warned=bool(asked.warnings),
        doubtful={verdict: runs for verdict, runs in doubtful.items() if runs},
        without=beside,
        solved=found.solved,
        left=found.left,
        both=both,
        look_for="" if left is None else left.look_for,
        to_record=stated.lacking(campaign, found.scatter, found.beyond_flicker),
        values=values,
    )


def _added(found: Answer) -> tuple[Model, Sequence[FoundEffect], Sequence[Mapping[str, Any]]]:
    """Return the model with what it lacked, what of that shows inside the collects only, and what each parameter is."""
    model, after, values = found.problem.model, found.problem.model, list[dict[str, Any]]()
    if found.names:
        gap, read = found.gap, found.reading
        if read.mistakes and found.proof:  # what the names by themselves close of it
            proof = held_out(found.posterior, read.mended, read.found)
            gap = findings.gap_of(proof, found.fit, found.before, read.chance)
        record = {each.name: findings.origin(found.campaign, each, gap) for each in found.names}
        sizes = scatter.pooled(found.scatter)
        after = improved(model, found.sensors, found.terms, sizes, record, found.calibrated)
        values = before_and_after(model, after, found.sensors, found.terms, found.calibrated, found.alike)
    after = stated.with_ordinary(after, found.beyond_flicker, found.fit.conditions)
    sensors = {number: rows.conditions.sensor for number, rows in found.campaign.sensors.items()}
    moving = {n for n, sensor in sensors.items() if n in found.wanders or model.moves_inside(sensor)}
    moving |= {n for each in found.names if getattr(each.effect, "moves_inside", False) for n in each.terms or sensors}
    named = named_within(found.inside, SERIES_EFFECTS, found.alpha, moving)
    within = [effect for effect in named if not model.knows_inside(effect.id, effect.sensors)]
    after = findings.with_inside(after, within, found.campaign)
    if after != model or found.wanders:
        after = stated.with_white_noise(after, found.campaign, wanders=found.wanders)
        after = after.model_copy(update={"version": model.version + 1})
    return after, within, values


def _where(found: Answer) -> list[Disagreement]:
    """Return where simulation and measurement disagree: by mistakes, by what moves averages, by what scatters them."""
    fit, chance = found.fit, found.reading.chance
    terms = [{(n, j) for n, js in named.terms.items() for j in js} for named in found.names if named.terms]
    moved = places(fit, terms, chance, found.alpha)
    spoiled = mistakes.mistake_places(found.reading.mistakes, fit, chance)
    return [*spoiled, *moved, *scatter.places(found.scatter, chance)]


def _only_together(found: Answer) -> Iterator[str]:
    """Say of which parameters that were found the collects tell only a combination: each is as usual by itself."""
    for named in found.names:
        for number, own in named.terms.items():
            for said in dict.fromkeys(said for j in own for said in found.fit.only_together(number, j)):
                which = f"{findings.id_of(named, found.fit)}, sensor {number}: {said}"
                yield f"{which}: by itself each is only as these collects and what is usual leave it, and so is its ±"


def _otherwise_asked(results: Sequence[FoundEffect], solved: Solved) -> Iterator[str]:
    """Say what hil thermal asks of what was found to follow temperature: there it may be told otherwise."""
    follow = [each.id for each in results if any("degC" in of["unit"] for of in each.parameters)]
    if follow and not too_few(solved.temperatures):
        yield (
            f"{listed(follow)}: asked of all collects together, and of what is typical; hil thermal asks of each "
            "parameter whether its curve predicts a temperature that was left out, and may call constant what is told "
            "here"
        )


def _at_an_end(found: Answer, results: Sequence[FoundEffect]) -> Iterator[str]:
    """Say which time constants and widths may lie beyond all that were tried: their errors are of those alone."""
    for named, result in zip(found.names, results, strict=True):
        for shape in (of for of in (named.effect.shapes if named.effect else ()) if of.continuous):
            for number, first in result.shapes.items():
                own = [each for each in (first, *first.more) if shape.name in each.values]
                may_be = sorted(v for of in own for v in of.may_be.get(shape.name, [of.values[shape.name]]))
                below, above = [v for v in may_be if v < shape.grid[0]], [v for v in may_be if v > shape.grid[-1]]
                for end in (*below[:1], *above[-1:]):
                    last = f"{shape_in_words({shape.name: float(f'{end:.3g}')})} is the last that was tried"
                    yield f"{result.id}, sensor {number}: {last}: what lies beyond it is in no ±"


def _may_be_too(found: Answer) -> Iterator[str]:
    """Say what is more probable than not, and not so sure that it is called missing."""
    posterior = found.posterior
    titles = {term.called: term.candidate.title for each in posterior.sets for term in posterior.members(each)}
    called, beside = {"", *(named.name for named in (*found.names, *found.reverted))}, unasked(posterior)
    called |= {rival.id for named in found.names for rival in named.rivals if rival.probability > LIKELY}
    for name in (each for each in titles if each not in called):
        if (share := posterior.likely[name]) > LIKELY:
            which = "something that no effect describes" if name == NO_NAME else f"{titles[name]} ({name})"
            which = " or ".join([which, *(each.effect.id for each in beside.get(name, ()))])
            yield f"{which}: {percent(share)}, and so not called missing at a rate of false alarms of {found.alpha:.2g}"


def _next(found: Answer) -> dict[str, Any] | None:
    """The experiment for the effect of which the name is settled least."""
    fit = found.fit
    for named in sorted(found.names, key=lambda named: named.probability):
        asked = [r for r in named.rivals if r.untold or r.share > LISTED]
        rival = next((r for r in asked if r.terms or r.remedy), None)
        if named.kind == "named" or (named.kind == NO_NAME and rival is None):
            continue
        if not named.terms:
            if rival is None:
                continue
            places = next(iter(rival.terms.items()), None)
            effect = None if places is None else fit.posterior.term(*places).candidate.effect
            if rival.remedy or effect is None:
                return without_collects(f"{rival.remedy} separates {named.name} from {rival.id}")
            return without_collects(f"separates {named.name} from {rival.id}: {known_as(effect).experiment}")
        shared = [n for n in named.terms if rival is not None and n in rival.terms]
        number = shared[0] if shared else next(iter(named.terms))
        at = named.terms[number]
        candidate = fit.posterior.term(number, at[0]).candidate
        known = fit.of_term(number, at[0])
        values = np.array([known.get(column, (0.0,))[0] for column in range(len(candidate.parameters))])
        sigma = float(np.sqrt(np.mean([np.median(b.variance) for b in fit.blocks])))
        other = fit.posterior.term(number, rival.terms[number]).candidate if rival and shared else None
        other = other if other is not None and other.effect is not None else None
        return next_experiment((candidate, values), other, rival, found.problem.sensors[number], sigma)
    return None


def _between(inside: Sequence[FoundEffect]) -> dict[str, Any] | None:
    """The experiment for what shows inside collects under a name that is not settled: no further collect parts it."""
    for effect in inside:
        if effect.kind == "ambiguous":
            rivals = " or ".join(rival.id for rival in effect.confusable_with) or "chance"
            return without_collects(f"separates {effect.id} from {rivals}: {effect.experiment}")
    return None
