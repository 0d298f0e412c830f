"""The frame description that a bench file names."""

from __future__ import annotations

from drivers.frames.description import DescriptionError, StreamDescription, load_description
from hil.config.bench import Bench
from hil.errors import InputError


def load_frames(bench: Bench) -> StreamDescription:
    """Load the IMU's frame description; raise `InputError` where it cannot be used."""
    try:
        return load_description(bench.imu_description, parameters=bench.imu.parameters, sample_rate_hz=bench.imu.rate)
    except DescriptionError as error:
        raise InputError(str(error)) from error
