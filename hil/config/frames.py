"""Whether a unit says its own serial number."""

from hil.config.bench import ASK, Bench


def tells_serial(bench: Bench) -> bool:
    """Tell whether a unit of this bench says its serial number."""
    role = bench.frames.roles.identity if bench.frames.roles is not None else None
    return role is not None and role.frame is not None and role.serial is not None


def must_be_typed(bench: Bench) -> bool:
    """Tell whether the unit's serial number has to be asked for."""
    return bench.unit.serial == ASK and not tells_serial(bench)
