"""What residuals say of a run and of the noise of averages, and what differs from run to run where noise is stated.

`hil.solve.repeats` puts the two together; every command that states what a collect scatters by asks there.
"""

import math
from collections.abc import Collection, Sequence, Set
from dataclasses import dataclass, field, replace
from functools import cached_property

import numpy as np
from scipy.special import chdtr, chdtrc, fdtrc

from hil.campaign import BoolArray, Collects, FloatArray, IntArray
from hil.files.numbers import degrees
from hil.model.forms import default_form
from hil.solve.identifiability import orthonormal
from hil.solve.precision import stated_noise
from hil.solve.temperatures import runs_by_temperature
from hil.solve.uncertain import RARE, uneven
from procedures.verdict import Judgement, Verdict
from procedures.words import counted, listed, plural, significant, spelled

PASS_PROBABILITY = 0.05
FAIL_PROBABILITY = 0.001
EXCESS = "the residuals are {} times what the standard errors allow"
LACKS = "the model lacks something (ask hil reconcile), or they are too small, as every ± allows"
"""Why runs FAIL that would FAIL again if they were measured again."""
MOVED = "by what the unit went through before it had settled, or by what the model lacks then, too"
"""Why runs FAIL whose soak had not ended."""
APART = "it is in no mean, and no ± allows for that"
"""Why runs FAIL of which nothing holds: they are in no mean, and in no other run's ±."""
RESIDUALS, DIFFERENCES = "residuals", "differences beside bias and MU"
NO_ONE = "no one ± holds at each"
"""Of temperatures at which noise, or what changes from run to run, is not alike."""
_ROUNDING = 1e-6  # of their errors: values that differ by less do not differ
_ENOUGH = 4.0  # degrees of freedom, by which Student's interval is a fifth wider than by twice as many
_COMMON = 1e-3  # of what all runs have in common: less is a difference of poses, and their parameters'


def shares_of(collects: Collects) -> dict[str, FloatArray]:
    """Return what each channel's noise gives of the variance of each parameter, in these collects, (c,)."""
    form, sigma = default_form(collects.conditions), stated_noise(collects)
    known = np.isfinite(collects.rates_deg_per_hr)
    weight = np.where(known, 1.0 / np.where(known, 1.0 if sigma is None else sigma, 1.0), 0.0)
    columns = form.columns(collects.conditions) * weight[..., None]
    response = np.linalg.pinv(columns.reshape(-1, len(form.names))).reshape(-1, *weight.shape)
    of_each = np.sum(response**2, axis=1)
    return dict(zip(form.names, of_each / np.maximum(of_each.sum(axis=1, keepdims=True), 1e-300), strict=True))


@dataclass(frozen=True)
class Left:
    """The noise of rates that state no errors, deg/hr, and degrees of freedom behind it, (c,): NaN, and none, unknown.

    `by` says what tells it, and `larger` that it is so at one temperature, or nothing.
    """

    deg_per_hr: FloatArray = field(default_factory=lambda: np.full(1, math.nan))
    freedom: FloatArray = field(default_factory=lambda: np.full(1, math.inf))
    by: str = RESIDUALS
    larger: Sequence[str] = ()

    def of(self, channels: Sequence[str]) -> dict[str, float]:
        """Return the noise by channel, of those of which it is known."""
        known = zip(channels, self.deg_per_hr.tolist(), strict=True)
        return {channel: noise for channel, noise in known if math.isfinite(noise)}


Squares = Sequence[tuple[float | None, FloatArray, FloatArray]]
"""Squares and their degrees of freedom, (c,) each, at each temperature, °C."""


