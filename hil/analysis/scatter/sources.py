"""Scatter signatures of a night or campaign, and of a published table: channel by channel, temperature by temperature.

    for signature in campaign_signatures(read_campaign("night")):
        print(signature.axis, signature.temperature_degC, signature.sentence)
    published_signatures("rd-gc-86-1-table-1")

Per channel: every temperature with repeats, then, where there are several, all of them pooled.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator

import numpy as np

from hil.analysis.scatter.signature import QUIET_COLLECT_DEG_PER_HR, Repeats, ScatterSignature, scatter_signature
from hil.campaign import Campaign, Collects, FloatArray
from hil.model.forms import MATRIX_6, matrix_6_form
from hil.solve import solve
from hil.solve.runs import OBSERVABLE, stated_noise
from hil.solve.temperatures import runs_by_temperature

# C and M of each channel from the six parameters: MU adds +MUB to A and -MUA to B (eqs. 5, 6).
_C_AND_M = {
    "A": np.array([[name == "BA" or name == "MUB" for name in MATRIX_6], [name == "BA" for name in MATRIX_6]], float),
    "B": np.array(
        [[(name == "BB") - (name == "MUA") for name in MATRIX_6], [name == "BB" for name in MATRIX_6]], float
    ),
}


def campaign_signatures(campaign: Campaign) -> tuple[ScatterSignature, ...]:
    """Return the signatures of all rotor sensors of a campaign; empty where nothing was repeated."""
    return tuple(
        signature
        for collects in campaign.sensors.values()
        if collects.conditions.sensor.is_rotor
        for signature in signatures_by_channel(_repeats(collects))
    )


def signatures_by_channel(groups: Iterable[Repeats]) -> list[ScatterSignature]:
    """Return, channel by channel, the signature at every temperature and then the pooled one."""
    channels: dict[tuple[int, str], list[Repeats]] = {}
    for group in groups:
        channels.setdefault((group.sensor, group.axis), []).append(group)
    found = []
    for several in channels.values():
        found += [scatter_signature([group]) for group in several]
        found += [scatter_signature(several)] if len(several) > 1 else []
    return found


def overall(signatures: Iterable[ScatterSignature]) -> list[ScatterSignature]:
    """Return one signature per channel: the pooled one, or that of its only temperature."""
    return list({(each.sensor, each.axis): each for each in signatures}.values())


def _repeats(collects: Collects) -> Iterator[Repeats]:
    """Yield each channel at each temperature that has two runs or more from which all six parameters follow."""
    for axis, to_c_and_m in _C_AND_M.items():
        for temperature, runs in runs_by_temperature(collects.conditions):
            solved = [
                found for run in runs if (found := _run(collects.rows(collects.conditions.run == run))) is not None
            ]
            if len(solved) < 2:
                continue
            points = np.array([to_c_and_m @ values for values, _, _ in solved])
            away = points - points.mean(axis=0)
            white = np.mean([to_c_and_m @ covariance @ to_c_and_m.T for _, covariance, _ in solved], axis=0)
            ramp = np.mean([to_c_and_m @ drift for _, _, drift in solved], axis=0)
            number = collects.conditions.sensor.number
            yield Repeats(number, axis, temperature, len(solved), away.T @ away, white, ramp)


def _run(collects: Collects) -> tuple[FloatArray, FloatArray, FloatArray] | None:
    """Return one run's six parameters, their covariance by the collects' noise, and their answer to a drift."""
    conditions = collects.conditions
    design = matrix_6_form(conditions.sensor).columns(conditions).reshape(-1, len(MATRIX_6))
    stated = stated_noise(collects)
    sigma = QUIET_COLLECT_DEG_PER_HR if stated is None else stated.reshape(-1)
    rates = (collects.rates_deg_per_hr - conditions.w_channels_deg_per_hr).reshape(-1)
    solution = solve(design, rates, sigma, rank_tolerance=OBSERVABLE)
    if np.any(np.isnan(solution.values)):
        return None
    order = np.argsort(np.argsort(conditions.start_s, kind="stable"), kind="stable").astype(np.float64)
    ramp = np.where(np.isnan(rates), np.nan, np.repeat(order - order.mean(), len(conditions.sensor.channels)))
    return solution.values, solution.covariance, solve(design, ramp, sigma, rank_tolerance=OBSERVABLE).values
