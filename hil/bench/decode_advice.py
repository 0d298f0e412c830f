"""What to say about a recording that a frame description does not fit: what was seen, and what would fit.

    for sentence in misfit(Path("night.bin"), description, counts): ...

A wrong description gives no wrong numbers, but no numbers either; and a counter that is described wrongly gives good
frames with a false account of what is missing. Both are said in words.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator
from pathlib import Path

import numpy as np

from drivers.frames.batch import FrameBatch
from drivers.frames.counts import StreamCounts
from drivers.frames.decoder import StreamDecoder
from drivers.frames.description import CounterDescription, StreamDescription, load_description
from drivers.given_file import opened
from hil.errors import InputError
from hil.files.strict import config_folders

_LOOK = 1 << 16  # bytes from the beginning of a file that are tried with other descriptions
_FEW = 20  # frames from which on a counter's habit can be told


def misfit(path: Path, description: StreamDescription, counts: StreamCounts) -> Iterator[str]:
    """Say what was seen in a file of which most is in no frame, and which shipped description reads it; else nothing.

    `counts` are those of the whole file. Raise `InputError` where the file cannot be read.
    """
    size = path.stat().st_size
    if not counts.skipped_bytes or 2 * counts.skipped_bytes <= size:
        return
    with opened(path) as file:
        data = file.read(_LOOK)
    begun = sum(data.count(header) for name in description.frames for header in description.headers(name))
    what = "no good frame is" if not counts.ok else f"{counts.skipped_bytes} of {size} bytes are in no frame"
    said = f"{what} in {size} bytes" if not counts.ok else what
    times = "once" if begun == 1 else f"{begun} times"
    yield f"{said}: in the first {len(data)}, what begins a frame of {description.name} is there {times}"
    others = sorted(_that_read(data), reverse=True)
    for share, ok, name in others[:2]:
        yield f"{name} reads {share:.1%} of the first {len(data)} bytes as {ok} good frames: try --frames {name}"
    if others:
        return
    if counts.bad_checksum > begun / 2 > 2:
        yield "frames begin as described, but their checksums do not match: compare length and checksum with the manual"
    yield "no shipped description reads it: compare baud rate, word length and the unit's settings with the manual"


def _that_read(data: bytes) -> Iterator[tuple[float, int, str]]:
    """Try the shipped descriptions: of those that read most of `data`, which share, how many frames, and the name."""
    paths = {path.stem: path for folder in config_folders("imus") for path in folder.glob("*.yaml")}
    for name, path in paths.items():
        try:
            decoder = StreamDecoder(load_description(path))
        except InputError:
            continue
        counts = decoder.feed(data).counts + decoder.finish().counts
        share = 1.0 - counts.skipped_bytes / len(data)
        if share > 0.5:
            yield share, counts.ok, name


class CounterHabit:
    """How the counter of one frame type really moves, to be held against its description."""

    def __init__(self, frame: str, counter: CounterDescription) -> None:
        self._frame = frame
        self._counter = counter
        self._moves: Counter[int] = Counter()
        self._last: int | None = None
        self._most = 0

    def add(self, batch: FrameBatch) -> None:
        """Take the next good frames."""
        told = batch.told(self._counter.field)
        values = batch.wire(self._counter.field)[told].astype(np.int64)
        if not len(values):
            return
        self._most = max(self._most, int(values.max()))
        moves, times = np.unique(
            np.diff(values, prepend=values[:1] if self._last is None else self._last), return_counts=True
        )
        self._moves.update(dict(zip(moves.tolist(), times.tolist(), strict=True)))
        self._last = int(values[-1])
        for move, _ in self._moves.most_common()[256:]:
            del self._moves[move]

    def mistakes(self) -> Iterator[str]:
        """Say where step or modulus are not what the frames show; nothing where too few were seen."""
        counter, place = self._counter, f"frames.{self._frame}.counter"
        so_lost = "lost and duplicate mean nothing"
        if self._most >= counter.modulus:
            yield f"{place}.modulus: is {counter.modulus}, but {counter.field} goes up to {self._most}; {so_lost}"
            return
        ahead = Counter({move: times for move, times in self._moves.items() if move > 0})
        back = Counter({move: times for move, times in self._moves.items() if move < 0})
        if ahead.total() + back.total() < _FEW or not ahead:
            return
        step, times = ahead.most_common(1)[0]
        if 2 * times <= ahead.total() + back.total():
            return
        if step != counter.step:
            yield (
                f"{place}.step: is {counter.step}, but {counter.field} moves by {step} from frame to frame; {so_lost}. "
                "Is the sample rate (--rate) the unit's?"
            )
        if not back:
            return
        fall, turns = back.most_common(1)[0]
        if turns > 1 and 2 * turns > back.total() and step - fall != counter.modulus:
            yield f"{place}.modulus: is {counter.modulus}, but {counter.field} comes round at {step - fall}; {so_lost}"
