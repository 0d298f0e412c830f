"""A live stream over a pseudo-terminal: an hour of it a hundred times faster, and some of it in real time.

    pytest benchmarks/test_live.py -s

The hour is 7.2 million frames of 59 bytes (2 kHz). A process of its own sends; the live reader drains; the decoder
looks every 20 ms. No byte may be missing. Where other programs hold the decoder up, the sender waits for it: a hundred
times real time, the three minutes of the reader's queue are less than two seconds. In real time, with a look every
0.5 s, the share of one core that reader and decoder take is printed.
"""

from __future__ import annotations

import os
import resource
import signal
import subprocess
import sys
import time
from pathlib import Path

import numpy as np
import pytest

from drivers.clock import SystemClock
from drivers.frames.counts import StreamCounts
from drivers.frames.description import load_description
from drivers.frames.layout import encode
from drivers.imu.stream import StreamImu
from drivers.transports import open_port
from drivers.transports.live_reader import LiveReader

_MFS = load_description(Path(__file__).resolve().parents[1] / "configs" / "imus" / "mfs.yaml", sample_rate_hz=2000.0)
_BEHIND = 1 << 22  # bytes in one look, of 0.24 MB that a look brings, that tell of a decoder that was held up
_TURN = 65536  # frames in which the counter comes round

# Sends a file over and over: so many turns, each frame when it is due.
_SENDER = """
import os, sys, time
descriptor, turns, rate, path = int(sys.argv[1]), float(sys.argv[2]), float(sys.argv[3]), sys.argv[4]
data = open(path, "rb").read()
total, sent, begins = int(turns * len(data)) // 59 * 59, 0, time.monotonic()
while sent < total:
    allowed = min(total, int((time.monotonic() - begins) * rate) * 59)
    if allowed <= sent:
        time.sleep(0.0005)
        continue
    at = sent % len(data)
    sent += os.write(descriptor, data[at : at + min(65536, allowed - sent)])
"""


def receive(tmp_path: Path, frames: int, rate: float, look_s: float = 0.02) -> tuple[StreamCounts, float, float]:
    """Send so many frames over a terminal and read them; return the counts, seconds and seconds of processor time."""
    path = tmp_path / "turn.bin"
    path.write_bytes(encode(_MFS, "sample", {"counter": np.arange(_TURN)}))
    master, slave = os.openpty()
    clock = SystemClock()
    imu = StreamImu(LiveReader(open_port(os.ttyname(slave), clock=clock), clock), _MFS, clock)
    sender = subprocess.Popen(
        [sys.executable, "-c", _SENDER, str(master), str(frames / _TURN), str(rate), str(path)], pass_fds=[master]
    )
    decoder = imu._decoder  # an hour in seconds is no hour on the clock: leave out what places samples in time
    counts, begins, used = StreamCounts(), time.perf_counter(), time.process_time()
    while counts.ok < frames and time.perf_counter() - begins < 10.0 + 4.0 * frames / rate:
        time.sleep(look_s)
        data = imu.transport.read_available()
        if len(data) > _BEHIND:
            sender.send_signal(signal.SIGSTOP)
        decoded = decoder.feed(data, clock.now())
        counts += decoded.counts
        assert len(decoded["sample"].columns["rate_A2"]) == decoded.counts.ok
        sender.send_signal(signal.SIGCONT)
    elapsed, used = time.perf_counter() - begins, time.process_time() - used
    assert sender.wait(10) == 0
    reader = imu.transport
    assert isinstance(reader, LiveReader)
    counts += StreamCounts(overflow_bytes=reader.take_overflow())
    imu.close()
    os.close(master)
    os.close(slave)
    return counts, elapsed, used


@pytest.mark.timeout(300)
def test_an_hour_at_2_kHz_loses_no_byte(tmp_path: Path) -> None:
    """7.2 million frames a hundred times faster than they would come; memory stays what it was."""
    receive(tmp_path, 400_000, 200_000.0)
    before = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    counts, elapsed, used = receive(tmp_path, 7_200_000, 200_000.0)
    grown = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss - before
    print(f"\n7.2 M frames in {elapsed:.1f} s ({3600 / elapsed:.0f} × real time), {used:.1f} s of processor time, ")
    print(f"memory grew by {grown / 1024:.1f} MB")
    assert counts == StreamCounts(ok=7_200_000)
    assert grown < 50 * 1024


def test_2_kHz_in_real_time_take_a_small_share_of_a_core(tmp_path: Path) -> None:
    """Ten seconds, looked at every 0.5 s, as a controller does."""
    counts, elapsed, used = receive(tmp_path, 20_000, 2000.0, look_s=0.5)
    print(f"\n2 kHz in real time: {100 * used / elapsed:.1f} % of a core")
    assert counts == StreamCounts(ok=20_000)
