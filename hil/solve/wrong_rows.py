"""What is wrong with rows, and what is done about it: the same answer in every command that states a number.

    found = wrong_rows(campaign)[2]
    found.rows          # (Wrong(sensor=2, run=5, collects=(13, 14), done="mended", why="…exchanged…"),)
    found.collects      # what is solved: labels put right, rates that are wrong left out
    found.judged[5]     # no run that rests on such a row is a PASS

The quick form of what `hil reconcile` asks of every row: how the unit lay by its accelerometers, and what explains all
rates best, with the search's own odds of a mistake (`hil.solve.explained`).
"""

from collections.abc import Iterator, Mapping, Sequence, Set
from dataclasses import dataclass, replace
from functools import lru_cache
from typing import Any, Self

import numpy as np
from scipy.special import chdtrc

from hil.campaign import Campaign, Collects, FloatArray
from hil.campaign.laws import FIXTURE_G, from_the_usual_g
from hil.campaign.plausibility import accelerations_g, clipped, unclipped
from hil.model.forms import default_form
from hil.solve.asked import OtherSensor
from hil.solve.causes import OWN, Cause, all_of
from hil.solve.explained import HARDLY, Explained, Together, beyond_others, lost, mended
from hil.solve.least_squares import solve
from hil.solve.precision import stated_noise, with_every_error
from hil.solve.temperatures import runs_by_temperature
from procedures.verdict import Judgement, Verdict, combine
from procedures.words import listed, numbered, significant

LEFT_OUT, MENDED, USED = "left out", "mended", "used"
_LIES = ": in each the unit lies, by its accelerometers, as in the other's position"
_FROM = " from what all others show"
_AS_FILED = MENDED, Verdict.FAIL, ": so all rates agree with each other, and not as they are filed", ""
_ELSE = ", and its other values are used"
_DONE = {
    "rate": (LEFT_OUT, Verdict.MARGINAL, "", ", and is left out"),
    "collect": (LEFT_OUT, Verdict.MARGINAL, "", ", and is left out"),
    "bias": (USED, Verdict.MARGINAL, f"; all collects of the run alike: its bias was another{_ELSE}", ""),
    "MU": (USED, Verdict.MARGINAL, f"; all collects of the run as MU moves them: its MU was another{_ELSE}", ""),
    "run": (
        LEFT_OUT,
        Verdict.INCONCLUSIVE,
        " in what neither a bias nor MU moves",
        ", and the run is in no mean and in no other run's ±",
    ),
}
"""What is done about a cause, the verdict of its run at best, what is said of it and of what is done; `_AS_FILED`."""
_WHICH = ": most runs there contradict each other, and nothing tells that these are right"
_FEW = 4  # things that may be wrong are named
_TOLD = 1e-6  # deg/hr: less is what arithmetic leaves of a channel of which nothing is told
_ALIKE = 0.01  # chance of rates as far from those of another position, from which on the unit may have lain there
_ONLY = 0.99  # of its square: a parameter with so much in some rates is seen in no others


@dataclass(frozen=True)
class Wrong:
    """Collects of one run that something is wrong with: what is `done` about them, and why."""

    sensor: int
    run: int
    collects: tuple[int, ...]
    channels: tuple[str, ...]
    done: str
    why: str

    @classmethod
    def of(cls, collects: Collects, cause: Cause, done: str, why: str) -> Self:
        """Return what is wrong with rows by the campaign's own names; no channel in particular is every one."""
        conditions, names = collects.conditions, tuple(collects.conditions.sensor.channels)
        collect = tuple(conditions.collect[list(cause.rows)].tolist())
        channels = tuple(names[c] for c in cause.channels) or names
        return cls(conditions.sensor.number, cause.run, collect, channels, done, why)

    def document(self) -> dict[str, Any]:
        """Return the entry of key `rows`."""
        return {**vars(self), "collects": list(self.collects), "channels": list(self.channels)}

    def used_here(self) -> Self:
        """Return the same where what numbers are made without is used."""
        return replace(self, done=USED, why=f"{self.why}; hil solve leaves it out") if self.done == LEFT_OUT else self


