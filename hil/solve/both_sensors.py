"""Two sensors in one unit: what they have in common from run to run, and what each does alone.

    both = common_and_differential(campaign)
    both.common.means[0].values["BA"]     # (BA of sensor 1 + BA of sensor 2) / 2 at the first temperature
    both.shared                           # every pair of parameters that certainly moves together

What base, supply, mount or chamber do moves both sensors in the same runs; what a sensor does, it does alone. Every
command that says what makes repeats scatter says this, too. The sensors need not lie alike, so a common cause may enter
through different parameters: a base that turns about an axis along which the one has its A and the other its B axis is
BA of the one and BB of the other. Therefore every pair is looked at, of parameters that scatter by more than noise
explains. Earth rate and gravity are taken as the same for both: an error there is common too, but in every run alike.
"""

import math
from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from scipy.special import ndtri, stdtr

from hil.campaign import Campaign, FloatArray, IntArray
from hil.files.document import picked
from hil.model.forms import MATRIX_6, PER_G, RATE
from hil.solve.repeats import SensorRepeats, repeats
from hil.solve.runs import solve_campaign
from hil.solve.temperatures import runs_by_temperature
from hil.solve.uncertain import CONFIDENCE, RARE, Spread, means_at
from procedures.words import counted, listed

EXCHANGES = 10_000
"""Ways to exchange runs that are tried: of 36 pairs each is asked at one in 3 600."""

UNITS = dict(zip(MATRIX_6, (RATE,) * 2 + (PER_G,) * 4, strict=True))


@dataclass(frozen=True)
class SharedPair:
    """Parameters of the two sensors that move together from run to run: `first` of the one, `second` of the other."""

    first: str
    second: str
    correlation: float
    p: float


@dataclass(frozen=True)
class BothSensors:
    """Half the sum and the difference (second sensor less first) of each parameter, with what repeats show of them.

    `correlations` has the same parameter of both, with its 95 % interval; `shared` any pair of those `asked`.
    """

    sensors: tuple[int, int]
    common: SensorRepeats
    differential: SensorRepeats
    degrees_of_freedom: int
    correlations: Mapping[str, tuple[float | None, float | None, float | None]]
    shared: tuple[SharedPair, ...]
    asked: int

    def sentences(self) -> list[str]:
        """Say what moves together, and how much of it."""
        one, two = self.sensors
        if self.degrees_of_freedom < 2:
            return [f"sensors {one} and {two}: too few repeats to tell what they have in common from run to run"]
        if not self.shared:
            found = f"nothing certainly moves together from run to run ({self.degrees_of_freedom} degrees of freedom)"
            return [f"sensors {one} and {two}: {found}; as far as these runs tell, each scatters alone"]
        pairs = [
            f"{pair.first} of the one and {pair.second} of the other (correlation {pair.correlation:+.2f}, "
            f"p = {pair.p * self.asked:.1g} of {counted(self.asked, 'pair')})"
            for pair in self.shared
        ]
        cause = "a common cause, such as base, supply, mount or temperature"
        return [f"sensors {one} and {two} move together from run to run, {listed(pairs)}: {cause}"]

    @property
    def together(self) -> list[str]:
        """What moves together, in words; nothing where each scatters alone, or nobody can tell."""
        return self.sentences() if self.shared else []

    @property
    def look_for(self) -> str:
        """What somebody has to look for; empty where nothing is shared."""
        return f"what moves sensors {listed(self.sensors)} together from run to run" if self.shared else ""

    def document(self) -> dict[str, Any]:
        """Return what `hil solve --json` prints of it."""
        return {
            **picked(self, "sensors degrees_of_freedom"),
            "common": self.common.document(),
            "differential": self.differential.document(),
            "correlations": {
                n: {"value": r, "low": low, "high": high} for n, (r, low, high) in self.correlations.items()
            },
            "shared": [vars(pair) for pair in self.shared],
            "sentences": self.sentences(),
        }


