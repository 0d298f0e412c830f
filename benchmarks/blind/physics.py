"""The hidden effects, from the catalogue's equations, with what a real one has and a fitted column has not.

Continuous time constants, a Preisach hysteresis, true non-linearities. Each function returns the contribution to
(RA, RB), shape (n, 2), at unit size; `cases.py` scales it.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from benchmarks.blind.night import Night


@dataclass
class Truth:
    """The base the night really has: six coefficients, each quadratic in temperature, evaluated per row (n,)."""

    ba: np.ndarray
    bb: np.ndarray
    gsa: np.ndarray
    gsb: np.ndarray
    mua: np.ndarray
    mub: np.ndarray
    slope: np.ndarray  # d(BA, BB)/dT, (n, 2)

    def rates(self, f: np.ndarray, w: np.ndarray) -> np.ndarray:
        """R = B + K·f + w."""
        ra = self.ba + self.gsa * f[:, 0] + self.gsb * f[:, 1] + self.mub * f[:, 2] + w[:, 0]
        rb = self.bb - self.gsb * f[:, 0] + self.gsa * f[:, 1] - self.mua * f[:, 2] + w[:, 1]
        return np.stack([ra, rb], 1)


def make_truth(night: Night, rng: np.random.Generator, *, thermal: bool, mu: float = 1.0) -> Truth:
    """Draw a unit. `thermal` lets the coefficients follow temperature; `mu` scales MU (0: the contractor was right)."""
    t = (night.rotor - 25.0) / 40.0
    bend = 1.0 if thermal else 0.0

    def curve(size: float, linear: float, square: float) -> tuple[np.ndarray, np.ndarray]:
        c0, c1, c2 = size * rng.normal(), bend * linear * rng.normal(), bend * square * rng.normal()
        return c0 + c1 * t + c2 * t**2, (c1 + 2.0 * c2 * t) / 40.0

    ba, dba = curve(20.0, 10.0, 5.0)
    bb, dbb = curve(20.0, 20.0, 8.0)
    gsa, gsb = curve(60.0, 8.0, 2.0)[0], curve(25.0, 4.0, 1.0)[0]
    mua, mub = mu * curve(10.0, 8.0, 6.0)[0], mu * curve(8.0, 6.0, 5.0)[0]
    return Truth(ba, bb, gsa, gsb, mua, mub, np.stack([dba, dbb], 1))


Hidden = Callable[[Night, Truth, np.random.Generator], np.ndarray]


def _axes(rng: np.random.Generator, column: np.ndarray) -> np.ndarray:
    """The same time history on both axes with an amplitude and sign of its own on each."""
    angle = rng.uniform(0.0, 2.0 * np.pi)
    return np.stack([np.cos(angle) * column, np.sin(angle) * column], 1)


def _bias_tdot(n: Night, _t: Truth, r: np.random.Generator) -> np.ndarray:
    return _axes(r, n.rotor_slope)


def _bias_grad(n: Night, _t: Truth, r: np.random.Generator) -> np.ndarray:
    return _axes(r, n.case - n.rotor)


def _hyst(n: Night, _t: Truth, r: np.random.Generator) -> np.ndarray:
    """A Preisach sum of relays over the temperature history, read at each collect."""
    centres, widths = np.linspace(-35.0, 70.0, 22), r.uniform(4.0, 14.0)
    up, down = centres + widths, centres - widths
    relay = np.full(len(centres), -1.0)
    out = np.empty(len(n))
    for i, temperature in enumerate(n.rotor):
        relay = np.where(temperature >= up, 1.0, np.where(temperature <= down, -1.0, relay))
        out[i] = relay.mean()
    single = np.tanh((n.rotor[:, None] - centres) / 3.0).mean(1)
    return _axes(r, out - single)


def _soak(n: Night, _t: Truth, r: np.random.Generator) -> np.ndarray:
    tau = r.uniform(1500.0, 4500.0)
    return _axes(r, (n.setpoint - n.previous_setpoint) * np.exp(-n.since_setpoint_s / tau))


def _warmup(n: Night, _t: Truth, r: np.random.Generator) -> np.ndarray:
    tau = r.uniform(1800.0, 9000.0)
    return _axes(r, np.exp(-n.since_power_s / tau))


def _mu(n: Night, _t: Truth, r: np.random.Generator) -> np.ndarray:
    mua, mub = r.normal(size=2)
    return np.stack([mub * n.f[:, 2], -mua * n.f[:, 2]], 1)


def _k2(n: Night, _t: Truth, r: np.random.Generator) -> np.ndarray:
    return _axes(r, n.f[:, 2] ** 2 - n.f[:, 0] ** 2)


def _phase(n: Night, t: Truth, r: np.random.Generator) -> np.ndarray:
    psi = r.choice([-1.0, 1.0]) * (1.0 + r.normal() * (n.rotor - 25.0) / 60.0)
    rates = t.rates(n.f, n.w)
    return np.stack([-psi * rates[:, 1], psi * rates[:, 0]], 1)


def _scale(n: Night, t: Truth, r: np.random.Generator) -> np.ndarray:
    return r.choice([-1.0, 1.0]) * t.rates(n.f, n.w) * (1.0 + 0.02 * (n.rotor - 25.0))[:, None]


def _index(n: Night, t: Truth, r: np.random.Generator) -> np.ndarray:
    """Each position has its own error of the index angle; the true rotation is used, not its derivative."""
    delta = dict(zip(np.unique(n.position), r.normal(0.0, 1e-3, 9), strict=False))
    turn = np.array([delta[p] for p in n.position])
    s, c = np.sin(turn), np.cos(turn)

    def swing(v: np.ndarray) -> np.ndarray:
        return np.stack([v[:, 0] * c + v[:, 2] * s, v[:, 1], v[:, 2] * c - v[:, 0] * s], 1)

    return t.rates(swing(n.f), swing(n.w)) - t.rates(n.f, n.w)


def _earth(n: Night, _t: Truth, r: np.random.Generator) -> np.ndarray:
    """The heading in the file is wrong: the horizontal earth rate is turned."""
    horizontal = 15.041067 * np.cos(np.deg2rad(n.design.latitude_deg))
    h, dh = np.deg2rad(n.heading), r.choice([-1.0, 1.0]) * 0.05
    d2 = horizontal * (np.cos(h + dh) - np.cos(h))
    d3 = horizontal * (np.sin(h + dh) - np.sin(h))
    return np.stack([d3 * np.cos(n.theta), d2], 1)


def _drift(n: Night, _t: Truth, r: np.random.Generator) -> np.ndarray:
    return _axes(r, n.order - n.order.mean())


def _jump(n: Night, _t: Truth, r: np.random.Generator) -> np.ndarray:
    last = n.run.max()
    at = r.integers(max(2, last // 4), max(3, 3 * last // 4))
    return _axes(r, (n.run >= at).astype(float))


def _jump_anywhere(n: Night, _t: Truth, r: np.random.Generator) -> np.ndarray:
    """From any collect on, the second to the last."""
    return _axes(r, (np.arange(len(n)) >= r.integers(1, len(n))).astype(float))


def _jump_within(n: Night, _t: Truth, r: np.random.Generator) -> np.ndarray:
    """From a collect on that is not the first of its run."""
    return _axes(r, (np.arange(len(n)) >= r.choice(np.flatnonzero(np.diff(n.run) == 0)) + 1).astype(float))


def _supply(n: Night, _t: Truth, r: np.random.Generator) -> np.ndarray:
    return _axes(r, n.supply - 28.0)


def _settle(n: Night, _t: Truth, r: np.random.Generator) -> np.ndarray:
    """The index move's disturbance, larger after a larger slew, dies away; the collect averages its tail."""
    tau = r.uniform(10.0, 40.0)
    tail = np.exp(-30.0 / tau) * tau / n.design.collect_s * (1.0 - np.exp(-n.design.collect_s / tau))
    return _axes(r, n.slew * tail)


