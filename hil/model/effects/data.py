"""Mistakes in the data: signs and frames of the earth rate, labels that were exchanged."""

import itertools
from collections.abc import Mapping

import numpy as np

from hil.campaign import Conditions, FloatArray
from hil.model.effects.base import OUTSIDE, Base, Effect, Parameter, ShapeParameter, required_base
from hil.model.effects.geometry import local_frame
from hil.model.equation import pickoff_rates

ALL_RUNS = -1.0
"""Value of swap's shape parameter `run` that stands for the whole campaign."""


class EarthRateFrame(Effect):
    """A component of the earth rate was used with the wrong sign: the data then differs by twice that component."""

    id = "frame"
    follows = "heading"
    title = "Earth-rate sign or frame defect"
    equation = "R -= 2 w_used of the component whose sign is wrong"
    parameters = (
        Parameter("wrong_vertical", "1", (1.0, 1.0)),
        Parameter("wrong_level_2", "1", (1.0, 1.0)),
        Parameter("wrong_level_3", "1", (1.0, 1.0)),
    )
    common_to_sensors = True
    signature = "Constant offsets: GSA by 2 W1 (17 deg/hr at 35 deg latitude), MUB by 2 W3, BB by 2 W2."
    confusable_with = ("earth",)
    odds = OUTSIDE
    experiment = "Turn the heading by 180 deg: the horizontal components change sign."

    def columns(self, conditions: Conditions, base: Base | None, shape: Mapping[str, float]) -> FloatArray:
        """Return −2 times the vertical part of w, its level part along axis 2, and the rest, shape (n, c, 3).

        Axis 2 of the bench is a rotor sensor's B axis; any other sensor has its whole level part in the second column.
        """
        w = np.nan_to_num(conditions.w_deg_per_hr)
        up = local_frame(conditions).up
        vertical = np.sum(w * up, axis=1, keepdims=True) * up
        along_2 = w - vertical
        rest = np.zeros_like(w)
        if conditions.sensor.is_rotor:
            along_2 = along_2 * np.array([0.0, 1.0, 0.0])
            rest = w - vertical - along_2
        return -2.0 * np.stack([vertical, along_2, rest], -1)[:, conditions.sensor.channel_axes, :]


class Mislabelled(Effect):
    """Two positions, or the two channels, of one run (or of all) were exchanged in the record."""

    id = "swap"
    follows = "run"
    title = "Mislabelled collect or axis"
    equation = "R(p) becomes R(q) and R(q) becomes R(p) in one run; or RA and RB change places"
    parameters = (Parameter("swapped", "1", (1.0, 1.0)),)
    needs_base = True
    in_models = False
    signature = (
        "An isolated run: 1 and 2 exchanged turns the sign of GS; 3 with another gives a huge MU; A-B turns by 90 deg."
    )
    confusable_with = ("jump", "MU_real", "MU_rr")
    searched = False  # exchanged labels are looked for among the outliers
    experiment = "Look at the accelerometers of that run: G shows which way it stood."

    def shapes_for(self, conditions: Conditions) -> tuple[ShapeParameter, ...]:
        """Return the run (−1: all) and which exchange: pairs of collects (or positions), then the channels."""
        runs = [ALL_RUNS, *(float(run) for run in np.unique(conditions.run))]
        most = max((len(_collect_pairs(conditions, run)) for run in np.unique(conditions.run)), default=0)
        exchanges = max(most, len(_pairs(conditions))) + (len(conditions.sensor.channels) == 2)
        return (
            ShapeParameter("run", "", tuple(runs)),
            ShapeParameter("exchange", "", tuple(float(index) for index in range(exchanges))),
        )

    def columns(self, conditions: Conditions, base: Base | None, shape: Mapping[str, float]) -> FloatArray:
        """Return by how much the exchange changes each rate, shape (n, c, 1)."""
        base = required_base(self, base)
        everywhere = shape["run"] == ALL_RUNS
        rows = np.ones(len(conditions), dtype=bool) if everywhere else conditions.run == shape["run"]
        exchange, change = int(shape["exchange"]), np.zeros_like(base.rates)
        pairs = _pairs(conditions) if everywhere else _collect_pairs(conditions, shape["run"])
        if exchange >= len(pairs):
            last = self.shapes_for(conditions)[1].grid[-1]
            if base.rates.shape[1] == 2 and exchange == last:
                change[rows] = base.rates[rows][:, ::-1] - base.rates[rows]
            return change[..., None]
        axes, w = conditions.sensor.channel_axes, np.nan_to_num(conditions.w_deg_per_hr)
        labels = conditions.position if everywhere else conditions.collect
        for label, other in (pairs[exchange], pairs[exchange][::-1]):
            here, there = rows & (labels == label), (labels == other) & (rows | everywhere)
            f = conditions.f_g[there].mean(axis=0) - conditions.f_g[here]
            change[here] = pickoff_rates(0.0, base.k[here], f, (w[there].mean(axis=0) - w[here])[:, axes])
        return change[..., None]


def _collect_pairs(conditions: Conditions, run: float) -> list[tuple[int, int]]:
    """Pairs of collects of one run that stand in different positions, by number."""
    rows = np.flatnonzero(conditions.run == run)
    return [
        (int(conditions.collect[i]), int(conditions.collect[j]))
        for i, j in itertools.combinations(rows.tolist(), 2)
        if conditions.position[i] != conditions.position[j]
    ]


def _pairs(conditions: Conditions) -> list[tuple[str, str]]:
    return list(itertools.combinations(sorted(str(label) for label in np.unique(conditions.position)), 2))
