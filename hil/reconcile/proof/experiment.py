"""What to measure next: the collects that separate the surviving names most, with the power of doing so.

For every feasible addition to the campaign (another index position, another heading, the present positions again, the
temperatures in reverse order) the surviving names are worked out on the enlarged design. What the leader would add,
less what the rival together with a refitted base can imitate, in units of the noise, is the non-centrality of telling
them apart; what counts is by how much the addition raises it.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np
from scipy.special import ndtr, ndtri

from hil.campaign import Conditions, FloatArray
from hil.model.effects.base import Base
from hil.model.effects.history import joined
from hil.reconcile.naming import Naming, Weighed
from hil.reconcile.search.candidates import Candidate
from hil.reconcile.search.problem import SensorProblem
from hil.solve.changes import Addition, additions
from hil.solve.identifiability import orthonormal, project_out

_EASY = 9.0
_NEARLY = 0.8


def next_experiment(
    naming: Naming, sensors: Mapping[int, SensorProblem], sigma: Mapping[int, float]
) -> dict[str, Any] | None:
    """Return the addition that separates the leader from its strongest rival, or say that none of those tried does."""
    rivals = [rival for rival in naming.rivals if rival.tier == 1 or rival.remedy]
    leader = naming.leader
    if leader.tier != 1:
        return None
    if not rivals:
        return _once_more(leader, sensors[leader.added.hypothesis.candidate.sensor])
    rival = max(rivals, key=lambda r: (bool(r.same_on), r.probability))
    if rival.remedy:
        return _measured_again(leader, rival, sensors[leader.added.hypothesis.candidate.sensor])
    touched = [unit.candidate.sensor for unit in leader.added.units]
    sensor = sensors[next((number for number in touched if number in rival.same_on), touched[0])]
    scored = []
    present = separation(leader, rival, sensor, None, sigma[sensor.number])
    for addition in additions(sensor.collects.conditions):
        outcome = separation(leader, rival, sensor, addition, sigma[sensor.number])
        if outcome is not None and present is not None:  # what counts is what the new rows add to those at hand
            scored.append((outcome[0] - present[0], outcome[1], addition))
    if not scored:
        return None
    most = max(s[0] for s in scored)
    least = _EASY if most >= _EASY else min(_NEARLY * most, most)
    enough = [s for s in scored if s[0] >= least]  # of what says enough, or nearly the most, what asks least
    best = min(enough, key=lambda s: (s[2].effort, -s[0]))
    noncentrality, difference, addition = best
    repeats, power = repeated(noncentrality)
    if repeats == 0:
        return {
            "why": f"no stationary collect that was tried separates {leader.name} from {rival.name}; {_remedy(leader)}",
            "collects": [],
            "expected_difference_deg_per_hr": difference,
            "power": power,
            "impossible": True,
        }
    return {
        "why": f"separates {leader.name} from {rival.name}",
        "what": addition.name,
        "collects": _described(addition.rows),
        "repeats": repeats,
        "expected_difference_deg_per_hr": difference,
        "power": power,
        "impossible": False,
    }


def repeated(noncentrality: float) -> tuple[int, float]:
    """Return how often an addition of this non-centrality is to be measured, and the power of that at 1 %.

    0 times where it adds next to nothing; the power is then that of measuring it once.
    """
    repeats = int(np.ceil(_EASY / noncentrality)) if noncentrality >= 1.0 else 0
    shift, limit = np.sqrt(max(noncentrality, 0.0) * max(repeats, 1)), -ndtri(0.005)
    return repeats, float(ndtr(shift - limit) + ndtr(-shift - limit))


def _once_more(leader: Weighed, sensor: SensorProblem) -> dict[str, Any]:
    """The same collects once more, where no other name is in question but whether there is anything at all."""
    return {
        "why": f"shows {leader.name} again, or that it was chance",
        "what": "the same collects again",
        "collects": _described(sensor.collects.conditions),
        "expected_difference_deg_per_hr": None,
        "power": None,
        "impossible": False,
    }


def _measured_again(leader: Weighed, rival: Weighed, sensor: SensorProblem) -> dict[str, Any]:
    """The same collects once more, with what this data lacks."""
    return {
        "why": f"separates {leader.name} from {rival.name}: {rival.remedy}",
        "what": "the same collects again",
        "collects": _described(sensor.collects.conditions),
        "expected_difference_deg_per_hr": None,
        "power": None,
        "impossible": False,
    }


def _remedy(weighed: Weighed) -> str:
    """What the catalogue says separates a name from its rivals."""
    effect = weighed.added.hypothesis.candidate.effect
    return effect.experiment if effect is not None else "vary the driver alone"


def separation(
    leader: Weighed, rival: Weighed, sensor: SensorProblem, addition: Addition | None, sigma: float
) -> tuple[float, float] | None:
    """Return non-centrality and largest difference in deg/hr, after an addition or with the rows at hand (None).

    None where columns are lacking.
    """
    before = sensor.collects.conditions
    both = before if addition is None else joined(before, addition.rows)
    base = sensor.base_on(both)
    truth = _signal(leader, sensor.number, both, base)
    other = _columns(rival, sensor.number, both, base)
    if truth is None or other is None:
        return None
    measured = np.isfinite(sensor.collects.rates_deg_per_hr)
    mask = np.vstack([measured, np.ones((len(both) - len(before), truth.shape[1]), dtype=bool)])
    design = np.concatenate([sensor.form.columns(both), other], axis=2)[mask]
    target = truth[mask]
    rest = project_out(orthonormal(design, 1e-6), target)
    return float(np.sum(rest**2)) / sigma**2, float(np.ptp(rest))


def _signal(weighed: Weighed, number: int, conditions: Conditions, base: Base) -> FloatArray | None:
    """The leader's fitted effect on the rows of an enlarged design, (n, c)."""
    columns = _columns(weighed, number, conditions, base)
    candidate = _candidate(weighed, number)
    if columns is None or candidate is None or candidate.effect is None:
        return None
    values = np.zeros(columns.shape[2])
    names = [parameter.name for parameter in candidate.effect.parameters_for(conditions)]
    for place, (_, u, k) in enumerate(weighed.fit.owner):
        unit = weighed.added.units[u]
        if unit.candidate.sensor == number:
            index = unit.parameters[k]
            if candidate.form == "constant":  # an enlarged design may have more parameters: match by name
                index = names.index(candidate.parameters[index].name)
            values[index] = weighed.fit.values[place]
    return np.asarray(columns @ values)


def _columns(weighed: Weighed, number: int, conditions: Conditions, base: Base) -> FloatArray | None:
    candidate = _candidate(weighed, number)
    return None if candidate is None or candidate.effect is None else candidate.rebuilt(conditions, base)


def _candidate(weighed: Weighed, number: int) -> Candidate | None:
    return next((unit.candidate for unit in weighed.added.units if unit.candidate.sensor == number), None)


def _described(rows: Conditions) -> list[dict[str, Any]]:
    """One entry per kind of collect: label, f and w."""
    out = []
    for label in dict.fromkeys(rows.position.tolist()):
        at = rows.position == label
        out.append(
            {
                "position": label,
                "f": [round(float(v), 4) for v in rows.f_g[at].mean(axis=0)],
                "w_deg_per_hr": [round(float(v), 3) for v in rows.w_deg_per_hr[at].mean(axis=0)],
                "runs": len(np.unique(rows.run)),
            }
        )
    return out[:24]
