"""The unit's own index: confirmed by its stream, refused or given up with what the stream said."""

from __future__ import annotations

from dataclasses import replace

import pytest

from drivers.clock import VirtualClock
from drivers.errors import CommandRefused, DeviceTimeout, ProtocolError
from drivers.imu.stream import StreamImu
from drivers.positioners.indexing import IndexingPositioner
from drivers.simulators.memory import MemoryTransport
from drivers.simulators.unit import FaultWindow, ImuFault, SimulatedImu
from tests.drivers.frames.streams import SteadyPhysics, mfs, stim300
from tests.drivers.imu.simulated_unit import POSITIONS, Bench, joined


def test_a_move_returns_when_the_stream_confirms_it() -> None:
    """Not before the unit arrived, and the position is known afterwards."""
    bench = Bench()
    assert bench.positioner.position() == "1"
    bench.positioner.move_to("2", timeout_s=60.0)
    assert bench.physics.moves == [("1", 0.0, 0.0), ("2", 0.0, 10.0)]
    assert 10.2 < bench.clock.now() < 10.6
    assert bench.positioner.position() == "2"
    state = bench.imu.index_status
    assert state is not None
    assert (state.code, state.moving, state.in_position) == (2, False, True)


def test_a_move_that_was_made_before_costs_few_looks_and_is_confirmed_as_promptly() -> None:
    """Its time is known; one that takes shorter or longer than before is still noticed within the bound."""
    bench = Bench()
    looks = []
    read_block = bench.imu.read_block
    bench.imu.read_block = lambda: looks.append(bench.clock.now()) or read_block()  # type: ignore[method-assign,func-returns-value]

    def move(position: str, move_s: float) -> float:
        bench.device.index = replace(bench.device.index, move_s=move_s)
        begins_s = bench.clock.now()
        looks.clear()
        bench.positioner.move_to(position, timeout_s=60.0)
        return bench.clock.now() - begins_s - move_s

    assert 0.25 <= move("2", 10.0) <= 0.65
    assert len(looks) > 30
    move("1", 10.0)
    assert 0.25 <= move("2", 10.0) <= 0.45
    assert len(looks) < 18
    for move_s in (4.0, 16.0):
        move("1", 10.0)
        assert 0.25 <= move("2", move_s) <= 1.35


def test_a_place_that_was_reached_between_two_looks_counts_from_its_first_frame() -> None:
    """The frames of one read tell when the unit arrived, and a break in between begins anew."""
    bench = Bench()
    bench.clock.sleep(5.0)
    bench.imu.read_block()
    bench.imu.command_index(2)
    for _ in range(3):
        bench.clock.sleep(7.0)
        bench.imu.read_block()
    state = bench.imu.index_status
    assert state is not None
    assert state.place == (2, False, True)
    assert state.since_s == pytest.approx(15.0, abs=0.06)
    assert state.time_s == pytest.approx(26.0, abs=0.06)


def test_a_move_to_where_the_unit_is_waits_for_the_unit_not_for_its_old_status() -> None:
    """The frames before the command still say `in position`: they confirm nothing."""
    bench = Bench()
    bench.clock.sleep(5.0)
    bench.positioner.move_to("1", timeout_s=60.0)
    assert bench.clock.now() > 15.2


def test_samples_during_a_move_are_no_part_of_the_collect_after_it() -> None:
    """The first sample of the collect was taken after the confirmation."""
    bench = Bench()
    bench.positioner.move_to("3", timeout_s=60.0)
    confirmed_s = bench.clock.now()
    blocks = bench.collect(10.0)
    assert joined(blocks, "rate_A2")[0] > confirmed_s
    assert set(joined(blocks, "index_position")) == {3.0}
    assert all(block.counts.lost == 0 for block in blocks)


@pytest.mark.parametrize(
    ("fault", "error", "message"),
    [
        (ImuFault.INDEX_NEVER_FINISHES, DeviceTimeout, "was not confirmed within 30 s; the unit says that it is still"),
        (ImuFault.INDEX_WRONG_POSITION, DeviceTimeout, "was not confirmed within 30 s; .* in position '1'"),
        (ImuFault.STALL, DeviceTimeout, "no good frame arrived since the command"),
        (ImuFault.INDEX_REFUSED, CommandRefused, "reports an index fault on the way to position '2'"),
    ],
)
def test_a_move_that_is_not_confirmed_fails_with_what_the_stream_said(
    fault: ImuFault, error: type[Exception], message: str
) -> None:
    """Never finishing, arriving elsewhere, falling silent and refusing have different words."""
    bench = Bench([FaultWindow(fault, begins_s=1.0)])
    bench.clock.sleep(2.0)
    with pytest.raises(error, match=message):
        bench.positioner.move_to("2", timeout_s=30.0)
    assert bench.clock.now() <= 32.2
    assert bench.positioner.position() != "2"


def test_after_a_refused_move_the_next_one_is_not_blamed_for_it() -> None:
    """The fault bit of the old command is still in the frames when the new one is sent."""
    bench = Bench([FaultWindow(ImuFault.INDEX_REFUSED, begins_s=0.0, ends_s=5.0)])
    with pytest.raises(CommandRefused):
        bench.positioner.move_to("2", timeout_s=30.0)
    bench.clock.sleep(10.0)
    bench.positioner.move_to("2", timeout_s=30.0)
    assert bench.positioner.position() == "2"


def test_a_command_damaged_on_its_way_is_sent_once_more() -> None:
    """One flipped character must not end the night; a unit that never understands is said to."""
    bench = Bench()
    write, damaged = bench.transport.write, []

    def damage_first(data: bytes) -> None:
        damaged.append(data)
        write(data.replace(b"INDEX", b"INDEY") if len(damaged) == 1 else data)

    bench.transport.write = damage_first  # type: ignore[method-assign]
    bench.positioner.move_to("2", timeout_s=30.0)
    assert len(damaged) == 2
    bench.transport.write = lambda data: write(data.replace(b"INDEX", b"INDEY"))  # type: ignore[method-assign]
    with pytest.raises(CommandRefused, match="does not understand the index command"):
        bench.positioner.move_to("3", timeout_s=30.0)


def test_a_position_that_the_bench_file_lacks_is_refused_before_anything_is_sent() -> None:
    """The message gives the positions that there are."""
    bench = Bench()
    with pytest.raises(CommandRefused, match="no position '4'; the bench file gives 1, 2, 3"):
        bench.positioner.move_to("4", timeout_s=30.0)
    assert len(bench.physics.moves) == 1


def test_while_it_moves_the_position_is_not_known() -> None:
    """None, neither the old nor the new."""
    bench = Bench([FaultWindow(ImuFault.INDEX_NEVER_FINISHES)])
    with pytest.raises(DeviceTimeout):
        bench.positioner.move_to("2", timeout_s=5.0)
    assert bench.positioner.position() is None


def test_a_description_without_commands_cannot_index_and_one_without_roles_cannot_drive() -> None:
    """The driver says so instead of sending nothing."""
    clock = VirtualClock()
    description = mfs().model_copy(update={"commands": None})
    transport = MemoryTransport(SimulatedImu(description, SteadyPhysics()), clock, "sim://imu")
    imu = StreamImu(transport, description, clock)
    with pytest.raises(ProtocolError, match="MFS has no index command; use an operator"):
        IndexingPositioner(imu, clock, POSITIONS).move_to("2", timeout_s=1.0)
    with pytest.raises(ValueError, match="STIM300: roles: missing"):
        StreamImu(transport, stim300(), clock)
