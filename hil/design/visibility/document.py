"""The identifiability map as the JSON document hil.visibility/1, of a planned sweep or of a campaign, and as text.

What changes to the sweep would bring is in it: the maps before and after each, compared.

visibility_document(planned_conditions(plan, bench), "RD-GC-86-1, eight temperatures")
campaign_document(campaign, model)
"""

import math
from collections.abc import Callable, Collection, Iterable, Iterator, Mapping, Sequence
from dataclasses import replace
from types import MappingProxyType
from typing import Any

import numpy as np

from hil.campaign import Campaign, Conditions, FloatArray
from hil.campaign.plausibility import usable
from hil.campaign.stand_ins import with_stand_ins
from hil.config.bench import Bench
from hil.config.sweep import Sweep, check_sweep_against_bench
from hil.design.conditions import planned_conditions
from hil.design.visibility.map import AT_EACH, NoiseLevel, Sight, Sights, visibility
from hil.design.visibility.promise import PROBABILITY
from hil.files.document import picked
from hil.files.page import filled
from hil.model import Model, fitting_campaign, fitting_conditions
from hil.model.effects.catalogue import EFFECTS, FORM_EFFECTS, SERIES_EFFECTS, VARIANCE_EFFECTS, effect_by_id, named
from hil.model.effects.document import shape_in_words
from hil.model.effects.prior import ALPHA
from hil.solve import repeats, solve_campaign
from hil.solve.beside_terms import beside, beside_usual, scatter_of_runs, within_runs
from hil.solve.between_runs import NO_NOISE
from hil.solve.changes import CHANGES, Change
from hil.solve.omissions import in_words, what_is_wrong
from hil.solve.repeats import OF_MEANS, SensorRepeats
from hil.solve.temperatures import runs_made_alike, same_temperature
from hil.solve.wrong_rows import treated
from procedures.plan import make_plan
from procedures.words import listed, unit_in_words

_CLEAN = 0.1  # a leak that falls below this fraction of what it was is counted as gone

MOST_RUNS = 384
"""On so many of a campaign's runs at most, evenly chosen, a change is weighed: before and after alike."""

_BEYOND = 10  # so many times the largest typical size nobody has seen: what needs more is not seen in these collects

_LOUDER = 1.5  # times: noise that is so much larger at one temperature is told

_WORTH = 0.95  # of the size at which effects are seen without a change

Mapped = Callable[[Mapping[int, Conditions], Mapping[int, FloatArray]], dict[int, Sights]]


def visibility_document(
    sensors: Mapping[int, Conditions],
    title: str,
    model: Model | None = None,
    noise: Mapping[int, NoiseLevel] | None = None,
    sigmas: Mapping[int, FloatArray] | None = None,
    as_zero: Sequence[str] = (),
    changes: Sequence[Change] = CHANGES,
    values: Mapping[int, Mapping[str, float]] = MappingProxyType({}),
) -> dict[str, object]:
    """Return the document hil.visibility/1 of a campaign's or a planned sweep's conditions, by sensor.

    `sigmas` (n, c) are the averages' standard errors, deg/hr, and `noise` what each sensor scatters by (without:
    typical). `effects` has each effect once, as the sensor sees it that sees it best, with what cannot be told from it
    in one sensor at least (each has its own MU); `sensors` has the map of each. Parameters that were taken `as_zero`
    show nothing, and nothing acts on them; `values` are what others are known to be. Each of the `changes` takes
    further maps: without any there are none.
    """

    def mapped(sensors: Mapping[int, Conditions], sigma: Mapping[int, FloatArray]) -> dict[int, Sights]:
        return {
            n: visibility(rows, model, (noise or {}).get(n), sigma.get(n), len(sensors), as_zero, values.get(n, {}))
            for n, rows in sorted(sensors.items())
        }

    maps = mapped(sensors, sigmas or {})
    alike: dict[str, set[str]] = {}
    for sights in maps.values():
        for sight in sights.effects:
            alike.setdefault(sight.effect.id, set()).update(sight.members)
    first = next(iter(maps.values()))
    return {
        "schema": "hil.visibility/1",
        "title": title,
        "model": (forms := {str(number): sights.form for number, sights in maps.items()}),
        "forms": forms,
        "false_alarm_rate": ALPHA,
        "noise": vars(first.noise),
        "noise_level": vars(first.noise),
        "effects": [
            {"sensor": number, **_effect_document(sight, maps[number]), "class": sorted(alike[sight.effect.id])}
            for number, sight in _best(maps).values()
        ],
        "sensors": {
            str(number): {
                "effects": [_effect_document(sight, sights) for sight in sights.effects],
                "cannot_be_asked": dict(sights.reasons),
                "noise": vars(sights.noise),
            }
            for number, sights in maps.items()
        },
        "not_in_averages": sorted(
            {each.id for each in (*VARIANCE_EFFECTS, *SERIES_EFFECTS)} - {each.id for each in EFFECTS}
        ),
        "runs": (runs := max(len(np.unique(rows.run)) for rows in sensors.values())),
        "changes_weighed_on_runs": min(MOST_RUNS, runs),
        "changes": _improvements(sensors, mapped, changes, None if sigmas else maps),
    }


