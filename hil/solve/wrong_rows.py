"""What is wrong with rows, and what is done about it: the same answer in every command that states a number.

    found = wrong_rows(campaign)[2]
    found.rows          # (Wrong(sensor=2, run=5, collects=(13, 14), done="mended", why="…exchanged…"),)
    found.collects      # what is solved: labels put right, rates that are wrong left out
    found.judged[5]     # no run that rests on such a row is a PASS

The quick form of what `hil reconcile` asks of every row: what the unit's accelerometers and the other runs show at the
same position and temperature (`hil.solve.neighbours`), and where a run stands alone and holds more rates than
parameters, whether it is far more probable with one collect left out, with the search's own prior of a wrong row.
"""

from collections.abc import Collection, Mapping, Sequence, Set
from dataclasses import dataclass, replace
from itertools import product
from typing import Any

import numpy as np

from hil.campaign import Campaign, Collects, FloatArray, IntArray
from hil.campaign.plausibility import clipped, unclipped
from hil.model.forms import default_form
from hil.solve.contradicting import contradicting
from hil.solve.exchanged import by_which_all_agree
from hil.solve.identifiability import orthonormal
from hil.solve.neighbours import Found, Neighbours, compared_with_neighbours
from hil.solve.precision import with_every_error
from hil.solve.temperatures import unsettled
from procedures.verdict import Judgement, Verdict, combine
from procedures.words import numbered

LEFT_OUT, MENDED, USED = "left out", "mended", "used"
PRIOR = 0.1
"""Prior odds that a campaign has a wrong row: those of the search."""
_LIES = "in each the unit lies, by its accelerometers, as in the other's position"
_AGREES = "so all rates agree with each other, and not as they are filed"
_WIDE = np.log(30.0)  # what a row that may be anywhere pays for each of its rates
_FREEDOM = 6  # residuals that must be left where a collect is left out
_LEVEL = 0.7  # of a channel's mean variance in every row's: standard errors leave out what differs by collect


@dataclass(frozen=True)
class Wrong:
    """Collects of one run that something is wrong with: what is `done` about them, and why."""

    sensor: int
    run: int
    collects: tuple[int, ...]
    channels: tuple[str, ...]
    done: str
    why: str

    def document(self) -> dict[str, Any]:
        """Return the entry of key `rows`."""
        return {**vars(self), "collects": list(self.collects), "channels": list(self.channels)}


@dataclass(frozen=True)
class WrongRows:
    """What is wrong with one sensor's rows; `collects` are those to solve, `not_compared` runs that stand alone.

    `sees_from`, deg/hr, is that of `Neighbours`: among so few runs what is off by less does not show.
    """

    collects: Collects
    rows: tuple[Wrong, ...]
    judged: Mapping[int, Judgement]
    not_compared: Set[int]
    sees_from: float | None


def wrong_rows(campaign: Campaign) -> dict[int, WrongRows]:
    """Return by sensor what is wrong with its rows, and its collects with that mended or left out.

    Of runs that FAIL by their records nothing is held against another's rows.
    """
    return {
        number: _wrong_rows(rows, campaign.exchanged.get(number, ()), _failed(campaign, number))
        for number, rows in campaign.sensors.items()
    }


def _failed(campaign: Campaign, number: int) -> set[int]:
    """Return a sensor's runs that FAIL by what was recorded of them, mended or not."""
    recorded = {run for run, of in campaign.verdicts.items() if of.verdict is Verdict.FAIL}
    return recorded | {run for run, sensor in campaign.contradicted if sensor == number}


def _mended(campaign: Campaign, number: int) -> set[int]:
    """Return a sensor's runs that FAIL by their records for nothing but what is mended."""
    if not campaign.contradicted:
        return set()
    recorded = {run for run, of in campaign.verdicts.items() if of.verdict is Verdict.FAIL}
    rows, pairs = campaign.sensors[number], campaign.exchanged.get(number, ())
    found = _wrong_rows(rows, pairs, _failed(campaign, number))
    return {row.run for row in found.rows if row.done == MENDED} - recorded


