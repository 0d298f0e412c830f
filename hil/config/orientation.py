"""Orientations as a bench file writes them: signed bench axes, a rotation from another position, or a matrix."""

from collections.abc import Mapping
from typing import Any

import numpy as np

from hil.campaign import FloatArray
from hil.files.units import ANGLE, to_number
from hil.model.equation import Orientation

_FORMS = "{A: -1, B: +2, S: +3}, {from: '3', rotate: -90 deg, about: 2} or {matrix: [[…], […], […]]}"


def build_orientations(given: Mapping[str, Any], axes: tuple[str, str, str]) -> dict[str, Orientation]:
    """Return the orientation at each position; raise `ValueError` naming the position that cannot be understood."""
    built: dict[str, Orientation] = {}
    for label, entry in given.items():
        if not (isinstance(entry, Mapping) and "from" in entry):
            built[label] = _absolute(label, entry, axes)
    for label, entry in given.items():
        if label not in built:
            built[label] = _rotated(label, entry, built)
    return {label: built[label] for label in given}


def _absolute(label: str, entry: object, axes: tuple[str, str, str]) -> Orientation:
    if isinstance(entry, Mapping) and set(entry) == {"matrix"}:
        return Orientation(label, _orthonormal(label, entry["matrix"]))
    if not isinstance(entry, Mapping) or set(entry) != set(axes):
        raise ValueError(f"orientations.{label}: {entry!r} is not an orientation; write it like {_FORMS}")
    directions = []
    for axis in axes:
        text = str(entry[axis]).strip()
        directions.append(text if text[:1] in {"+", "-"} else f"+{text}")
        if directions[-1][1:] not in {"1", "2", "3"} or isinstance(entry[axis], float | bool):
            raise ValueError(
                f"orientations.{label}.{axis}: {entry[axis]!r} is not a signed bench axis, such as -1 or +3"
            )
    try:
        return Orientation.from_signed_axes(label, *directions)
    except ValueError as error:
        raise ValueError(f"orientations.{label}: {', '.join(directions)} must be three different bench axes") from error


def _orthonormal(label: str, matrix: object) -> FloatArray:
    """Accept rows that are orthonormal as far as people write digits, and make them so to the last one."""
    try:
        rows = np.array(matrix, dtype=np.float64)
    except (TypeError, ValueError):
        rows = np.empty(0)
    if rows.shape != (3, 3) or not np.allclose(rows @ rows.T, np.eye(3), atol=2e-3):
        raise ValueError(f"orientations.{label}.matrix: three rows of three numbers, orthonormal, are needed")
    left, _, right = np.linalg.svd(rows)
    return np.asarray(left @ right)


def _rotated(label: str, entry: Mapping[str, Any], known: Mapping[str, Orientation]) -> Orientation:
    if set(entry) != {"from", "rotate", "about"}:
        raise ValueError(f"orientations.{label}: a rotation needs from, rotate and about, such as {_FORMS}")
    start = known.get(str(entry["from"]))
    if start is None:
        raise ValueError(
            f"orientations.{label}.from: {entry['from']!r} is not a position that is given by axes or a matrix"
        )
    if str(entry["about"]) not in {"1", "2", "3"}:
        raise ValueError(f"orientations.{label}.about: {entry['about']!r} is not a bench axis; allowed: 1, 2, 3")
    try:
        angle_deg = to_number(entry["rotate"], ANGLE)
    except ValueError as error:
        raise ValueError(f"orientations.{label}.rotate: {error}") from error
    axis = np.eye(3)[int(str(entry["about"])) - 1]
    from scipy.spatial.transform import Rotation  # imported late: it is slow, and few benches need it

    turn = Rotation.from_rotvec(np.deg2rad(angle_deg) * axis).as_matrix()
    return Orientation(label, start.axes @ turn.T)
