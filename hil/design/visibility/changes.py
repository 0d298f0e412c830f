"""What a sweep would look like if it were changed: the same rows with a fourth collect, another order or heading.

    for change in CHANGES:
        better = change.apply(conditions)

They act on conditions, so they work on a planned sweep and on a campaign that was measured alike. All are for an index
axis along the sensor's second axis, as on the report's bench; a change that does not fit returns None.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np

from hil.campaign import Conditions, FloatArray, IntArray
from hil.model.effects.geometry import local_frame
from hil.model.effects.history import collect_interval_s, joined


@dataclass(frozen=True)
class Change:
    """A change to a sweep: its name, what it costs in words, and what it makes of the conditions."""

    name: str
    cost: str
    apply: Callable[[Conditions], Conditions | None]


def _chosen(conditions: Conditions, rows: IntArray) -> Conditions:
    return replace(
        conditions,
        collect=conditions.collect[rows],
        run=conditions.run[rows],
        position=conditions.position[rows],
        start_s=conditions.start_s[rows],
        duration_s=conditions.duration_s[rows],
        f_g=conditions.f_g[rows],
        w_deg_per_hr=conditions.w_deg_per_hr[rows],
        columns={name: values[rows] for name, values in conditions.columns.items()},
    )


def _in_time_order(conditions: Conditions) -> Conditions:
    order = np.argsort(conditions.start_s, kind="stable")
    return replace(_chosen(conditions, order), collect=np.arange(1, len(conditions) + 1))


def _interval_s(conditions: Conditions) -> float:
    interval = collect_interval_s(conditions)
    return interval if np.isfinite(interval) else float(2.0 * np.max(conditions.duration_s))


def with_collect_4(conditions: Conditions) -> Conditions | None:
    """Add to each run collect 3 turned over (the spin axis down), one interval after its last collect."""
    if not conditions.sensor.is_rotor or "4" in conditions.position or "3" not in conditions.position:
        return None
    third = _chosen(conditions, np.flatnonzero(conditions.position == "3"))
    over = np.array([-1.0, 1.0, -1.0])
    ends = np.array([conditions.start_s[conditions.run == run].max() for run in third.run])
    fourth = _later(third, ends + _interval_s(conditions) - third.start_s)
    fourth = replace(fourth, position=np.full(len(third), "4"), f_g=third.f_g * over)
    return _in_time_order(joined(conditions, replace(fourth, w_deg_per_hr=third.w_deg_per_hr * over)))


def with_order_1_3_2(conditions: Conditions) -> Conditions | None:
    """Let collects 2 and 3 of every run change places in time."""
    if not {"1", "2", "3"} <= set(conditions.position.tolist()):
        return None
    swapped = conditions
    rows = np.arange(len(conditions))
    for run in np.unique(conditions.run):
        second = rows[(conditions.run == run) & (conditions.position == "2")]
        third = rows[(conditions.run == run) & (conditions.position == "3")]
        if len(second) != 1 or len(third) != 1 or conditions.start_s[second[0]] > conditions.start_s[third[0]]:
            return None
        rows[second[0]], rows[third[0]] = third[0], second[0]
    return replace(
        swapped,
        position=conditions.position[rows],
        f_g=conditions.f_g[rows],
        w_deg_per_hr=conditions.w_deg_per_hr[rows],
    )


def with_second_heading(conditions: Conditions) -> Conditions | None:
    """Repeat everything with the bench turned by 90 deg about the vertical."""
    frame = local_frame(conditions)
    if not np.any(frame.north):
        return None
    w = conditions.w_deg_per_hr
    up = np.sum(w * frame.up, axis=1, keepdims=True)
    level = np.sum(w * frame.north, axis=1, keepdims=True)
    turned = replace(_repeated(conditions), w_deg_per_hr=up * frame.up + level * frame.east)
    return _in_time_order(joined(conditions, turned))


def with_both_directions(conditions: Conditions) -> Conditions | None:
    """Repeat everything backwards: every temperature approached from the other side."""
    temperature = conditions.columns.get("temperature_degC")
    if temperature is None or not np.ptp(temperature[np.isfinite(temperature)]) > 5.0:
        return None
    runs = np.unique(conditions.run)[::-1]
    rows = np.concatenate([np.flatnonzero(conditions.run == run) for run in runs])
    back = _repeated(conditions)
    # Soak, settling and order within each run stay as they were; the plateau and the sign of its approach change.
    back = replace(
        back,
        columns={
            name: (values[rows] if name.endswith("degC") else values) * (-1.0 if name == "dTdt_degC_per_min" else 1.0)
            for name, values in back.columns.items()
        },
    )
    return _in_time_order(joined(conditions, back)) if len(rows) == len(conditions) else None


def with_every_run_twice(conditions: Conditions) -> Conditions | None:
    """Repeat everything as it was: what more of the same would bring, to compare the other changes with."""
    return _in_time_order(joined(conditions, _repeated(conditions)))


def _repeated(conditions: Conditions) -> Conditions:
    """Return the same rows as new runs after the last one."""
    length = float(np.max(conditions.start_s + conditions.duration_s) - np.min(conditions.start_s))
    later = _later(conditions, np.full(len(conditions), length + _interval_s(conditions)))
    return replace(later, run=conditions.run + (conditions.run.max() - conditions.run.min() + 1))


def _later(conditions: Conditions, by_s: FloatArray) -> Conditions:
    columns = dict(conditions.columns)
    if "time_since_power_on_s" in columns:
        columns["time_since_power_on_s"] = columns["time_since_power_on_s"] + by_s
    return replace(conditions, start_s=conditions.start_s + by_s, columns=columns)


CHANGES: tuple[Change, ...] = (
    Change("add collect 4 (spin axis down) to every run", "one more collect per run", with_collect_4),
    Change("take the collects in the order 1-3-2", "nothing", with_order_1_3_2),
    Change("repeat at a second heading, 90 deg away", "the sweep twice, and turning the bench", with_second_heading),
    Change("visit the temperatures in both directions", "the sweep twice", with_both_directions),
    Change("the same sweep twice", "the sweep twice", with_every_run_twice),
)
