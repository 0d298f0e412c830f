"""The plan as `hil plan --json` prints it (schema hil.plan/1)."""

from typing import Any

from procedures.plan import Plan


def plan_document(plan: Plan, *, simulated: bool) -> dict[str, Any]:
    """Return every step with its expected times in seconds from the beginning."""
    return {
        "schema": "hil.plan/1",
        "title": plan.title,
        "simulated": simulated,
        "total_s": plan.total_s,
        "self_calibrations": len(plan.self_calibrations),
        "steps": [{**vars(step), "kind": step.kind.value, "parameters": dict(step.parameters)} for step in plan.steps],
    }