def noise_left(by_residuals: Squares, by_repeats: Squares, channels: int) -> Left:
    """Return what all of a sensor's runs make of noise that is not stated, by squares (c,) in (deg/hr)².

    Residuals tell it, and where there are none what runs of one temperature differ by. It is that of each channel, or
    of all together where few degrees of freedom tell that of any.
    """
    told = any(freedom.any() for *_, freedom in by_residuals)
    at, by = (by_residuals, RESIDUALS) if told else (by_repeats, DIFFERENCES)
    squares, freedom = sum((np.array(own) for _, *own in at), np.zeros((2, channels)))
    if not np.any(freedom > 0.5):
        return Left(np.full(channels, math.nan), np.full(channels, math.inf))
    if np.any(np.round(freedom) < _ENOUGH):
        squares, freedom = (np.full(channels, of.sum()) for of in (squares, freedom))
    return Left(np.sqrt(squares / freedom), freedom, by, _larger_somewhere(at, by))


@dataclass(frozen=True)
class Changes:
    """What differs from run to run: its squares, in standard errors, and their degrees of freedom, by channel (c,).

    `certain`: whether errors do not hold beside all parameters, which is noise for certain. Of a channel that differs
    more at some temperatures than at others there are none; `uneven` are temperatures with their runs, and how many
    times its errors it differs by at each, (c,), 1 by chance and of others.
    """

    squares: FloatArray
    freedom: FloatArray
    certain: bool = False
    uneven: Sequence[tuple[float, Sequence[int], FloatArray]] = ()

    @cached_property
    def times(self) -> FloatArray:
        """How many times their errors each channel's averages differ by, (c,), 1 by chance.

        Alike where none is odd, or where they are likelier so than if those that are not odd are as stated. Values that
        do not differ at all were rounded or copied, and tell nothing of noise.
        """

        def times(square: float, degrees: float, among: int) -> float:
            by_chance = degrees < 0.5 or min(chdtr(degrees, square), chdtrc(degrees, square)) > 0.5 * RARE / among
            return 1.0 if by_chance else math.sqrt(square / degrees)

        own = np.array([times(*each, len(self.freedom)) for each in zip(self.squares, self.freedom, strict=True)])
        alike = np.full(len(own), times(self.squares.sum(), self.freedom.sum(), 1))
        own_log, alike_log = (
            -float(np.sum(self.freedom * np.log(of) + 0.5 * self.squares / of**2)) if np.all(of > 0.0) else -math.inf
            for of in (own, alike)
        )
        return alike if alike_log > own_log else own

    def larger_in(self, runs: Collection[int]) -> FloatArray:
        """How many times as large as stated errors of some runs are to be taken, (c,): 1 at least."""
        own = [times for _, several, times in self.uneven if not set(several).isdisjoint(runs)]
        return np.asarray(np.max([np.maximum(self.times, 1.0), *own], axis=0))

    def in_words(self, channels: Sequence[str]) -> list[str]:
        """Say by how much standard errors are too small or too large, and of which channel that is no one number."""
        odd = {channel: times for channel, times in zip(channels, self.times.tolist(), strict=True) if times != 1.0}
        together = len(odd) == len(channels) > 1 and len({*odd.values()}) == 1
        beside = "their parameters" if self.certain else "bias and MU"
        said = [
            f"standard errors of {of} are {significant(max(times, 1.0 / times))} times too "
            f"{'small' if times > 1.0 else 'large'}, by what runs of one temperature differ in beside {beside}"
            + ", or another value of the unit changes"
            * (times > 1.0 and not self.certain)
            for of, times in ({"all channels together": max(odd.values())} if together else odd).items()
        ]
        return [*said, *self.uneven_in_words(channels)]

    def uneven_in_words(self, channels: Sequence[str]) -> list[str]:
        """Say of which channels averages differ by more at one temperature than their standard errors, by how much."""
        where: dict[str, list[str]] = {}
        for c, channel in enumerate(channels):
            degC, _, times = max(self.uneven, key=lambda each: each[2][c], default=(0.0, (), np.ones(len(channels))))
            if times[c] > 1.0:
                at = f"{significant(times[c])} times their standard errors at {degrees(degC)}"
                where.setdefault(at, []).append(channel)
        how = "differ by more at some temperatures than at others"
        return [f"averages of {listed(of)} {how}: by {at}: {NO_ONE}" for at, of in where.items()]


