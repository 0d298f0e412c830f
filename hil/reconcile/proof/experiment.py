"""What to measure next: the collects that separate the surviving names most, with the power of doing so.

For every feasible addition to the campaign (another index position, another heading, the present positions again, the
temperatures in reverse order) the surviving names are worked out on the enlarged design. What the leader would add,
less what the rival together with a refitted base can imitate, in units of the noise, is the non-centrality of telling
them apart; what counts is by how much the addition raises it.
"""

from typing import Any

import numpy as np
from scipy.special import ndtr, ndtri

from hil.campaign import Conditions, FloatArray
from hil.model.effects.base import Base
from hil.model.effects.catalogue import named as known_as
from hil.model.effects.history import joined
from hil.reconcile.result import without_collects
from hil.reconcile.rivals import Rival
from hil.reconcile.search.candidates import Candidate
from hil.reconcile.search.problem import SensorProblem
from hil.solve.changes import Addition, additions
from hil.solve.identifiability import orthonormal, project_out

_EASY = 9.0
_NEARLY = 0.8


Fitting = tuple[Candidate, FloatArray]
"""The leader on one sensor, as fitted: its candidate and values (p,) of all its columns, zero where not fitted."""


def next_experiment(
    leader: Fitting, rival: Candidate | None, named: Rival | None, sensor: SensorProblem, sigma: float
) -> dict[str, Any] | None:
    """Return the addition that separates the leader from its strongest rival, or say that none of those tried does.

    That rival is `named`, and where its effect is on this sensor `rival`. The leader's values are (p,), `sigma` is the
    noise, deg/hr.
    """
    effect, name, rival_name = leader[0].effect, leader[0].name, "" if named is None else named.id
    if named is not None and named.remedy:  # it is no further collect that is needed
        return _the_same_again(f"separates {name} from {rival_name}: {named.remedy}", sensor)
    asked = [each.effect for each in (leader[0], rival) if each is not None and each.effect is not None]
    untold = next(filter(None, (each.untold_by(sensor.collects.conditions) for each in asked)), "")
    if untold:  # what it does in further collects is nobody's to say
        return _the_same_again(f"separates {name} from {rival_name or 'chance'}: record {untold}", sensor)
    if rival is None:
        # What happened at a time does not come back when asked.
        once = effect is not None and effect.happens(sensor.collects.conditions, leader[0].shape)
        of_it = f"by how runs scatter whether {name} was chance" if once else f"{name} again, or that it was chance"
        return _the_same_again(f"shows {of_it}", sensor)
    scored = []
    present = separation(leader, rival, sensor, None, sigma)
    for addition in additions(sensor.collects.conditions):
        outcome = separation(leader, rival, sensor, addition, sigma)
        if outcome is not None and present is not None:  # what counts is what the new rows add to those at hand
            scored.append((outcome[0] - present[0], outcome[1], addition))
    if not scored:
        return None
    most = max(s[0] for s in scored)
    least = _EASY if most >= _EASY else min(_NEARLY * most, most)
    enough = [s for s in scored if s[0] >= least]  # of what says enough, or nearly the most, what asks least
    noncentrality, difference, addition = min(enough, key=lambda s: (s[2].effort, -s[0]))
    repeats, power = repeated(noncentrality)
    if repeats == 0:
        otherwise = known_as(effect).experiment.rstrip(".") if effect is not None else "vary the driver alone"
        why = f"no stationary collect that was tried separates {name} from {rival_name}. {otherwise}"
        return {**without_collects(why), "impossible": True}
    return {
        "why": f"separates {name} from {rival_name}",
        "what": addition.name,
        "collects": _described(addition.rows),
        "repeats": repeats,
        "expected_difference_deg_per_hr": difference,
        "power": power,
        "impossible": False,
    }


def _the_same_again(why: str, sensor: SensorProblem) -> dict[str, Any]:
    collects = _described(sensor.collects.conditions)
    return {**without_collects(why), "what": "the same collects again", "collects": collects}


def repeated(noncentrality: float) -> tuple[int, float]:
    """Return how often an addition of this non-centrality is to be measured, and the power of that at 1 %.

    0 times where it adds next to nothing; the power is then that of measuring it once.
    """
    repeats = int(np.ceil(_EASY / noncentrality)) if noncentrality >= 1.0 else 0
    shift, limit = np.sqrt(max(noncentrality, 0.0) * max(repeats, 1)), -ndtri(0.005)
    return repeats, float(ndtr(shift - limit) + ndtr(-shift - limit))


def separation(
    leader: Fitting, rival: Candidate, sensor: SensorProblem, addition: Addition | None, sigma: float
) -> tuple[float, float] | None:
    """Return non-centrality and largest difference in deg/hr, after an addition or with the rows at hand (None).

    None where columns are lacking. The leader's values are (p,).
    """
    before = sensor.collects.conditions
    both = before if addition is None else joined(before, addition.rows)
    base = sensor.base_on(both)
    if leader[0].effect is None or rival.effect is None:
        return None
    truth = _signal(*leader, both, base)
    other = rival.rebuilt(both, base)
    measured = np.isfinite(sensor.collects.rates_deg_per_hr)
    mask = np.vstack([measured, np.ones((len(both) - len(before), truth.shape[1]), dtype=bool)])
    design = np.concatenate([sensor.form.columns(both), other], axis=2)[mask]
    rest = project_out(orthonormal(design, 1e-6), truth[mask])
    return float(np.sum(rest**2)) / sigma**2, float(np.ptp(rest))


def _signal(leader: Candidate, values: FloatArray, conditions: Conditions, base: Base) -> FloatArray:
    """The leader's fitted effect on the rows of an enlarged design, (n, c), which may have more parameters: by name."""
    columns = leader.rebuilt(conditions, base)
    if leader.form != "constant" or leader.effect is None:
        return np.asarray(columns @ values)
    own = {p.name: v for p, v in zip(leader.parameters, values, strict=True)}
    every = leader.effect.parameters_for(conditions)
    kept = leader.kept or range(len(every))
    return np.asarray(columns @ np.array([own.get(every[k].name, 0.0) for k in kept]))


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