def _wrong_rows(collects: Collects, exchanged: Sequence[tuple[int, int]], failed: Collection[int]) -> WrongRows:
    at_limit = clipped_rows(collects)
    collects = with_every_error(unclipped(collects))
    collects, lay, neighbours = _as_the_unit_lay(collects, exchanged, failed)
    rates, se = collects.rates_deg_per_hr.copy(), collects.rates_se_deg_per_hr.copy()
    rows, judged = [*at_limit, *lay], {each.run: Judgement(Verdict.FAIL, each.why) for each in lay}
    judged |= neighbours.judged
    for found in neighbours.found:
        if found.exchanged is not None:
            one, other = found.exchanged
            rates[[one, other]], se[[one, other]] = rates[[other, one]], se[[other, one]]
        rates[found.wrong] = np.nan
        done = MENDED if found.exchanged is not None else LEFT_OUT if found.wrong.any() else USED
        rows.append(_wrong(collects, found, done, judged[found.run].reason))
    for run in sorted(neighbours.not_compared):
        for row in _far_from_residuals(collects.rows(own := np.flatnonzero(collects.conditions.run == run))):
            wrong = np.zeros(rates.shape, dtype=bool)
            wrong[own[row]] = True
            rates[wrong] = np.nan
            found = Found(run, np.array([own[row]]), wrong, None)
            number = int(collects.conditions.collect[own[row]])
            why = f"collect {number} is far from what all others show, and is left out"
            judged[run] = combine([*([judged[run]] if run in judged else []), Judgement(Verdict.MARGINAL, why)])
            rows.append(_wrong(collects, found, LEFT_OUT, why))
    used = replace(collects, rates_deg_per_hr=rates, rates_se_deg_per_hr=se)
    # Where a wrong collect would not be seen among its neighbours, these say no more than those that are not there.
    unseen = neighbours.not_compared if neighbours.sees_from is None else set(used.conditions.run.tolist())
    for run, why in contradicting(used, unseen - set(failed)).items():
        if run not in judged:
            here = Found(run, np.flatnonzero(used.conditions.run == run), np.zeros(rates.shape, dtype=bool), None)
            judged[run] = Judgement(Verdict.INCONCLUSIVE, why)
            rows.append(_wrong(used, here, USED, why))
    return WrongRows(used, tuple(rows), judged, neighbours.not_compared, neighbours.sees_from)


def _as_the_unit_lay(
    collects: Collects, exchanged: Sequence[tuple[int, int]], failed: Collection[int]
) -> tuple[Collects, list[Wrong], Neighbours]:
    """Put rates under the labels that accelerometers or residuals give them; not where other runs contradict it."""
    tried: dict[tuple[int, int], str] = {}
    out, told = [], ~np.isin(collects.conditions.run, list(failed))
    given = [pair for pair in exchanged if np.isin(pair, collects.conditions.collect).all()]
    while pair := given.pop(0) if given else by_which_all_agree(collects.rows(told)):
        if pair in tried:
            break
        tried[pair] = _LIES if pair in exchanged else _AGREES
        i, j = np.flatnonzero(np.isin(collects.conditions.collect, pair)).tolist()
        rates, se = collects.rates_deg_per_hr.copy(), collects.rates_se_deg_per_hr.copy()
        rates[[i, j]], se[[i, j]] = rates[[j, i]], se[[j, i]]
        laid = replace(collects, rates_deg_per_hr=rates, rates_se_deg_per_hr=se)
        beside = [
            each.rows for each in compared_with_neighbours(laid, failed).found if each.wrong.any() or each.exchanged
        ]
        if not np.isin([i, j], np.concatenate([np.zeros(0), *beside])).any():
            why = f"{numbered('collect', pair)} look exchanged: {tried[pair]}"
            found = Found(int(laid.conditions.run[i]), np.array([i, j]), np.zeros(rates.shape, dtype=bool), (i, j))
            out.append(_wrong(laid, found, MENDED, why))
            collects = laid
    return collects, out, compared_with_neighbours(collects, failed)


def clipped_rows(collects: Collects) -> list[Wrong]:
    """Return the averages that stand at a channel's limit, run by run."""
    conditions, out = collects.conditions, []
    for channel, rows, why in clipped(collects):
        name = (list(conditions.sensor.channels)[channel],)
        for run in np.unique(conditions.run[rows]).tolist():
            numbers = tuple(conditions.collect[rows & (conditions.run == run)].tolist())
            out.append(Wrong(conditions.sensor.number, run, numbers, name, LEFT_OUT, why))
    return out


