"""The IMU driver: samples on the bench's clock, stale bytes left out, identity confirmed or refused."""

from __future__ import annotations

from contextlib import suppress

import numpy as np
import pytest

from drivers.clock import VirtualClock
from drivers.errors import DeviceTimeout, TransportError, WrongDevice
from drivers.frames.layout import encode
from drivers.imu import ImuIdentity
from drivers.imu.stream import StreamImu
from drivers.simulators.memory import MemoryTransport
from drivers.simulators.unit import FaultWindow, ImuFault, SimulatedImu
from tests.drivers.frames.streams import SteadyPhysics, mfs
from tests.drivers.imu.simulated_unit import Bench, joined


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


@pytest.mark.slow
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
        transport = MemoryTransport(SimulatedImu(mfs(rate_hz), SteadyPhysics()), clock, "sim://imu")
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
    with pytest.raises(DeviceTimeout, match=r"the unit streamed good frames \(\d+\) but did not say who it is"):
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


def test_a_lost_port_is_an_error_and_a_closed_driver_stays_closed() -> None:
    """Unplugged is not the same as silent."""
    bench = Bench()
    bench.transport.pulled_between.append((0.0, 1.0))
    with pytest.raises(TransportError, match="sim://imu: the port is gone"):
        bench.imu.read_block()
    bench.clock.sleep(1.0)
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
            bench.transport.pulled_between.append((20.0, 20.5))
        bench.imu.identify()
        while bench.clock.now() < 30.0:
            bench.clock.sleep(0.4)
            with suppress(TransportError):
                bench.imu.read_block()
        assert bench.imu.unsure == (what not in ("nothing", "short")), what
        bench.imu.identify()
        assert not bench.imu.unsure
