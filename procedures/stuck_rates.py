"""For how long each rate of a stream has shown the very same value: one that never changes is not being measured."""

from collections.abc import Mapping

import numpy as np

from drivers.frames.roles import SensorRole
from drivers.imu import SampleBlock
from drivers.imu.samples import rate_fields


class Unchanged:
    """The rates of one unit, block by block."""

    def __init__(self, sensors: Mapping[int, SensorRole]) -> None:
        self._fields = rate_fields(sensors)
        self._last: dict[str, tuple[float, float]] = {}  # by label: the value, and since when it stands

    def lasting_s(self, block: SampleBlock, time_s: float) -> Mapping[str, float]:
        """Take in what was drained at `time_s`; return for how long each rate of it has not changed."""
        lasting: dict[str, float] = {}
        for label, field in self._fields.items():
            values = block.fields.get(field)
            if values is None or not len(values):
                continue
            value, since_s = self._last.get(label, (float(values[0]), time_s))
            if values[-1] != value or np.any(values != value):  # nearly always the newest tells
                value, since_s = float(values[-1]), time_s
            self._last[label] = (value, since_s)
            lasting[label] = time_s - since_s
        return lasting