def what_is_wrong(campaign: Campaign) -> dict[str, Any]:
    """Return what is wrong with rows and runs of all sensors: keys `rows`, and those of `without`, of every document.

    Rows are those of runs that are in means: of the others each solution's reason says it. `rows_seen_from`, deg/hr by
    sensor, is there for one of which so few runs were made that a collect off by less is not seen.
    """
    not_used, every = pooled(campaign).not_used, wrong_rows(campaign)
    rows = [each for found in every.values() for each in found.rows]
    seen_from = {str(number): found.sees_from for number, found in every.items() if found.sees_from is not None}
    return {
        "rows": [each.document() for each in rows if each.run not in not_used[each.sensor]],
        **without(campaign),
    } | ({"rows_seen_from": seen_from} if seen_from else {})


def without(campaign: Campaign) -> dict[str, Any]:
    """Return keys `missing`, of what was asked for; `runs_not_used`, by sensor; `runs_not_settled`: sensor, runs, why.

    And `runs_used_though_failed` where every run FAILs, so that all are used.
    """
    used = pooled(campaign)
    found: dict[str, Any] = {
        "missing": list(campaign.missing),
        "runs_not_used": {str(number): list(runs) for number, runs in used.not_used.items() if runs},
    }
    found["runs_not_settled"] = [
        {"sensor": number, "runs": [run for run, of in soaks.items() if of == why], "why": why}
        for number, soaks in not_settled(used).items()
        for why in dict.fromkeys(soaks.values())
    ]
    runs = {number: set(rows.conditions.run.tolist()) for number, rows in used.sensors.items()}
    every = {
        str(number): sorted(own)
        for number, own in runs.items()
        if not used.not_used[number] and own <= _failed(used, number) - _mended(used, number)
    }
    return found | ({"runs_used_though_failed": every} if every else {})


def in_words(wrong: Mapping[str, Any]) -> list[str]:
    """Say of each entry of the keys that `what_is_wrong` returns what is done and why."""
    more = "; hil reconcile weighs it against everything else, and may leave it out"
    runs_by_words: dict[tuple[str, int, str], list[int]] = {}
    for each in wrong.get("rows", ()):
        why = each["why"].removeprefix(f"sensor {each['sensor']}: ")
        runs_by_words.setdefault((each["done"], each["sensor"], why), []).append(each["run"])
    rows = [
        f"{done}: sensor {number}, {numbered('run', runs)}: {why}{more * (done == USED)}"
        for (done, number, why), runs in runs_by_words.items()
    ]
    where = "in no mean, in no other run's ±, in no search"
    return (
        [f"missing: {each}" for each in wrong.get("missing", ())]
        + rows
        + [
            f"sensor {number}: {numbered('run', runs)} FAILed by what was recorded: {where}"
            for number, runs in wrong.get("runs_not_used", {}).items()
        ]
        + [
            f"sensor {number}: every run FAILed by what was recorded: no number of it is to be used"
            for number in wrong.get("runs_used_though_failed", {})
        ]
        + [
            f"sensor {each['sensor']}, {numbered('run', each['runs'])}: {each['why']}"
            for each in wrong.get("runs_not_settled", ())
        ]
        + [
            f"sensor {number}: among so few runs a collect that is off by less than {size:.2g} deg/hr is not seen "
            "here; hil reconcile looks closer"
            for number, size in wrong.get("rows_seen_from", {}).items()
        ]
    )


def not_settled(campaign: Campaign) -> dict[int, dict[int, str]]:
    """Return by sensor the runs, of those that are in means, in which the unit had not settled, and why."""
    every, used = campaign.sensors, pooled(campaign).sensors
    told = {number: unsettled(every[number].conditions) for number in used}
    return {n: {run: of for run, of in told[n].items() if run in rows.conditions.run} for n, rows in used.items()}