def unstated_changes(rows: Collects, runs: Set[int]) -> Squares:
    """Return what differs from run to run as `changes` does, (c,) in (deg/hr)², of rates that state no errors."""
    rows = replace(rows, rates_se_deg_per_hr=np.ones_like(rows.rates_se_deg_per_hr))
    groups, squares, freedom, _ = _between_runs(rows, runs)
    return [(degC, *own) for (degC, _), *own in zip(groups, squares, freedom, strict=True)]


def changes(rows: Collects, runs: Set[int]) -> Changes:
    """Return what differs from run to run.

    Among `runs` of the same collects at one known temperature, less what a bias or MU of each makes: where nobody knows
    it GS may follow it. Where GS differs, beyond chance in all channels together, by more than what no parameter of a
    run makes does, or, where a run leaves nothing of that, than the bias or MU, in which noise is, too, it changes, and
    what none makes is what differs.
    """
    groups, squares, freedom, certain = _between_runs(rows, runs)
    count = squares.shape[1]
    told = squares.sum(axis=0) > _ROUNDING**2 * freedom.sum(axis=0)
    odd = _uneven(squares, freedom) & told
    if not odd.any() and told.all() and _uneven(*(of.sum(axis=1, keepdims=True) for of in (squares, freedom)))[0]:
        odd |= True  # few runs of a temperature tell it of all channels together sooner than of each
        squares, freedom = (np.tile(of.sum(axis=1, keepdims=True), count) for of in (squares, freedom))
    times = np.sqrt(squares / np.maximum(freedom, 0.5))
    more = np.where(odd & (chdtrc(np.maximum(freedom, 0.5), squares) < RARE / max(len(groups), 1)), times, 1.0)
    by_temperature = [(degC, several, own) for (degC, several), own in zip(groups, more, strict=True)]
    of_all = told & ~odd
    return Changes(
        squares.sum(axis=0) * of_all, freedom.sum(axis=0) * of_all, certain, by_temperature if odd.any() else ()
    )


def _between_runs(
    rows: Collects, runs: Set[int]
) -> tuple[Sequence[tuple[float, Sequence[int]]], FloatArray, FloatArray, bool]:
    """Return temperatures with their runs, squares and degrees of freedom at each, (k, c), and if no errors hold."""
    conditions, form = rows.conditions, default_form(rows.conditions)
    seen, known = rows.rates_deg_per_hr - conditions.w_channels_deg_per_hr, np.isfinite(rows.rates_deg_per_hr)
    root = np.where(known, 1.0 / np.where(known, rows.rates_se_deg_per_hr, 1.0), 0.0)
    columns, white = form.columns(conditions) * root[..., None], np.where(known, seen, 0.0) * root
    bias, mu = (np.array([name.startswith(kind) for name in form.names]) for kind in ("B", "MU"))
    groups = [(degC, several) for degC, several in runs_by_temperature(conditions) if degC is not None]
    count, of_each = known.shape[1], conditions.of_each_run
    alike: dict[tuple[int, bytes, bytes], list[IntArray]] = {}
    for k, (_, several) in enumerate(groups):
        for rows_of in (of_each[run] for run in several if run in runs):
            what = conditions.position[rows_of].tobytes(), known[rows_of].tobytes()
            alike.setdefault((k, *what), []).append(rows_of)
    found = np.zeros((4, 2, len(groups), count))  # beside these of a run's own
    for (k, *_), each in alike.items():
        for beside, of_run in zip(found, (bias, mu, bias | mu, bias | True), strict=True):
            beside[:, k] += _differs(white[each], columns[np.array(each)][..., of_run], root[each])
    certain = bool(np.any(Changes(*found[-1].sum(axis=1)).times != 1.0))
    of_bias, of_mu, usual, every = found.sum(axis=(2, 3))
    noises = (every,) if every[1] > 0.5 else (of_bias - usual, of_mu - usual)
    another = any(_exceeds(usual - every, noise, len(noises)) for noise in noises)
    squares, freedom = found[2 + another]
    return groups, squares, freedom, certain