@dataclass(frozen=True)
class WrongRows:
    """What is wrong with one sensor's rows; `collects` are those to solve, `not_compared` runs that stand alone.

    With each, the parameters of which no other tells; none where that is the whole. `apart` are runs of which it is
    certain that nothing holds: they are solved, and are in no mean. `sees_from`, deg/hr: among so few runs what is off
    by less does not show; None among more. `may_be` are two that explain best what is not certain, and `likeliest` the
    collects without that, too: nothing is solved by them, a search starts there. `other` is what another sensor shows.
    `off_deg_per_hr` is how far each rate that is left out is from what all others show, by run, collect and channel.
    `another` are by parameter the runs of which the bias or MU was another, `mends` what puts rates where they belong.
    """

    collects: Collects
    rows: tuple[Wrong, ...]
    judged: Mapping[int, Judgement]
    not_compared: Mapping[int, tuple[str, ...]]
    apart: Set[int]
    sees_from: float | None
    may_be: tuple[Wrong, ...]
    likeliest: Collects
    other: OtherSensor | None
    off_deg_per_hr: Mapping[tuple[int, int, str], float]
    another: Mapping[str, frozenset[int]]
    mends: Sequence[Cause]

    def as_filed(self, rates: FloatArray) -> FloatArray:
        """Return rates (n, c) that are known where they belong as they would have been filed, mistakes included."""
        for cause in reversed(self.mends):  # each of which undoes itself
            rates = mended(replace(self.collects, rates_deg_per_hr=rates), cause).rates_deg_per_hr
        return rates


def wrong_rows(campaign: Campaign) -> dict[int, WrongRows]:
    """Return by sensor what is wrong with its rows, and its collects with that mended or left out.

    Of runs that FAIL by their records nothing is held against another's rows.
    """
    fails = tuple(frozenset(failed(campaign, number)) for number in campaign.sensors)
    exchanged = tuple(tuple(campaign.exchanged.get(number, ())) for number in campaign.sensors)
    return dict(zip(campaign.sensors, _wrong_rows(tuple(campaign.sensors.values()), fails, exchanged), strict=True))


def failed(campaign: Campaign, number: int, *, unless_mended: bool = False) -> set[int]:
    """Return a sensor's runs that FAIL by what was recorded of them; or those that do not only for what is mended."""
    recorded = {run for run, of in campaign.verdicts.items() if of.verdict is Verdict.FAIL}
    contradicted = {run for run, sensor in campaign.contradicted if sensor == number}
    if unless_mended and contradicted:
        contradicted -= {row.run for row in wrong_rows(campaign)[number].rows if row.done == MENDED}
    return recorded | contradicted


@lru_cache(maxsize=4)
def _wrong_rows(
    sensors: tuple[Collects, ...],
    failed: tuple[frozenset[int], ...],
    exchanged: tuple[tuple[tuple[int, int], ...], ...],
) -> tuple[WrongRows, ...]:
    laid = [with_every_error(unclipped(each)) for each in sensors]
    together = Together.of(laid, failed, exchanged)
    known = [clipped_rows(each) for each in sensors]
    for causes, by_accelerometers in together.exchanged:
        of = {k: Wrong.of(laid[k], cause, MENDED, "") for k, cause in causes.items()}
        named = {k: f"{numbered('collect', each.collects)} of sensor {each.sensor}" for k, each in of.items()}
        for k, cause in causes.items():
            others = [name for other, name in named.items() if other != k]
            with_it = f"; the same of {listed(others)}, recorded with them" if others else ""
            why = _LIES if by_accelerometers else _AS_FILED[2]
            said = f"{cause_in_words(laid[k], cause)}{why}{in_the_file(laid[k], cause)}{with_it}"
            known[k].append(replace(of[k], why=said))
    return tuple(_told(together, k, known[k], failed[k]) for k in range(len(sensors)))


