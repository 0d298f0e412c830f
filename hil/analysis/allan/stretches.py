"""A series of rates cut into stretches without a gap."""

from dataclasses import dataclass

import numpy as np

from hil.campaign import FloatArray
from hil.errors import InputError

_GAP = 1.5  # a step longer than this many intervals is a gap
_UNEVEN = 0.05  # more steps than this far from the interval: not sampled evenly
_MOST = 1000
_STUCK = 50
_JUMP = 20.0  # times the usual step from sample to sample
_POSSIBLE_DEG_PER_HR = 1e10  # three million degrees per second


@dataclass(frozen=True)
class Recording:
    """One channel's rates, deg/hr, in gap-free `stretches`, (n,) each, of samples `interval_s` apart.

    `notes` say what a reader of the result must know: gaps, what was left out, what looks wrong.
    """

    name: str
    interval_s: float
    stretches: tuple[FloatArray, ...]
    simulated: bool = False
    notes: tuple[str, ...] = ()

    @property
    def samples(self) -> int:
        """How many samples all stretches have together."""
        return sum(len(each) for each in self.stretches)

    @property
    def longest_s(self) -> float:
        """The length of the longest stretch, s."""
        return max(len(each) for each in self.stretches) * self.interval_s


def cut(name: str, values: FloatArray, interval_s: float, time_s: FloatArray | None = None) -> list[FloatArray]:
    """Return the gap-free stretches of a series, shape (n,), cut at missing values and at gaps in `time_s`.

    Raises `InputError` where the times do not rise or the samples are not evenly spaced.
    """
    good = np.isfinite(values)
    broken = ~good[1:] | ~good[:-1]
    if time_s is not None:
        step = np.diff(time_s)
        if np.any(~np.isfinite(step)) or np.any(step <= 0):
            row = int(np.flatnonzero(~(step > 0))[0]) + 2
            raise InputError(f"{name}: sample {row}: times must be filled and rise from row to row")
        uneven = np.abs(step / interval_s - np.round(step / interval_s)) > 0.25
        if np.mean(uneven) > _UNEVEN:
            raise InputError(
                f"{name}: {np.mean(uneven):.0%} of the samples are not a whole number of intervals ({interval_s:g} s) "
                "apart; an Allan deviation needs evenly spaced samples"
            )
        broken |= step > _GAP * interval_s
    pieces = np.split(values, np.flatnonzero(broken) + 1)
    return [piece for piece in pieces if len(piece) and np.all(np.isfinite(piece))]


def sampling_interval(name: str, time_s: FloatArray) -> float:
    """Return the median step of the times (n,), s. Raises `InputError` where there are fewer than three."""
    if len(time_s) < 3:
        raise InputError(f"{name}: {len(time_s)} samples; an Allan deviation needs more")
    return float(np.median(np.diff(time_s)))


def recording(
    name: str, pieces: list[FloatArray], interval_s: float, *, simulated: bool = False, notes: tuple[str, ...] = ()
) -> Recording:
    """Gather stretches, (n,) each in deg/hr, as a recording, with notes about gaps and about what looks wrong.

    Raises `InputError` where no stretch is long enough, the rate never changes, or is larger than any rate can be.
    """
    usable = [piece for piece in pieces if len(piece) >= 4]
    if not usable:
        longest = max((len(piece) for piece in pieces), default=0)
        raise InputError(f"{name}: the longest stretch without a gap has {longest} samples; at least 4 are needed")
    said = list(notes)
    if len(pieces) > 1:
        said.append(f"{len(pieces)} stretches without a gap; differences are taken within each, never across a gap")
    if len(usable) > _MOST:
        usable = sorted(usable, key=len, reverse=True)[:_MOST]
        said.append(f"only the {_MOST} longest stretches are used")
    if all(np.ptp(piece) == 0.0 for piece in usable):
        raise InputError(f"{name}: the rate never changes; this is no measurement of noise")
    largest = max(float(np.abs(piece).max()) for piece in usable)
    if largest > _POSSIBLE_DEG_PER_HR:
        raise InputError(f"{name}: rates up to {largest:.3g} deg/hr; is the unit (--unit) or the column right?")
    said += _jumps(usable, interval_s)
    same = max(_longest_run(piece) for piece in usable)
    if same >= _STUCK:
        said.append(f"{same} samples in a row are exactly equal: was the stream stuck, or the file padded?")
    return Recording(name, interval_s, tuple(usable), simulated, tuple(said))


def _jumps(pieces: list[FloatArray], interval_s: float) -> list[str]:
    """Name samples that lie far from the one before: the fit takes a spike or a step for noise."""
    steps = np.concatenate([np.abs(np.diff(piece)) for piece in pieces])
    usual = float(np.median(steps))
    far = int(np.count_nonzero(steps > _JUMP * usual)) if usual > 0.0 else 0
    if not far:
        return []
    first_s = (int(np.argmax(steps > _JUMP * usual)) + 1) * interval_s
    said = (
        f"{far} steps from one sample to the next are more than {_JUMP:g} times the usual one (the first "
        f"{first_s:.6g} s into what was used): spikes or steps are no noise, and the fit takes them for it"
    )
    return [said]


def _longest_run(values: FloatArray) -> int:
    """Return how many samples in a row are exactly equal, at most."""
    changes = np.flatnonzero(np.diff(values) != 0.0)
    edges = np.concatenate([[-1], changes, [len(values) - 1]])
    return int(np.max(np.diff(edges)))