def _uneven(squares: FloatArray, freedom: FloatArray) -> BoolArray:
    """Tell of which of some columns squares (k, p) of degrees of freedom (k, p) are not alike at all temperatures."""
    return uneven(squares / np.maximum(freedom, 0.5), np.where(freedom > 0.5, freedom, 0.0))


def _larger_somewhere(at: Squares, by: str) -> list[str]:
    """Say that what is left is larger at one temperature than at another; or nothing."""
    told = {degC: (own.sum(), free.sum()) for degC, own, free in at if degC is not None and free.sum() > 0.5}
    squares, freedom = np.array([*told.values()]).reshape(-1, 2).T[..., None]
    if not _uneven(squares, freedom)[0]:
        return []
    size = dict(zip(told, np.sqrt(squares / freedom).ravel().tolist(), strict=True))
    loud, quiet = max(size, key=lambda of: size[of]), min(size, key=lambda of: size[of])
    times = significant(size[loud] / max(size[quiet], 1e-300))
    return [f"{by} are {times} times as large at {degrees(loud)} as at {degrees(quiet)}: {NO_ONE}"]


def _differs(white: FloatArray, columns: FloatArray, root: FloatArray) -> FloatArray:
    """Return the squares, and their degrees of freedom, of what runs of the same collects differ by, by channel (2, c).

    That is beside the own `columns` (r, n, c, p) of each run, and whatever each rate has in common in all of them: of
    rates `white` (r, n, c) in units of their errors, of which `root` (r, n, c) is one over each. Both are fitted at
    once: errors that are not alike would else leave of a run's own parameters what is none of them.
    """
    runs, *shape = white.shape
    scale = root.reshape(runs, -1)
    own = columns.reshape(*scale.shape, columns.shape[-1])
    beside = np.stack([np.eye(scale.shape[1]) - basis @ basis.T for basis in map(orthonormal, own)])
    common = beside * scale[:, None]  # what a rate that is the same in all runs leaves of itself
    values, vectors = np.linalg.eigh(np.einsum("rij,rik->jk", common, common))
    there = values > _COMMON**2 * values[-1]
    common = common @ (vectors[:, there] / np.sqrt(values[there]))
    left = (beside @ white.reshape(runs, -1, 1))[..., 0]
    left -= common @ np.einsum("riq,ri->q", common, left)
    free = np.diagonal(beside, axis1=1, axis2=2) - np.sum(common**2, axis=2)
    told = np.stack([left**2, free]) * (scale > 0.0)
    return np.asarray(told.reshape(2, runs, *shape).sum(axis=(1, 2)))


def _exceeds(more: FloatArray, noise: FloatArray, among: int) -> bool:
    """Tell whether mean squares exceed others, by squares and degrees of freedom of each, (2,), as one of so many."""
    (squares, freedom), (others, known) = more, noise
    if min(freedom, known) < 0.5:
        return False
    return bool(fdtrc(freedom, known, squares / freedom / max(others / known, 1e-300)) < RARE / among)


def beyond_errors(names: Sequence[str], of_channels: tuple[FloatArray, FloatArray], among: int) -> str:
    """Say by how much the residuals of a channel exceed its standard errors, where those of another do not.

    `of_channels` are the squares of residuals in standard errors, and degrees of freedom, of each channel, (c,) each.
    """
    each = [*zip(names, *of_channels, strict=True)]
    odd = [name for name, chi, nu in each if nu > 0.5 and chdtrc(nu, chi) < PASS_PROBABILITY / among]
    told = [f"{name} {significant(np.sqrt(chi / nu))} times" for name, chi, nu in each if name in odd]
    return f", in {listed(told)}" if 0 < len(odd) < len(names) else ""


