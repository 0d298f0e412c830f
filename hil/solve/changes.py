"""What else could be measured: a further collect in each run, another heading, the same again, backwards, reordered.

    for change in CHANGES:                     # of a sweep, before the night: what it would be with the change
        better = change.apply(conditions)
    for addition in additions(conditions):     # to a campaign that was measured: the further rows, and what they ask
        both = joined(conditions, addition.rows)

They act on conditions, so they work on a planned sweep and on a campaign that was measured alike. What turns the unit
is for an index axis along the sensor's second axis, as on the report's bench. A change that does not fit returns None.
"""

from collections.abc import Callable
from dataclasses import dataclass, replace
from itertools import product

import numpy as np
from numpy.typing import NDArray

from hil.campaign import Conditions, FloatArray, IntArray
from hil.model.effects.geometry import local_frame
from hil.model.effects.history import collect_interval_s, joined, setpoint_step
from hil.model.equation import Orientation
from hil.solve.temperatures import visits

_INDEX_ANGLES = {"4": 180.0, "at 45 deg": 45.0, "at 135 deg": 135.0}
_ROOM_DEGC = 23.0  # from which the first setpoint is approached
_NEXT_COLLECT_S = 90.0  # from a campaign's last collect of a run to one more in it
_NEXT_CAMPAIGN_S = 3600.0  # from a campaign's last collect to the first of a further one


@dataclass(frozen=True)
class Change:
    """A change to a sweep: its name, what it costs in words, and what it makes of the conditions."""

    name: str
    cost: str
    apply: Callable[[Conditions], Conditions | None]


@dataclass(frozen=True)
class Addition:
    """A feasible addition: what it is called, the rows it adds, and how much it asks of the bench (fewer is easier)."""

    name: str
    rows: Conditions
    effort: float


def with_collect_4(conditions: Conditions) -> Conditions | None:
    """Add to each run collect 3 turned over (the spin axis down), one interval after its last collect."""
    if not conditions.sensor.is_rotor or "4" in conditions.position or "3" not in conditions.position:
        return None
    return _beside(conditions, _indexed(conditions, conditions.position == "3", "4", _interval_s(conditions)))


def with_order_1_3_2(conditions: Conditions) -> Conditions | None:
    """Let collects 2 and 3 of every run change places in time."""
    if not {"1", "2", "3"} <= set(conditions.position.tolist()):
        return None
    rows = np.arange(len(conditions))
    for own in conditions.of_each_run.values():
        second, third = (own[conditions.position[own] == label] for label in ("2", "3"))
        if len(second) != 1 or len(third) != 1 or conditions.start_s[second[0]] > conditions.start_s[third[0]]:
            return None
        rows[second], rows[third] = third, second
    return replace(
        conditions,
        position=conditions.position[rows],
        f_g=conditions.f_g[rows],
        w_deg_per_hr=conditions.w_deg_per_hr[rows],
    )


def with_second_heading(conditions: Conditions) -> Conditions | None:
    """Repeat everything with the bench turned by 90 deg about the vertical."""
    turned = _at_second_heading(conditions)
    return None if turned is None else _beside(conditions, _again(turned, _after_a_sweep_s(conditions)))


def with_both_directions(conditions: Conditions) -> Conditions | None:
    """Repeat everything with the temperatures in reverse order: each approached as that order has it.

    Soaks and the order within each visit stay as they were. None where the reverse is the same sweep again.
    """
    temperature = conditions.columns.get("temperature_degC")
    if temperature is None or not np.ptp(temperature[np.isfinite(temperature)]) > 5.0:
        return None
    every = visits(conditions)
    if [at for at, _ in every] == [at for at, _ in every[::-1]]:
        return None
    runs = [run for _, of in every[::-1] for run in of]
    order = np.concatenate([_in_time(conditions, np.flatnonzero(conditions.run == run)) for run in runs])
    return _beside(conditions, _in_order(conditions, order, _after_a_sweep_s(conditions)))


