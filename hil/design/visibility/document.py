"""The identifiability map as the JSON document hil.visibility/1, of a planned sweep or of a campaign.

visibility_document(planned_conditions(plan, bench), "RD-GC-86-1, eight temperatures")
campaign_document(campaign, model)
"""

from collections.abc import Mapping
from dataclasses import replace

import numpy as np

from hil.campaign import Campaign, Collects, Conditions, FloatArray
from hil.campaign.plausibility import usable
from hil.config.bench import Bench
from hil.config.sweep import Sweep, check_sweep_against_bench
from hil.design.conditions import planned_conditions
from hil.design.visibility.map import NoiseLevel, Sight, Sights, visibility
from hil.design.visibility.promise import PROBABILITY
from hil.design.visibility.worth import MOST_RUNS, improvements
from hil.model import Model
from hil.model.effects.catalogue import FORM_EFFECTS, SERIES_EFFECTS, VARIANCE_EFFECTS
from hil.model.effects.prior import ALPHA
from hil.solve import repeats, solve_campaign
from hil.solve.omissions import what_is_wrong
from hil.solve.repeats import SensorRepeats
from hil.solve.runs import finite
from hil.solve.wrong_rows import treated
from procedures.plan import make_plan


def visibility_document(
    sensors: Mapping[int, Conditions],
    title: str,
    model: Model | None = None,
    noise: Mapping[int, NoiseLevel] | None = None,
    sigmas: Mapping[int, FloatArray] | None = None,
) -> dict[str, object]:
    """Return the document hil.visibility/1 of a campaign's or a planned sweep's conditions, by sensor.

    `sigmas` (n, c) are the averages' standard errors, deg/hr, and `noise` what each sensor scatters by (without:
    typical). `effects` has each effect once, as the sensor sees it that sees it best, with what cannot be told from it
    in one sensor at least (each has its own MU); `sensors` has the map of each.
    """
    noise, sigmas = noise or {}, sigmas or {}
    maps = {
        n: visibility(rows, model, noise.get(n), sigma=sigmas.get(n), sensors=len(sensors))
        for n, rows in sensors.items()
    }
    best: dict[str, tuple[int, Sight]] = {}
    alike: dict[str, set[str]] = {}
    for number, sights in maps.items():
        for sight in sights.effects:
            alike.setdefault(sight.effect.id, set()).update(sight.members)
            if sight.effect.id not in best or sight.kept > best[sight.effect.id][1].kept:
                best[sight.effect.id] = (number, sight)
    first = next(iter(maps.values()))
    changes = improvements(sensors, model, noise)
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
            for number, sight in best.values()
        ],
        "sensors": {
            str(number): {
                "effects": [_effect_document(sight, sights) for sight in sights.effects],
                "cannot_be_asked": dict(sights.reasons),
                "noise": vars(sights.noise),
            }
            for number, sights in maps.items()
        },
        "not_in_averages": sorted({entry.id for entry in (*VARIANCE_EFFECTS, *SERIES_EFFECTS)}),
        "runs": (runs := max(len(np.unique(rows.run)) for rows in sensors.values())),
        "changes_weighed_on_runs": min(MOST_RUNS, runs),
        "changes": [
            {
                **vars(one),
                "protected": list(dict.fromkeys(pair for of in one.protected.values() for pair in of)),
                "protected_in": {str(number): pairs for number, pairs in one.protected.items()},
            }
            for one in changes
        ],
    }


def _effect_document(sight: Sight, sights: Sights) -> dict[str, object]:
    best = sight.best
    index = next(i for i, one in enumerate(sights.effects) if one is sight)
    rivals = sorted(
        ((float(sights.overlaps[index, i]), one.effect.id) for i, one in enumerate(sights.effects) if i != index),
        reverse=True,
    )
    return {
        "id": sight.effect.id,
        "title": sight.effect.title,
        "kept": round(sight.kept, 6),
        "visible": sight.visible,
        "in_model": sight.effect.id in FORM_EFFECTS.get(sights.form, ()),
        "class": list(sight.members),
        "smallest_visible": {
            "value": finite(best.value),
            "unit": best.parameter.unit,
            "probability": PROBABILITY,
            "parameter": best.parameter.name,
            "typical": list(best.parameter.typical),
            "shape": dict(best.shape),
            "easiest": {"value": finite(best.easiest), "shape": dict(best.easiest_shape)},
        },
        "leaks": {name: round(leak, 3) for name, leak in sight.leaks.items() if leak > 1.0},
        "nearest": [{"id": rival, "overlap": round(value, 4)} for value, rival in rivals[:3] if value > 0.3],
    }


def sweep_document(sweep: Sweep, bench: Bench, model: Model | None = None) -> dict[str, object]:
    """Return the map of a sweep before it runs; raises `InputError` where the bench cannot carry it out."""
    check_sweep_against_bench(sweep, bench)
    conditions = planned_conditions(make_plan(sweep.procedure()), bench)
    return visibility_document(conditions, sweep.title, model)


def campaign_document(campaign: Campaign, model: Model | None = None) -> dict[str, object]:
    """Return the map of collects that were measured, with their own standard errors, gaps, and scatter of repeats."""
    told = {"simulated": campaign.simulated, "warnings": list(campaign.warnings), **what_is_wrong(campaign)}
    sensors = {number: _with_typical_noise(rows) for number, rows in campaign.sensors.items()}
    stated = replace(campaign, sensors=sensors)
    shown = repeats(stated, solve_campaign(stated))
    used = usable(treated(stated)).sensors
    conditions = {number: rows.conditions for number, rows in used.items()}
    sigmas = {  # as large as residuals and repeats show them to be
        number: np.where(np.isfinite(rows.rates_deg_per_hr), rows.rates_se_deg_per_hr, np.nan)
        * (shown[number].noise_times if number in shown else 1.0)
        for number, rows in used.items()
    }
    noise = {
        number: replace(
            _seen(each, assumed=sensors[number] is not campaign.sensors[number])
            if np.any(each.spread.degrees)
            else NoiseLevel(),
            collect_deg_per_hr=float(np.nanmedian(sigmas[number])),  # one that is huge says nothing of the others
        )
        for number, each in shown.items()
        if number in used
    }
    found = visibility_document(conditions, campaign.title, model, noise, sigmas)
    return {**found, **told}


def _with_typical_noise(rows: Collects) -> Collects:
    """Return the collects with the typical standard error in channels that state none: repeats show what is beyond."""
    silent = ~np.any(rows.rates_se_deg_per_hr > 0.0, axis=0)
    errors = np.where(silent, NoiseLevel().collect_deg_per_hr, rows.rates_se_deg_per_hr)
    return replace(rows, rates_se_deg_per_hr=errors) if silent.any() else rows


def _seen(shown: SensorRepeats, *, assumed: bool) -> NoiseLevel:
    """Return what repeats scatter by beyond white noise: bias and, of a rotor, MU, rms of both channels."""
    beyond = [each for each in zip(shown.names, shown.beyond_noise, shown.spread.degrees, strict=True) if each[2]]
    bias, mu = ([more**2 for name, more, _ in beyond if name.startswith(kind)] for kind in ("B", "MU"))
    source = "its repeats, beyond an assumed noise of collects" if assumed else "its repeats"
    source += "".join(f"; {each}" for each in shown.noise_in_words)
    size = [float(np.sqrt(np.mean(each))) if each else 0.0 for each in (bias, mu)]
    return NoiseLevel(run_bias_deg_per_hr=size[0], run_mu_deg_per_hr_per_g=size[1], source=source)