def otherwise(campaign: Campaign, rows: Sequence[Mapping[str, Any]]) -> list[str]:
    """Say where the search's `rows` are not what the quick form, which numbers are made from, does about them."""
    search, quick = (
        {
            (int(row["sensor"]), channel, collect)
            for row in of
            if row["done"] != USED
            for collect, channel in product(row["collects"], row["channels"])
        }
        for of in (rows, what_is_wrong(campaign)["rows"])
    )
    here = "by hil solve, report, budget, thermal and visibility, which judge by neighbours and residuals alone"
    return [
        f"sensor {sensor}, {channel}: {numbered('collect', sorted(n for *of, n in odd if of == [sensor, channel]))}: "
        f"{what} {here}"
        for odd, what in ((search - quick, "used as measured"), (quick - search, "left out or mended"))
        for sensor, channel in sorted({(s, c) for s, c, _ in odd})
    ]


def treated(campaign: Campaign) -> Campaign:
    """Return the campaign with its rows mended or left out: what numbers are made from."""
    return replace(campaign, sensors={n: found.collects for n, found in wrong_rows(campaign).items()}, exchanged={})


def pooled(campaign: Campaign) -> Campaign:
    """Return what repeats, means and searches are made from: no run that FAILs by its records, where others are left.

    One whose only fault is mended is none of these. `not_used` says which are not among them.
    """
    sensors, not_used = {}, {}
    for number, rows in campaign.sensors.items():
        kept = ~np.isin(rows.conditions.run, list(_failed(campaign, number) - _mended(campaign, number)))
        sensors[number] = rows.rows(kept) if kept.any() and not kept.all() else rows
        gone = np.setdiff1d(rows.conditions.run, sensors[number].conditions.run).tolist()
        not_used[number] = sorted({*campaign.not_used.get(number, ()), *gone})
    return replace(campaign, sensors=sensors, not_used=not_used)


def _wrong(collects: Collects, found: Found, done: str, why: str) -> Wrong:
    conditions = collects.conditions
    channels = [
        name for c, name in enumerate(conditions.sensor.channels) if done != LEFT_OUT or found.wrong[:, c].any()
    ]
    numbers = tuple(int(each) for each in conditions.collect[found.rows])
    return Wrong(conditions.sensor.number, found.run, numbers, tuple(channels), done, why)


def _far_from_residuals(collects: Collects) -> IntArray:
    """Return the collects of one run, (k,), without which its rates are more probable than with them."""
    conditions, rates = collects.conditions, collects.rates_deg_per_hr
    kept = np.asarray(np.isfinite(rates).all(axis=1))
    if not kept.any():
        return np.zeros(0, dtype=np.int64)
    variance = np.nan_to_num(collects.rates_se_deg_per_hr, nan=1.0) ** 2
    weight = 1.0 / np.sqrt(np.maximum((1.0 - _LEVEL) * variance + _LEVEL * variance[kept].mean(axis=0), 1e-12))
    columns = default_form(conditions).columns(conditions) * weight[..., None]
    observed = (rates - conditions.w_channels_deg_per_hr) * weight
    out: list[int] = []
    while (score := _log_odds(columns[kept], observed[kept])) is not None and score.max() > 0.0:
        worst = int(np.flatnonzero(kept)[int(np.argmax(score))])
        out.append(worst)
        kept[worst] = False
        if len(out) > 0.2 * len(rates):
            return np.zeros(0, dtype=np.int64)  # what stands out from so many is no row
    return np.array(out, dtype=np.int64)


def _log_odds(columns: FloatArray, observed: FloatArray) -> FloatArray | None:
    """Log odds that each of n collects is wrong, (n,), from columns (n, c, p) and rates (n, c); None for too few."""
    n, channels, p = columns.shape
    freedom = n * channels - p
    if freedom - channels < _FREEDOM:
        return None
    basis = orthonormal(columns.reshape(-1, p))
    left = observed.reshape(-1)
    left = left - basis @ (basis.T @ left)
    whole = float(left @ left)
    apart = left.reshape(n, channels)
    own = basis.reshape(n, channels, -1)
    keeps = np.eye(channels) - own @ np.swapaxes(own, 1, 2)
    gain = np.einsum("nc,ncd,nd->n", apart, np.linalg.pinv(keeps, rcond=1e-6, hermitian=True), apart)
    share = np.clip(gain / max(whole, np.finfo(np.float64).tiny), 0.0, 1.0 - 1e-12)
    return np.asarray(np.log(PRIOR / n) - channels * _WIDE - 0.5 * freedom * np.log1p(-share))
