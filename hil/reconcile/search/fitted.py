"""A set as numbers: values with errors, the noise beside them, and what each term makes of every row."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from functools import cached_property

import numpy as np

from hil.campaign import Conditions, FloatArray, IntArray
from hil.files.numbers import rounded
from hil.reconcile.search.block_search import BlockSearch
from hil.reconcile.search.chains import COMPARED
from hil.reconcile.search.evidence import SEEN
from hil.reconcile.search.posterior import Found, Posterior
from hil.reconcile.search.set_in_block import SetInBlock
from hil.reconcile.search.sets import SensorSearch, Set
from hil.reconcile.search.sizes import over_sizes
from hil.solve.identifiability import describe, orthonormal, project_out
from hil.solve.runs import OBSERVABLE
from procedures.words import listed, unit_in_words

Key = tuple[int, int, int]  # sensor, term, parameter
Values = Mapping[int, tuple[float, float]]
"""Value and standard error by the place of a candidate's column."""
_NOISES = 32  # of which errors are the mean: what is less probable than a thirtieth hardly widens them


@dataclass(frozen=True)
class FittedBlock:
    """One block with one set, as it was `weighed`: columns (N, k) with their keys, and noise.

    That is `scale` times that of the search's point `at`.
    """

    search: BlockSearch
    weighed: SetInBlock
    at: int
    scale: float
    columns: FloatArray
    keys: Sequence[Key]
    _beside_base: dict[int, FloatArray] = field(default_factory=dict)

    @property
    def calibrated(self) -> bool:
        """Whether a value of the base follows temperature."""
        return bool(self.search.points.profile[self.at] > 0)

    def white(self, columns: FloatArray) -> FloatArray:
        """Return columns (N, k), deg/hr, with rows that are independent and of variance one."""
        return np.asarray(self.search.whitened(columns, np.array([self.at]))[0] / np.sqrt(self.scale))

    def beside(self, columns: FloatArray) -> FloatArray:
        """Return what the base leaves of columns (N, k) that are whitened with it."""
        base = self.search.block.base
        base, white = np.split(self.white(np.column_stack([base, columns])), [base.shape[1]], axis=1)
        return project_out(orthonormal(base), white)

    @property
    def variance(self) -> FloatArray:
        """The variance of the rows' noise, (N,), deg²/hr², without values that follow temperature, which are none."""
        noise = self.search.noise
        return np.asarray(noise.variance(self.search.points.take(np.array([self.at])))[0] * noise.unit * self.scale)

    @cached_property
    def _precision(self) -> FloatArray:
        """What weighs the first `COMPARED` rows in time by what the base leaves of them, (n, n)."""
        noise, points = self.search.noise, self.search.points.take(np.array([self.at]))
        white = np.linalg.inv(np.linalg.cholesky(noise.covariance(points)))
        rows, values = noise.order[:COMPARED], noise.by_station[:COMPARED] * self.calibrated
        left = project_out(orthonormal(white @ np.hstack([self.search.block.base[rows], values]), SEEN), white)
        return np.asarray(left.T @ left)

    def beside_base(self, kind: int) -> FloatArray:
        """Return what a kind of scatter makes of the rows that the base leaves, times their precision, (n, n).

        The trace of the product of two such is the inner product of the whitened covariances.
        """
        if kind not in self._beside_base:
            self._beside_base[kind] = self.search.noise.kinds[kind].chain.covariance @ self._precision
        return self._beside_base[kind]

    def beside_values(self, left: FloatArray) -> FloatArray:
        """Return what values of the base that follow temperature leave of a residual, (N,)."""
        noise = self.search.noise
        values = np.sqrt(noise.unit * self.scale) * noise.following(int(self.search.points.profile[self.at]))
        return np.asarray(left - values @ (self.white(values).T @ self.white(left[:, None])[:, 0]))


