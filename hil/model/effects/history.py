"""What a row's past does to it: joined rows, averaged decays, the play operator, setpoint steps, order in a run."""

from dataclasses import replace
from typing import Any

import numpy as np

from hil.campaign import Conditions, FloatArray
from hil.campaign.data import known_mean
from hil.model.effects.columns import column


def joined(earlier: Conditions, later: Conditions) -> Conditions:
    """Return the rows of `earlier` followed by those of `later`; a column that only one has is NaN in the other."""
    names = [*earlier.columns, *(name for name in later.columns if name not in earlier.columns)]

    def both(name: str) -> FloatArray:
        return np.concatenate([each.columns.get(name, np.full(len(each), np.nan)) for each in (earlier, later)])

    known = {name: each for name, each in vars(earlier).items() if isinstance(each, np.ndarray)}
    rows: dict[str, Any] = {name: np.concatenate([each, getattr(later, name)]) for name, each in known.items()}
    return replace(later, **rows, columns={name: both(name) for name in names})


def averaged_decay(since_s: FloatArray, duration_s: FloatArray, tau_s: float) -> FloatArray:
    """Mean of exp(-t/τ) for t from `since_s` to `since_s + duration_s`, shape (n,); zero where `since_s` is NaN.

    With duration 0 it is the value at that instant. Before the event (negative time) nothing has decayed: it is zero.
    """
    known = np.isfinite(since_s) & (since_s >= 0.0)
    start = np.where(known, since_s, 0.0)
    ratio = duration_s / tau_s
    within = np.where(ratio > 1e-9, -np.expm1(-ratio) / np.maximum(ratio, 1e-9), 1.0)
    return np.where(known, np.exp(-start / tau_s) * within, 0.0)


def play(values: FloatArray, half_width: float) -> FloatArray:
    """Play (backlash) operator over a history, starting relaxed: the output moves only when pushed by the edge.

    |values − play|, (n,), never exceeds `half_width`; the result does not depend on how fast the history was gone
    through.

    >>> play(np.array([0.0, 1.0, 3.0, 2.0, -1.0]), half_width=1.0)
    array([0., 0., 2., 2., 0.])
    """
    output = []
    held = float(values[0]) if len(values) else 0.0
    for value in values.tolist():  # plain floats: each step depends on the one before
        held = min(max(held, value - half_width), value + half_width)
        output.append(held)
    return np.array(output)


def loop_side(temperature: FloatArray, start_s: FloatArray, half_width: float, from_degC: float = np.nan) -> FloatArray:
    """Where on a hysteresis loop each row is: +1 on the heating branch, −1 on the cooling branch, shape (n,).

    (T − play(T)) / half-width over the rows in time order; rows without a temperature get 0. `from_degC` is where it
    was relaxed before them: at the first, where that is not known (NaN).
    """
    side = np.zeros(len(temperature))
    order = np.argsort(start_s, kind="stable")
    order = order[np.isfinite(temperature[order])]
    history = temperature[order]
    if half_width > 0.0 and len(history):
        before = from_degC if np.isfinite(from_degC) else history[0]
        side[order] = (history - play(np.append(before, history), half_width)[1:]) / half_width
    return side


def setpoint_step(conditions: Conditions, from_degC: float = np.nan) -> FloatArray:
    """Return by how much the setpoint was last changed before each row, °C, shape (n,); 0 before the first change.

    `from_degC` is where the unit stood before the first row; NaN, where that is not known: then it stood there.

    Without a `setpoint_degC` column the plateaus are the runs: the change of mean temperature from one to the next,
    where it is more than 1 °C.
    """
    order = np.argsort(conditions.start_s, kind="stable")
    levels, least = column(conditions, "setpoint_degC"), 0.0
    if "setpoint_degC" not in conditions.columns:
        temperature, least = column(conditions, "temperature_degC"), 1.0
        for rows in conditions.of_each_run.values():
            levels[rows] = known_mean(temperature[rows])
    levels = levels[order]
    steps = np.zeros(len(levels))
    known = np.flatnonzero(np.isfinite(levels))
    level = from_degC if np.isfinite(from_degC) or not len(known) else levels[known[0]]
    # Only where the level differs from the row before can there be a step: a night has few of those rows.
    for index in known[np.diff(levels[known], prepend=level) != 0.0]:
        if abs(levels[index] - level) > least:
            steps[index:] = levels[index] - level
            level = levels[index]
    result = np.zeros(len(levels))
    result[order] = steps
    return result


def collect_interval_s(conditions: Conditions) -> float:
    """Return the usual time from one collect to the next within a run, s; NaN where no run has two collects."""
    starts = (np.unique(conditions.start_s[rows]) for rows in conditions.of_each_run.values())
    spacings = [each for own in starts for each in np.diff(own).tolist()]
    return float(np.median(spacings)) if spacings else float("nan")


def place_in_run(conditions: Conditions, interval_s: float) -> FloatArray:
    """Return how many collect intervals after its run's first collect each row was taken: 0, 1, 2; shape (n,).

    Counted by time, so that a missing collect does not move the others, in whole collects: rows of the same collect
    (samples) have its place. Where the first is missing, the others stand where their positions stand in the runs that
    miss none.
    """
    place = np.zeros(len(conditions))
    _, of_row = np.unique(conditions.collect, return_inverse=True)
    begins_s = np.full(of_row.max(initial=-1) + 1, np.inf)
    np.minimum.at(begins_s, of_row, conditions.start_s)
    begins_s = begins_s[of_row]
    runs = conditions.of_each_run.values()
    for rows in runs:
        place[rows] = np.round((begins_s[rows] - begins_s[rows].min()) / interval_s)
    most, labels = max(map(len, runs), default=0), conditions.position
    whole = np.concatenate([rows for rows in runs if len(rows) == most]) if runs else np.empty(0, dtype=np.int64)
    usual = set(zip(labels[whole].tolist(), place[whole].tolist(), strict=True))
    for rows in runs:
        if len(rows) < most and usual:
            # A run that has only begun stands where it is: as many of its positions are right without any shift.
            shifts = range(int(max(at for _, at in usual)) + 1)
            here = list(zip(labels[rows].tolist(), place[rows].tolist(), strict=True))
            place[rows] += int(np.argmax([sum((label, at + s) in usual for label, at in here) for s in shifts]))
    return place


def slew_since_previous(conditions: Conditions) -> FloatArray:
    """Return how far each collect's orientation is from the one before it, in units of 90 deg, shape (n,).

    The first collect's predecessor is unknown: it gets the mean of the others (1 where there are none).
    """
    order = np.argsort(conditions.start_s, kind="stable")
    f = conditions.f_g[order]
    f = f / np.linalg.norm(f, axis=1, keepdims=True)
    turned = np.arccos(np.clip(np.sum(f[1:] * f[:-1], axis=1), -1.0, 1.0)) / (0.5 * np.pi)
    changed = np.asarray(conditions.position[order][1:] != conditions.position[order][:-1])
    usual = float(turned[changed].mean()) if changed.any() else 1.0
    # Rows of the same collect (samples) share the slew that led to it: the latest change of position.
    latest = np.maximum.accumulate(np.where(np.concatenate([[False], changed]), np.arange(len(f)), 0))
    result = np.zeros(len(f))
    result[order] = np.where(latest > 0, np.concatenate([[usual], turned])[latest], usual)
    return result
