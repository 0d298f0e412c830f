"""What is random about a simulated unit, drawn so that the same seed gives the same bytes however it is polled.

Every kind of noise has its own stream of the seed. White noise is drawn once per sample and slow noise once per grid
point, both in time order; scatter from run to run is drawn by the number of the self-calibration, and that from collect
to collect by the number of the stay, not by when it is asked.
"""

from collections.abc import Mapping, Sequence
from itertools import accumulate

import numpy as np

from hil.campaign import FloatArray, IntArray
from hil.model.curve import Curve
from hil.model.effects.scatter import Scatter
from hil.twin.thermal import GRID_S

WHITE, RUNS, SUPPLY, _NAMED, COLLECTS = 0, 2, 3, 4, 5


def stream(seed: int, *key: int) -> np.random.Generator:
    """Return the stream of one kind of noise."""
    return np.random.default_rng(np.random.SeedSequence(seed, spawn_key=key))


def correlated(keep: float, steps: FloatArray, before: FloatArray) -> FloatArray:
    """Return x_k = keep x_(k-1) + steps_k, (m, p), from the x before the first, (p,): the same wherever interrupted."""
    columns = zip(steps.T.tolist(), before.tolist(), strict=True)
    return np.array([[*accumulate(own, lambda x, s: keep * x + s, initial=x)][1:] for own, x in columns]).T


class NamedNoise:
    """The coefficients of one part of an effect that scatters (`Scatter`), at unit size.

    What is the same within a group is drawn by its label, also after a resume; what wanders once per grid point, and
    what is white once per sample, in time order. `name` tells the part from all others.
    """

    def __init__(self, seed: int, session: int, name: Sequence[int], part: Scatter) -> None:
        self._seed, self._name, self._part = seed, name, part
        self._generator = stream(seed, _NAMED, *name, session)
        self._drawn: dict[int, FloatArray] = {}
        self._count = int(part.columns.shape[2])
        self._before = np.asarray(self._generator.standard_normal(self._count))  # the sample before the first
        self._from = 0
        self._wandered: FloatArray = np.zeros((0, self._count))  # at grid points from that one on

    def of_groups(self, labels: IntArray) -> FloatArray:
        """Return the coefficients of each row's group, (m, p), by the labels of the rows, (m,)."""
        for label in set(labels.tolist()) - set(self._drawn):
            own = stream(self._seed, _NAMED, *self._name, 0, label % 2**32)  # a power cycle may lie before 0
            self._drawn[label] = np.asarray(own.standard_normal(self._count))
        return np.array([self._drawn[label] for label in labels.tolist()])

    def on_grid(self, first: int, last: int) -> FloatArray:
        """Return the coefficients at grid points `first` to `last`, both included, (m, p); later never earlier ones."""
        known = self._from + len(self._wandered)
        if last >= known:
            keep, kick = (float(each[0]) for each in self._part.step(np.array([GRID_S / 3600.0])))
            steps = kick * self._generator.standard_normal((last + 1 - known, self._count))
            before = self._wandered[-1] if known else np.zeros(self._count)
            if not known:
                steps[0] = 0.0 if self._part.walk else self._before
            self._wandered = np.concatenate([self._wandered, correlated(keep, steps, before)])
        self._from, self._wandered = first, self._wandered[first - self._from :]
        return self._wandered[: last + 1 - first]

    def of_samples(self, samples: int) -> FloatArray:
        """Return the coefficients of the next samples, (samples, p): white, or the differences of a white angle."""
        white = self._generator.standard_normal((samples, self._count))
        if not self._part.of_angle or not samples:
            return white
        angles = np.concatenate([self._before[None], white])
        self._before = angles[-1]
        return np.asarray(np.diff(angles, axis=0) / np.sqrt(2.0))


def drawn_base(
    seed: int, key: Sequence[int], sizes: Mapping[str, Curve], factor: FloatArray, temperature_degC: float
) -> dict[str, float]:
    """Return departures of base parameters, drawn by `key`, as large as `sizes`, correlated by `factor` (k, k)."""
    names, at = sorted(sizes), np.array([temperature_degC])
    sigmas = np.array([float(sizes[name].at(at)[0]) for name in names])
    drawn = sigmas * (factor @ stream(seed, *key).standard_normal(len(names)))
    return dict(zip(names, drawn.tolist(), strict=True))
