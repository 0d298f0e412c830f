"""Directions from a collect's f and w: up, north and east along the sensor's axes, and turns about its index axis."""

from dataclasses import dataclass

import numpy as np

from hil.campaign import Conditions, FloatArray

LEVEL = 0.05
"""Of 1 g, along an axis that is called horizontal: three degrees."""


@dataclass(frozen=True)
class LocalFrame:
    """Unit vectors along the sensor's axes, each (n, 3). North and east are zero where the earth rate is not known.

    East is up × north in the sensor's own axes: its sign is mirrored for a left-handed triad, the same in every row.
    """

    up: FloatArray
    north: FloatArray
    east: FloatArray


def local_frame(conditions: Conditions) -> LocalFrame:
    """Return up from f, north from the horizontal part of w (zero, or parallel to f at a pole, gives no north)."""
    up = conditions.f_g / np.linalg.norm(conditions.f_g, axis=1, keepdims=True)
    w = np.nan_to_num(conditions.w_deg_per_hr)
    horizontal = w - np.sum(w * up, axis=1, keepdims=True) * up
    length = np.linalg.norm(horizontal, axis=1, keepdims=True)
    north = np.divide(horizontal, length, out=np.zeros_like(horizontal), where=length > 1e-6)
    return LocalFrame(up, north, np.cross(up, north))


def frame_of_one_axis(conditions: Conditions) -> LocalFrame:
    """Return the frame, its north where no earth rate tells it from the one axis that the unit was turned about.

    That stays horizontal, and points where it did: north is then a right angle from it, wherever that is.
    """
    frame = local_frame(conditions)
    _, size, axes = np.linalg.svd(frame.up, full_matrices=False)
    if np.any(frame.north) or len(size) < 3 or size[2] > LEVEL * np.sqrt(len(conditions)) or size[1] < size[0] * LEVEL:
        return frame
    north = np.cross(axes[2], frame.up)
    north /= np.linalg.norm(north, axis=1, keepdims=True)
    return LocalFrame(frame.up, north, np.cross(frame.up, north))


def turned_about_index_axis(vectors: FloatArray) -> FloatArray:
    """Return the change of (n, 3) components per radian that the index angle θ grows: (vS, 0, −vA) along (A, B, S).

    From fA = G1 sin θ + G3 cos θ, fS = G1 cos θ − G3 sin θ.
    """
    return np.stack([vectors[:, 2], np.zeros(len(vectors)), -vectors[:, 0]], -1)
