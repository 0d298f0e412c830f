"""How the unit lies, by its own accelerometers, against how it should lie: and if not so, how it looks instead.

At rest an accelerometer shows the component of f along its axis (the acceleration reaction G of RD-GC-86-1, +1 g along
the axis that is up). What is measured (m), what the orientation table and the site give (e), and how far they may be
apart are arrays; a cause is something that turns e into what would be measured if it were so. The first cause under
which nothing departs any more is named; where two are as good, both are. Arrays of f have shape (n, s, 3): n collects,
s sensors, g along the sensor's axes; NaN in m where there is no accelerometer.
"""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import permutations, product

import numpy as np
from numpy.typing import NDArray

from drivers.frames.wire import FloatArray

BoolArray = NDArray[np.bool_]

STANDARD_GRAVITY_M_PER_S2 = 9.80665
_GAINS = {STANDARD_GRAVITY_M_PER_S2: "m/s², not in g", 1000.0: "milli-g, not in g"}
_LEAST_SEEN_G = 0.5  # a gain is seen only in a component of this size


@dataclass(frozen=True)
class PoseTolerance:
    """How far a unit's accelerometers may be from what the orientation table and the site give at rest.

    `bias_g` and `scale` are what the accelerometers may be wrong by, `fixture_deg` how far the unit may lie from its
    pose. Far more than a laboratory's grade of either, far less than another position. Raises `ValueError` where a
    number is negative, or so large that no pose could be told from another.
    """

    bias_g: float = 0.03
    scale: float = 0.03
    fixture_deg: float = 2.0

    def __post_init__(self) -> None:
        for name, largest in (("bias_g", 0.3), ("scale", 0.3), ("fixture_deg", 20.0)):
            if not 0.0 <= getattr(self, name) <= largest:
                raise ValueError(f"pose: {name} must lie between 0 and {largest:g}, not {getattr(self, name)}")

    def allowed_g(self, f_g: FloatArray) -> FloatArray:
        """Return how far each component of `f_g`, any shape, g, may be from what is measured."""
        across = np.sqrt(np.clip(1.0 - f_g**2, 0.0, 1.0))  # a small turn changes a component by what lies across it
        return np.asarray(self.bias_g + self.scale * np.abs(f_g) + np.deg2rad(self.fixture_deg) * across)

    def departs(self, measured_g: FloatArray, expected_g: FloatArray) -> BoolArray:
        """Return where a sensor, (n, s), of measured and expected (n, s, 3) is further off than is allowed."""
        off = np.abs(measured_g - expected_g) > self.allowed_g(expected_g)  # NaN: False
        return np.asarray(np.any(off, axis=-1))


@dataclass(frozen=True)
class Contradiction:
    """What is contradicted: in which collects, (n,), in words, of which sensor; `seen` is the position where sure."""

    collects: BoolArray
    words: str
    sensor: int | None = None
    seen: str = ""


