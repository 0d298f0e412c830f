"""The IMU driver: samples on the bench's clock, stale bytes left out, identity and index confirmed or refused."""

from __future__ import annotations

from collections.abc import Sequence
from contextlib import suppress

import numpy as np
import pytest

from drivers.clock import VirtualClock
from drivers.errors import CommandRefused, DeviceTimeout, ProtocolError, TransportError, WrongDevice
from drivers.frames.encoder import encode
from drivers.imu import ImuIdentity, SampleBlock
from drivers.imu.stream import StreamImu
from drivers.positioners.indexing import IndexingPositioner
from drivers.simulators.faults import FaultWindow, ImuFault
from drivers.simulators.memory import MemoryTransport
from drivers.simulators.unit import IndexSettings, SimulatedImu
from tests.drivers.frames.streams import SteadyPhysics, mfs, stim300

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


def test_samples_arrive_complete_with_their_values_and_times() -> None:
    """Ten minutes at 20 Hz: 12 000 samples, none lost, each at the time at which it was taken."""
    bench = Bench()
    bench.clock.sleep(100.0)
    blocks = bench.collect(600.0, poll_s=7.5)
    times_s = np.concatenate([block.time_s for block in blocks])
    assert len(times_s) == 12000
    assert joined(blocks, "rate_A2") == pytest.approx(times_s, abs=1e-3)  # the physics makes the time its rate
    assert times_s[0] == pytest.approx(100.05)
    assert sum(block.counts.ok for block in blocks) == 12000
    assert all(block.counts.lost == 0 for block in blocks)
    assert joined(blocks, "rate_A1") == pytest.approx(-7.5)
    assert joined(blocks, "case_degC") == pytest.approx(-29.72)
    assert b"".join(block.raw for block in blocks)[:3] == b"\xa5\x5a\x01"


def test_a_read_without_anything_new_is_empty_and_has_every_field() -> None:
    """Whoever joins blocks needs no special case."""
    bench = Bench()
    bench.imu.read_block()
    block = bench.imu.read_block()
    assert len(block) == 0
    assert set(block.fields) == {name for name, f in mfs().frames["sample"].fields.items() if f.type != "text"}


def test_sensors_and_conditions_are_those_of_the_description() -> None:
    """Each sensor has its rates, accelerations, temperature and conditions of its own."""
    imu = Bench().imu
    assert imu.sensors[2].rates == {"RA": "rate_A2", "RB": "rate_B2"}
    assert imu.sensors[1].temperature == "rotor_1_degC"
    assert imu.sensors[1].conditions == {"spin_period_us": "spin_period_1_us"}
    assert imu.conditions["supply_V"] == "supply_V"
    assert imu.sample_rate_hz == 20.0


def test_stale_bytes_are_no_part_of_a_collect_not_even_half_a_frame() -> None:
    """After a discard the first sample is one that began after it, and what was left out is not lost."""
    clock = VirtualClock()
    frames = [encode(mfs(), "sample", {"counter": number, "rate_A2": float(number)}) for number in range(6)]

    class Scripted:
        name = "sim://scripted"
        arriving = b""

        def read_available(self) -> bytes:
            data, self.arriving = self.arriving, b""
            return data

    transport = Scripted()
    imu = StreamImu(transport, mfs(), clock)  # type: ignore[arg-type]
    transport.arriving = frames[0] + frames[1] + frames[2][:20]
    clock.sleep(0.1)
    assert imu.discard().ok == 2
    transport.arriving = frames[2][20:] + frames[4] + frames[5]
    clock.sleep(0.15)
    block = imu.read_block()
    assert block.fields["rate_A2"].tolist() == [4.0, 5.0]
    assert (block.counts.lost, block.counts.ok) == (0, 2)
    assert block.time_s == pytest.approx([0.2, 0.25])


def test_faults_of_the_stream_are_counted_and_the_good_samples_keep_their_times() -> None:
    """Dropped frames, flipped bits, garbage and repetitions: what is left is right and placed right."""
    faults = [
        FaultWindow(ImuFault.DROPPED_FRAMES, probability=0.05),
        FaultWindow(ImuFault.FLIPPED_BITS, probability=0.05),
        FaultWindow(ImuFault.GARBAGE, probability=0.05),
        FaultWindow(ImuFault.REPEATED_FRAMES, probability=0.05),
    ]
    bench = Bench(faults)
    blocks = bench.collect(600.0)
    times_s = np.concatenate([block.time_s for block in blocks])
    counts = [block.counts for block in blocks]
    assert 0.85 * 12000 < len(times_s) < 0.95 * 12000
    assert joined(blocks, "rate_A2") == pytest.approx(times_s, abs=0.051)  # a late last frame shifts by one period
    assert sum(c.lost for c in counts) + len(times_s) == pytest.approx(12000, abs=3)
    for name in ("bad_checksum", "skipped_bytes", "resyncs", "duplicate"):
        assert sum(getattr(c, name) for c in counts) > 100, name


def test_an_outage_longer_than_a_turn_of_the_counter_is_counted_by_the_clock() -> None:
    """Two hours of silence: a 16-bit counter at 20 Hz comes round every 55 minutes."""
    bench = Bench([FaultWindow(ImuFault.STALL, begins_s=60.0, ends_s=60.0 + 7200.0)])
    blocks = bench.collect(7400.0, poll_s=10.0)
    times_s = np.concatenate([block.time_s for block in blocks])
    assert joined(blocks, "rate_A2") == pytest.approx(times_s, abs=0.051)
    assert sum(block.counts.lost for block in blocks) == 7200 * 20