def _spin(n: Night, t: Truth, r: np.random.Generator) -> np.ndarray:
    """Another rotor speed changes the gain and the phase of the signal, by its own period."""
    error = (np.median(n.spin_us) / n.spin_us - 1.0)[:, None]
    rates = t.rates(n.f, n.w)
    gain, turn = r.uniform(0.5, 3.0), r.choice([-1.0, 1.0]) * r.uniform(0.5, 5.0)
    return error * (gain * rates + turn * np.stack([-rates[:, 1], rates[:, 0]], 1))


def _vre(n: Night, _t: Truth, r: np.random.Generator) -> np.ndarray:
    return _axes(r, n.vibration**2)


def _misalign(n: Night, _t: Truth, r: np.random.Generator) -> np.ndarray:
    """Input axes that lean: each channel sees earth rate about the two others."""
    m = r.normal(size=(2, 2))
    return np.stack([m[0, 0] * n.w[:, 1] + m[0, 1] * n.w[:, 2], m[1, 0] * n.w[:, 0] + m[1, 1] * n.w[:, 2]], 1)


def _mag(n: Night, _t: Truth, r: np.random.Generator) -> np.ndarray:
    """The earth's field, dip 62 deg, in the sensor's axes; each channel has its own three sensitivities."""
    h = np.deg2rad(n.heading)
    field = np.stack([np.full(len(n), -0.45), 0.24 * np.cos(h), 0.24 * np.sin(h)], 1)
    s, c = np.sin(n.theta), np.cos(n.theta)
    seen = np.stack([field[:, 0] * s + field[:, 2] * c, field[:, 1], field[:, 0] * c - field[:, 2] * s], 1)
    return seen @ r.normal(size=(3, 2))