def _best(maps: Mapping[int, Sights]) -> dict[str, tuple[int, Sight]]:
    best: dict[str, tuple[int, Sight]] = {}
    for number, sights in maps.items():
        for sight in sights.effects:
            if sight.effect.id not in best or _seen_better(sight, best[sight.effect.id][1]):
                best[sight.effect.id] = (number, sight)
    return best


def _seen_better(sight: Sight, other: Sight) -> bool:
    """Whether an effect is seen from a smaller size on, or, where neither sees it, more is left of it."""
    if not (sight.visible and other.visible):
        return sight.kept > other.kept
    return sight.least < other.least


def _effect_document(sight: Sight, sights: Sights) -> dict[str, object]:
    best = sight.best
    index = next(i for i, one in enumerate(sights.effects) if one is sight)
    rivals = sorted(
        ((float(sights.overlaps[index, i]), one.effect.id) for i, one in enumerate(sights.effects) if i != index),
        reverse=True,
    )
    return {
        **picked(sight.effect, "id title"),
        "found_as": named(sight.effect).id,
        "kept": round(sight.kept, 6),
        "visible": sight.visible,
        "in_sight": sight.in_sight,
        "in_model": sight.effect.id in FORM_EFFECTS.get(sights.form.removesuffix(AT_EACH), ()),
        "class": list(sight.members),
        "unasked": dict(sight.unasked),
        "smallest_visible": {
            **picked(best, "value shape"),
            **picked(best.parameter, "unit parameter=name typical"),
            "probability": PROBABILITY,
            **picked(sight, "of_largest_typical=least"),
            "easiest": picked(best, "value=easiest shape=easiest_shape"),
        },
        "leaks": {name: round(leak, 3) for name, leak in sight.leaks.items() if leak > 1.0},
        "nearest": [{"id": rival, "overlap": round(value, 4)} for value, rival in rivals[:3] if value > 0.3],
    }


def sweep_document(sweep: Sweep, bench: Bench, model: Model | None = None) -> dict[str, object]:
    """Return the map of a sweep before it runs; raises `InputError` where the bench cannot carry it out."""
    check_sweep_against_bench(sweep, bench)
    conditions = planned_conditions(make_plan(sweep.procedure()), bench)
    noise = {n: NoiseLevel(float(bench.uncertainties.of_collects(of)[0, 0])) for n, of in conditions.items()}
    told: dict[str, object] = {"simulated": bench.simulated}
    if model is not None:
        model = fitting_conditions(model, [*conditions.values()])
        noise = {n: _planned(conditions[n], model, level) for n, level in noise.items()}
        told |= {"noise_of": model.full_title} if model.noise else {}
    return {**told, **visibility_document(conditions, sweep.title, model, noise)}


def _planned(conditions: Conditions, model: Model, level: NoiseLevel) -> NoiseLevel:
    """Return the noise of planned collects as a model states it; what it does not state is that of the level."""
    white, parts = model.white_noise(conditions), model.stated_scatter(conditions)
    within = within_runs(conditions, parts)
    collect = np.sqrt((level.collect_deg_per_hr if white is None else white[:, None]) ** 2 + within)
    known = _of_model(_level(scatter_of_runs(conditions, parts))) if parts else level
    return replace(known, collect_deg_per_hr=float(np.median(collect)))


