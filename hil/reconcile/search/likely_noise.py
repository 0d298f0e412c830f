"""Which noise a block of rows leaves probable: from every model of it to the few that are worth weighing sets at.

What the rows are to every model of the noise is said once, by inner products of a few columns; how the base's values
follow temperature then costs matrices of the size of a sweep, however many rows there are.
"""

from collections.abc import Container, Iterator, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from itertools import pairwise

import numpy as np
from scipy.linalg.blas import dtrsm

from hil.campaign import BoolArray, FloatArray, IntArray
from hil.model.effects.prior import log_sum
from hil.reconcile.search.evidence import LEAST, ROUNDING, SEEN, Scale, eliminated, student
from hil.reconcile.search.noise import TOGETHER, Noise
from hil.reconcile.search.points import FOLLOWS, Points, Profile
from hil.solve.identifiability import independent_columns

POINTS = 48
"""Points of the noise that a block is weighed at: what the data leave probable under any of the leading sets."""
DEPTH = 9.0
"""Noise this much (in log probability) below the best is left out: one part in eight thousand."""

_AT_ONCE = 300_000  # numbers: of so few, arrays stay in the processor's own cache, and their memory with the process


@dataclass(frozen=True)
class _Rows:
    """Inner products (κ, m, m) of columns by temperature (r), `base`, further columns and data, at every noise.

    `variants` are some of the further columns each, `data` the places of the data among these.
    """

    noise: Noise
    grid: Points
    scales: Sequence[Scale]
    gram: FloatArray
    half_log_det: FloatArray
    base: int
    variants: Sequence[IntArray]
    data: Sequence[int]
    known: dict[Profile, FloatArray] = field(default_factory=dict)

    def heights(self, at: IntArray, profiles: Sequence[Profile]) -> FloatArray:
        """Log evidence (v, k, f) of variants at some of the noises (k,) with profiles (f,), all priors included."""
        factors = np.array([self.noise.factor(self.noise.place(p)) for p in profiles])
        factors = factors[:, :, np.any(factors, axis=(0, 1))]
        step = max(1, _AT_ONCE // (self.gram[0].size * len(profiles)))
        few = (at[first : first + step] for first in range(0, max(len(at), 1), step))
        return np.concatenate([self._weighed(some, profiles, factors) for some in few], axis=1)

    def _weighed(self, at: IntArray, profiles: Sequence[Profile], factors: FloatArray) -> FloatArray:
        """Weigh variants beside the base and what values do by factors (f, r, s), both integrated out, (v, k, f)."""
        values, gram = factors.shape[1], self.gram[at][:, None]
        own = np.swapaxes(factors, 1, 2) @ gram[:, :, :values]
        seen, of_values = explained(np.eye(factors.shape[2]) + own[..., :values] @ factors, own[..., values:])
        gram = gram[:, :, values:, values:]
        rest = np.moveaxis(gram - np.swapaxes(seen, 2, 3) @ seen if values else gram, (2, 3), (0, 1)).copy()
        # Where values explain all but a part in 10^13, what is left is rounding, and may be less than nothing.
        diagonal = np.einsum("iikf->ikf", rest)
        diagonal += ROUNDING * np.einsum("kfii->ikf", gram)
        diagonal *= 1.0 + SEEN**2
        _, of_base = eliminated(rest, self.base)
        half_log_det = self.half_log_det[at][:, None] + of_values + of_base
        own = self.grid.log_prior[at][:, None] + np.array([self.noise.log_profile(p) for p in profiles])
        out, sizes = np.empty((len(self.variants), *own.shape)), np.array([len(each) for each in self.variants])
        for size in np.unique(sizes):
            alike = np.flatnonzero(sizes == size)
            index = self.base + np.array([[*self.variants[v], self.data[v]] for v in alike.tolist()])
            out[alike] = own + self._alone(rest, half_log_det, index)
        return out

    def _alone(self, rest: FloatArray, half_log_det: FloatArray, index: IntArray) -> FloatArray:
        """Log evidence (v, k, f) of data beside columns that are free: their places (v, q + 1), the data's last."""
        left, of_columns = eliminated(rest[index.T[:, None], index.T])
        log_base, rss = -of_columns - half_log_det, np.maximum(left, LEAST)
        freedom = len(self.noise.order) - self.base - index.shape[1] + 1
        return log_sum(student(rss[None], log_base, self.scales, freedom))

    def climb(self) -> list[tuple[Profile, FloatArray]]:
        """Return of each variant how values likeliest follow, and the heights (κ,) beside that."""
        stand = next(iter(self.noise.profiles))
        if not self.noise.calibrated:
            return [(stand, self.everywhere(v, stand)) for v in range(len(self.variants))]
        ordinary = np.flatnonzero(self.grid.sort == 0)
        alike = [(way,) * len(stand) for way in FOLLOWS]
        asked, out = dict[tuple[int, Profile], list[int]](), dict[int, tuple[Profile, FloatArray]]()
        for v, own in enumerate(self.heights(ordinary, alike)):
            k, f = np.unravel_index(np.argmax(own), own.shape)
            asked.setdefault((int(ordinary[k]), alike[f]), []).append(v)
        height = np.full(len(self.variants), -np.inf)
        while asked:  # by turns to the likeliest way for each value, and to the likeliest noise beside these
            (at, best), some = next(iter(asked.items()))
            del asked[at, best]
            for v, likeliest in sorted(self._profiles(at, some, best)):
                beside = self.everywhere(v, likeliest)
                then = int(np.argmax(beside))
                if then == at or beside[then] <= height[v]:
                    out[v] = likeliest, beside
                else:
                    height[v] = beside[then]
                    asked.setdefault((then, likeliest), []).append(v)
        return [out[v] for v in range(len(self.variants))]

    def _profiles(self, at: int, some: list[int], best: Profile) -> Iterator[tuple[int, Profile]]:
        """Climb with some variants to the likeliest way for each value at a noise, side by side while they go alike."""
        asked = [(some, best, 0, 0)]
        while asked:
            some, best, place, stays = asked.pop()
            if stays == len(best):  # since one last went another way, all others were asked
                yield from ((v, best) for v in some)
                continue
            changed = [(*best[:place], way, *best[place + 1 :]) for way in FOLLOWS]
            likeliest = np.argmax(self._only(some, at).heights(np.arange(1), changed)[:, 0], axis=1)
            for f in np.unique(likeliest).tolist():
                own, then = [some[k] for k in np.flatnonzero(likeliest == f)], (place + 1) % len(best)
                asked.append((own, changed[f], then, stays + 1 if changed[f] == best else 1))

    def everywhere(self, v: int, profile: Profile) -> FloatArray:
        """Return the heights (κ,) of one variant beside a profile, at every noise that is not out of the question.

        That is beside the first of profiles that was asked about: several climb to the same, and to others that differ
        in little.
        """
        first, near = next(iter(self.known), profile), np.ones(len(self.grid), dtype=bool)
        if first != profile:
            self.everywhere(v, first)
            near = self._near_first
        self.at(np.flatnonzero(near), profile)
        return np.asarray(self.known[profile][v])

    def at(self, places: IntArray, profile: Profile) -> FloatArray:
        """Return the heights (v, k) of all variants beside a profile at some of the noises (k,), each made once."""
        known = self.known.get(profile, np.zeros((len(self.variants), 0)))
        if more := len(self.grid) - known.shape[1]:
            known = self.known[profile] = np.pad(known, ((0, 0), (0, more)), constant_values=-np.inf)
        if len(new := places[known[0, places] == -np.inf]):
            known[:, new] = self.heights(new, [profile])[:, :, 0]
        return np.asarray(known[:, places])

    @cached_property
    def _near_first(self) -> BoolArray:
        """Which noises (κ,) are not out of the question beside the first profile, which was asked about everywhere."""
        return np.asarray(np.any([_near(own, self.grid.sort) for own in next(iter(self.known.values()))], axis=0))

    def _only(self, some: Sequence[int], at: int) -> "_Rows":
        """Return what is about some variants, at one noise."""
        first, data = self.noise.by_station.shape[1] + self.base, [self.data[v] for v in some]
        used = np.unique(np.concatenate([*(self.variants[v] for v in some), data]))
        index = np.append(np.arange(first), first + used)
        variants, data = [np.searchsorted(used, self.variants[v]) for v in some], np.searchsorted(used, data).tolist()
        gram, half_log_det = self.gram[at][index[:, None], index][None], self.half_log_det[[at]]
        grid = self.grid.take(np.array([at]))
        return replace(self, grid=grid, gram=gram, half_log_det=half_log_det, variants=variants, data=data, known={})

    def log_width(self, v: int, at: int, profile: Profile, others: Container[Profile]) -> float:
        """Log of how probable beside a profile all are for which it stands: one value goes a way of none of `others`.

        Values are weighed one by one: what they do beside each other is all but independent.
        """
        only, out = self._only([v], at), 0.0
        for place in range(len(profile)):
            near = [(*profile[:place], way, *profile[place + 1 :]) for way in FOLLOWS]
            near = [profile, *(own for own in near if own != profile and own not in others)]
            heights = only.heights(np.arange(1), near).ravel()
            out += float(log_sum(heights - heights[0]))
        return out


def explained(gram: FloatArray, columns: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return S (k, f, n, m), of which S'S is X'G^-1 X, of Gram matrices G and columns X, and half of log det G, (k, f).

    A triangle is solved in a third of the time of any matrix.
    """
    triangle, out = np.linalg.cholesky(gram), columns.copy()
    for k, f in np.ndindex(*out.shape[:2]) if out.size else ():
        dtrsm(1.0, triangle[k, f].T, out[k, f].T, side=1, overwrite_b=1)
    return out, np.sum(np.log(np.einsum("kfii->kfi", triangle)), axis=2)


def likely_points(
    noise: Noise,
    scales: Sequence[Scale],
    data: Sequence[FloatArray],
    base: FloatArray,
    extras: Sequence[FloatArray],
    *,
    quieter: bool = False,
) -> tuple[Points, FloatArray]:
    """Return the points that are probable for some data (N,) beside the base with some further columns (N, q).

    With each how probable it is beside the best, log, (t,). Each of the data is weighed with each of the extras. With
    `quieter` ones than the likeliest beside the first of them: how probable each is beside that.
    """
    base = independent_columns(base, SEEN)
    free = [independent_columns(np.hstack([base, extra]), SEEN)[:, base.shape[1] :] for extra in extras]
    columns = np.column_stack([noise.by_station, *(own[noise.order] for own in (base, *free, *data))])
    ends = np.cumsum([0, *(own.shape[1] for own in free)])
    variants = [np.arange(a, b) for a, b in pairwise(ends)]
    gram, half_log_det = noise.products(columns)
    each, of = zip(*((v, int(ends[-1]) + y) for v in variants for y in range(len(data))), strict=True)
    rows = _Rows(noise, _priced(noise), scales, gram, half_log_det, base.shape[1], each, of)

    found = rows.climb()
    if noise.grow(noise.grid.take(np.flatnonzero(np.any([_leads(own, noise.grid.sort) for _, own in found], axis=0)))):
        gram, half_log_det = noise.products(columns)
        rows = replace(rows, grid=_priced(noise), gram=gram, half_log_det=half_log_det)
        found = [(best, rows.everywhere(v, best)) for v, (best, _) in enumerate(found)]
    grid = noise.grid
    seen = {best: (v, int(np.argmax(beside))) for v, (best, beside) in reversed([*enumerate(found)])}
    profiles = list(dict.fromkeys(best for best, _ in found))
    near = np.flatnonzero(np.any([_near(b, grid.sort) for _, b in found], axis=0) | _quiet(grid))
    if quieter:
        near = np.union1d(near, np.flatnonzero(grid.quieter(int(np.argmax(found[0][1])))))
    heights = np.stack([rows.at(near, p) for p in profiles], axis=2)
    heights -= heights.max(axis=(1, 2), keepdims=True)
    at, which = (part.ravel() for part in np.indices(heights.shape[1:]))
    every = grid.take(near[at])
    places = np.array([noise.place(p) for p in profiles])[which]
    log_width = [rows.log_width(*seen[p], p, seen) if noise.calibrated else 0.0 for p in profiles]
    prior = (np.array([noise.log_profile(p) for p in profiles]) + log_width)[which]
    every = replace(every, profile=places, log_prior=every.log_prior + prior)
    first, best = heights[0].ravel(), np.max(heights, axis=0).ravel()
    kept = _kept(every, best, noise.sorts)
    if quieter:
        kept |= every.quieter(int(np.argmax(first)))
    return every.take(np.flatnonzero(kept)), (first if quieter else best)[kept]


def _priced(noise: Noise) -> Points:
    """Return every noise, with the log prior of what scatters in that of each."""
    return replace(noise.grid, log_prior=noise.grid.log_prior + noise.log_odds(noise.grid))


def _kept(every: Points, best: FloatArray, sorts: Sequence[frozenset[str]]) -> BoolArray:
    """Tell the best points; the best of every effect, for what one block speaks against another may ask for; the quiet.

    And of two effects that do more together than either by itself. The quiet are kept whatever the base alone says of
    them: a term may explain what it takes for noise.
    """
    order = np.argsort(-best)
    kept = np.zeros(len(best), dtype=bool)
    kept[order[:POINTS]] = best[order[:POINTS]] > -DEPTH
    highest = _highest(best, every.sort)
    height = {sorts[every.sort[k]]: best[k] for k in np.flatnonzero(highest)}
    alone = {own: max((height.get(own - {name}, -np.inf) for name in own), default=-np.inf) for own in height}
    more = np.array([len(own) < TOGETHER or height.get(own, -np.inf) > alone.get(own, np.inf) for own in sorts])
    kept |= highest & more[every.sort]
    return np.asarray(kept | (_quiet(every) & (every.profile == every.profile[order[0]])))


def _highest(height: FloatArray, sort: IntArray) -> BoolArray:
    """Tell which of points (t,) is the highest of its sort (t,)."""
    out = np.zeros(len(height), dtype=bool)
    order = np.lexsort((-height, sort))
    out[order[np.append(True, np.diff(sort[order]) > 0)]] = True
    return out


def _near(height: FloatArray, sort: IntArray) -> BoolArray:
    """Tell which of points (t,) are not far below the highest, or are that of their sort (t,)."""
    return np.asarray((height > height.max() - 2.0 * DEPTH) | _highest(height, sort))


def _leads(height: FloatArray, sort: IntArray) -> BoolArray:
    """Tell the highest of points (t,), and of each sort (t,) those that are higher than all of ordinary noise."""
    least = max(min(height.max(), height[sort == 0].max()), height.max() - 2.0 * DEPTH)
    return np.asarray(_highest(height, sort) & (height >= least))


def _quiet(points: Points) -> BoolArray:
    """Tell which of the points are ordinary noise with next to no offset from run to run, (t,)."""
    return np.asarray((points.sort == 0) & (points.level == points.level.max()) & (points.offset < 1.0))
