"""Whether parameters are measured well enough to say anything of them, and how wrong the site may be unseen.

A standard error as large as what a parameter usually is tells next to nothing about it, however well the residuals
agree. The usual size is the catalogue's: the middle of what is typical for a rotor sensor; for any other, whose
technology a campaign does not tell, that of the technology where it is largest. A bench may ask for more.

A standard error that is not stated is the largest that the others of its channel show: what is not known must not make
a result look better.

The earth rate that is subtracted rests on latitude and heading. In the collects of one heading what is wrong of it
looks like bias and acceleration sensitivity, and leaves no residual.
"""

import math
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import replace

import numpy as np

from hil.campaign import BoolArray, Campaign, Collects, Conditions, FloatArray, Sensor
from hil.campaign.data import EARTH_RATE_DEG_PER_HR
from hil.campaign.stand_ins import OWN, temperature_of
from hil.model.effects.base import VarianceEffect
from hil.model.effects.catalogue import effect_by_id, variance_effect_by_id
from hil.model.effects.geometry import local_frame
from hil.model.effects.setup import EarthRateError
from hil.model.forms import PER_G, RATE, default_form
from hil.solve.identifiability import orthonormal, project_out
from procedures.verdict import Judgement, Verdict
from procedures.words import listed

_ROTOR = {each.name: each.size for effect in ("bias", "GS", "MU_real") for each in effect_by_id(effect).parameters}
_OTHER = {
    each.name: max(replace(each, typical=size).size for size in each.typical_other.values())
    for effect in ("bias", "g_sensitivity")
    for each in effect_by_id(effect).parameters
}
_SIGMAS = 3.0
_LEFT = 1e-3  # of what an error does to the rates, beside the parameters: less is the rounding of f and w
_FROM_RUN_TO_RUN = {
    name: variance_effect_by_id(effect)
    for name, effect in (("B", "turnon"), ("MU", "MU_rr"), ("GS", "GS_rr"), ("G", "G_rr"))
}


def unstated(collects: Collects) -> BoolArray:
    """Return which measured rates (n, c) have no standard error (0 is none), where every channel has some."""
    measured, stated = np.isfinite(collects.rates_deg_per_hr), collects.rates_se_deg_per_hr > 0.0
    silent = np.any(measured, axis=0) & ~np.any(measured & stated, axis=0)
    return np.asarray(measured & ~stated & ~silent.any())


def stated_noise(collects: Collects) -> FloatArray | None:
    """Return the rates' standard errors (n, c), or None where a measured rate has none (0 is none): all weigh alike."""
    errors = collects.rates_se_deg_per_hr
    return errors if np.all(errors[~np.isnan(collects.rates_deg_per_hr)] > 0.0) else None


def with_every_error(collects: Collects) -> Collects:
    """Return the collects with the largest standard error of the channel, at its duration, where one is not stated.

    Where a channel has none at all, none is used: nobody knows how much more the others tell.
    """
    lacking, errors = unstated(collects), collects.rates_se_deg_per_hr
    if not lacking.any():
        every = np.all(errors[np.isfinite(collects.rates_deg_per_hr)] > 0.0)
        return collects if every else replace(collects, rates_se_deg_per_hr=np.full_like(errors, np.nan))
    longer = np.sqrt(np.maximum(collects.conditions.duration_s / collects.conditions.duration_s[:, None], 1.0))
    most = np.max(np.nan_to_num(errors) * longer[:, :, None], axis=1)
    return replace(collects, rates_se_deg_per_hr=np.where(lacking, most, errors))


def usual_size(parameter: str, sensor: Sensor) -> float:
    """Return how large a bias, deg/hr, or an acceleration sensitivity, deg/hr/g, of a `sensor` usually is.

    >>> round(usual_size("BA", Sensor(2, ("A", "B", "S"), {"RA": "A", "RB": "B"})), 1)
    15.8
    """
    sizes = _ROTOR if sensor.is_rotor else _OTHER
    return sizes.get(parameter, sizes.get(parameter[0], math.inf))


def typical_scatter(parameter: str, sensor: Sensor) -> float:
    """Return by how much a bias, deg/hr, MU, GS or G, deg/hr/g, typically differs from run to run at most; else any.

    >>> typical_scatter("MUA", Sensor(2, ("A", "B", "S"), {"RA": "A", "RB": "B"}))
    6.0
    """
    of = _changes_by(parameter)
    if of is None:
        return math.inf
    known = of.parameters[0]
    return max(high for _, high in ([known.typical] if sensor.is_rotor else known.typical_other.values()))