def campaign_document(
    campaign: Campaign, model: Model | None = None, changes: Sequence[Change] = CHANGES
) -> dict[str, object]:
    """Return the map of collects that were measured, with their own standard errors, gaps, and scatter of repeats.

    What the terms of a `model` make is taken off, and what it states of noise counts where the campaign states and
    shows none; the `changes` are weighed. Raises `InputError` where that cannot be known.
    """
    told: dict[str, Any] = {"simulated": campaign.simulated, "warnings": list(campaign.warnings)}
    if model is not None:
        model = fitting_campaign(model, campaign)
        campaign = beside(campaign, model)
        told |= {"taken_off": model.full_title} if model.terms else {}
        told |= {"noise_of": model.full_title} if model.noise else {}
    told |= what_is_wrong(campaign)
    usual = NoiseLevel().collect_deg_per_hr  # repeats show what is beyond
    campaign, shown, assumed = beside_usual(
        campaign,
        repeats(campaign, solve_campaign(campaign), runs_made_alike),
        lambda conditions: np.full(conditions.w_channels_deg_per_hr.shape, usual),
        runs_made_alike,
    )
    used = with_stand_ins(usable(treated(campaign))).sensors
    conditions = {number: rows.conditions for number, rows in used.items()}
    sigmas = {  # as large as residuals and repeats show them to be
        number: np.where(
            np.isfinite(rows.rates_deg_per_hr),
            shown[number].noise(rows.rates_se_deg_per_hr) if number in shown else rows.rates_se_deg_per_hr,
            np.nan,
        )
        for number, rows in used.items()
    }
    noise = {
        number: replace(
            _seen(each, assumed=number in assumed)
            if each.scatter_included
            else NoiseLevel(source="assumed" if number in assumed else "assumed, for no run was repeated"),
            collect_deg_per_hr=float(np.nanmedian(sigmas[number])),  # one that is huge says nothing of the others
            channels_deg_per_hr=_of_channels(each.times_of, sigmas[number]),
            at_one_temperature_deg_per_hr=_noisiest(each.times_of, sigmas[number], conditions[number]),
        )
        for number, each in shown.items()
        if number in used
    }
    values = {number: each.usual for number, each in shown.items()}
    found = visibility_document(
        conditions, campaign.title, model, noise, sigmas, campaign.taken_as_zero, changes, values
    )
    return {**found, **told}


def _of_channels(names: Iterable[str], sigma: FloatArray) -> dict[str, float]:
    """Return the median of standard errors (n, c) by channel, of those that are known."""
    every = zip(names, sigma.T, strict=True)
    return {name: float(np.nanmedian(of)) for name, of in every if np.isfinite(of).any()}


def _noisiest(names: Collection[str], sigma: FloatArray, conditions: Conditions) -> dict[str, float]:
    """Return it at the temperature at which it is largest, of channels of which it is much larger there."""
    usual, station = _of_channels(names, sigma), same_temperature(conditions)
    of_each = [_of_channels(names, sigma[station == k]) for k in np.unique(station)]
    largest = {name: max(of[name] for of in of_each if name in of) for name in usual}
    return {name: most for name, most in largest.items() if most > _LOUDER * usual[name]}


def _seen(shown: SensorRepeats, *, assumed: bool) -> NoiseLevel:
    """Return what repeats, or else the model, scatter by beyond white noise, and means of runs not: see `_level`."""
    every = zip(shown.names, shown.by_noise.beyond.tolist(), shown.spread.degrees, strict=True)
    level = _level({name: beyond for name, beyond, degrees in every if degrees or not shown.repeated})
    some = any(level.run_scatter.values())
    if shown.repeated:
        whose = "its repeats" + ", within chance" * (some and not np.any(shown.by_noise.certain))
    elif shown.of_means:
        whose = OF_MEANS + "; beside it the model" * some
    else:
        level = _of_model(level)
        whose = level.source
    stated = "; ".join([whose, *shown.between.in_words, *shown.cautions])  # of assumed errors nothing is to be said
    return replace(level, source=f"{whose}, beyond an assumed noise of collects" if assumed else stated)


def _of_model(level: NoiseLevel) -> NoiseLevel:
    if level.run_bias_deg_per_hr > 0.0:
        return replace(level, source="the model")
    usual = NoiseLevel().run_bias_deg_per_hr
    told = listed(_of_g(level) or ["MU"])
    others = {name: size for name, size in level.run_scatter.items() if not name.startswith("B")}
    source = f"{told} by the model, the bias assumed"
    return replace(level, run_bias_deg_per_hr=usual, run_scatter=others, source=source)


def _of_g(level: NoiseLevel) -> list[str]:
    sizes = {"GS": level.run_gs_deg_per_hr_per_g, "MU": level.run_mu_deg_per_hr_per_g}
    return [name for name, size in sizes.items() if size > 0.0]


def _level(beyond: Mapping[str, float]) -> NoiseLevel:
    """Return a noise level by what parameters scatter by from run to run, rms: bias and, of a rotor, MU and GS."""
    of_each = ([more**2 for name, more in beyond.items() if name.startswith(kind)] for kind in ("B", "MU", "GS"))
    bias, mu, gs = (float(np.sqrt(np.mean(each))) if each else 0.0 for each in of_each)
    return NoiseLevel(
        run_bias_deg_per_hr=bias, run_mu_deg_per_hr_per_g=mu, run_gs_deg_per_hr_per_g=gs, run_scatter={**beyond}
    )