def wider_in_words(names: Sequence[str], times: FloatArray) -> str:
    """Say which channels' standard errors repeats show to be larger than stated, so many times (c,); "" of none."""
    larger = [f"those of {name} {significant(of)} times" for name, of in zip(names, times, strict=True) if of > 1.0]
    if larger and len(set(times.tolist())) == 1:
        larger = [f"each {significant(times[0])} times"]
    return f"{listed(larger)} as large as stated, as repeats show" if larger else ""


def judge(
    chi_square: float,
    degrees: int,
    equations: int,
    noise_stated: bool,
    among: int = 1,
    where: str = "",
    why: str = LACKS,
    wider: str = "",
) -> Judgement:
    """Judge the residuals of `equations` rates: chi-square on `degrees` degrees of freedom against stated noise.

    Of so many judgements, `among`, one is further off by chance than a single is. `where` says in which channels, `why`
    what residuals of a FAIL come by, `wider` which standard errors were taken larger than they are stated.
    """
    if degrees == 0:
        known, unknown = (f"{spelled(equations)} {plural(noun, equations)}" for noun in ("equation", "unknown"))
        reason = f"no residual: {known}, {unknown}; these collects cannot contradict the model"
        if not noise_stated:
            reason += "; with neither a residual nor stated standard errors a run alone tells no uncertainty"
        return Judgement(Verdict.PASS, reason)
    freedom = f"{counted(degrees, 'degree')} of freedom"
    if not noise_stated:
        return Judgement(
            Verdict.PASS,
            f"the rates have no (or not all) standard errors: the residuals, on {freedom}, are taken as the noise and "
            "cannot contradict the model",
        )
    probability = float(chdtrc(degrees, chi_square))
    found = f"chi-square {significant(chi_square, 3)} on {freedom}, p = {probability:.2g}"
    if probability >= PASS_PROBABILITY / among:
        chance = "; of so many runs one is so by chance" if probability < PASS_PROBABILITY else ""
        errors = f"the standard errors, {wider}" if wider else "the stated standard errors"
        return Judgement(Verdict.PASS, f"the residuals agree with {errors} ({found}{chance})")
    factor = np.sqrt(chi_square / degrees)
    excess = f"{EXCESS.format(significant(factor))}{where}{f', even with {wider}' if wider else ''} ({found})"
    if probability >= FAIL_PROBABILITY / among:
        return Judgement(Verdict.MARGINAL, excess)
    return Judgement(Verdict.FAIL, f"{excess}: {why}")


def what_lacks(collects: Collects, every: Collects, unobservable: Sequence[str]) -> str:
    """Say what was measured, and what lacks: a channel or positions that other runs of `every` have, or the unseen."""
    rates, all_rates = (np.isfinite(rows.rates_deg_per_hr) for rows in (collects, every))
    position, all_positions = collects.conditions.position, every.conditions.position
    names, here = np.array(list(collects.conditions.sensor.channels)), rates.any(axis=0)
    channels: dict[str, list[str]] = {}
    for name, known in zip(names.tolist(), rates.T, strict=True):
        count, places = int(known.sum()), len(set(position[known].tolist()))
        at = f" at {spelled(places)} {plural('position', places)}" if count else ""
        channels.setdefault(f"{spelled(count)} {plural('collect', count)}{at}", []).append(name)
    measured = listed(f"{listed(of)} in {where}" for where, of in channels.items())
    few = f"measured are {measured}: these cannot support every parameter"
    if silent := names[all_rates.any(axis=0) & ~here].tolist():
        has = "has" if len(silent) == 1 else "have"
        which = f"{plural('channel', len(silent))} {listed(silent)}, which other runs have"
        return f"{which}, {has} no rate here that is used; {few}"
    told, told_elsewhere = position[rates[:, here].all(axis=1)], all_positions[all_rates[:, here].all(axis=1)]
    if lacks := np.setdiff1d(told_elsewhere, told).tolist():
        gone = "is missing or left out: collect it" if len(lacks) == 1 else "are missing or left out: collect them"
        return f"{plural('position', len(lacks))} {listed(lacks)}, which other runs have, {gone} again; {few}"
    return f"{few}: {'; '.join(unobservable)}"
