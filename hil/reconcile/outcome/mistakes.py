"""Mistakes in the data in the words and numbers of the result: exchanged labels, wrong runs, wrong rows."""

from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import Any

import numpy as np

from hil.campaign import Campaign, Conditions
from hil.campaign.plausibility import clipped
from hil.model.effects.data import OF_A_RUN, of_a_run
from hil.reconcile.outcome.findings import physics
from hil.reconcile.result import LEFT_OUT, Disagreement, FoundEffect, Shape, without_collects
from hil.reconcile.rivals import CERTAIN
from hil.reconcile.search.candidates import Candidate
from hil.reconcile.search.fitted import Fitted
from hil.reconcile.search.posterior import Posterior
from hil.reconcile.search.problem import Problem, SensorProblem
from hil.reconcile.search.sets import Set
from hil.reconcile.search.terms import Term
from hil.solve.causes import Cause, all_of
from hil.solve.explained import LISTED
from hil.solve.wrong_rows import LEFT_OUT as OMITTED
from hil.solve.wrong_rows import (
    MENDED,
    USED,
    Wrong,
    as_at,
    cause_in_words,
    clipped_rows,
    in_the_file,
    lies_off_g,
    of_its_run,
    wrong_rows,
)
from procedures.words import numbered


def mistakes_found(wrong: Sequence[Term], fit: Fitted, campaign: Campaign, chance: float) -> list[FoundEffect]:
    """Return mistakes in labels and runs as found effects: exchanged labels by name, wrong runs as one finding.

    `chance` is that of nothing being wrong or missing at all.
    """
    out = []
    for term in (each for each in wrong if each.candidate.effect is not None):
        which, p, sure = _which(term, fit.posterior, campaign)
        out.append(
            FoundEffect(
                id=term.name,
                title=term.candidate.title,
                equation=which,
                probability=p,
                kind="named" if sure else "ambiguous",
                shapes={term.candidate.sensor: Shape(term.candidate.shape)},
                sensors=(term.candidate.sensor,),
                physics=physics(term.candidate.effect),
                experiment=getattr(term.candidate.effect, "experiment", ""),
                mends_labels=True,
            )
        )
    if runs := wrong_runs(wrong):
        numbers = numbered("run", sorted({run for _, _, run in runs}), to="")
        many = "runs" in numbers
        out.append(
            FoundEffect(
                id=f"empirical: {numbers}",
                title=f"{numbers.capitalize()} {'do' if many else 'does'} not agree with the others "
                "in any way that an effect of the catalogue does",
                probability=1.0 - chance,
                kind="empirical",
                shapes={runs[0][0]: Shape({LEFT_OUT: float(len({(n, run) for n, _, run in runs}))})},
                sensors=tuple(sorted({n for n, _, _ in runs})),
                physics="No effect of the catalogue behaves like this; what is certain is which runs differ, not why.",
                experiment=f"Look at {numbers}; repeat {'them' if many else 'it'}.",
            )
        )
    return out


def wrong_runs(wrong: Sequence[Term]) -> list[tuple[int, int, int]]:
    """Return sensor, channel and the campaign's number of every run that is wrong."""
    runs = [term.candidate for term in wrong if term.name == "run"]
    return [(of.sensor, int(of.shape["channel"]), int(of.shape["number"])) for of in runs]


def _which(term: Term, posterior: Posterior, campaign: Campaign) -> tuple[str, float, bool]:
    """Say which labels are exchanged, and which others may be instead; how probable it is, and whether certain."""
    p, instead, number = 0.0, dict[Set, float](), term.candidate.sensor
    for found in posterior.sets:
        wrong = {j: each for j in found.terms[number] if (each := posterior.term(number, j)).is_mistake}
        if any(each is term for each in wrong.values()):
            p += float(np.exp(found.log_weight))
        elif way := tuple(j for j, each in wrong.items() if each.candidate.effect is not None):
            instead[way] = instead.get(way, 0.0) + float(np.exp(found.log_weight))
    likely = sorted((way for way, weight in instead.items() if weight > LISTED), key=lambda way: -instead[way])
    ways = [all_of([_exchange(posterior.term(number, j).candidate, campaign) for j in way]) for way in likely]
    said = [_exchange(term.candidate, campaign), *ways]
    return "; or ".join(said) + ("; these rates cannot tell which" if ways else ""), p, p >= CERTAIN and not ways


def _cause(candidate: Candidate, campaign: Campaign) -> Cause:
    """Return which labels are exchanged, as `hil solve` has it."""
    conditions = campaign.sensors[candidate.sensor].conditions
    run, exchange = int(candidate.shape["run"]), int(candidate.shape["exchange"])
    rows = np.flatnonzero(np.any(candidate.columns != 0.0, axis=(1, 2)) & (conditions.run == run))
    what, channels = "exchanged" if exchange >= 0 else "sensors", tuple[int, ...]()
    if exchange <= OF_A_RUN:
        what, channels = of_a_run(len(conditions.sensor.channels))[OF_A_RUN - exchange]
    return Cause(what, run, tuple(rows.tolist()), channels)