@dataclass(frozen=True)
class Fitted:
    """A set that was found over all sensors: its blocks, the values of all parameters (p,), their covariance (p, p).

    `alone` (p,) are their errors where all others are what they are here.
    """

    posterior: Posterior
    found: Found
    blocks: Sequence[FittedBlock]
    keys: Sequence[Key]
    values: FloatArray
    covariance: FloatArray
    alone: FloatArray

    @property
    def conditions(self) -> Mapping[int, Conditions]:
        """The conditions of the sensors, by number."""
        return {block.search.block.sensor: block.search.noise.conditions for block in self.blocks}

    def of_term(self, number: int, place: int, *, alone: bool = False) -> Values:
        """Return the values of a term's columns in their own units; `alone`, with all others what they are here."""
        scale, errors = self.posterior.term(number, place).scale, np.sqrt(np.diag(self.covariance))
        every = zip(self.keys, self.values.tolist(), (self.alone if alone else errors).tolist(), strict=True)
        return {k: (v / float(scale[k]), e / float(scale[k])) for (*of, k), v, e in every if of == [number, place]}

    def only_together(self, number: int, place: int) -> tuple[str, ...]:
        """Say which of a term's parameters these rows tell in combination only, and its value; nothing of none."""
        own = [at for at, key in enumerate(self.keys) if key[:2] == (number, place)]
        whole, left = [], []
        for block in self.blocks:
            columns = self.design(block, {(number, place)})[:, own]
            whole.append(block.white(columns))
            left.append(block.beside(columns))
        term, each = self.posterior.term(number, place), [self.keys[at][2] for at in own]
        parameters, scale = [term.candidate.parameters[k] for k in each], term.scale[each]
        size = np.linalg.norm(np.concatenate(whole), axis=0)
        rows = np.linalg.qr(np.concatenate(left) * scale).R  # of which the directions are the same
        told = describe([of.name for of in parameters], rows, size * scale, OBSERVABLE)
        of = told.seen / scale
        errors = np.sqrt(np.diag(of @ self.covariance[np.ix_(own, own)] @ of.T)).tolist()
        sizes = map(rounded, (of @ self.values[own]).tolist(), errors)
        units = (unit_in_words(parameters[at].unit) for at in np.argmax(told.seen == 1.0, axis=1).tolist())
        known = {text: f"{text} = {size} {unit}" for text, size, unit in zip(told.seen_text, sizes, units, strict=True)}
        said = [(each, listed([of for text, of in known.items() if text in each])) for each in told.sentences]
        return tuple(f"{each} ({values})" if values else each for each, values in said)

    def effect(self, block: FittedBlock) -> FloatArray:
        """Return what all terms make of a block's rates, (N,), deg/hr."""
        return self.design(block) @ self.values

    def design(self, block: FittedBlock, terms: set[tuple[int, int]] | None = None) -> FloatArray:
        """Return columns (N, p) of some terms (sensor, term), or of all, in one block."""
        out = np.zeros((len(block.search.block.y), len(self.keys)))
        for column, key in zip(block.columns.T, block.keys, strict=True):
            if terms is None or key[:2] in terms:
                out[:, self.keys.index(key)] += column
        return out

    def free(self, terms: set[tuple[int, int]]) -> dict[Key, float]:
        """Return the values of some terms in their own units as rows alone say, all others being what they are here."""
        out = {}
        for block in self.blocks:
            own = [at for at, key in enumerate(self.keys) if key[:2] in terms and key in block.keys]
            columns = self.design(block, terms)[:, own]
            left = block.search.block.y - self.effect(block) + columns @ self.values[own]
            white = block.beside(np.column_stack([columns, left]))
            fit = np.linalg.lstsq(white[:, :-1], white[:, -1], rcond=1e-9)[0]
            for at, value in zip(own, fit.tolist(), strict=True):
                number, place, k = self.keys[at]
                out[self.keys[at]] = value / float(self.posterior.term(number, place).scale[k])
        return out

    def residual(self, block: FittedBlock) -> FloatArray:
        """Return what terms and base leave of a block's rates, (N,), deg/hr."""
        left, base = block.search.block.y - self.effect(block), block.search.block.base
        white = block.white(np.column_stack([base, left]))
        beta = np.linalg.lstsq(white[:, :-1], white[:, -1], rcond=1e-9)[0]
        return np.asarray(left - base @ beta)

    @cached_property
    def information(self) -> float:
        """Log likelihood, each free value paid for by half the log of the rows (Schwarz 1978)."""
        total, rows = 0.0, 0
        for block in self.blocks:
            own = block.search
            left = block.beside(own.block.y - self.effect(block))[:, 0]
            rows += len(left)
            total += float(own.beside.log_noise[block.at]) - 0.5 * float(left @ left)
            total -= 0.5 * len(left) * float(np.log(own.noise.unit * block.scale))
        return total - 0.5 * len(self.keys) * float(np.log(rows))

    def overlap(self, number: int, own: Sequence[int], rival: int) -> float:
        """How much of what a sensor's terms `own` add, a rival can do as well, beside the base: 0 nothing, 1 all."""
        whole, share = 0.0, 0.0
        blocks = [block for block in self.blocks if block.search.block.sensor == number]
        for b, block in enumerate(blocks):
            added = self.design(block, {(number, j) for j in own}) @ self.values
            part = self.posterior.term(number, rival).parts[b]
            left = block.beside(np.column_stack([added, *([] if part is None else [part.columns])]))
            whole += float(left[:, 0] @ left[:, 0])
            share += float(np.sum((orthonormal(left[:, 1:], SEEN).T @ left[:, 0]) ** 2))
        return float(np.sqrt(share / whole)) if whole > 0.0 else 0.0

    def scatter_overlap(self, name: str, rival: str) -> float:
        """How alike two effects on the scatter are beside the base: the cosine of what they make of the rows, 0 to 1.

        In the shapes in which they are most alike, of `name` that which was fitted, where it was; of blocks the least.
        """
        out = []
        for block in self.blocks:
            there = block.search.points.amount[block.at] > 0.0
            named, others = ([kind.name == own for kind in block.search.noise.kinds] for own in (name, rival))
            both = there & named if any(there & named) else named, others
            seen = [[block.beside_base(int(kind)) for kind in np.flatnonzero(of)] for of in both]
            norms = [[np.sqrt(np.sum(own * own.T)) for own in of] for of in seen]
            cosines = [
                np.sum(a * b.T) / (c * d)
                for a, c in zip(seen[0], norms[0], strict=True)
                for b, d in zip(seen[1], norms[1], strict=True)
            ]
            out.append(float(max(cosines, default=0.0)))
        return min(out, default=0.0)


