"""What a unit gives: who it is, and its stream as blocks of decoded samples."""

import math
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field
from typing import TypeVar

import numpy as np

from drivers.frames.counts import StreamCounts
from drivers.frames.roles import SensorRole
from drivers.frames.wire import FloatArray as FloatArray

Label = TypeVar("Label")


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


def finite_mean(values: FloatArray) -> tuple[float, int]:
    """Return the mean of the finite ones of the values (n,), NaN where there is none, and their number."""
    total = float(values.sum())
    if not math.isfinite(total):
        values = values[np.isfinite(values)]
        total = float(values.sum())
    return total / len(values) if len(values) else math.nan, len(values)


def means(block: SampleBlock, fields: Mapping[Label, str]) -> Iterator[tuple[Label, float, int]]:
    """Yield label, mean and number of a block's finite values for every field of which it holds any."""
    for label, name in fields.items():
        if name in block.fields:
            mean, n = finite_mean(block.fields[name])
            if n:
                yield label, mean, n