def _exchange(candidate: Candidate, campaign: Campaign) -> str:
    return cause_in_words(campaign.sensors[candidate.sensor], _cause(candidate, campaign))


def certain(wrong: Sequence[Term], fit: Fitted, campaign: Campaign) -> list[Term]:
    """Return those of the mistakes that are done something about: of labels that may be exchanged elsewhere nothing."""
    return [t for t in wrong if t.candidate.effect is None or _which(t, fit.posterior, campaign)[2]]


def mended(sensors: Mapping[int, SensorProblem], wrong: Sequence[Term]) -> dict[int, SensorProblem]:
    """Return the sensors with what was exchanged put right, and without the rates that are wrong."""
    out = dict(sensors)
    for term in wrong:
        n, columns = term.candidate.sensor, term.candidate.columns
        collects = out[n].collects
        spoiled = np.any(columns != 0.0, axis=2) & (term.candidate.effect is None)
        exchanged = 0.0 if term.candidate.effect is None else columns[..., 0]
        rates = np.where(spoiled, np.nan, collects.rates_deg_per_hr - exchanged)
        out[n] = replace(out[n], collects=replace(collects, rates_deg_per_hr=rates))
    return out


def mistake_places(wrong: Sequence[Term], fit: Fitted, chance: float) -> list[Disagreement]:
    """Return where mistakes show: channel, position and run of each, and by how much."""
    out = []
    for term in (each for each in wrong if each.name != "row"):
        n, conditions = term.candidate.sensor, fit.conditions[term.candidate.sensor]
        channels = list(conditions.sensor.channels)
        for block in fit.blocks:
            own = block.search.block
            if own.sensor != n or not np.any(part := own.select(term.candidate.columns)):
                continue
            noise = np.sqrt(block.variance)
            before = fit.residual(block) + (fit.effect(block) if term.name == "run" else part[:, 0])
            for c in np.unique(own.channel):
                rows = np.any(part != 0.0, axis=1) & (own.channel == c)
                if term.name == "run" and np.any(rows):
                    size, error = float(np.sqrt(np.mean(before[rows] ** 2))), noise[rows].mean() / np.sqrt(rows.sum())
                    where = {"sensor": n, "channel": channels[c], "runs": [int(term.candidate.shape["number"])]}
                    out.append(Disagreement(where, size, float(error), chance))
                    continue
                for i in np.flatnonzero(rows):
                    label, run = str(conditions.position[own.rows[i]]), int(conditions.run[own.rows[i]])
                    where = {"sensor": n, "channel": channels[c], "position": label, "runs": [run]}
                    out.append(Disagreement(where, float(before[i]), float(noise[i]), chance))
    return sorted(out, key=lambda place: -abs(place.size_deg_per_hr))


def outliers_found(fit: Fitted, campaign: Campaign) -> list[dict[str, Any]]:
    """Return single rows that are wrong, by the campaign's own names, each with its size and score.

    The size is how far the rate is from what all others show: what is usual of mistakes is no part of it. Where `hil
    solve` leaves the rate out, too, it is the one that is said there.
    Where another row may be the wrong one in its place, `or_collects` has it: of two that differ nobody knows which.
    """
    out, likely, posterior, quick = [], _probable_rows(fit), fit.posterior, wrong_rows(campaign)
    wrong = {(n, j) for n, places in fit.found.terms.items() for j in places if posterior.term(n, j).name == "row"}
    off = fit.free(wrong)
    for n, places in fit.found.terms.items():
        for j in (j for j in places if (n, j) in wrong):
            term = posterior.term(n, j)
            conditions = fit.conditions[n]
            row, single = int(term.candidate.shape["row"]), term.candidate.shape.get("channel")
            chosen = {int(posterior.term(n, k).candidate.shape.get("row", -1)) for k in places}
            others = [r for (m, r), p in likely.items() if m == n and r not in chosen and p > 1.0 - CERTAIN]
            instead = sorted(conditions.collect[others].tolist()) if likely[n, row] < CERTAIN else []
            for column, (_, error) in fit.of_term(n, j).items():
                channel = column if single is None else int(single)
                one = _row(n, conditions, channel, row, off[n, j, column], error)
                at = one["run"], one["collect"], one["channel"]
                one["size_deg_per_hr"] = quick[n].off_deg_per_hr.get(at, one["size_deg_per_hr"])
                out.append(one | ({"or_collects": instead} if instead else {}))
    return out