def _bias_t(n: Night, _t: Truth, r: np.random.Generator) -> np.ndarray:
    t = (n.rotor - 25.0) / 40.0
    return _axes(r, t + 0.4 * r.normal() * t**2)


def _gs_t(n: Night, t: Truth, r: np.random.Generator) -> np.ndarray:
    """GS changes gain and turns with temperature: the exponential, not its first term."""
    warm = n.rotor - 25.0
    turn, gain = r.normal(0.0, 2e-4) * warm, 1.0 + r.normal(0.0, 2e-3) * warm
    gsa = gain * (t.gsa * np.cos(turn) + t.gsb * np.sin(turn)) - t.gsa
    gsb = gain * (t.gsb * np.cos(turn) - t.gsa * np.sin(turn)) - t.gsb
    return np.stack([gsa * n.f[:, 0] + gsb * n.f[:, 1], gsa * n.f[:, 1] - gsb * n.f[:, 0]], 1)


def _demod(n: Night, _t: Truth, r: np.random.Generator) -> np.ndarray:
    """Quadrature leaks through a phase that follows the electronics (the case)."""
    return _axes(r, np.sin(1e-4 * (n.case - 25.0)))


def _frame(n: Night, _t: Truth, r: np.random.Generator) -> np.ndarray:
    """One bench component of the earth rate has the wrong sign in the file: the unit shows its opposite."""
    horizontal = 15.041067 * np.cos(np.deg2rad(n.design.latitude_deg))
    h = np.deg2rad(n.heading)
    if r.random() < 0.5:
        return np.stack([np.zeros(len(n)), -2.0 * horizontal * np.cos(h)], 1)
    return np.stack([-2.0 * horizontal * np.sin(h) * np.cos(n.theta), np.zeros(len(n))], 1)


def _lag(n: Night, t: Truth, _r: np.random.Generator) -> np.ndarray:
    """The thermometer is late: the bias follows a temperature that the file does not have."""
    return -t.slope * n.rotor_slope[:, None]


def _ageing(n: Night, _t: Truth, r: np.random.Generator) -> np.ndarray:
    return _axes(r, n.start_s / n.start_s.max() - 0.5)


CATALOGUE: dict[str, Hidden] = {
    "bias_Tdot": _bias_tdot,
    "bias_grad": _bias_grad,
    "hyst": _hyst,
    "soak_insufficient": _soak,
    "warmup": _warmup,
    "MU_real": _mu,
    "k2": _k2,
    "phase": _phase,
    "scale": _scale,
    "index": _index,
    "earth": _earth,
    "drift": _drift,
    "jump": _jump,
    "supply": _supply,
    "T_lag": _lag,
    "settle": _settle,
    "spin": _spin,
    "vre": _vre,
    "misalign": _misalign,
    "mag": _mag,
    "bias_T": _bias_t,
    "GS_T": _gs_t,
    "demod": _demod,
    "ageing": _ageing,
    "frame": _frame,
}
"""Effects of the catalogue that leave a trace in averages."""


def _mua_supply(n: Night, _t: Truth, r: np.random.Generator) -> np.ndarray:
    return _axes(r, n.f[:, 2] * (n.supply - 28.0))


def _gs_rate(n: Night, _t: Truth, r: np.random.Generator) -> np.ndarray:
    a, b = r.normal(size=2)
    x = n.rotor_slope / np.abs(n.rotor_slope).max()
    return np.stack([a * n.f[:, 0] * x, -b * n.f[:, 0] * x], 1)


def _one_position(n: Night, _t: Truth, r: np.random.Generator) -> np.ndarray:
    return _axes(r, ((n.position == r.choice(np.unique(n.position))) & (n.rotor < 10.0)).astype(float))


def _mu_step(n: Night, _t: Truth, r: np.random.Generator) -> np.ndarray:
    return _axes(r, n.f[:, 2] * (n.rotor > r.uniform(0.0, 45.0)))


def _gs_ripple(n: Night, _t: Truth, r: np.random.Generator) -> np.ndarray:
    return _axes(r, n.f[:, 0] * np.sin(2.0 * np.pi * n.rotor / 23.0 + r.uniform(0.0, 6.0)))


VARIANTS: dict[str, Hidden] = {"jump@any collect": _jump_anywhere, "jump@within a run": _jump_within}
"""Effects of the catalogue in a form of their own; the name that is right stands before the @."""


OUTSIDE: dict[str, Hidden] = {
    "MU × supply": _mua_supply,
    "GS × dT/dt": _gs_rate,
    "one position, cold": _one_position,
    "MU step in temperature": _mu_step,
    "GS ripple in temperature": _gs_ripple,
}
"""Effects that no catalogue entry describes."""