def _told(together: Together, k: int, known: Sequence[Wrong], failed: Set[int]) -> WrongRows:
    """Do what was found to be wrong with the collects of a sensor, beside what is `known`, and say so."""
    collects, found, other = together.collects[k], together.found[k], together.shown[k]
    rows, filed = [*known], collects
    judged = {each.run: [Judgement(Verdict.FAIL, each.why)] for each in known if each.done == MENDED}
    for each in found:
        if each.likeliest and each.likeliest.what == "run" and each.likeliest.run in failed:
            continue  # nothing more is known of it than that it is not to be used
        for run, wrong, judgement in _said(filed, each):
            judged.setdefault(run, []).append(judgement)
            rows.append(wrong)
        collects = mended(collects, each.likeliest) if each.likeliest is not None else collects
    for gone, left in _left_alone(filed, lost(found)):
        why = f"{numbered('run', gone)} of its temperature are left out{_WHICH}"
        for run in left:
            judged.setdefault(run, []).append(Judgement(Verdict.MARGINAL, why))
    every = {run: combine(several) for run, several in judged.items()}
    # A search meets one thing by itself, with its rivals; two that hide each other it would not.
    hidden = [next((way for way in each.ways if len(way) > 1), ()) for each in found if each.likeliest is None]
    unsure = {cause.place: cause for way in hidden for cause in way}
    likeliest, may_be = collects, []
    for cause in unsure.values():
        may_be.append(Wrong.of(filed, cause, _DONE.get(cause.what, _AS_FILED)[0], cause_in_words(filed, cause)))
        likeliest = mended(likeliest, cause)
    alone, seen_from = beyond_others(collects, {*failed, *(run for each in found for run in each.used)})
    off = {at: by for each in found if each.leaves_out and each.likeliest for at, by in _off(filed, each.likeliest)}
    mends = [causes[k] for causes, _ in together.exchanged if k in causes]
    mends += [c for each in found if (c := each.likeliest) and c.what not in _DONE and not c.instead]
    another: dict[str, frozenset[int]] = {}
    for cause in (each.likeliest for each in found if each.likeliest and each.likeliest.what in OWN):
        for name in _of_its_own(filed, cause):
            another[name] = another.get(name, frozenset()) | {cause.run}
    return WrongRows(
        collects=collects,
        rows=tuple(rows),
        judged=every,
        not_compared=alone,
        apart=lost(found),
        sees_from=seen_from,
        may_be=tuple(may_be),
        likeliest=likeliest,
        other=other,
        off_deg_per_hr=off,
        another=another,
        mends=mends,
    )


def _left_alone(filed: Collects, gone: Set[int]) -> Iterator[tuple[list[int], list[int]]]:
    """Yield the runs that are `gone` from a temperature, and those that are left there, where most are gone."""
    for _, runs in runs_by_temperature(filed.conditions):
        out, left = [run for run in runs if run in gone], [run for run in runs if run not in gone]
        if left and len(out) > len(left):
            yield out, left


def _of_its_own(filed: Collects, cause: Cause) -> list[str]:
    """Return the parameters of a run that were others: those of the cause that move a channel which is off."""
    form, off = default_form(filed.conditions), np.abs(cause.off) > _TOLD
    moves = np.any(form.columns(filed.conditions)[list(cause.rows)][:, off], axis=(0, 1))
    return [n for n, does in zip(form.names, moves, strict=True) if does and n.startswith(OWN[cause.what])]


def _off(filed: Collects, cause: Cause) -> Iterator[tuple[tuple[int, int, str], float]]:
    """Yield how far off the rates of a cause are, deg/hr, by run, collect and channel."""
    names, (row, *_) = list(filed.conditions.sensor.channels), cause.rows
    for c in cause.channels or range(len(names)):
        yield (cause.run, int(filed.conditions.collect[row]), names[c]), cause.off[c]


def _said(filed: Collects, found: Explained) -> Iterator[tuple[int, Wrong, Judgement]]:
    """Yield the runs that something found is about, what is done, and the judgement that they have at best."""
    conditions, cause = filed.conditions, found.likeliest
    if cause is not None:
        rivals = [cause_in_words(filed, other) for other, _ in found.rivals[1:]]
        others = "; or ".join(["", *rivals, *of_its_run(filed, cause)])
        done, verdict, because, hence = _DONE.get(cause.what, _AS_FILED)
        why = f"{cause_in_words(filed, cause)}{because}{in_the_file(filed, cause)}"
        others = as_at(filed, cause) + others
        yield cause.run, Wrong.of(filed, cause, done, f"{why}{others}"), Judgement(verdict, f"{why}{hence}{others}")
        return
    runs = sorted(found.runs or set(conditions.run.tolist()))
    may_be = dict.fromkeys(all_of([cause_in_words(filed, each) for each in way]) for way in found.ways[:_FEW])
    several, every = len(runs) > 1, {*runs} == set(conditions.run.tolist())
    alone = "contradict each other" if several else "contradicts itself"
    how = alone if every else f"{'do' if several else 'does'} not agree with the others"
    differ = f"{numbered('run', runs)} {how}"
    or_noise = "standard errors are too small" if stated_noise(filed) is not None else "noise is larger"
    nothing = f", or nothing is wrong and {or_noise}" * (found.nothing >= HARDLY)
    once = _FROM if all(each.endswith(_FROM) for each in may_be) else ""
    some = ", or ".join(each.removesuffix(once) for each in may_be)
    why = f"{differ}: {some}{once}{nothing}; these rates cannot tell which"
    if not may_be:
        why = (
            f"{differ}: in what neither a bias nor MU moves rates are {significant(found.times)} times as far apart as "
        )
        why += "their standard errors say; several collects are wrong, or what is stated is no error of theirs"
    for run in runs:
        own = Cause("run", run, tuple(np.flatnonzero(conditions.run == run).tolist()))
        at_best = Verdict.INCONCLUSIVE if found.nothing < HARDLY else Verdict.MARGINAL
        yield run, Wrong.of(filed, own, USED, why), Judgement(at_best, why)