def common_and_differential(campaign: Campaign) -> BothSensors | None:
    """Compare the first two rotor sensors of a campaign; None where there are not two, or no run has both."""
    rotors = [number for number, rows in campaign.sensors.items() if rows.conditions.sensor.is_rotor][:2]
    if len(rotors) < 2:
        return None
    only = {number: campaign.sensors[number] for number in rotors}
    chosen = campaign if [*only] == [*campaign.sensors] else replace(campaign, sensors=only)
    solved: dict[int, dict[int, FloatArray]] = {}
    shown = repeats(chosen, every := solve_campaign(chosen))
    solutions = [each for each in every if each.runs[0] in shown[each.sensor].of_each]
    for each in solutions:
        pairs = [(e.value, math.nan if e.se is None else e.se) for e in each.by_noise(each.left.deg_per_hr).values()]
        if len(pairs) == len(MATRIX_6) and all(value is not None for value, _ in pairs):
            solved.setdefault(each.runs[0], {})[each.sensor] = np.array(pairs, dtype=np.float64)
    both = {run: np.stack([of[n] for n in rotors]) for run, of in solved.items() if len(of) == 2}
    at = [
        (temperature, own)
        for temperature, runs in runs_by_temperature(campaign.sensors[rotors[0]].conditions)
        if (own := tuple(run for run in runs if run in both))
    ]
    if not at:
        return None
    group = np.repeat(np.arange(len(at)), [len(runs) for _, runs in at])
    values, errors = np.moveaxis(np.array([both[run] for _, runs in at for run in runs]), -1, 0)  # (runs, 2, 6)
    white = np.sqrt(np.sum(errors**2, axis=1))  # the sensors' noise is independent
    known = min(float(each.left.freedom.min()) for each in solutions)

    def told_of(of: FloatArray, error: FloatArray) -> SensorRepeats:
        spread = Spread.of(of, error, group, residuals=known)
        return SensorRepeats.of(UNITS, spread, means_at(UNITS, of, error, group, at, spread))

    common, differential = (
        told_of(of, error) for of, error in ((values.mean(axis=1), 0.5 * white), (values[:, 1] - values[:, 0], white))
    )
    alike = not any(shown[number].uneven.any() or shown[number].left.larger for number in rotors)
    every_sensor = zip(values.swapaxes(0, 1), errors.swapaxes(0, 1), strict=True)
    away = np.stack([_away(*of, group, known, alike=alike) for of in every_sensor])
    degrees = len(group) - len(at)
    with np.errstate(invalid="ignore", divide="ignore"):
        correlation = away[0].T @ away[1] / np.outer(*np.linalg.norm(away, axis=1))
    same = {name: _interval(float(correlation[i, i]), degrees) for i, name in enumerate(MATRIX_6)}
    # Of parameters that scatter from run to run by no more than noise explains nothing moves any.
    one, other = (np.isin(MATRIX_6, np.array(of.names)[of.by_noise.certain]) for of in map(shown.__getitem__, rotors))
    asked = one[:, None] & other
    chance = _of_normal(correlation, degrees) if alike else _of_exchanged(away, group)
    # Of those asked chance would give any with less than RARE.
    rare = np.argwhere(asked & (chance < RARE / max(asked.sum(), 1))).tolist()
    told = [SharedPair(MATRIX_6[i], MATRIX_6[j], float(correlation[i, j]), float(chance[i, j])) for i, j in rare]
    shared = tuple(sorted(told, key=lambda pair: pair.p))
    return BothSensors((rotors[0], rotors[1]), common, differential, degrees, same, shared, int(asked.sum()))


def moving_together(campaign: Campaign) -> list[str]:
    """Say what moves both sensors of a campaign together; nothing where each scatters alone, or nobody can tell."""
    both = common_and_differential(campaign)
    return [] if both is None else both.together


def _away(values: FloatArray, errors: FloatArray, group: IntArray, residuals: float, *, alike: bool) -> FloatArray:
    """Return how far runs' values (r, p) are from the mean of their `group` (r,), in what each scatters by.

    Of values as they are, one run that is noisy in both sensors would be all that a correlation is of. Where groups do
    not scatter `alike`, each is in what it scatters by itself.
    """
    sd = Spread.of(values, errors, group, residuals=residuals).sd(errors)
    weight = np.where(np.all(sd > 0.0, axis=0), sd, 1.0) ** -2.0
    of_each = group == np.unique(group)[:, None]
    away = np.sqrt(weight) * (values - (of_each @ (weight * values) / (of_each @ weight))[group])
    if not alike:
        squares = of_each @ away**2 / np.maximum(of_each.sum(axis=1, keepdims=True) - 1.0, 1.0)
        away = away / np.sqrt(np.where(squares > 0.0, squares, 1.0))[group]
    return np.asarray(away)


def _interval(correlation: float, degrees: int) -> tuple[float | None, float | None, float | None]:
    """Return a correlation with its 95 % interval by Fisher's transformation; None where nothing is known."""
    if not math.isfinite(correlation) or degrees < 3:
        return (correlation if math.isfinite(correlation) else None), None, None
    middle = math.atanh(max(min(correlation, 1.0 - 1e-12), 1e-12 - 1.0))
    width = float(ndtri(0.5 + 0.5 * CONFIDENCE)) / math.sqrt(degrees - 2)
    return correlation, math.tanh(middle - width), math.tanh(middle + width)


def _of_normal(correlation: FloatArray, degrees: int) -> FloatArray:
    """How rarely chance gives as large a correlation of what scatters normally, and alike everywhere."""
    tangent = np.abs(correlation) * np.sqrt(max(degrees - 1, 0) / np.maximum(1.0 - correlation**2, 1e-12))
    return np.asarray(2.0 * stdtr(degrees - 1, -tangent)) if degrees > 1 else np.ones_like(correlation)


def _of_exchanged(away: FloatArray, group: IntArray) -> FloatArray:
    """How rarely (6, 6) runs of one sensor, exchanged within each `group`, go with the other as much (Fisher 1935)."""
    rng = np.random.default_rng(0)
    order = np.lexsort((rng.random((EXCHANGES, len(group))), np.broadcast_to(group, (EXCHANGES, len(group)))))
    products = np.abs(np.einsum("rp,erq->epq", away[0][np.argsort(group, kind="stable")], away[1][order]))
    real = np.abs(away[0].T @ away[1])
    return np.asarray((1.0 + (products >= real * (1.0 - 1e-9)).sum(axis=0)) / (1.0 + EXCHANGES))
