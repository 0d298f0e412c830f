"""The one equation: R = B + K·f + w, in sensor axes.

A collect is an orientation: it turns the known acceleration G = (G1, G2, G3) and earth rate W = (W1, W2, W3) of the
bench frame into the components f and w along the sensor's axes (A, B, S). Everything else is data. At the report's
three orientations of sensor 2 the equation *is* equations (1)–(6) of RD-GC-86-1, as `tests/hil/model/test_equation.py`
proves term by term.

    [RA]   [BA]   [ GSA  GSB  MUB ]       [wA]
    [RB] = [BB] + [-GSB  GSA -MUA ] · f + [wB]        f = (fA, fB, fS)

    >>> position = Orientation.from_signed_axes("1", "-1", "+2", "+3")
    >>> f_g = position.components([1.0, 0.0, 0.0])
    >>> f_g
    array([-1.,  0.,  0.])
    >>> k = rotor_matrix(gsa=2.0, gsb=0.5, mua=3.0, mub=-7.5)
    >>> pickoff_rates([22.0, -4.0], k, f_g, [-8.5, 10.7])  # RA, RB in deg/hr
    array([11.5,  7.2])

Source: RD-GC-86-1 eqs. (1)–(6). The matrix printed there has two misprints in row 6 (RA for RB, MU_SA2 for GSB_2); the
corrected rows are followed here.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from hil.campaign import FloatArray


@dataclass(frozen=True, eq=False)
class Orientation:
    """One collect position: the sensor's axes in the bench frame 1-2-3, one row per sensor axis, shape (3, 3).

    Rows are orthonormal; the determinant is the handedness of the sensor's triad as used (+1 right, -1 left where the
    bench frame is right-handed). The report's (A, B, S) triad is left-handed in all three collects. Raises `ValueError`
    where the rows are not orthonormal.
    """

    label: str
    axes: FloatArray

    def __post_init__(self) -> None:
        axes = np.asarray(self.axes, dtype=np.float64)
        if axes.shape != (3, 3) or not np.allclose(axes @ axes.T, np.eye(3), atol=1e-9):
            raise ValueError(f"orientation {self.label}: the axes must be three orthonormal rows of three")
        object.__setattr__(self, "axes", axes)

    @classmethod
    def from_signed_axes(cls, label: str, *directions: str) -> Orientation:
        """Build from words: `from_signed_axes("1", "-1", "+2", "+3")` has A along -axis 1, B along +2, S along +3.

        Raises `ValueError` for another word.
        """
        rows = []
        for direction in directions:
            sign, axis = direction[:1], direction[1:]
            if sign not in "+-" or axis not in {"1", "2", "3"}:
                raise ValueError(f"orientation {label}: {direction!r} is not a sign and a bench axis, such as +2")
            rows.append((1.0 if sign == "+" else -1.0) * np.eye(3)[int(axis) - 1])
        return cls(label, np.array(rows))

    @classmethod
    def from_rotation_about_2(cls, label: str, theta_deg: float) -> Orientation:
        """Build the report's left-handed (A, B, S) triad turned by `theta_deg` about bench axis 2.

        -90, +90 and 0 degrees are Collects 1, 2 and 3; 180 degrees, spin axis down, is the fourth collect that gives
        the first residual. f_A = G1 sin θ + G3 cos θ, f_B = G2, f_S = G1 cos θ - G3 sin θ.
        """
        theta = np.deg2rad(theta_deg)
        sine, cosine = np.sin(theta), np.cos(theta)
        return cls(label, np.array([[sine, 0.0, cosine], [0.0, 1.0, 0.0], [cosine, 0.0, -sine]]))

    def components(self, bench_vector: ArrayLike) -> FloatArray:
        """Turn (…, 3) bench-frame components into (…, 3) components along the sensor's axes."""
        return np.asarray(np.asarray(bench_vector, dtype=np.float64) @ self.axes.T)


RD_GC_86_1_SENSOR_2: Mapping[str, Orientation] = {
    "1": Orientation.from_signed_axes("1", "-1", "+2", "+3"),
    "2": Orientation.from_signed_axes("2", "+1", "+2", "-3"),
    "3": Orientation.from_signed_axes("3", "+3", "+2", "+1"),
}
"""Figure 1 of the report, for gyro 2 (gyro 1's orientations are nowhere given; they are configuration)."""


def rotor_matrix(gsa: ArrayLike, gsb: ArrayLike, mua: ArrayLike, mub: ArrayLike) -> FloatArray:
    """Return K, shape (…, 2, 3), of a two-channel rotor sensor from its four terms in deg/hr/g, shape (…)."""
    gsa, gsb, mua, mub = np.broadcast_arrays(gsa, gsb, mua, mub)
    return np.stack([np.stack([gsa, gsb, mub], -1), np.stack([-gsb, gsa, -mua], -1)], -2).astype(np.float64)


def pickoff_rates(bias: ArrayLike, k: ArrayLike, f_g: ArrayLike, w_channels: ArrayLike) -> FloatArray:
    """Evaluate R = B + K·f + w: the only place where rates are put together, for the model, the twin and every design.

    `bias` (…, c) deg/hr, `k` (…, c, 3) deg/hr/g, `f_g` (…, 3) g, `w_channels` (…, c) deg/hr: the earth rate about each
    channel's own axis. Returns (…, c) deg/hr; leading dimensions broadcast. It is linear in bias and K together, and in
    f and w: changes of either give the change of the rates, slopes of B and K the slope.

    K·f is written out, so that a row's result never depends on how many rows are asked for together, nor on how the
    arrays lie in memory.
    """
    k, f_g = np.asarray(k, dtype=np.float64), np.asarray(f_g, dtype=np.float64)[..., None, :]
    pulled = k[..., 0] * f_g[..., 0] + k[..., 2] * f_g[..., 2] + k[..., 1] * f_g[..., 1]
    return np.asarray(np.asarray(bias, dtype=np.float64) + pulled + np.asarray(w_channels, dtype=np.float64))
