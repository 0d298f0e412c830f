"""What shows inside the collects: tones, settling, ramps, lattices, saturation, bursts, where the campaign has series.

Each test of the catalogue is asked of every collect and channel; the p-values of one effect are combined by the
smallest, corrected for how many were asked. What is the same from collect to collect is also asked of all together: a
settling or a tone that no single collect proves shows there. All effects share one rate of false alarms.

A standard error that allows for correlated samples holds white noise and flicker; drawn as white noise they would be
another noise. Moments of the series tell the two.
"""

from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass
from functools import cache
from typing import Any

import numpy as np

from hil.campaign import Campaign, Conditions, FloatArray
from hil.model.effects.catalogue import effect_by_id
from hil.model.effects.columns import middle_hr
from hil.model.effects.inside import FEWEST, FEWEST_BESIDE, SeriesEffect, SeriesFinding
from hil.model.effects.noise import BiasInstability
from hil.model.effects.scatter import Scatter
from hil.model.effects.series import Ramp, blocked
from hil.reconcile.result import FoundEffect
from hil.reconcile.rivals import BEYOND, CERTAIN, Rival

_USUAL = 0.5  # of the mean is what half of the collects show at least: .9 of flicker
_LIKELIER = 4.0  # twice the log of how much likelier a walk makes what blocks far apart differ by: seven times
_FINE = 5  # points by which a block is averaged
_LEAST_P = 1e-300
_UNITS = (("_deg_per_hr_per_min", "deg/hr/min"), ("_deg_per_hr", "deg/hr"), ("_hz", "Hz"), ("_s", "s"))
_ODDS = 0.05  # prior odds that one effect shows inside the collects, as of one that shows in the averages


_Answer = tuple[int, SeriesFinding, FloatArray]
"""A collect, what it answered, and what is asked of all collects together."""


def within_collects(campaign: Campaign, effects: Sequence[SeriesEffect], alpha: float) -> list[dict[str, Any]]:
    """Return what the series show beyond chance, strongest first; empty where the campaign has no series.

    `alpha` is the rate at which anything is returned from series in which nothing is hidden.
    """
    asked: dict[tuple[SeriesEffect, int, str], list[_Answer]] = {}
    for number, collects in campaign.sensors.items():
        sensor = collects.conditions.sensor
        of_sensor = [effect for effect in effects if effect.applies_to(sensor)]
        for collect in collects.conditions.collect.tolist():
            if (series := campaign.series(collect)) is None:
                continue
            for effect in of_sensor:
                for index, answer in enumerate(effect.test(series, sensor)):
                    if np.isfinite(answer.p_value):
                        own = asked.setdefault((effect, number, answer.channel), [])
                        own.append((collect, answer, effect.summary(series, index)))
    findings = []
    for (effect, number, channel), answers in asked.items():
        p_values, count = effect.p_values([answer for _, answer, _ in answers]), len(answers)
        collect, strongest, _ = answers[int(np.argmin(p_values))]
        together = effect.together([summary for *_, summary in answers])
        ways = len(asked) * (2 if together else 1)
        shown = int(np.sum(p_values * count * ways < alpha))
        p_value, estimates = float(p_values.min()) * count, strongest.estimates
        told = f"Collect {collect}, channel {channel}: {strongest.sentence}"
        if together and together[0] < p_value:
            p_value, estimates, shown = together[0], together[1], count
            told = f"Channel {channel}: all {count} collects together {together[2]}"
        if p_value * ways >= alpha:  # chance explains it
            continue
        found = {"id": effect.id, "sensor": number, "channel": channel, "collect": collect, "collects": shown}
        more = {"asked": count, "q_value": p_value * ways, "estimates": dict(estimates), "sentence": told}
        findings.append(found | more)
    return sorted(findings, key=lambda item: item["q_value"])


