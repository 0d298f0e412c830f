"""A simulated unit, its transport, its driver and its index on one virtual clock, for tests of driver and index."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from drivers.clock import VirtualClock
from drivers.imu import ImuIdentity, SampleBlock
from drivers.imu.stream import StreamImu
from drivers.positioners.indexing import IndexingPositioner
from drivers.simulators.memory import MemoryTransport
from drivers.simulators.unit import FaultWindow, IndexSettings, SimulatedImu
from tests.drivers.frames.streams import SteadyPhysics, mfs

POSITIONS = {"1": 1, "2": 2, "3": 3}


class Bench:
    """A simulated unit, its transport and its driver on one virtual clock."""

    def __init__(
        self, faults: Sequence[FaultWindow] = (), *, move_s: float = 10.0, expected: ImuIdentity | None = None
    ) -> None:
        self.clock = VirtualClock()
        self.physics = SteadyPhysics()
        self.device = SimulatedImu(
            mfs(), self.physics, faults=faults, index=IndexSettings(POSITIONS, first="1", move_s=move_s), seed=7
        )
        self.transport = MemoryTransport(self.device, self.clock, "sim://imu")
        self.imu = StreamImu(self.transport, mfs(), self.clock, expected=expected)
        self.positioner = IndexingPositioner(self.imu, self.clock, POSITIONS)

    def collect(self, duration_s: float, poll_s: float = 1.0) -> list[SampleBlock]:
        """Discard what is stale, then read every `poll_s`."""
        self.imu.discard()
        blocks = []
        for _ in range(round(duration_s / poll_s)):
            self.clock.sleep(poll_s)
            blocks.append(self.imu.read_block())
        return blocks


def joined(blocks: list[SampleBlock], field: str) -> np.ndarray:
    """Return one field of all blocks."""
    return np.concatenate([block.fields[field] for block in blocks])