def _changes_by(parameter: str) -> VarianceEffect | None:
    """Return the effect by which a parameter differs from run to run; None where no entry says."""
    return _FROM_RUN_TO_RUN.get(parameter[:-1], _FROM_RUN_TO_RUN.get(parameter[0]))


def to_record_of(changing: Iterable[str], conditions: Conditions) -> tuple[str, ...]:
    """Return the columns that nobody recorded and that parameters which change from run to run may follow."""
    effects = {of for name in changing if (of := _changes_by(name))}
    return tuple(sorted({need for effect in effects for need in to_record(conditions, effect)}))


def to_record(conditions: Conditions, effect: VarianceEffect) -> Iterator[str]:
    """Yield the columns that nobody recorded and that what scatters by an effect may follow instead.

    `conditions` are a sensor's rows as they were filed. A column that shows one number throughout is no record, nor is
    what stands in for the unit's own temperature under its name.
    """
    copied = {OWN} - {temperature_of(conditions)}
    shows = {
        n: of for n, of in conditions.columns.items() if n not in copied and np.unique(of[np.isfinite(of)]).size > 1
    }
    for name in effect.kin:
        for need in effect_by_id(name).missing(replace(conditions, columns=shows)):
            yield need.replace("|", " or ")


def measured_well_enough(
    errors: Mapping[str, tuple[float | None, str]], sensor: Sensor, accepted: float | None
) -> Judgement:
    """Judge standard `errors` with their units, by parameter, against what is `accepted`, deg/hr (at 1 g), or usual.

    By how much the unit itself changes from run to run is another question, which limits ask: no run is worse measured
    for that.
    """
    limits = {
        name: accepted or usual_size(name, sensor)
        for name, (se, unit) in errors.items()
        if se is not None and unit in (RATE, PER_G)
    }
    poor = {name: se for name, limit in limits.items() if (se := errors[name][0] or 0.0) > limit}
    if not poor:
        return Judgement(Verdict.PASS, "")
    worst = max(poor, key=lambda name: float(f"{poor[name] / limits[name]:.6g}"))  # of equals the first, on any machine
    why = "is accepted" if accepted else "such a parameter usually is"
    return Judgement(
        Verdict.INCONCLUSIVE,
        f"{listed(poor)} not measured well enough to say: the standard error of {worst}, without what runs "
        f"scatter by beyond it, is {poor[worst]:.3g} {errors[worst][1]}, more than {why} ({limits[worst]:.3g})",
    )


def smallest_seen_deg(campaign: Campaign) -> Mapping[str, float]:
    """Return how large an error of `latitude` and `heading`, deg, must be to show in the residuals; inf where none is.

    Nothing where no earth rate is given, or no latitude.
    """
    latitude = np.deg2rad(campaign.site.get("latitude_deg", np.nan))
    up, north, east = np.eye(3)
    turns = np.stack([np.cos(latitude) * up - np.sin(latitude) * north, np.cos(latitude) * east], -1)
    seen, used = np.zeros(2), False
    for collects in campaign.sensors.values():
        for run in np.unique(collects.conditions.run):
            rows = collects.rows(collects.conditions.run == run)
            sigma = stated_noise(rows)
            if not np.any(local_frame(rows.conditions).north) or not np.isfinite(latitude):
                continue
            used = True
            weights = 1.0 / (np.ones_like(rows.rates_deg_per_hr) if sigma is None else sigma).reshape(-1, 1)
            known = np.isfinite(rows.rates_deg_per_hr).reshape(-1) & np.isfinite(weights[:, 0])
            design = default_form(rows.conditions).columns(rows.conditions).reshape(len(known), -1)
            per_deg = EarthRateError().columns(rows.conditions, None, {}).reshape(len(known), 3) @ turns
            wrong = weights[known] * per_deg[known] * np.deg2rad(EARTH_RATE_DEG_PER_HR)
            left = np.linalg.norm(project_out(orthonormal(weights[known] * design[known]), wrong), axis=0)
            seen += np.where(left > _LEFT * np.linalg.norm(wrong, axis=0), left, 0.0) ** 2
    with np.errstate(divide="ignore"):
        return dict(zip(("latitude", "heading"), (_SIGMAS / np.sqrt(seen)).tolist(), strict=True)) if used else {}
