"""The IMU as procedures see it: a stream of decoded sample blocks, and an index that can be commanded."""

from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from drivers.frames.counts import StreamCounts
from drivers.frames.roles import SensorRole

FloatArray = NDArray[np.float64]


@dataclass(frozen=True)
class SampleBlock:
    """Samples decoded from the bytes that arrived between two reads.

    `time_s` has shape (n,), seconds on the bench's clock; every column of `fields` has shape (n,) and the unit that
    the frame description gives. `raw` are the bytes as they arrived, `counts` what became of them.
    """

    time_s: FloatArray
    fields: Mapping[str, FloatArray]
    counts: StreamCounts = field(default_factory=StreamCounts)
    raw: bytes = b""
    arrival_s: float = 0.0

    def __len__(self) -> int:
        return len(self.time_s)


@dataclass(frozen=True)
class ImuIdentity:
    """Who answered: model, serial number, firmware as the unit gives them (empty where it cannot say)."""

    model: str
    serial: str = ""
    firmware: str = ""

    def __str__(self) -> str:
        serial = f"S/N {self.serial}" if self.serial else ""
        return " ".join(part for part in (self.model, serial, self.firmware) if part)


def rate_fields(sensors: Mapping[int, SensorRole]) -> Mapping[str, str]:
    """Return the field of every rate, by sensor and channel as people see them: "2.RA"."""
    return {f"{number}.{channel}": name for number, each in sensors.items() for channel, name in each.rates.items()}


def rate_means(block: SampleBlock, fields: Mapping[str, str]) -> Iterator[tuple[str, float, int]]:
    """Yield label, mean and number of a block's finite values for every rate of which it holds any."""
    for label, name in fields.items():
        if name in block.fields:
            values = block.fields[name]
            values = values[np.isfinite(values)]
            if len(values):
                yield label, float(values.mean()), len(values)


class Imu(Protocol):
    """A unit that streams. Sensors are numbered as in the bench file (the report's sensor 2 is 2)."""

    @property
    def sensors(self) -> Mapping[int, SensorRole]:
        """The decoded fields, by sensor."""

    @property
    def conditions(self) -> Mapping[str, str]:
        """Fields that are neither rates nor accelerations: campaign column name to field name."""

    @property
    def sample_rate_hz(self) -> float:
        """The nominal rate of the stream."""

    @property
    def port(self) -> str:
        """The port behind which it is."""

    @property
    def unsure(self) -> bool:
        """Whether its stream was lost since it was identified, so that another unit may be there."""

    def identify(self) -> ImuIdentity:
        """Ask or wait for the unit's identity; raise `DeviceTimeout` where no good frame arrives."""

    def read_block(self) -> SampleBlock:
        """Decode what has arrived since the last call; never waits, perhaps empty."""

    def discard(self) -> StreamCounts:
        """Throw away what has arrived, so that stale bytes are no part of what follows."""

    def close(self) -> None:
        """Release the port."""
