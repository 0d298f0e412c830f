"""The frame description that a bench file names."""

from drivers.frames.description import StreamDescription, load_description
from hil.config.bench import ASK, Bench


def load_frames(bench: Bench) -> StreamDescription:
    """Load the IMU's frame description; raise `InputError` where it cannot be used."""
    return load_description(bench.imu_description, parameters=bench.imu.parameters, sample_rate_hz=bench.imu.rate)


def tells_serial(description: StreamDescription) -> bool:
    """Tell whether a unit of this description says its serial number."""
    role = description.roles.identity if description.roles is not None else None
    return role is not None and role.frame is not None and role.serial is not None


def must_be_typed(bench: Bench, description: StreamDescription) -> bool:
    """Tell whether the unit's serial number has to be asked for."""
    return bench.unit.serial == ASK and not tells_serial(description)