def fitted(posterior: Posterior, found: Found) -> Fitted:
    """Fit a set of all sensors: what the rows say of its values, and what was known before.

    Values and errors are over all that is probable of the noise, whatever scatters, and of how large such values may
    be: few runs leave much open that the likeliest has not. What rows cannot tell apart is no surer than typical.
    """
    blocks = [
        fitted_block(search, found.terms[number], found.scatter, b)
        for number, search in posterior.searches.items()
        for b in range(len(search.blocks))
    ]
    keys: list[Key] = list(dict.fromkeys(key for block in blocks for key in block.keys))
    values, covariance, variance = _over_all(blocks, keys, _scatters(posterior, found))
    mean = values.mean(axis=0)
    off = values - mean
    alone = np.sqrt(variance.mean(axis=0) + np.mean(off**2, axis=0))
    return Fitted(posterior, found, blocks, keys, mean, covariance.mean(axis=0) + off.T @ off / _NOISES, alone)


def _over_all(
    blocks: Sequence[FittedBlock], keys: Sequence[Key], scatters: Mapping[frozenset[str], float]
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Return values (d, p), their covariance (d, p, p), and variances alone (d, p), at all that is probable.

    What one block scatters by says of the others nothing but what: they are taken to be quiet or noisy together.
    """
    many = len(keys)
    gram, score = np.zeros((_NOISES, many, many)), np.zeros((_NOISES, many))
    mean, deviation = np.zeros((2, _NOISES, many))
    for block in blocks:
        own, index = block.weighed, np.array([keys.index(key) for key in block.keys], dtype=np.int64)
        t = _over_noises(block, scatters)
        gram[:, index[:, None], index] += own.gram[t] / own.scales_left[t, None, None]
        score[:, index] += own.score[t] / own.scales_left[t, None]
        priors = [own.prior(sizes) for sizes in over_sizes(own, block.at, _NOISES)]
        mean[:, index], largest = (np.array(each) for each in zip(*priors, strict=True))
        deviation[:, index] = np.maximum(deviation[:, index], largest)
    known, both = deviation**-2.0, deviation[:, :, None] * deviation[:, None]
    gram[:, range(many), range(many)] += known
    covariance = np.linalg.inv(gram * both) * both
    values = (covariance @ (score + mean * known)[..., None])[..., 0]
    return values, covariance, np.diagonal(gram, axis1=1, axis2=2) ** -1.0


def _scatters(posterior: Posterior, found: Found) -> dict[frozenset[str], float]:
    """Return how probable it is that this or that scatters, where the terms are those that were found."""
    log = {each.scatter: each.log_weight for each in posterior.sets if each.terms == found.terms}
    log = log or {found.scatter: 0.0}
    whole = float(np.logaddexp.reduce([*log.values()]))
    return {scatter: float(np.exp(each - whole)) for scatter, each in log.items()}


def _over_noises(block: FittedBlock, scatters: Mapping[frozenset[str], float]) -> IntArray:
    """Return points of a block's noise, `_NOISES` of them, the noisiest last, each as often as it is probable."""
    points, sorts = block.search.points, block.search.noise.sorts
    total, weight = block.weighed.terms_log + points.log_prior, np.zeros(len(points))
    for scatter, share in scatters.items():
        log = np.where(np.array([sort <= scatter for sort in sorts])[points.sort], total, -np.inf)
        weight += share * np.exp(log - np.logaddexp.reduce(log))
    noisy = np.argsort(-np.einsum("tkk->t", block.weighed.gram) / block.weighed.scales_left, kind="stable")
    ends = np.cumsum(weight[noisy])
    return np.asarray(noisy[np.searchsorted(ends, (np.arange(_NOISES) + 0.5) / _NOISES * ends[-1])])


def fitted_block(search: SensorSearch, chosen: Set, scatter: frozenset[str], b: int) -> FittedBlock:
    """Return one block with one set, at its most probable point of the noise with some of what scatters, or none."""
    own = search.blocks[b]
    weighed = search.in_block(chosen, b)
    total = weighed.terms_log + own.points.log_prior
    within = np.array([sort <= scatter for sort in own.noise.sorts])[own.points.sort]
    t = int(np.argmax(np.where(within, total, -np.inf)))
    keys = [(own.block.sensor, *of) for of in weighed.owner]
    return FittedBlock(own, weighed, t, float(weighed.scales_left[t]), search.columns(chosen, b), keys)
