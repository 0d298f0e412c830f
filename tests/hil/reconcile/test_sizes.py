"""How large an effect may be: the whole range of a gyro of unknown technology, and sizes in one axis alone."""

from __future__ import annotations

import numpy as np

from hil.campaign import Campaign, Collects, Conditions
from hil.model.effects.base import Parameter
from hil.reconcile import reconcile
from tests.hil.reconcile.hidden_effects import TRIAD

SIX = np.array([[1, 0, 0], [-1, 0, 0], [0, 1, 0], [0, -1, 0], [0, 0, 1], [0, 0, -1]], dtype=np.float64)


def of_one_axis(slope: float) -> Campaign:
    """Return two runs of six positions at each of three temperatures, of a triad one of whose biases follows these."""
    rng, n = np.random.default_rng(2), 36
    run = np.repeat(np.arange(1, 7), 6)
    temperature = np.array([0.0, 25.0, 50.0])[(run - 1) // 2]
    f = np.tile(SIX, (6, 1))
    rates = 30.0 + 5.0 * f + rng.normal(0.0, 1.0, (n, 3))
    rates[:, 0] += slope * (temperature - 25.0)
    positions = np.tile([f"{axis}-{way}" for axis in "xyz" for way in ("up", "down")], 6)
    columns = {"temperature_degC": temperature, "setpoint_degC": temperature}
    times = 3600.0 * run + 240.0 * np.tile(np.arange(6.0), 6)
    known = Conditions(TRIAD, np.arange(1, n + 1), run, positions, times, np.full(n, 120.0), f, 0.0 * f, columns)
    return Campaign("made", "", {1: Collects(known, rates, np.full(rates.shape, 1.0))}, simulated=True)


def test_a_typical_range_ends_where_it_says() -> None:
    """The bottom of one that spans the technologies was taken for a hundredth of its top."""
    assert Parameter("b1", "deg/hr/degC", (0.005, 30.0)).bounds == (0.005, 30.0)
    assert Parameter("k", "deg/hr/g^2", (0.0, 1.0)).bounds == (0.01, 1.0)


def test_a_bias_of_one_axis_that_follows_temperature_is_no_offset_of_runs() -> None:
    """Axes that do not follow it paid more than the one that does brought in: it was called an offset of each run."""
    found = {each.id: each.probability for each in reconcile(of_one_axis(0.4), "triad-12", prove=False).effects}
    assert found.get("bias_T", 0.0) > 0.5
    assert reconcile(of_one_axis(0.0), "triad-12", prove=False).verdict == "none"
