"""Random faults for a rehearsal: what, when, how large and for how long, drawn by a seed."""

from __future__ import annotations

import math
import random
from collections.abc import Callable, Mapping

from hil.config.simulation import CATALOGUE, Device, Fault
from procedures.plan import Plan

_OFTEN: Mapping[Device, int] = {"imu": 4, "chamber": 4, "disk": 1, "clock": 1, "controller": 1}
"""How often each device is chosen; no operator, for nobody is asked on a bench that indexes."""
NEVER = frozenset({"no_answer", "wrong_position", "not_carried_out", "exchanged"})
"""What is not drawn: no controller can survive it, and what it leads to is tested where it is said."""
_AT_A_STEP = 0.3  # so often a fault waits for a step
_FOR_EVER = 0.15  # so often it lasts for the rest of the night
_SHORTEST_S, _LONGEST_S = 5.0, 3600.0
_SIZES: Mapping[str, Callable[[random.Random], float | str]] = {
    "late": lambda draw: f"{draw.uniform(0.5, 20.0):.1f} s",
    "sensor_break": lambda draw: f"{draw.choice((-199.9, -60.0, 0.0, 95.0, 850.0))} degC",
    "runaway": lambda draw: f"{draw.uniform(2.0, 90.0):.0f} delta_degC",
    "jump": lambda draw: f"{draw.choice((-1, 1)) * 10.0 ** draw.uniform(0.0, 5.0):.0f} s",
}


def draw_faults(
    draw: random.Random, plan: Plan, count: tuple[int, int], longest_s: float | None = None
) -> tuple[Fault, ...]:
    """Return between `count[0]` and `count[1]` faults for a night of this plan; of several units each concerns one.

    With `longest_s` they are glitches: none lasts longer, and none for ever.
    """
    return tuple(_fault(draw, plan, longest_s) for _ in range(draw.randint(*count)))


def _fault(draw: random.Random, plan: Plan, longest_s: float | None) -> Fault:
    (device,) = draw.choices(list(_OFTEN), weights=list(_OFTEN.values()))
    name = draw.choice([each for each in CATALOGUE[device] if each not in NEVER])
    kind = CATALOGUE[device][name]
    waits = draw.random() < _AT_A_STEP
    at = draw.choice(plan.steps).key if waits else f"{draw.uniform(0.0, plan.total_s):.0f} s"
    facts: dict[str, object] = {"at": at, "device": device, "kind": name}
    if device == "imu" and (units := [*filter(None, plan.units)]):
        facts["unit"] = draw.choice(units)
    if kind.size == "share":
        facts["size"] = round(10.0 ** draw.uniform(-3.0, 0.0), 4)
    elif kind.size is not None:
        facts["size"] = _SIZES[name](draw)
    if kind.lasts and (draw.random() >= _FOR_EVER or longest_s is not None):
        longest_s = longest_s or _LONGEST_S
        lasts_s = math.exp(draw.uniform(math.log(min(_SHORTEST_S, longest_s / 10.0)), math.log(longest_s)))
        facts["duration"] = f"{lasts_s:.0f} s"
    return Fault.model_validate(facts)
