"""What a run's residuals say of it, and what its collects lack where they cannot support every parameter."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from scipy.special import chdtrc

from hil.campaign import Collects, FloatArray
from procedures.verdict import Judgement, Verdict
from procedures.words import counted, listed, plural, significant, spelled

PASS_PROBABILITY = 0.05
FAIL_PROBABILITY = 0.001
EXCESS = "the residuals are {} times what the standard errors allow"
LACKS = "the model lacks something (ask hil reconcile), or they are too small, as every ± allows"
"""Why runs FAIL that would FAIL again if they were measured again."""
MOVED = "by what the unit went through before it had settled, or by what the model lacks then, too"
"""Why runs FAIL whose soak had not ended."""


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
        return f"{plural('channel', len(silent))} {listed(silent)}, which other runs have, gave no rate here; {few}"
    told, told_elsewhere = position[rates[:, here].all(axis=1)], all_positions[all_rates[:, here].all(axis=1)]
    if lacks := np.setdiff1d(told_elsewhere, told).tolist():
        gone = "is missing or left out: collect it" if len(lacks) == 1 else "are missing or left out: collect them"
        return f"{plural('position', len(lacks))} {listed(lacks)}, which other runs have, {gone} again; {few}"
    return f"{few}: {'; '.join(unobservable)}"