def _probable_rows(fit: Fitted) -> dict[tuple[int, int], float]:
    """Return how probably each row is a wrong one beside the names of the set, by sensor and row."""
    out, posterior = dict[tuple[int, int], float](), fit.posterior
    alike = [each for each in posterior.sets if posterior.names(each) == posterior.names(fit.found)]
    whole = np.logaddexp.reduce([each.log_weight for each in alike])
    for found in alike:
        wrong = [term.candidate for term in posterior.members(found) if term.name == "row"]
        for key in {(of.sensor, int(of.shape["row"])) for of in wrong}:
            out[key] = out.get(key, 0.0) + float(np.exp(found.log_weight - whole))
    return out


def at_limits(campaign: Campaign, problem: Problem) -> list[dict[str, Any]]:
    """Return the averages that stand at a channel's limit, each with how far the model is from it."""
    out = []
    for n, sensor in problem.sensors.items():
        collects = campaign.sensors[n]
        conditions, off = collects.conditions, collects.rates_deg_per_hr - sensor.base.rates
        for channel, rows, _ in clipped(collects):
            both = off[:, channel], collects.rates_se_deg_per_hr[:, channel]
            out += [
                _row(n, conditions, channel, row, *(of[row] for of in both)) for row in np.flatnonzero(rows).tolist()
            ]
    return out


def _row(number: int, conditions: Conditions, channel: int, row: int, size: float, error: float) -> dict[str, Any]:
    """Return one rate that was left out, by the campaign's own names."""
    return {
        "sensor": number,
        "channel": [*conditions.sensor.channels][channel],
        "collect": int(conditions.collect[row]),
        "run": int(conditions.run[row]),
        "position": str(conditions.position[row]),
        "size_deg_per_hr": size,
        "score": abs(size) / max(error, 1e-9),
    }


def rows_found(
    wrong: Sequence[Term], fit: Fitted, campaign: Campaign, outliers: Sequence[Mapping[str, Any]]
) -> list[dict[str, Any]]:
    """Return what is wrong with the rows, in the form that every command gives it: key `rows`."""
    found = []
    for term in (each for each in wrong if each.candidate.effect is not None):
        which, _, sure = _which(term, fit.posterior, campaign)
        collects, cause = campaign.sensors[term.candidate.sensor], _cause(term.candidate, campaign)
        how = in_the_file(collects, cause) * sure
        why = f"{which}{how}: correct it in collects.csv; the model is not changed by this"
        found.append(Wrong.of(collects, cause, MENDED if sure else USED, why))
    for n, channel, run in wrong_runs(wrong):
        collects = campaign.sensors[n]
        name = list(collects.conditions.sensor.channels)[channel]
        whole = Cause("run", run, tuple(np.flatnonzero(collects.conditions.run == run).tolist()), (channel,))
        why = f"{name} does not agree with the other runs in any way that an effect does"
        found.append(Wrong.of(collects, whole, OMITTED, why))
    by_collect: dict[tuple[int, int, int], list[Mapping[str, Any]]] = {}
    for each in outliers:
        by_collect.setdefault((each["sensor"], each["run"], each["collect"]), []).append(each)
    for (n, run, collect), several in by_collect.items():
        collects = campaign.sensors[n]
        place = int(np.flatnonzero((collects.conditions.run == run) & (collects.conditions.collect == collect))[0])
        size = {each["channel"]: each["size_deg_per_hr"] for each in several}
        off = tuple(size.get(name, 0.0) for name in collects.conditions.sensor.channels)
        cause = Cause("collect", run, (place,), tuple(np.flatnonzero(off).tolist()), off)
        why = "; or ".join([f"{cause_in_words(collects, cause)}{as_at(collects, cause)}", *of_its_run(collects, cause)])
        if instead := sorted({other for each in several for other in each.get("or_collects", ())}):
            why += f"; or {numbered('collect', instead)} may be, in its place: these rates cannot tell which is wrong"
        found.append(Wrong.of(collects, cause, OMITTED, why))
    found += [row for collects in campaign.sensors.values() for row in clipped_rows(collects)]
    return [each.document() for each in found]


def look_up(wrong: Sequence[Term], campaign: Campaign) -> dict[str, Any] | None:
    """The experiment for mistakes in the data: what was recorded settles them, no further collect is needed."""
    swaps = [(campaign.sensors[t.candidate.sensor], _cause(t.candidate, campaign)) for t in wrong if t.candidate.effect]
    if swaps:
        which = numbered("run", sorted({cause.run for _, cause in swaps}), to="")
        off_g = [lies_off_g(*each) for each in swaps if each[1].what == "exchanged"]
        lay = any(as_filed != as_the_other for as_filed, as_the_other in off_g if np.isfinite(as_filed))
        look = f"look at {'the accelerometers and ' * lay}the log of {which}; no further collect is needed"
        return without_collects(f"confirms what was exchanged or turned: {look}")
    runs = sorted({run for _, _, run in wrong_runs(wrong)})
    if not runs:
        return None
    numbers = numbered("run", runs, to="")
    return without_collects(f"look at {numbers}; repeat {'them' if 'runs' in numbers else 'it'}")
