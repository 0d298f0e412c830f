"""Steps and durations as a technician would say them."""

from __future__ import annotations

from procedures.plan import Step, StepKind


def step_in_words(step: Step) -> str:
    """Say what a step does, as a technician would."""
    where = "" if step.temperature_degC is None else f" at {step.temperature_degC:.1f} °C"
    run = "" if step.self_calibration is None else f"self-calibration {step.self_calibration}"
    match step.kind:
        case StepKind.IDENTIFY:
            return "checking who is connected"
        case StepKind.SETPOINT:
            return f"chamber to {step.temperature_degC:.1f} °C"
        case StepKind.RESTABILISE:
            return f"{run}: restabilising{where}"
        case StepKind.INDEX:
            return f"{run}: indexing to position {step.position}"
        case StepKind.COLLECT:
            return f"{run}: Collect {step.position}{where}"
        case StepKind.SAFE_STATE:
            return "bringing the chamber to its safe state"


def hours_minutes(seconds: float) -> str:
    """Write a duration as people say it.

    >>> hours_minutes(45), hours_minutes(720), hours_minutes(11_100)
    ('45 s', '12 min', '3 h 05 min')
    """
    if seconds < 100:
        return f"{seconds:.0f} s"
    minutes = round(seconds / 60.0)
    return f"{minutes} min" if minutes < 100 else f"{minutes // 60} h {minutes % 60:02d} min"
