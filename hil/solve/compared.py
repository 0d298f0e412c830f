"""What explains best what values of one temperature differ by: a column, or a jump between two of them.

    own = Compared.of(values, sd, errors, group, compared, run)
    columns, jump, apart = own.explained("deg/hr", drivers, None)

Everything is asked of values less what the temperature does to them: each has its own value, or, where each was gone to
once, all lie about a curve, as far as runs of one temperature scatter. What scatters is what each leaves (an F test).
"""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import Self

import numpy as np
from scipy.special import chdtrc, fdtrc

from hil.campaign import FloatArray, IntArray
from hil.solve.identifiability import orthonormal, project_out
from hil.solve.uncertain import RARE

_VERY_RARE = 0.1 * RARE  # chance of a jump that is none, where more than noise scatters: runs are judged by it
_USUAL = 0.05  # chance of noise that is no larger
_BETTER = 6.0  # twice the log of how much likelier one of two makes what is seen, 20 times: it alone is told
DRIFT = 3  # order in time, and of a curve over temperature, of what is no jump
_SAME = 0.999  # of its square: a column that has so much of time is no other
UNSEEN = 1e-6  # of a column: what differs by less at any temperature, or by rounding alone, explains nothing
_JUMP = 2  # what is fitted of a jump: its size and its place
_NOTHING = 1e-12  # of the whole: what arithmetic leaves
TIME, WAY = "time", "the way to a temperature"


@dataclass(frozen=True)
class Jump:
    """By how much, in `unit`, a parameter is another somewhere between a run `before` and one `after`; `sd` of that.

    `alone`: one run alone may be another than all others, as it certainly is where that run is both. Where each
    temperature was gone to `once` it is off a curve, which may be what the unit does there.
    """

    size: float
    sd: float
    unit: str
    before: int
    after: int
    alone: bool = False
    once: bool = False


Places = list[tuple[int, int]] | None
"""Runs before and after, between which alone a jump is asked about; None: anywhere."""
Answer = tuple[tuple[str, ...], Jump | None, list[int]]
"""Columns that explain what values differ by; or a jump that does, and the runs that others contradict across it."""


