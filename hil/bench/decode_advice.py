"""What to say about a recording that a frame description does not fit: what was seen, and what would fit.

    for sentence in misfit(Path("night.bin"), description, counts): ...

A wrong description gives no wrong numbers, but no numbers either; and a counter that is described wrongly gives good
frames with a false account of what is missing. Both are said in words.
"""

import math
import re
from collections import Counter
from collections.abc import Iterator
from pathlib import Path

import numpy as np

from drivers.frames.batch import FrameBatch
from drivers.frames.counts import StreamCounts
from drivers.frames.decoder import StreamDecoder
from drivers.frames.description import FrameDescription, StreamDescription, load_description
from drivers.frames.roles import CounterDescription
from drivers.given_file import opened
from hil.errors import InputError
from hil.files.strict import config_folders
from procedures.words import counted

_LOOK = 1 << 16  # bytes from the beginning of a file that are tried with other descriptions
_FEW = 10  # frames from which on a counter's habit can be told
_JITTER = 0.01  # of a clock that stamps frames
_OFF = 0.05  # a clock, and a rate that was heard for two seconds, may be off by so much


def misfit(path: Path, description: StreamDescription, counts: StreamCounts) -> Iterator[str]:
    """Say what was seen in a file of which most is in no frame, and which shipped description reads it; else nothing.

    `counts` are those of the whole file. Raise `InputError` where the file cannot be read.
    """
    size = path.stat().st_size
    if not counts.skipped_bytes or 2 * counts.skipped_bytes <= size:
        return
    with opened(path) as file:
        data = file.read(_LOOK)
    headers = [
        header for name, each in description.frames.items() if not each.parts for header in description.headers(name)
    ]
    begun = sum(1 for header in headers for _ in re.finditer(header.pattern, data, re.DOTALL))
    what = "no good frame is" if not counts.ok else f"{counts.skipped_bytes} of {size} bytes are in no frame"
    said = f"{what} in {size} bytes" if not counts.ok else what
    times = "once" if begun == 1 else f"{begun} times"
    yield f"{said}: in the first {len(data)}, what begins a frame of {description.name} is there {times}"
    others = sorted(that_read(data), reverse=True)
    for share, ok, name in others[:2]:
        read = f"{share:.1%} of the first {len(data)} bytes as {counted(ok, 'good frame')}"
        yield f"{name} reads {read}: try --frames {name}"
    if others:
        return
    if counts.bad_checksum > begun / 2 > 2:
        advice = "compare length, checksum and the byte order of both with the manual"
        yield f"frames begin as described, but their checksums do not match: {advice}"
    yield "no shipped description reads it: compare baud rate, word length and the unit's settings with the manual"


def that_read(data: bytes, least: float = 0.5) -> Iterator[tuple[float, int, str]]:
    """Try the shipped descriptions: of those that read more than `least`, the share, how many frames, and the name."""
    paths = {path.stem: path for folder in config_folders("imus") for path in folder.glob("*.yaml")}
    for name, path in paths.items():
        try:
            decoder = StreamDecoder(load_description(path))
        except InputError:
            continue
        counts = decoder.feed(data).counts + decoder.finish().counts
        share = 1.0 - counts.skipped_bytes / len(data)
        if share > least and counts.ok:
            yield share, counts.ok, name


class CounterHabit:
    """How the counter (or the clock) of one frame type really moves, to be held against its description.

    `rate_hz` is at which frames come: as described, or better, as heard.
    """

    def __init__(self, name: str, frame: FrameDescription, rate_hz: float) -> None:
        self._name = name
        self._told_by = frame.counter or frame.time
        self._rate_hz = rate_hz
        self._moves: Counter[int] = Counter()
        self._last: int | None = None
        self._most = 0

    def add(self, batch: FrameBatch) -> None:
        """Take the next good frames."""
        if self._told_by is None:
            return
        told = batch.told(self._told_by.field)
        values = batch.wire(self._told_by.field)[told].astype(np.int64)
        if not len(values):
            return
        self._most = max(self._most, int(values.max()))
        moves, times = np.unique(np.diff(values if self._last is None else [self._last, *values]), return_counts=True)
        self._moves.update(dict(zip(moves.tolist(), times.tolist(), strict=True)))
        self._last = int(values[-1])
        for move, _ in self._moves.most_common()[256:]:
            del self._moves[move]

    def mistakes(self) -> Iterator[str]:
        """Say where step, resolution or modulus are not what the frames show; nothing where too few were seen."""
        told_by = self._told_by
        if told_by is None:
            return
        place = f"frames.{self._name}.{'counter' if isinstance(told_by, CounterDescription) else 'time'}"
        so_lost, field, modulus = "lost and duplicate mean nothing", told_by.field, told_by.modulus
        if modulus is not None and self._most >= modulus:
            yield f"{place}.modulus: is {modulus}, but {field} goes up to {self._most}; {so_lost}"
            return
        ahead = sorted(Counter({move: times for move, times in self._moves.items() if move > 0}).elements())
        back = Counter({move: times for move, times in self._moves.items() if move < 0})
        if len(ahead) + back.total() < _FEW or not ahead:
            return
        usual = ahead[len(ahead) // 2]
        near = [move for move in ahead if abs(move - usual) <= max(1.0, _JITTER * usual)]
        if 2 * len(near) <= len(ahead) + back.total():
            return
        step = sum(near) / len(near)
        asks = f"{so_lost}. Is the sample rate (--rate, imu.rate) the unit's?"
        if not isinstance(told_by, CounterDescription):
            if abs(step * told_by.resolution * self._rate_hz - 1.0) > _OFF:
                yield (
                    f"{place}.resolution: is {told_by.resolution:.4g} s, but {field} moves by {step:.6g} from frame to "
                    f"frame, which at {self._rate_hz:.4g} Hz is {_tick(step * self._rate_hz)}; {asks}"
                )
        elif near[0] != near[-1] and abs(step - told_by.step) > 0.5 and usual > 2:
            tick = _tick(step * self._rate_hz)
            yield (
                f"{place}: {field} counts no frames: it moves by {near[0]} to {near[-1]} from frame to frame, so that "
                f"at {self._rate_hz:.4g} Hz the counter is a clock of {tick}; describe it as time: {{field: {field}, "
                f"resolution: {tick.removesuffix(' s')}, modulus: {modulus}}} in the place of counter. {asks}"
            )
        elif usual != told_by.step:
            yield f"{place}.step: is {told_by.step}, but {field} moves by {usual} from frame to frame; {asks}"
        if not back:
            return
        fall, turns = back.most_common(1)[0]
        if turns > 1 and 2 * turns > back.total() and near[0] == near[-1] and usual - fall != modulus:
            yield f"{place}.modulus: is {modulus}, but {field} comes round at {usual - fall}; {so_lost}"


def _tick(per_second: float) -> str:
    """Return what one count of a clock is worth: one that clocks have, where it is near."""
    usual = [2.0**n for n in range(10, 25)] + [10.0**n for n in range(2, 10)]
    nearest = min(usual, key=lambda each: abs(math.log(per_second / each)))
    return f"1/{nearest if abs(nearest / per_second - 1.0) < _OFF else round(per_second):.0f} s"


def wrong_counter(description: StreamDescription, raw: bytes, rate_hz: float) -> Iterator[str]:
    """Say what a described counter or clock is not, by the frames in `raw`, which came at `rate_hz`."""
    name = "" if description.roles is None else description.roles.frame
    habit = CounterHabit(name, description.frames[name], rate_hz)
    habit.add(StreamDecoder(description).feed(raw)[name])
    yield from habit.mistakes()