def named_within(
    findings: Sequence[Mapping[str, Any]],
    effects: Sequence[SeriesEffect],
    alpha: float,
    moving: Collection[int] = (),
) -> list[FoundEffect]:
    """Return what the findings are called: per sensor, the strongest of each group that can be taken for one another.

    The share of a name among its rivals is that of its prior odds and its Bayes factor's bound, 1/(−e p ln p) (Sellke,
    Bayarri, Berger); what is nothing with a probability above `alpha` has no name. A slope inside the collects is that
    of the slow effect which the model states of a sensor (`moving`), and ambiguous where it states none.
    """
    by_id = {effect.id: effect for effect in effects}
    out = []
    for sensor in dict.fromkeys(f["sensor"] for f in findings):
        left = [f for f in findings if f["sensor"] == sensor and (f["id"] != Ramp.id or sensor not in moving)]
        while left:
            leader = left[0]
            same = {leader["id"], *by_id[leader["id"]].confusable_with}
            alike = [f for f in left if f["id"] in same or leader["id"] in by_id[f["id"]].confusable_with]
            named, nothing = _named(leader, alike, by_id)
            out += [named] if nothing <= alpha else []
            left = [f for f in left if f not in alike]
    return out


def _named(
    leader: Mapping[str, Any], alike: Sequence[Mapping[str, Any]], by_id: dict[str, SeriesEffect]
) -> tuple[FoundEffect, float]:
    """Return an effect with its rivals, and the probability that nothing is there."""
    weight: dict[str, float] = {}
    for finding in alike:
        p = min(max(finding["q_value"], _LEAST_P), 0.3)
        weight[finding["id"]] = max(weight.get(finding["id"], 0.0), -_ODDS / (np.e * p * np.log(p)))
    total = 1.0 + sum(weight.values())  # 1: that nothing is there
    effect = by_id[leader["id"]]
    if effect.id == Ramp.id:
        slow = {name: weight[Ramp.id] for name in effect.confusable_with if name not in weight}
        weight, total = {**weight, **slow}, total + sum(slow.values())
    probability = float(weight.pop(effect.id) / total)
    rivals = [(name, own, by_id.get(name) or effect_by_id(name)) for name, own in weight.items()]
    found = FoundEffect(
        id=effect.id,
        title=effect.title,
        equation=effect.equation,
        parameters=[
            _parameter(name, value, leader) for name, value in leader["estimates"].items() if name != "se_deg_per_hr"
        ],
        probability=probability,
        confusable_with=[Rival(name, float(own / total), 0.0, of.title) for name, own, of in rivals],
        kind="named" if probability >= CERTAIN else "ambiguous",
        sensors=(leader["sensor"],),
        physics=f"{' '.join((type(effect).__doc__ or '').split())} {effect.signature} {leader['sentence']}.",
        experiment=effect.experiment,
        inside_collects=True,
    )
    return found, float(1.0 / total)


def _parameter(name: str, value: float, finding: Mapping[str, Any]) -> dict[str, Any]:
    """Return one estimate as a parameter: its name carries its unit."""
    suffix, unit = next(((end, unit) for end, unit in _UNITS if name.endswith(end)), ("", "1"))
    return {
        "name": name.removesuffix(suffix),
        "value": float(value),
        "se": finding["estimates"].get("se_deg_per_hr"),
        "unit": unit,
        "at": f"{finding['channel']}, {finding['collects']} of {finding['asked']} collects",
        "sensor": finding["sensor"],
    }


@dataclass(frozen=True)
class Wander:
    """Bias instability `size` ± `se`, deg/hr, and the white noise beside it, `white` (n, c), deg/√hr, of some collects.

    `within` and `between` are what it scatters averages by inside a run and from run to run, deg/hr.
    """

    size: float
    se: float
    conditions: Conditions
    white: FloatArray
    within: float
    between: float


