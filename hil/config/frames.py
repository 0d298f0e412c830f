"""The frame description that a bench file names."""

from __future__ import annotations

from drivers.frames.description import StreamDescription, load_description
from hil.config.bench import Bench


def load_frames(bench: Bench) -> StreamDescription:
    """Load the IMU's frame description; raise `InputError` where it cannot be used."""
    return load_description(bench.imu_description, parameters=bench.imu.parameters, sample_rate_hz=bench.imu.rate)