@dataclass(frozen=True)
class PoseTable:
    """A unit's poses: by position, f along the axes of s sensors, (s, 3), g; `axes` names these by sensor number."""

    axes: Mapping[int, Sequence[str]]
    poses: Mapping[str, FloatArray]
    tolerance: PoseTolerance = PoseTolerance()

    def measured(self, accelerations_g: Mapping[int, Mapping[str, float | None]]) -> FloatArray:
        """Return what is known of f by sensor and axis as an array (1, s, 3), NaN where it is not known."""
        table = [
            [np.nan if (v := accelerations_g.get(number, {}).get(axis)) is None else v for axis in axes]
            for number, axes in self.axes.items()
        ]
        return np.array([table], dtype=np.float64).reshape(1, len(self.axes), 3)

    def contradiction(self, position: str, accelerations_g: Mapping[int, Mapping[str, float | None]]) -> str:
        """Return in words what the accelerations of one collect at `position` contradict, or nothing."""
        expected = self.poses.get(position)
        if expected is None:
            return ""
        found = self.contradictions([position], self.measured(accelerations_g), expected[None])
        return "; ".join(each.words for each in found)

    def contradictions(
        self, positions: Sequence[str], measured_g: FloatArray, expected_g: FloatArray
    ) -> list[Contradiction]:
        """Return what `measured_g` contradicts of `expected_g`, both (n, s, 3), at the n `positions`."""
        off = self.tolerance.departs(measured_g, expected_g)
        wrong: BoolArray = np.asarray(off.any(axis=1))
        if not wrong.any():
            return []
        labels = np.asarray(positions)
        numbers = list(self.axes)
        lies = list(self._lies_elsewhere(labels, wrong, measured_g))
        poses = len(np.unique(np.round(expected_g, 1), axis=0))
        if lies and poses == 1:  # one pose alone says nothing about the accelerometers that another pose does not
            causes: dict[int, str] = {}
        else:
            causes = {
                k: f"sensor {numbers[k]}: {cause}"
                for k in np.flatnonzero(off.any(axis=0)).tolist()
                if (cause := self._cause(k, measured_g, expected_g))
            }
        left = np.asarray(wrong & ~np.any([each.collects for each in lies], axis=0)) if lies else wrong
        if lies and not left.any():  # every collect has its pose: whether axes are turned instead cannot be told
            all_have = len(causes) == np.count_nonzero(off.any(axis=0))
            instead = f" (or else {'; '.join(causes.values())})" if all_have else ""
            return [replace(each, words=each.words + instead, seen="") if instead else each for each in lies]
        unexplained = np.asarray(off[:, [k for k in range(off.shape[1]) if k not in causes]].any(axis=1))
        if causes:
            found = [Contradiction(off[:, k], cause, numbers[k]) for k, cause in causes.items()]
            return [*found, *self._unexplained(labels, unexplained, measured_g, expected_g)]
        return [*lies, *self._unexplained(labels, left, measured_g, expected_g)]

    def _lies_elsewhere(
        self, labels: NDArray[np.str_], wrong: BoolArray, measured_g: FloatArray
    ) -> Iterator[Contradiction]:
        for asked in dict.fromkeys(labels[wrong].tolist()):
            rows = wrong & (labels == asked)
            for seen, f_g in self.poses.items():
                alike = rows & ~self.tolerance.departs(measured_g, f_g[None]).any(axis=1)
                if seen != asked and alike.any():
                    words = f"position {asked} was asked for, but the unit lies as in position {seen}"
                    yield Contradiction(alike, words, seen=seen)

    def _cause(self, k: int, measured_g: FloatArray, expected_g: FloatArray) -> str:
        """Return what is wrong with the accelerometers of the k-th sensor in all collects alike, or nothing."""
        m, e = measured_g[:, k : k + 1], expected_g[:, k : k + 1]
        if np.all(m[np.isfinite(m)] == 0.0):
            return "its accelerometers show exactly 0 g: they are not being measured"
        for gain, unit in _GAINS.items():
            if not self.tolerance.departs(m / gain, e).any():
                return f"its accelerometers seem to be in {unit}"
        measured = np.flatnonzero(np.isfinite(m).any(axis=(0, 1))).tolist()
        words = [
            (changes, said)
            for changes, said, turned in _turned(list(self.axes.values())[k], measured, e)
            if not self.tolerance.departs(m, turned).any()
        ]
        if words:
            fewest = min(changes for changes, _ in words)
            return " or ".join(dict.fromkeys(said for changes, said in words if changes == fewest))
        seen = np.isfinite(m) & (np.abs(e) > _LEAST_SEEN_G)
        if seen.any():
            gain = float(np.sum(m[seen] * e[seen]) / np.sum(e[seen] ** 2))
            if gain > 0.0 and not self.tolerance.departs(m / gain, e).any():
                return f"its accelerometers show {gain:.2f} times what gravity is: |f| is not 1 g"
        return ""

    def _unexplained(
        self, labels: NDArray[np.str_], rows: BoolArray, measured_g: FloatArray, expected_g: FloatArray
    ) -> Iterator[Contradiction]:
        for asked in dict.fromkeys(labels[rows].tolist()):
            here = rows & (labels == asked)
            first = int(np.flatnonzero(here)[0])
            excess = np.abs(measured_g[first] - expected_g[first]) / self.tolerance.allowed_g(expected_g[first])
            k, axis = np.unravel_index(int(np.nanargmax(excess)), excess.shape)
            number, names = list(self.axes.items())[int(k)]
            words = (
                f"position {asked} was asked for, but sensor {number} shows {measured_g[first, k, axis]:+.3f} g along "
                f"{names[int(axis)]} where {expected_g[first, k, axis]:+.3f} g belong, as in no position of the table"
            )
            yield Contradiction(here, words, number)


def _turned(
    axes: Sequence[str], measured: Sequence[int], expected_g: FloatArray
) -> Iterator[tuple[tuple[int, int], str, FloatArray]]:
    """Yield how many axes and signs are concerned, words, and `expected_g`, (n, 1, 3), with axes turned or dead."""
    for dead in measured:
        yield (1, 0), f"its accelerometer {axes[dead]} measures nothing", expected_g * (np.arange(3) != dead)
    for order in permutations(range(3)):
        for signs in product((1, -1), repeat=3):
            moved = [i for i in measured if order[i] != i]
            turned = [i for i in measured if signs[i] < 0]
            if not moved and not turned:
                continue
            words = []
            if moved and all(order[order[i]] == i for i in moved) and not set(moved) & set(turned):
                names = sorted({axes[i] for i in moved} | {axes[order[i]] for i in moved})
                words.append(f"its accelerometers {' and '.join(names)} are exchanged")
                moved = []
            words += [f"its accelerometer {axes[i]} shows {'minus ' * (i in turned)}{axes[order[i]]}" for i in moved]
            alone = [axes[i] for i in turned if i not in moved]
            if alone:
                words.append(f"the sign of its accelerometer{'s' * (len(alone) > 1)} {' and '.join(alone)} is turned")
            changes = (len({*turned, *(i for i in measured if order[i] != i)}), len(turned))
            yield changes, " and ".join(words), expected_g[..., list(order)] * np.array(signs, dtype=np.float64)