def wandering(campaign: Campaign, number: int) -> Wander | None:
    """Return what the series of a sensor show beyond chance, over all its collects and channels.

    Half the variance of neighbouring blocks' differences is that of the white noise, and so is the variance about a
    straight line; each has as much of flicker on top as the covariance of that says. So has what blocks far apart
    differ by: where that is a random walk's, and not flicker's, it is none.
    """
    rows = campaign.sensors[number].conditions
    parts = BiasInstability().scatter(rows, {})
    sizes = np.array([part.columns[0, 0, 0] ** 2 for part in parts])
    # Measured, and of flicker and a walk of unit size: of neighbours, about a line, of blocks far apart.
    seen = np.full((3, 3, len(rows), len(rows.sensor.channels)), np.nan)
    block_hr = np.zeros(seen.shape[2:])
    for row, collect in enumerate(rows.collect.tolist()):
        if (series := campaign.series(collect)) is None:
            continue
        for channel in range(seen.shape[3]):
            times, rates = blocked(series, channel)
            if len(rates) >= FEWEST:
                x, block_s = times - times.mean(), round(float(np.median(np.diff(times))), 3)
                left = rates - rates.mean() - x * (x @ rates / (x @ x))
                near, far = (float(np.mean((rates[k:] - rates[:-k]) ** 2)) / 2.0 for k in (1, len(rates) // 3))
                measured = near, float(left @ left) / (len(rates) - 2), far
                of_flicker = sizes @ [_moments(float(part.tau_s or 0.0), len(rates), block_s) for part in parts]
                seen[:, :, row, channel] = measured, of_flicker, _moments(np.inf, len(rates), block_s)
                block_hr[row, channel] = block_s / 3600.0
    (neighbours, line, apart), *of_each = seen[:, :, np.isfinite(seen[0, 0])]
    if len(line) < FEWEST_BESIDE:
        return None
    more, unit = line - neighbours, float(np.mean(of_each[0][1] - of_each[0][0]))
    square, error = float(more.mean()) / unit, float(more.std()) / len(more) ** 0.5 / unit
    white = np.sqrt(np.maximum(seen[0, 0] - seen[1, 0] * square, 0.0) * block_hr)
    often = np.median(more) > _USUAL * more.mean()  # what a few collects show is no noise of all
    if not often or square <= BEYOND * error or np.nanmedian(white) <= 0.0:
        return None
    as_flicker, as_walk = (
        float(left.mean()) ** 2 * len(left) / float(left.var())
        for of in of_each
        for left in [apart - neighbours - more * np.mean(of[2] - of[0]) / np.mean(of[1] - of[0])]
    )
    if as_flicker - as_walk > _LIKELIER:
        return None
    hours, runs = middle_hr(rows), [rows.run == run for run in np.unique(rows.run)]
    middles = np.array([hours[run].mean() for run in runs])
    of_runs = np.array([np.mean([part.between(part, hours[run], hours[run]).mean() for run in runs]) for part in parts])
    of_all = np.array([part.between(part, middles, middles).mean() for part in parts])
    within, between = sizes @ (1.0 - of_runs), sizes @ np.maximum(of_runs - of_all, 0.0)
    size = square**0.5
    return Wander(size, error / (2.0 * size), rows, white, size * float(within) ** 0.5, size * float(between) ** 0.5)


@cache
def _moments(tau_s: float, count: int, block_s: float) -> tuple[float, float, float]:
    """Return what a wander of unit size adds to half the variance of blocks' steps, to that about a line, and of far.

    Those are blocks a third of all apart; what forgets nothing is a walk.
    """
    fine = (np.arange(count * _FINE) + 0.5) * block_s / _FINE / 3600.0
    wanders = Scatter(np.ones((1, 1, 1)), tau_s=tau_s, walk=bool(np.isinf(tau_s)))
    alike = wanders.between(wanders, fine, fine)
    blocks = alike.reshape(count, _FINE, count, _FINE).mean(axis=(1, 3))
    line, _ = np.linalg.qr(np.stack([np.ones(count), np.arange(count) - 0.5 * (count - 1)], axis=1))
    left = float(np.trace(blocks) - np.trace(line.T @ blocks @ line)) / (count - 2)
    own = blocks.diagonal()
    near, far = (0.5 * float(np.mean(own[k:] + own[:-k] - 2.0 * blocks.diagonal(k))) for k in (1, count // 3))
    return near, left, far