def with_every_run_twice(conditions: Conditions) -> Conditions | None:
    """Repeat everything as it was: what more of the same would bring, to compare the other changes with."""
    return _beside(conditions, _again(conditions, _after_a_sweep_s(conditions)))


CHANGES: tuple[Change, ...] = (
    Change("add collect 4 (spin axis down) to every run", "one more collect per run", with_collect_4),
    Change("take collect 3 before collect 2", "nothing", with_order_1_3_2),
    Change("repeat at a second heading, 90 deg away", "the sweep twice, and turning the bench", with_second_heading),
    Change("the sweep once more, its temperatures in reverse order", "the sweep twice", with_both_directions),
    Change("the same sweep twice", "the sweep twice", with_every_run_twice),
)


def additions(conditions: Conditions) -> list[Addition]:
    """List the feasible additions to a campaign: every run gets the extra collects once."""
    out: list[Addition] = []
    later_s = float(np.ptp(conditions.start_s)) + _NEXT_CAMPAIGN_S
    if not conditions.sensor.is_rotor:
        over = np.char.add(conditions.position.astype(str), " upside down")
        flipped = replace(conditions, f_g=-conditions.f_g, position=over)
        out.append(Addition("every pose upside down", _again(flipped, later_s), 2.0))
    elif (zero := _index_zero(conditions)) is not None:
        for label in _INDEX_ANGLES:
            if label not in conditions.position:
                rows = _indexed(conditions, zero, label, _NEXT_COLLECT_S)
                out.append(Addition(f"Collect {label}", rows, 1.0 if label == "4" else 1.5))
    turned = _at_second_heading(conditions)
    if turned is not None:
        out.append(Addition("the same positions at a heading 90 deg on", _again(turned, later_s), 3.0))
    out.append(Addition("the same collects once more, afterwards", _again(conditions, later_s), 1.8))
    if len(np.unique(conditions.run)) > 1:
        rows = _in_order(conditions, _in_time(conditions, np.arange(len(conditions)))[::-1], later_s)
        out.append(Addition("the same collects in reverse order, within each run too", rows, 2.5))
    return out


def _in_time(conditions: Conditions, rows: IntArray) -> IntArray:
    """Return some rows (k,) in the order of time."""
    return rows[np.argsort(conditions.start_s[rows], kind="stable")]


def _beside(conditions: Conditions, further: Conditions) -> Conditions:
    """Return both in the order of time, counted from 1."""
    both = joined(conditions, further)
    return replace(both.rows(np.argsort(both.start_s, kind="stable")), collect=np.arange(1, len(both) + 1))


def _interval_s(conditions: Conditions) -> float:
    interval = collect_interval_s(conditions)
    return interval if np.isfinite(interval) else float(2.0 * np.max(conditions.duration_s))


def _after_a_sweep_s(conditions: Conditions) -> float:
    """Return how much later a sweep that follows at once begins."""
    length = float(np.max(conditions.start_s + conditions.duration_s) - np.min(conditions.start_s))
    return length + _interval_s(conditions)


def _index_zero(conditions: Conditions) -> NDArray[np.bool_] | None:
    """Mark the rows at index angle zero: the position labelled 3, or the one with its spin axis most nearly up."""
    labels = np.unique(conditions.position)
    label = (
        "3" if "3" in labels else max(labels, key=lambda p: float(conditions.f_g[conditions.position == p, 2].mean()))
    )
    rows = conditions.position == label
    return None if conditions.f_g[rows, 2].mean() < 0.5 else rows


def _indexed(conditions: Conditions, zero: NDArray[np.bool_], label: str, wait_s: float) -> Conditions:
    """One more collect in every run, `wait_s` after its last: mean f and w of the rows at index zero, turned."""
    in_time = np.argsort(conditions.start_s, kind="stable")
    runs = conditions.run[in_time]
    rows = conditions.rows(np.array([in_time[runs == run][-1] for run in dict.fromkeys(conditions.run.tolist())]))
    start = Orientation.from_rotation_about_2("3", 0.0)
    turned = Orientation.from_rotation_about_2(label, _INDEX_ANGLES[label])
    means = (vectors[zero].mean(axis=0) for vectors in (conditions.f_g, np.nan_to_num(conditions.w_deg_per_hr)))
    f_g, w = (np.tile(turned.components(mean @ start.axes), (len(rows), 1)) for mean in means)
    return replace(
        _later(rows, wait_s),
        collect=conditions.collect.max() + 1 + np.arange(len(rows)),
        position=np.full(len(rows), label),
        f_g=f_g,
        w_deg_per_hr=w,
    )


