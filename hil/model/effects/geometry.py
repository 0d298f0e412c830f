"""Directions from a collect's f and w: up, north and east along the sensor's axes, and turns about its index axis."""

from dataclasses import dataclass

import numpy as np

from hil.campaign import Conditions, FloatArray, IntArray, TextArray

LEVEL = 0.05
"""Of 1 g, along an axis that is called horizontal: three degrees."""
LEVEL_DEG_PER_HR = 0.1
"""A horizontal part of the earth rate that is less counts as none: w is the vertical part, or nothing."""


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
    up, w = unit_vectors(conditions.f_g), np.nan_to_num(conditions.w_deg_per_hr)
    north = unit_vectors(w - np.sum(w * up, axis=1, keepdims=True) * up, LEVEL_DEG_PER_HR)
    return LocalFrame(up, north, np.cross(up, north))


def frame_by_heading(conditions: Conditions) -> tuple[LocalFrame, TextArray]:
    """Return the frame, and by row (n,) the position that has a heading of its own; empty where it is of no position.

    Where no earth rate tells north, an axis that a unit was turned about stays level, and points where it did: north is
    then a right angle from it, wherever that is. A unit that was turned over in several ways had some heading in each
    place, and "north" is a level direction there, the same in every row of it, whatever its position is called. It is
    zero where a place was measured once, of which a heading would explain everything.
    """
    frame, one = local_frame(conditions), np.full(len(conditions), "")
    if np.any(frame.north):
        return frame, one
    _, size, axes = np.linalg.svd(frame.up, full_matrices=False)
    if len(size) > 2 and size[2] < LEVEL * np.sqrt(len(conditions)) and size[1] > size[0] * LEVEL:
        north, headings = np.cross(axes[2], frame.up), one
    else:
        at = _places(frame.up)
        first, often = np.unique(at, return_index=True, return_counts=True)[1:]
        leaning = np.array([np.abs(frame.up[at == k]).sum(axis=0) for k in range(len(often))]).reshape(-1, 3)
        again = often[at] > 1
        north = np.cross(np.eye(3)[np.argmin(leaning, axis=1)][at], frame.up) * again[:, None]
        headings = np.where(again, conditions.position[first][at], "")
    north = unit_vectors(north)
    return LocalFrame(frame.up, north, np.cross(frame.up, north)), headings


def _places(up: FloatArray) -> IntArray:
    """Number (n,) the places in which a unit lay, by where up was, (n, 3): a log calls each stretch another pose."""
    at = np.full(len(up), -1)
    while np.any(new := at < 0):
        near = np.linalg.norm(up - up[np.argmax(new)], axis=1) <= LEVEL
        at[new & near] = at.max() + 1
    return at


def unit_vectors(vectors: FloatArray, least: float = 1e-9) -> FloatArray:
    """Return vectors (n, 3) of length one, zero where they are no longer than `least`."""
    length = np.linalg.norm(vectors, axis=1, keepdims=True)
    return np.asarray(np.divide(vectors, length, out=np.zeros_like(vectors), where=length > least))


def turned_about_index_axis(vectors: FloatArray) -> FloatArray:
    """Return the change of (n, 3) components per radian that the index angle θ grows: (vS, 0, −vA) along (A, B, S).

    From fA = G1 sin θ + G3 cos θ, fS = G1 cos θ − G3 sin θ.
    """
    return np.stack([vectors[:, 2], np.zeros(len(vectors)), -vectors[:, 0]], -1)