def test_an_outage_before_a_collect_is_no_loss_of_the_collect() -> None:
    """Two turns of the counter passed in silence; the collect that begins after it misses nothing."""
    bench = Bench([FaultWindow(ImuFault.STALL, begins_s=60.0, ends_s=60.0 + 7200.0)])
    bench.clock.sleep(30.0)
    bench.imu.read_block()
    bench.clock.sleep(7229.0)
    blocks = bench.collect(60.0)
    assert sum(len(block) for block in blocks) == 59 * 20 + 1
    assert sum(block.counts.lost for block in blocks) == 0


def test_a_unit_that_was_switched_off_is_placed_by_the_clock_and_loses_what_the_clock_says() -> None:
    """A counter that begins anew is not a gap of an hour."""
    clock = VirtualClock()
    first = SimulatedImu(mfs(), SteadyPhysics())
    transport = MemoryTransport(first, clock, "sim://imu")
    imu = StreamImu(transport, mfs(), clock)
    clock.sleep(100.0)
    imu.read_block()
    transport._device = SimulatedImu(mfs(), SteadyPhysics(), starts_s=130.0)
    clock.sleep(40.0)
    block = imu.read_block()
    assert block.time_s == pytest.approx(block.fields["rate_A2"], abs=0.051)
    assert block.counts.lost == pytest.approx(600, abs=2)


@pytest.mark.slow
def test_a_unit_whose_oscillator_is_slow_or_fast_stays_on_the_clock() -> None:
    """At 100 ppm a night would be seconds off if the nominal rate were believed."""
    for rate_hz in (20.0 * (1 - 1e-4), 20.0 * (1 + 1e-4)):
        clock = VirtualClock()
        transport = MemoryTransport(SimulatedImu(mfs(), SteadyPhysics(), rate_hz=rate_hz), clock, "sim://imu")
        imu = StreamImu(transport, mfs(), clock)
        for _ in range(1200):
            clock.sleep(30.0)
            block = imu.read_block()
        assert block.time_s == pytest.approx(block.fields["rate_A2"], abs=0.06)
        assert block.counts.lost == 0


def test_the_unit_says_who_it_is() -> None:
    """Asked by command, answered by a frame between samples."""
    assert Bench().imu.identify() == ImuIdentity("MFS", "SIM-0001", "simulated")


@pytest.mark.parametrize("expected", [ImuIdentity("MFS", "014"), ImuIdentity("STIM300")])
def test_another_unit_than_the_bench_file_describes_is_refused(expected: ImuIdentity) -> None:
    """A wrong serial number or model stops the night before it begins."""
    says = r"sim://imu: the unit says (serial 'SIM-0001'|model 'MFS'), '(014|STIM300)' is what the bench"
    with pytest.raises(WrongDevice, match=says):
        Bench(expected=expected).imu.identify()


def test_a_unit_that_cannot_be_asked_is_identified_by_its_frames() -> None:
    """Without a command the model's name is the description's, once a good frame arrived."""
    description = mfs().model_copy(update={"roles": mfs().roles.model_copy(update={"identity": None})})  # type: ignore[union-attr]
    clock = VirtualClock()
    transport = MemoryTransport(SimulatedImu(description, SteadyPhysics()), clock, "sim://imu")
    assert StreamImu(transport, description, clock).identify() == ImuIdentity("MFS")


def test_no_identity_is_said_with_its_cause() -> None:
    """Silence, bytes of another protocol, and a stream without an answer are three different things to look at."""
    stalled = Bench([FaultWindow(ImuFault.STALL), FaultWindow(ImuFault.SILENT_IDENTITY)])
    with pytest.raises(DeviceTimeout, match="nothing arrived; is the unit powered"):
        stalled.imu.identify()
    with pytest.raises(DeviceTimeout, match=r"the unit streamed \d+ good frames but did not say who it is"):
        Bench([FaultWindow(ImuFault.SILENT_IDENTITY)]).imu.identify()
    noisy = Bench(
        [
            FaultWindow(ImuFault.STALL),
            FaultWindow(ImuFault.SILENT_IDENTITY),
            FaultWindow(ImuFault.GARBAGE),
        ]
    )
    with pytest.raises(DeviceTimeout, match=r"\d+ bytes arrived but no good MFS frame .* check the baud rate"):
        noisy.imu.identify()
    assert noisy.clock.now() == pytest.approx(5.0, abs=0.2)


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
        bench.device._index.move_s = move_s
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


def test_a_lost_port_is_an_error_and_a_closed_driver_stays_closed() -> None:
    """Unplugged is not the same as silent."""
    bench = Bench()
    bench.transport.unplug()
    with pytest.raises(TransportError, match="sim://imu: the port is gone"):
        bench.imu.read_block()
    bench.transport.replug()
    bench.imu.read_block()
    bench.imu.close()
    with pytest.raises(TransportError, match="is closed"):
        bench.imu.read_block()


def test_a_lost_stream_makes_unsure_who_is_there_until_it_is_asked_again() -> None:
    """A port that failed, however short; two seconds without a frame; a counter that leaps without any silence."""
    lost = {
        "nothing": [],
        "short": [FaultWindow(ImuFault.STALL, 20.0, 21.0)],
        "silent": [FaultWindow(ImuFault.STALL, 20.0, 22.5)],
        "leaps": [FaultWindow(ImuFault.EXCHANGED, 20.0)],
        "failed": [],
    }
    for what, faults in lost.items():
        bench = Bench(faults)
        if what == "failed":
            bench.transport.unplug_between(20.0, 20.5)
        bench.imu.identify()
        while bench.clock.now() < 30.0:
            bench.clock.sleep(0.4)
            with suppress(TransportError):
                bench.imu.read_block()
        assert bench.imu.unsure == (what not in ("nothing", "short")), what
        bench.imu.identify()
        assert not bench.imu.unsure