def _improvements(
    sensors: Mapping[int, Conditions], mapped: Mapped, changes: Sequence[Change], known: Mapping[int, Sights] | None
) -> list[dict[str, Any]]:
    """Return what each change to the sweep would bring to its sensors, the most helpful first.

    In sight is what was not, as the map of the changed collects has it; apart, what any sensor could not tell apart;
    protected are effects with the base parameters that they leak into no more; `size_ratio` is the median of the
    smallest visible sizes, after by before. Both are `mapped` alike: further rows have no standard errors. `known` is
    the map before, where it is known already.
    """
    if not changes:
        return []
    some = dict(sensors)
    for n, rows in sensors.items():
        if len(runs := np.unique(rows.run)) > MOST_RUNS:
            chosen = runs[np.linspace(0, len(runs) - 1, MOST_RUNS).round().astype(np.int64)]
            some[n], known = rows.rows(np.isin(rows.run, chosen)), None
    before = known or mapped(some, {})
    hidden = {name for name, (_, sight) in _best(before).items() if not sight.visible}
    found = []
    for change in changes:
        changed = {n: new for n, rows in some.items() if (new := change.apply(rows)) is not None}
        if changed:
            found.append(_improvement(change, before, mapped(changed, {})))
    return sorted(found, key=lambda one: _worth(one, hidden), reverse=True)


def _worth(one: Mapping[str, Any], hidden: Collection[str]) -> float:
    """Return the rank of a change: one for each that was hidden and is found, apart or clean, two for half a size."""
    clean = sum(map(len, one["protected_in"].values()))
    halved = math.log2(max(one["size_ratio"], 1e-3))
    shown = sum(name in hidden for name in one["newly_visible"])
    return float(shown + len(one["separated"]) + clean - 2.0 * halved)


def _improvement(change: Change, before: Mapping[int, Sights], after: Mapping[int, Sights]) -> dict[str, Any]:
    pairs = {
        n: [(sight, other) for sight in before[n].effects if (other := after[n].sight(sight.effect.id)) is not None]
        for n in after
    }
    every = [pair for of in pairs.values() for pair in of]
    seen, sees = ([name for name, (_, sight) in _best(maps).items() if sight.in_sight] for maps in (before, after))
    separated = dict.fromkeys(
        (sight.effect.id, rival)
        for sight, other in every
        for rival in sight.members
        if sight.effect.id < rival and rival not in other.members and other.in_sight
    )
    protected = {n: found for n, of in pairs.items() if (found := tuple(_protected(of)))}
    ratios = [other.least / sight.least for sight, other in every if sight.visible and other.visible and other.least]
    known = [ratio for ratio in ratios if 0.0 < ratio < math.inf]  # both are of a size that is searched for
    return {
        "change": change.name,
        "cost": change.cost,
        "newly_visible": [name for name in sees if name not in seen],
        "separated": list(separated),
        "protected": list(dict.fromkeys(pair for of in protected.values() for pair in of)),
        "size_ratio": float(np.median(known)) if known else 1.0,
        "protected_in": {str(number): pairs for number, pairs in protected.items()},
    }


def _protected(pairs: Sequence[tuple[Sight, Sight]]) -> Iterator[tuple[str, str]]:
    for sight, other in pairs:
        for name, leak in sight.leaks.items() if sight.effect.in_models else ():
            if leak > 1.0 and other.leaks.get(name, 0.0) < _CLEAN * leak:
                yield sight.effect.id, name


def visibility_text(document: Mapping[str, Any]) -> str:
    """Return a screenful of plain lines from the document hil.visibility/1."""
    seen = [effect for effect in document["effects"] if effect["visible"]]
    seen.sort(key=lambda effect: effect["smallest_visible"]["of_largest_typical"] or math.inf)
    levels = [of["noise"] for of in document["sensors"].values() if any(of["noise"]["run_scatter"].values())]
    by_repeats = any("its repeats" in level["source"] for level in levels)
    words = {each.__name__: each for each in (listed, unit_in_words, shape_in_words)}
    known = {"r": document, "seen": seen, "wrong": list(in_words(document)), "no_noise": NO_NOISE, **words}
    known["follow"] = [e["id"] for e in seen if e["in_sight"] and effect_by_id(e["id"]).follows == "temperature"]
    return filled(
        "hil.design.visibility", "text.txt.j2", beyond=_BEYOND, worth=_WORTH, by_repeats=by_repeats, **known
    ).rstrip("\n")