def _at_second_heading(conditions: Conditions) -> Conditions | None:
    """The same rows with the level part of the earth rate turned by 90 deg; None where it has none."""
    frame = local_frame(conditions)
    if not np.any(frame.north):
        return None
    w = np.nan_to_num(conditions.w_deg_per_hr)
    vertical, level = (np.sum(w * along, axis=1, keepdims=True) for along in (frame.up, frame.north))
    return replace(conditions, w_deg_per_hr=vertical * frame.up + level * frame.east)


def _again(conditions: Conditions, by_s: float) -> Conditions:
    """The same rows as new runs after the last one."""
    return replace(
        _later(conditions, by_s),
        run=conditions.run + (conditions.run.max() - conditions.run.min() + 1),
        collect=conditions.collect.max() + 1 + np.arange(len(conditions)),
    )


def _in_order(conditions: Conditions, order: IntArray, by_s: float) -> Conditions:
    """The same rows again in another order (n,), at the same times of a later sweep, as new runs.

    Temperatures, and how fast they change, are what the step of the setpoint leaves that is made in this order.
    """
    again, clock = _again(conditions, by_s), _in_time(conditions, np.arange(len(conditions)))
    laid = conditions.rows(order)
    number = {run: again.run.min() + k for k, run in enumerate(dict.fromkeys(laid.run.tolist()))}
    run = np.array([number[each] for each in laid.run.tolist()])
    now = {name: again.columns[name][clock] for name in ("time_since_power_on_s",) if name in again.columns}
    laid = replace(laid, start_s=again.start_s[clock], run=run, collect=again.collect, columns={**laid.columns, **now})
    step = setpoint_step(conditions, _ROOM_DEGC)
    changed = setpoint_step(joined(conditions, laid), _ROOM_DEGC)[len(conditions) :] - step[order]
    per_degC = _left_of_steps(conditions, step)
    columns = {name: laid.columns[name] + changed * of[order] for name, of in per_degC.items()}
    return replace(laid, columns={**laid.columns, **columns})


def _left_of_steps(conditions: Conditions, step: FloatArray) -> dict[str, FloatArray]:
    """Return what temperatures and rates show per degree of a `step`, (n,), by lines through like collects."""
    place = np.zeros(len(conditions), dtype=np.int64)
    for _, runs in visits(conditions):
        rows = _in_time(conditions, np.flatnonzero(np.isin(conditions.run, runs)))
        place[rows] = np.arange(len(rows))
    shown = {name: values for name, values in conditions.columns.items() if name == "dTdt_degC_per_min"}
    if "setpoint_degC" in conditions.columns:
        thermometers = {"temperature_degC", "case_degC", "chamber_degC"} & conditions.columns.keys()
        shown |= {name: conditions.columns[name] - conditions.columns["setpoint_degC"] for name in thermometers}
    found = {name: np.zeros(len(left)) for name, left in shown.items()}
    for (name, left), k in product(shown.items(), range(int(place.max()) + 1)):
        here = np.flatnonzero((place == k) & np.isfinite(left))
        if len(here):
            off = step[here] - step[here].mean()
            found[name][place == k] = off @ left[here] / max(float(off @ off), 1e-300)
    return found


def _later(conditions: Conditions, by_s: float) -> Conditions:
    columns = dict(conditions.columns)
    if "time_since_power_on_s" in columns:
        columns["time_since_power_on_s"] = columns["time_since_power_on_s"] + by_s
    return replace(conditions, start_s=conditions.start_s + by_s, columns=columns)
