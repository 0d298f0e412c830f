"""Mistakes in the data: signs and frames of the earth rate, labels that were exchanged, signs that were turned."""

import itertools
from collections.abc import Hashable, Mapping

import numpy as np

from hil.campaign import Conditions, FloatArray
from hil.model.effects.base import OUTSIDE, Base, Effect, Parameter, ShapeParameter, required_base
from hil.model.effects.geometry import local_frame

OTHER_SENSOR, OF_A_RUN = -1, -2
"""Exchanges of whole runs: with another sensor, which the sensor's own collects do not know, and from here down those
of `of_a_run`."""


def of_a_run(channels: int) -> list[tuple[str, tuple[int, ...]]]:
    """Return what may be wrong with so many channels through a run: two in each other's place, all signs, or one."""
    pairs = [("channels", pair) for pair in itertools.combinations(range(channels), 2)]
    every = [("all turned", tuple(range(channels)))] * (channels > 1)
    return [*pairs, *every, *(("turned", (c,)) for c in range(channels))]


def put_right(rates: FloatArray, what: str, channels: tuple[int, ...]) -> FloatArray:
    """Return the rates (…, k, c) of runs without that."""
    out = rates.copy()
    out[..., channels] = rates[..., channels[::-1]] if what == "channels" else -rates[..., channels]
    return out


class EarthRateFrame(Effect):
    """A component of the earth rate was used with the wrong sign: the data then differs by twice that component."""

    id = "frame"
    follows = "heading"
    title = "Earth-rate sign or frame defect"
    equation = "R -= 2 w_used of the component whose sign is wrong"
    parameters = tuple(Parameter(f"wrong_{part}", "1", (1.0, 1.0)) for part in ("vertical", "level_2", "level_3"))
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
    """Two collects, or channels, of one run were exchanged in the record, or signs were turned."""

    id = "swap"
    follows = "run"
    title = "Mislabelled collect or axis"
    equation = "R(p) becomes R(q) and R(q) becomes R(p) in one run; or RA and RB change places, or R becomes -R"
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
        """Return the run and which exchange: from 0 on of pairs of collects, below of whole runs."""
        runs, channels = np.unique(conditions.run).tolist(), len(conditions.sensor.channels)
        pairs = max((len(_pairs(conditions, run)) for run in runs), default=0)
        whole = (OF_A_RUN - k for k in range(len(of_a_run(channels))))
        return (
            ShapeParameter("run", "", tuple(float(run) for run in runs)),
            ShapeParameter("exchange", "", tuple(float(exchange) for exchange in (*range(pairs), *whole))),
        )

    def columns(self, conditions: Conditions, base: Base | None, shape: Mapping[str, float]) -> FloatArray:
        rates = required_base(self, base).rates
        return (self.exchanged(conditions, rates, shape) - rates)[..., None]

    def happens(self, conditions: Conditions, shape: Mapping[str, float]) -> Hashable | None:
        """Return which exchange it is, in whatever run; another sensor's rates tell of every run."""
        return None if shape["exchange"] == OTHER_SENSOR else shape["exchange"]

    def exchanged(self, conditions: Conditions, rates: FloatArray, shape: Mapping[str, float]) -> FloatArray:
        """Return rates (n, c) in the places, and with the signs, that the exchange gives them."""
        out, exchange, rows = rates.copy(), int(shape["exchange"]), conditions.run == shape["run"]
        if exchange >= 0:
            for pair in _pairs(conditions, shape["run"])[exchange : exchange + 1]:
                out[pair] = rates[pair[::-1]]
        elif exchange <= OF_A_RUN:
            out[rows] = put_right(rates[rows], *of_a_run(rates.shape[1])[OF_A_RUN - exchange])
        return out


def _pairs(conditions: Conditions, run: float) -> list[list[int]]:
    """Pairs of rows of one run that stand in different positions."""
    rows = np.flatnonzero(conditions.run == run).tolist()
    return [[i, j] for i, j in itertools.combinations(rows, 2) if conditions.position[i] != conditions.position[j]]
