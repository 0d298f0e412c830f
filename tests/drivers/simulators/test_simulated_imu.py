"""The simulated unit sends what the physics says, indexes in its own time, and misbehaves exactly as told."""

from __future__ import annotations

import numpy as np
import pytest

from drivers.frames.counts import StreamCounts
from drivers.frames.decoder import StreamDecoder
from drivers.simulators.unit import FaultWindow, ImuFault, IndexSettings, SimulatedImu
from tests.drivers.frames.status_bits import bits
from tests.drivers.frames.streams import SteadyPhysics, mfs, stim300

INDEX = IndexSettings({"1": 1, "2": 2, "3": 3}, first="1", move_s=10.0)


def unit(*faults: FaultWindow, physics: SteadyPhysics | None = None, seed: int = 3) -> SimulatedImu:
    """Return a unit with the given faults."""
    return SimulatedImu(mfs(), physics or SteadyPhysics(), index=INDEX, faults=faults, seed=seed)


def line(command: str) -> bytes:
    """Return a command line with its checksum, computed here."""
    check = 0
    for character in command:
        check ^= ord(character)
    return f"${command}*{check:02X}\r\n".encode()


def test_a_frame_is_sent_at_every_period_and_not_before() -> None:
    """20 Hz from the start: frame n at n / 20 s."""
    device = unit()
    assert len(device.transmit(0.0)) == 59
    assert device.transmit(0.049) == b""
    assert device.next_transmission(0.049) == pytest.approx(0.05)
    assert len(device.transmit(0.05)) == 59
    assert len(device.transmit(10.0)) == 199 * 59


def test_the_cut_of_time_does_not_change_the_bytes() -> None:
    """Asked every 10 ms or once: the same stream."""
    often, once = unit(), unit()
    pieces = [often.transmit(0.01 * number) for number in range(1001)]
    assert b"".join(pieces) == once.transmit(10.0)


def test_the_same_seed_gives_the_same_faults() -> None:
    """A simulated night is reproducible to the byte."""
    faults = (FaultWindow(ImuFault.GARBAGE, probability=0.3), FaultWindow(ImuFault.FLIPPED_BITS, probability=0.3))
    assert unit(*faults).transmit(60.0) == unit(*faults).transmit(60.0)
    assert unit(*faults, seed=4).transmit(60.0) != unit(*faults).transmit(60.0)


def test_a_command_moves_the_index_and_the_frames_tell_it() -> None:
    """Moving with position 0 for ten seconds, then in position 2."""
    physics = SteadyPhysics()
    device = unit(physics=physics)
    device.receive(line("MFS,INDEX,2")[:5], 1.99)
    device.receive(line("MFS,INDEX,2")[5:], 2.0)
    samples = StreamDecoder(mfs()).feed(device.transmit(20.0))["sample"]
    times_s = np.arange(len(samples)) / 20
    moving = (times_s > 2.0) & (times_s < 12.0 - 1e-9)
    assert (bits(samples, "moving") == moving).all()
    assert (bits(samples, "in_position") == ~moving).all()
    assert (samples.wire("index_position") == np.where(moving, 0, np.where(times_s > 2.0, 2, 1))).all()
    assert not bits(samples, "index_fault").any()
    assert physics.moves == [("1", 0.0, 0.0), ("2", 2.0, 12.0)]


@pytest.mark.parametrize("bad", [b"$MFS,INDEX,2*00\r\n", line("MFS,INDEX,9"), line("MFS,JUMP"), b"\xff\x00\r\n"])
def test_a_line_that_is_not_understood_is_rejected_until_the_next_good_one(bad: bytes) -> None:
    """A wrong checksum, an unknown position, an unknown command and noise move nothing."""
    physics = SteadyPhysics()
    device = unit(physics=physics)
    decoder = StreamDecoder(mfs())
    device.receive(bad, 1.0)
    assert bits(decoder.feed(device.transmit(2.0))["sample"], "command_rejected")[-1]
    device.receive(line("MFS,INDEX,2"), 2.0)
    assert not bits(decoder.feed(device.transmit(3.0))["sample"], "command_rejected")[-1]
    assert len(physics.moves) == 2


def test_noise_without_a_line_end_does_not_fill_the_memory() -> None:
    """And a good line after it is understood."""
    physics = SteadyPhysics()
    device = unit(physics=physics)
    for _ in range(100):
        device.receive(bytes(100), 1.0)
    device.receive(b"\n" + line("MFS,INDEX,3"), 1.0)
    assert physics.moves[-1][0] == "3"


@pytest.mark.parametrize(
    ("fault", "expected"),
    [
        (ImuFault.DROPPED_FRAMES, {"lost": 199}),
        (ImuFault.STALL, {"lost": 199}),
        (ImuFault.FLIPPED_BITS, {"lost": 199}),
        (ImuFault.REPEATED_FRAMES, {"duplicate": 199}),
        (ImuFault.GARBAGE, {"resyncs": 199}),
    ],
)
def test_a_fault_happens_in_its_window_and_nowhere_else(fault: ImuFault, expected: dict[str, int]) -> None:
    """From 10 s to 19.95 s every frame is struck; before and after none."""
    decoded = StreamDecoder(mfs()).feed(unit(FaultWindow(fault, begins_s=10.0, ends_s=19.925)).transmit(60.0))
    counts = vars(decoded.counts)
    assert {name: counts[name] for name in expected} == expected
    assert decoded.counts.ok == 1201 - expected.get("lost", 0)


def test_frozen_values_are_good_frames_that_say_the_same() -> None:
    """The counter and the checksum go on, so that only the values can tell."""
    device = unit(FaultWindow(ImuFault.FROZEN, begins_s=10.0, ends_s=20.0))
    decoder = StreamDecoder(mfs())
    parts = [decoder.feed(device.transmit(time_s)) for time_s in np.arange(0.0, 30.0, 0.7)]
    rates = np.concatenate([part["sample"].column("rate_A2") for part in parts])
    assert sum((part.counts for part in parts), StreamCounts()) == StreamCounts(ok=len(rates))
    times_s = np.arange(len(rates)) / 20
    frozen = (times_s >= 10.0) & (times_s < 20.0)
    assert rates == pytest.approx(np.where(frozen, 10.0, times_s))


def test_a_rotor_that_is_not_at_speed_sets_its_bit() -> None:
    """In its window only."""
    samples = StreamDecoder(mfs()).feed(unit(FaultWindow(ImuFault.SPIN_FAULT, 1.0, 2.0)).transmit(3.0))["sample"]
    assert bits(samples, "spin_fault").tolist() == [False] * 20 + [True] * 20 + [False] * 21


def test_a_description_without_roles_cannot_be_simulated() -> None:
    """Nothing says which frame carries the samples."""
    with pytest.raises(ValueError, match="without roles cannot be simulated"):
        SimulatedImu(stim300(), SteadyPhysics())
