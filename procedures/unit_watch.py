"""One unit as a running sweep sees it: its stream at each poll, who it says it is, what onlookers are shown of it."""

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field

import numpy as np

from drivers.errors import DeviceError, WrongDevice, worded
from drivers.frames.counts import StreamCounts
from drivers.imu import ImuIdentity, SampleBlock
from drivers.imu.samples import rate_fields
from procedures.devices import BenchDevices
from procedures.interlocks import Look, of_unit


@dataclass(eq=False)
class UnitWatch:
    """The stream of one unit. `event` records what happened; `alive` is called before it is asked who it is."""

    name: str
    devices: BenchDevices
    event: Callable[[str, str], None]
    alive: Callable[[], None]
    look: Look | None = field(default=None, init=False)
    identity: ImuIdentity | None = field(default=None, init=False)  # who it said it was
    rates_deg_per_hr: Mapping[str, float] = field(default_factory=dict, init=False)  # running means, for onlookers
    rates_se_deg_per_hr: Mapping[str, float] = field(default_factory=dict, init=False)
    stream = StreamCounts()
    shown_ok = 0  # good frames that onlookers have heard of

    def __post_init__(self) -> None:
        self.imu, self._clock = self.devices.imu, self.devices.clock
        self.rate_fields = rate_fields(self.imu.sensors)
        self.temperature_fields = {n: each.temperature for n, each in self.imu.sensors.items() if each.temperature}
        self._last_frame_s = self._clock.now()
        self._stands: dict[str, tuple[float, float]] = {}  # by label of a rate: the value, and since when

    def forget(self) -> None:
        """Throw away what it sent so far."""
        self.stream += self.imu.discard()
        self._last_frame_s = self._clock.now()

    def same_unit(self) -> ImuIdentity:
        """Ask the unit who it is; raise `WrongDevice` where it is not the one with which the night began."""
        self.alive()
        imu, began = self.imu, self.identity
        with worded(WrongDevice, "", WrongDevice, f"; the night began with {began}" if began else ""):
            self.identity = found = imu.identify()
        if began not in (None, found):
            self.identity = began
            raise WrongDevice(f"the unit behind {imu.port} is now {found}, the night began with {began}")
        return found

    def drain(self, *, resting: bool) -> tuple[SampleBlock, float, str]:
        """Return what arrived, how long after the last frame, and what failed; `WrongDevice` for another unit."""
        error = ""
        try:
            block = self.imu.read_block()
        except DeviceError as failure:
            block, error = SampleBlock(np.empty(0), {}), str(failure)
        self.stream += block.counts
        if self.imu.unsure and len(block) and self.identity and not resting:
            block, error = SampleBlock(np.empty(0), {}), self._who_is_back()
        now_s = self._clock.now()
        # A drain too short to expect a frame says nothing, but short ones must add up to something: the span counts
        # from the last frame, not from the last drain.
        span_s = now_s - self._last_frame_s
        if len(block):
            self._last_frame_s = now_s
        return block, span_s, error

    def unchanged_s(self, block: SampleBlock, time_s: float) -> Mapping[str, float]:
        """Take in what was drained at `time_s`; return for how long each rate of it shows the very same value, s."""
        lasting: dict[str, float] = {}
        for label, name in self.rate_fields.items():
            values = block.fields.get(name)
            if values is None or not len(values):
                continue
            value, since_s = self._stands.get(label, (float(values[0]), time_s))
            if values[-1] != value or np.any(values != value):  # nearly always the newest tells
                value, since_s = float(values[-1]), time_s
            self._stands[label] = (value, since_s)
            lasting[label] = time_s - since_s
        return lasting

    def _who_is_back(self) -> str:
        whose = of_unit(self.name)
        try:
            told = self.same_unit()
        except WrongDevice:
            raise
        except DeviceError as failure:
            return f"it was lost and is back, and the unit does not say who it is: {failure}"
        self.event("unit-back", f"{whose}the unit's stream was lost and is back; it is {told}, as before")
        return ""


def labelled(unit: str, name: object) -> str:
    """Return the name of something of a unit among those of other units: 0042.2, or 2 where none is listed."""
    return f"{unit}.{name}" if unit else str(name)