def of_its_run(filed: Collects, cause: Cause) -> Iterator[str]:
    """Say what of the run's own shows in no rates but those that are left out: in the order 1-2-3 MU, in Collect 3."""
    if _DONE.get(cause.what, _AS_FILED)[0] == LEFT_OUT and cause.what != "run":
        form, here = default_form(filed.conditions), filed.conditions.of_each_run[cause.run]
        squares = (form.columns(filed.conditions) * np.isfinite(filed.rates_deg_per_hr)[..., None]) ** 2
        those = np.ix_([*cause.rows], cause.channels or range(squares.shape[1]))
        shares = squares[those].sum(axis=(0, 1)) / np.maximum(squares[here].sum(axis=(0, 1)), 1e-300)
        only = [n for n, of in zip(form.names, shares, strict=True) if n.startswith(("B", "MU")) and of > _ONLY]
        if only:
            yield f"{listed(only)} of run {cause.run} {'is another' if len(only) == 1 else 'are others'}"


def as_at(filed: Collects, cause: Cause) -> str:
    """Say at which other position a collect shows what it does, by the rest of its run: no channel is bad."""
    conditions, form, sigma = filed.conditions, default_form(filed.conditions), stated_noise(filed)
    here, row = np.setdiff1d(conditions.of_each_run[cause.run], cause.rows), cause.rows[0]
    if cause.what != "collect" or sigma is None or not len(here):
        return ""
    columns, beside_earth = form.columns(conditions), filed.rates_deg_per_hr - conditions.w_channels_deg_per_hr
    own = solve(columns[here].reshape(-1, columns.shape[2]), beside_earth[here].ravel(), sigma[here].ravel())
    if not np.isfinite(own.values).all():
        return ""
    chances = {}
    for position in np.unique(conditions.position[conditions.position != conditions.position[row]]).tolist():
        there = int(np.argmax(conditions.position == position))
        foretold = columns[there] @ own.values + conditions.w_channels_deg_per_hr[there]
        covariance = np.diag(sigma[row] ** 2) + columns[there] @ own.covariance @ columns[there].T
        away = filed.rates_deg_per_hr[row] - foretold
        chances[position] = float(chdtrc(len(away), away @ np.linalg.solve(covariance, away)))
    alike = max(chances, key=lambda position: chances[position], default="")
    lay = f"; it shows what position {alike} does: the unit may have lain there"
    return lay if chances.get(alike, 0.0) > _ALIKE else ""


def in_the_file(filed: Collects, cause: Cause) -> str:
    """Say of two collects what to exchange: rates, or what goes by a label; how the unit lay tells, if recorded."""
    if cause.what != "exchanged":
        return ""
    as_filed, as_the_other = lies_off_g(filed, cause)
    of_another_label = bool(np.all(from_the_usual_g(filed.conditions)[list(cause.rows)] > FIXTURE_G))
    rates = "rates" + " and position" * of_another_label
    labels = "position, " * (not of_another_label) + "f and w"
    if as_filed < as_the_other:
        return f" (exchange their {rates}: by its accelerometers the unit lies in each as f says)"
    if as_the_other < as_filed or of_another_label:
        return f" (exchange their {labels})"
    return f" (exchange their {rates}, or their {labels}: no accelerometer tells which)"


def lies_off_g(filed: Collects, cause: Cause) -> tuple[float, float]:
    """Return how far the unit lay, by its accelerometers, from where collects are filed, and from there exchanged, g.

    NaN where there are none.
    """
    rows = list(cause.rows)
    lay, f_g = accelerations_g(filed)[rows], filed.conditions.f_g[rows]
    return float(np.linalg.norm(lay - f_g)), float(np.linalg.norm(lay - f_g[::-1]))