@dataclass(frozen=True)
class Compared:
    """Values (m,) in the order of time, of runs or means of visits, each in one `group`; `whose` (r,) a run's is.

    With each its first run and its last, by their `number` (m, 2), and how much of its variance is its `noise`'s (m,).
    What is weighed by the `root` of the weight is less what the temperature does to it, an orthonormal basis (m, g).
    So many degrees of freedom as are `known` tell the noise beside what is left.
    """

    values: FloatArray
    root: FloatArray
    noise: FloatArray
    group: IntArray
    temperature: FloatArray
    whose: IntArray
    share: FloatArray
    number: IntArray
    run: IntArray
    known: float

    @classmethod
    def of(
        cls,
        values: FloatArray,
        sd: FloatArray,
        errors: FloatArray,
        group: IntArray,
        compared: IntArray,
        run: IntArray,
        degC: FloatArray | None = None,
        known: float = 0.0,
    ) -> Self:
        """Take together what is to be compared together; runs are in the order of time.

        Each group has a value of its own; along `degC` (r,), if given, all have a curve.
        """
        _, first, whose = np.unique(compared, return_index=True, return_inverse=True)
        weight = _sums(whose, sd**-2.0)
        share, root, group = sd**-2.0 / weight[whose], np.sqrt(weight), group[first]
        last = len(whose) - 1 - np.unique(compared[::-1], return_index=True)[1]
        ends = np.stack([run[first], run[last]], axis=1)
        noise = weight * _sums(whose, (share * np.nan_to_num(errors)) ** 2)
        does = np.equal.outer(group, np.unique(group)).astype(np.float64)
        if degC is not None:
            does = curve_over(degC[first], len(first))
        temperature = orthonormal(root[:, None] * does)
        return cls(_sums(whose, share * values), root, noise, group, temperature, whose, share, ends, run, known)

    def beside(self, columns: FloatArray) -> FloatArray:
        """Return columns (m, q) less what the temperature does, weighed."""
        return project_out(self.temperature, columns * self.root[:, None])

    def explained(self, unit: str, drivers: Sequence[tuple[str, FloatArray]], places: Places) -> Answer:
        """Return the columns (r, q) that explain best what values differ by at one temperature; or the jump that does.

        Neither where what explains it may be chance, or is history.
        """
        seen = self.beside(self.values[:, None])[:, 0]
        whole, freedom = float(seen @ seen), len(seen) - self.temperature.shape[1]
        if freedom <= _JUMP or whole <= (_NOTHING * float(np.linalg.norm(self.root * self.values))) ** 2:
            return (), None, []
        product, norm, first, last = self._jumps(seen)
        seen_at = norm > UNSEEN * norm.max(initial=0.0)
        if places is not None:
            ends = np.stack([self.number[first, 1], self.number[last, 0]])
            seen_at &= np.any([(ends[0] >= one) & (ends[1] <= other) for one, other in places], axis=0)
        there = np.flatnonzero(seen_at)
        (product, norm), (first, last) = (product[there], norm[there]), (first[there], last[there])
        left, tried = np.maximum(whole - product**2 / norm, 0.0), [*self._tried(drivers, seen)]
        of_steps = _score(left, whole, freedom, _JUMP)
        of_drivers = np.array([_score(whole - shown, whole, freedom, q) for _, shown, q in tried])
        best_step, best = of_steps.min(initial=np.inf), of_drivers.min(initial=np.inf)
        if self._uneven(seen, whole, freedom) < min(best_step, best):  # which no one run, nor column, makes
            return (), None, []
        among = len(there) + len(tried) * (places is None)
        if best_step + _BETTER < best:
            k, alike = int(np.argmin(of_steps)), of_steps < best_step + _BETTER
            by_noise = max(float(np.mean(self.noise)), _NOTHING)  # that makes what is left, and hardly what goes
            usual = chdtrc(freedom - 1, left[k] / by_noise) > _USUAL
            usual &= chdtrc(1, (whole - left[k]) / by_noise) < _VERY_RARE**2
            rare = RARE if usual or places is not None else _VERY_RARE
            known, more = (self.known, self.known * by_noise) if usual else (0.0, 0.0)
            if _chance(float(left[k]) + more, whole + more, freedom + known, 1) * among < rare:
                sd = float(np.sqrt(left[k] / (freedom - _JUMP + 1) / norm[k]))
                start, end = int(first[alike].min()), int(last[alike].max())
                both = np.intersect1d(self.group[: last[k]], self.group[last[k] :])
                parted = np.isin(self.group, both) if first[k] < last[k] else self.group == self.group[first[k]]
                runs = self.whose == start if start == end else parted[self.whose]
                after = -1.0 if first[k] == last[k] == start < end else 1.0  # what is off there is what goes, and comes
                size, before, then = product[k] / norm[k], int(self.number[start, 1]), int(self.number[end, 0])
                alone = bool(np.any(first[alike] == last[alike]))
                return (), Jump(after * float(size), sd, unit, before, then, alone), self.run[runs].tolist()
        elif best < best_step and places is None:
            _, shown, fitted = tried[int(np.argmin(of_drivers))]
            names = dict.fromkeys(name for (name, *_), of in zip(tried, of_drivers, strict=True) if of < best + _BETTER)
            if _chance(whole - shown, whole, freedom, fitted) * among < RARE:
                return tuple(names), None, []
        return (), None, []

    def _uneven(self, seen: FloatArray, whole: float, freedom: int) -> float:
        """Return the score of values that scatter more at one temperature, whichever that is best."""
        squares, count = _sums(self.group, seen**2), np.bincount(self.group) - 1.0
        here, rest = squares / np.maximum(count, 1.0), np.maximum(whole - squares, _NOTHING * whole)
        others = rest / np.maximum(freedom - count, 1.0)
        more = (count > 0.0) & (here > others)
        logs = count * np.log(np.where(more, here, 1.0)) + (freedom - count) * np.log(others)
        scores = logs - freedom * np.log(whole / freedom) + _JUMP * np.log(freedom)
        return float(np.min(scores, where=more, initial=np.inf))

    def _tried(self, drivers: Sequence[tuple[str, FloatArray]], seen: FloatArray) -> Iterator[tuple[str, float, int]]:
        """Yield by name the squares of what is seen that each of some columns (r, q) explains, and by how many."""
        time = np.zeros((len(seen), 0))
        for name, columns in drivers:
            shown = self.beside(np.stack([_sums(self.whose, self.share * of) for of in columns.T], axis=1))
            basis = orthonormal(shown, UNSEEN)
            if name == TIME and not time.size:
                time = basis
            same = name not in (TIME, WAY) and np.sum((time.T @ basis) ** 2) > _SAME
            if np.sum(shown**2) > UNSEEN**2 * (self.root @ self.root) and not same:
                yield name, float(np.sum((basis.T @ seen) ** 2)), basis.shape[1]

    def _jumps(self, seen: FloatArray) -> tuple[FloatArray, FloatArray, IntArray, IntArray]:
        """Return of a step after each value, and of each value alone, its product with what is seen, and its square.

        And the last value before it and the first after it, which is one where a value is alone; (2 m - 1,) each. Means
        of several runs are none that one run alone makes.
        """
        place, weight = np.arange(len(seen)), self.root**2
        does = self.root[:, None] * self.temperature
        by_step = np.cumsum(weight) - np.sum(np.cumsum(does, axis=0) ** 2, axis=1)
        alone = (weight - np.sum(does**2, axis=1)) * (np.bincount(self.whose) == 1)
        product = np.concatenate([-np.cumsum(self.root * seen)[:-1], self.root * seen])
        first, last = (np.concatenate([of, place]) for of in (place[:-1], place[1:]))
        return product, np.concatenate([by_step[:-1], alone]), first, last


def curve_over(degC: FloatArray, told_at: int, more: int = 0) -> FloatArray:
    """Return what a curve over temperatures (n,) is made of, (n, order + 1), the highest order first.

    It has half as many values as it is `told_at`, and as many `more` as are asked for.
    """
    order = max(min(DRIFT, told_at // 2 - 1), 0) + more
    return np.vander((degC - degC.mean()) / max(float(np.ptp(degC)), 1.0), order + 1)


def _sums(whose: IntArray, of_each: FloatArray) -> FloatArray:
    """Return the sums (m,) of what is whose, (r,) each."""
    return np.bincount(whose, of_each).astype(np.float64)


def _score(left: FloatArray | float, whole: float, freedom: int, fitted: int) -> FloatArray:
    """Return twice the log of how much less likely values are with what leaves so much of the whole (BIC)."""
    return np.asarray(freedom * np.log(np.maximum(left / whole, _NOTHING)) + fitted * np.log(freedom))


def _chance(left: float, whole: float, freedom: float, fitted: int) -> float:
    """Return the chance of so little left of what only scatters."""
    rest = freedom - fitted
    if rest < 1:
        return 1.0
    return float(fdtrc(fitted, rest, (whole - left) / fitted / max(left / rest, _NOTHING * whole)))