def cause_in_words(collects: Collects, cause: Cause) -> str:
    """Say what a cause is, by the numbers of its collects."""
    conditions = collects.conditions
    names, collect = list(conditions.sensor.channels), conditions.collect[list(cause.rows)].tolist()
    own = listed(names[c] for c in cause.channels or range(len(names)))
    named = numbered("collect", collect)
    at = f", at positions {' and '.join(conditions.position[list(cause.rows)].tolist())}, look exchanged"
    if cause.what in ("rate", "collect", *OWN):
        up_to = "up to " * (cause.what == "MU")
        off = [
            f"{name} is {up_to}{by:+.4g} deg/hr" for name, by in zip(names, cause.off, strict=True) if abs(by) > _TOLD
        ]
        return f"{named}: {' and '.join(off)}{_FROM}"
    return {
        "exchanged": f"{named}{at}",
        "channels": f"{named}: {own} look exchanged",
        "sensors": f"{named}: the rates look like the other sensor's",
        "turned": f"{named}: the sign of {own} looks turned",
        "all turned": f"{named}: the signs look turned",
        "run": f"{named}: more than one does not agree with the others",
    }[cause.what]


def clipped_rows(collects: Collects) -> list[Wrong]:
    """Return the averages that stand at a channel's limit, run by run."""
    conditions, out = collects.conditions, []
    for channel, rows, why in clipped(collects):
        for run in np.unique(conditions.run[rows]).tolist():
            here = tuple(np.flatnonzero(rows & (conditions.run == run)).tolist())
            out.append(Wrong.of(collects, Cause("rate", run, here, (channel,)), LEFT_OUT, why))
    return out


def treated(campaign: Campaign) -> Campaign:
    """Return what numbers are made from: rows mended or left out, and no run of which nothing holds, if any does.

    `not_used` says which those are, beside those that are not `pooled`.
    """
    used = pooled(campaign)
    sensors, not_used = {}, {}
    for number, found in wrong_rows(campaign).items():
        runs = set(used.sensors[number].conditions.run.tolist())
        kept = np.isin(found.collects.conditions.run, list(runs - found.apart or runs))
        sensors[number] = found.collects.rows(kept)
        not_used[number] = sorted({*used.not_used[number], *(runs & found.apart if runs - found.apart else ())})
    return replace(used, sensors=sensors, exchanged={}, not_used=not_used)


def laid_right(campaign: Campaign) -> tuple[Campaign, list[Wrong]]:
    """Return a campaign with rates where they belong that are certain to be filed elsewhere, and what is wrong with it.

    What `treated` leaves out is used there.
    """
    found, sensors = wrong_rows(campaign), {}
    for number, rows in campaign.sensors.items():
        laid = found[number].collects.rates_deg_per_hr  # what is left out there is not mended
        sensors[number] = replace(rows, rates_deg_per_hr=np.where(np.isfinite(laid), laid, rows.rates_deg_per_hr))
    return replace(campaign, sensors=sensors), [row.used_here() for of in found.values() for row in of.rows]


def sound(campaign: Campaign) -> Campaign:
    """Return a `pooled` campaign without sensors of which every run FAILs by its records, where others do not."""
    own = {number: set(rows.conditions.run.tolist()) for number, rows in campaign.sensors.items()}
    kept = {n: rows for n, rows in campaign.sensors.items() if own[n] - failed(campaign, n, unless_mended=True)}
    return replace(campaign, sensors=kept) if kept else campaign


def pooled(campaign: Campaign) -> Campaign:
    """Return what repeats, means and searches are made from: no run that FAILs by its records, where others are left.

    One whose only fault is mended is none of these. `not_used` says which are not among them.
    """
    sensors, not_used = {}, {}
    for number, rows in campaign.sensors.items():
        kept = ~np.isin(rows.conditions.run, list(failed(campaign, number, unless_mended=True)))
        sensors[number] = rows.rows(kept) if kept.any() and not kept.all() else rows
        gone = np.setdiff1d(rows.conditions.run, sensors[number].conditions.run).tolist()
        not_used[number] = sorted({*campaign.not_used.get(number, ()), *gone})
    return replace(campaign, sensors=sensors, not_used=not_used)
