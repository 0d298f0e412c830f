"""What the records of a campaign contradict of each other: no run rests on a row that another record gives the lie to.

    campaign = judged_by_its_records(campaign)
    campaign.contradicted[5, 2]   # of run 5, sensor 2: FAIL: collect 13: position 3 was asked for, but …

Each check asks what one record should be, given the others, and how far it may be off: the pose by the unit's own
accelerometers, and by the laws of `hil.campaign.laws` whatever is one number. What is further off is said in words with
its collects, and the runs of the sensors that rest on them FAIL, wherever they are shown.
"""

from collections.abc import Collection, Iterable, Iterator, Mapping, Sequence
from dataclasses import replace
from itertools import product

import numpy as np
from numpy.typing import NDArray

from hil.campaign.data import BoolArray, Campaign, Collects, Conditions, FloatArray, IntArray, Sensor
from hil.campaign.laws import digit, laws, slope_degC_per_min, soaked, to_come_degC
from hil.campaign.stand_ins import off_its_case
from hil.errors import InputError
from procedures.pose import Contradiction, PoseTable
from procedures.verdict import Judgement, Verdict, combine
from procedures.words import listed, numbered

_RIGID_G = 0.1  # in products of f: six degrees
_FOLLOWS = 0.5  # of the air's changes
_RANGE_DEGC = 10.0  # over which that is looked at
_WARM_DEGC = 20.0  # by more is no unit that powers itself off its air
_SAME_ROWS = 3
_DIGITS, _ROUNDING = 300.0, 1e-6
_AT_REST_DEG_PER_HR = 360_000.0  # a hundred degrees a second: many times what the poorest gyro is off by
_STILL = 0.05  # of what the earth rate alone moves a channel by
_POSES, _FAR = 4, 20.0  # so many, and so many sigmas in all
_STANDS = "shows the same in every pose, where {} by {:.3g} deg/hr: it does not turn with the unit, or {}"
_BEFORE = "the earth rate was taken off it before (a sensitivity that undoes just that is none)"
_FINE = 0.03  # of a standard error: in steps as fine as that hardly one in a thousand runs shows one value three times
_BY_CHANCE = 1e-3  # so rare it is that some collect of a campaign shows 0 in all channels, in steps as they are written
_PILED, _PILED_RATIO = 3, 2.0  # averages on one value, and times as many as on any between

_Found = tuple[Sequence[Collects], BoolArray, str]  # of sensors that were collected together, in which rows, what
_Lies = tuple[Sequence[Collects], Contradiction]


def judged_by_its_records(campaign: Campaign, series: Mapping[int, FloatArray] | None = None) -> Campaign:
    """Return the campaign with a FAIL, and a warning, for whatever its records contradict of each other.

    `series` holds what `laws.average` says, (4, c + 3), by the number of each collect that has its samples.
    """
    poses = list(_poses(campaign))
    found = [(about, each.collects, each.words) for about, each in poses]
    found += [*_tables(campaign), *_copies(campaign), *_limits(campaign)]
    found += _laws(campaign, series or {})
    contradicted: dict[tuple[int, int], Judgement] = {}
    said = []
    for sensors, rows, words in found:
        numbers = np.concatenate([each.conditions.collect[rows] for each in sensors]).tolist()
        sentence = f"{numbered('collect', numbers)}: {words}"
        said.append(sentence)
        for run, number in product(
            np.unique(sensors[0].conditions.run[rows]).tolist(), (each.conditions.sensor.number for each in sensors)
        ):
            recorded, known = campaign.verdicts.get(run), contradicted.get((run, number))
            if recorded is None or words not in recorded.reason:  # whoever recorded it may have said so already
                contradicted[run, number] = combine([Judgement(Verdict.FAIL, sentence), *([known] if known else [])])
    warnings = (*campaign.warnings, *said, *_off_the_case(campaign, contradicted))
    return replace(campaign, contradicted=contradicted, exchanged=_exchanged(poses), warnings=warnings)


def accelerations_g(collects: Collects) -> FloatArray:
    """Return what the unit's accelerometers showed along the sensor's axes, (n, 3), NaN where they did not."""
    columns, none = collects.conditions.columns, np.full(len(collects), np.nan)
    return np.stack([columns.get(name, none) for name in accelerometer_columns(collects.conditions.sensor)], axis=-1)


def accelerometer_columns(sensor: Sensor) -> list[str]:
    """Names of the columns of what the unit's own accelerometers show along the sensor's axes, g."""
    return [f"accelerometer_{axis}_g" for axis in sensor.axes]


def _poses(campaign: Campaign) -> Iterator[_Lies]:
    """Compare measured accelerations with f, over all sensors that were collected together: they are one body."""
    for group in _together(campaign):
        measured = np.stack([accelerations_g(each) for each in group], axis=1)
        if not np.isfinite(measured).any():
            continue
        f_g = np.stack([each.conditions.f_g for each in group], axis=1)
        labels = group[0].conditions.position
        poses = {label: np.median(f_g[labels == label], axis=0) for label in dict.fromkeys(labels.tolist())}
        axes = {each.conditions.sensor.number: each.conditions.sensor.axes for each in group}
        for each in PoseTable(axes, poses, campaign.pose).contradictions(labels.tolist(), measured, f_g):
            yield [one for one in group if each.sensor in (None, one.conditions.sensor.number)], each


def _exchanged(poses: Iterable[_Lies]) -> dict[int, list[tuple[int, int]]]:
    """Return by sensor the numbers of two collects of a run in which the unit lay, each, as the other's label says."""
    seen: dict[int, tuple[Collects, NDArray[np.str_]]] = {}
    for about, each in poses:
        for collects in about:
            labels = collects.conditions.position
            _, lies = seen.setdefault(collects.conditions.sensor.number, (collects, labels.astype(object)))
            lies[each.collects] = each.seen or labels[each.collects]
    out: dict[int, list[tuple[int, int]]] = {}
    for number, (collects, lies) in seen.items():
        run, labels = collects.conditions.run, collects.conditions.position
        turned = [np.flatnonzero((run == one) & (lies != labels)) for one in np.unique(run).tolist()]
        # Of three and more it is not known whose rates are whose where a position was taken twice.
        pairs = [of for of in turned if len(of) == 2 and (lies[of] == labels[of[::-1]]).all()]
        out[number] = [(int(one), int(other)) for one, other in collects.conditions.collect[pairs]] if pairs else []
    return out


def _together(campaign: Campaign) -> Collection[Sequence[Collects]]:
    groups: dict[tuple[float, ...], list[Collects]] = {}
    for each in () if campaign.centrifuge else campaign.sensors.values():
        groups.setdefault(tuple(each.conditions.start_s.tolist()), []).append(each)
    return groups.values()


def _tables(campaign: Campaign) -> Iterator[_Found]:
    """Compare the angles by which f turns from position to position: for the sensors of one body they are the same."""
    for first, *others in _together(campaign):
        position = first.conditions.position
        labels = list(dict.fromkeys(position.tolist()))
        for other in others:
            one, two = (
                np.array([np.median(each.conditions.f_g[position == label], axis=0) for label in labels])
                for each in (first, other)
            )
            apart = np.abs(one @ one.T - two @ two.T)
            if apart.max() > _RIGID_G:
                i, j = np.unravel_index(int(np.argmax(apart)), apart.shape)
                numbers = listed(each.conditions.sensor.number for each in (first, other))
                words = (
                    f"between positions {labels[int(i)]} and {labels[int(j)]} f turns by different angles for sensors "
                    f"{numbers}, which are one body: an orientation is wrong"
                )
                yield [first, other], np.isin(position, [labels[int(i)], labels[int(j)]]), words


def _copies(campaign: Campaign) -> Iterator[_Found]:
    """Look for rates that stand in two places: one channel's in another, or one collect's in another."""
    for group in _together(campaign):
        alike: dict[tuple[float, ...], dict[str, Collects]] = {}
        for each in group:
            for name, rates in zip(each.conditions.sensor.channels, each.rates_deg_per_hr.T, strict=True):
                whose = f"{name} of sensor {each.conditions.sensor.number}"
                if len(rates) >= _SAME_ROWS and np.ptp(rates) > 0.0:
                    alike.setdefault(tuple(rates.tolist()), {})[whose] = each
        for column, of in alike.items():
            if len(of) > 1:
                yield [*dict.fromkeys(of.values())], np.isfinite(column), f"{listed(of)} show the very same rates"
    for number, collects in () if campaign.rebuilt else campaign.sensors.items():
        rates, errors = collects.rates_deg_per_hr, collects.rates_se_deg_per_hr
        known = np.isfinite(rates).all(axis=1)
        _, first, times = np.unique(rates[known], axis=0, return_inverse=True, return_counts=True)
        twice = np.zeros_like(known)
        twice[known] = (times > 1)[first.ravel()]
        twice &= np.any([_by_no_chance(*own) for own in zip(rates.T, map(_least, errors.T), strict=True)], axis=0)
        if twice.any():
            yield [collects], twice, f"sensor {number}: show the very same rates: one was copied from another"


def clipped(collects: Collects) -> Iterator[tuple[int, BoolArray, str]]:
    """Yield channel, rows (n,) and words where averages pile up on a channel's extreme value, as no noise does.

    And where a channel shows the very same in every collect of a run, which turned it over.
    """
    for channel, rates in enumerate(collects.rates_deg_per_hr.T):
        name = f"sensor {collects.conditions.sensor.number}: {[*collects.conditions.sensor.channels][channel]}"
        moving, at_level = np.isfinite(rates), dict[float, list[IntArray]]()
        least, turned = _least(collects.rates_se_deg_per_hr[:, channel]), 1
        if not np.isfinite(least):  # of noise that nobody states it is known that poses of a run differ by more
            runs = (rates[rows[moving[rows]]] for rows in collects.conditions.of_each_run.values())
            least, turned = _least(np.array([np.ptp(own) for own in runs if len(own)])), 2
        by_digits = _by_no_chance(rates, least)
        telling = by_digits | (rates == 0.0)
        # What is written in digits far finer than noise no other rates of a run show by chance, too.
        finely = moving.any() and np.isfinite(least) and digit(rates) < _FINE * least
        known = telling | (moving & bool(finely))
        for own in collects.conditions.of_each_run.values():
            rows = own[known[own]]
            poses = len(np.unique(collects.conditions.position[rows]))
            if len(rows) >= _SAME_ROWS and poses >= turned and np.ptp(rates[rows]) == 0.0:
                at_level.setdefault(float(rates[rows[0]]), []).append(rows)
        for level, of in [*at_level.items()]:
            # A round value that runs show beside others, or that is the channel's extreme, is a limit.
            dead = np.nanmin(rates) < level < np.nanmax(rates) and sum(map(len, of)) == np.sum(rates == level)
            if not (dead or telling[of[0]].all()):
                del at_level[level]
        if moving.sum() >= 2 * _SAME_ROWS and np.ptp(rates[moving]) == 0.0:
            at_level = {float(rates[moving][0]): [np.flatnonzero(moving)]}  # in run after run, however round it is
        for level, stuck in at_level.items():
            here = np.zeros(len(rates), bool)
            here[np.concatenate(stuck)] = True
            here |= by_digits & (rates == level)  # from the middle of a run on, or up to it
            moving &= ~here
            yield channel, here, f"{name}: every rate is exactly {level + 0.0:g}: nothing was measured"
        levels, counts = np.unique(rates[moving], return_counts=True)
        for end in (0, -1) if len(levels) > _PILED else ():
            if counts[end] > max(_PILED - 1, _PILED_RATIO * counts[1:-1].max()):
                words = f"{name} goes no further than {levels[end]:g} deg/hr: it is clipped"
                yield channel, rates == levels[end], words


def _least(errors: FloatArray) -> float:
    """Return the smallest of some errors (n,) that is one, infinity where none is."""
    return float(np.min(errors, where=errors > 0.0, initial=np.inf))


def _by_no_chance(rates: FloatArray, least: float) -> BoolArray:
    """Return the rows (n,) whose rate has more digits than two averages have in common by chance.

    Of noise that is `least` at least, deg/hr; where nobody knows, it is infinite, and none has.
    """
    in_steps = rates / 10.0 ** np.ceil(np.log10(least / _DIGITS))
    return np.asarray(np.abs(in_steps - np.round(in_steps)) > _ROUNDING)


def unclipped(collects: Collects) -> Collects:
    """Return the collects without the averages that stand at a channel's limit (the rate lies beyond), or were none."""
    beyond, empty, rates = [*clipped(collects)], _empty(collects), collects.rates_deg_per_hr.copy()
    for channel, rows, _ in beyond:
        rates[rows, channel] = np.nan
    rates[empty] = np.nan
    return replace(collects, rates_deg_per_hr=rates) if beyond or empty.any() else collects


def _empty(collects: Collects) -> BoolArray:
    """Return the collects (n,) in which every channel shows exactly 0, as channels hardly do together by chance."""
    rates = collects.rates_deg_per_hr
    empty, chance = np.ones(len(rates), bool), np.full(len(rates), float(len(rates)))
    for own in rates.T:
        measured = np.isfinite(own)
        step, span = digit(own), float(np.ptp(own[measured])) if measured.any() else 0.0
        chance[measured] *= step / (step + span)
        empty &= (own == 0.0) | ~measured
    return np.asarray(empty & (chance < _BY_CHANCE))


def usable(campaign: Campaign) -> Campaign:
    """Return the campaign `unclipped`, without sensors of which no rate is left; `InputError` where none is."""
    sensors = {number: unclipped(collects) for number, collects in campaign.sensors.items()}
    sensors = {number: rows for number, rows in sensors.items() if np.isfinite(rows.rates_deg_per_hr).any()}
    if not sensors:
        raise InputError(f"{campaign.title}: no rate was measured that can be used")
    return replace(campaign, sensors=sensors)


def _limits(campaign: Campaign) -> Iterator[_Found]:
    for number, collects in campaign.sensors.items():
        empty = _empty(collects)
        for _, rows, words in clipped(collects):
            yield [collects], rows, words
            empty &= ~rows  # of which it is said already
        if empty.any():
            words = f"sensor {number}: every rate is exactly 0: nothing was measured"
            yield [collects], empty, f"{words}; a missing collect is an empty cell"
        size = np.nan_to_num(np.abs(collects.rates_deg_per_hr - collects.conditions.w_channels_deg_per_hr)).max(axis=1)
        if np.any(beyond := size > _AT_REST_DEG_PER_HR):
            words = f"sensor {number}: rates up to {size.max():.3g} deg/hr: no gyro shows as much of what it is held in"
            yield [collects], beyond, f"{words}; are they in deg/hr?"
        for name, own, errors, earth in zip(
            collects.conditions.sensor.channels,
            unclipped(collects).rates_deg_per_hr.T,  # of what stands still it is said already
            collects.rates_se_deg_per_hr.T,
            collects.conditions.w_channels_deg_per_hr.T,
            strict=True,
        ):
            known = np.isfinite(own + earth)
            moves, by_earth = (float(np.ptp(each[known])) if known.any() else 0.0 for each in (own, earth))
            if 0.0 < moves < _STILL * by_earth:
                words = f"sensor {number}: {name} moves by {moves:.2g} deg/hr in all, where the earth rate alone moves"
                yield [collects], known, f"{words} it by {by_earth:.3g}: is it in deg/hr?"
                continue
            usual = _mostly(collects.conditions, own), "mostly it moves", "the unit was not turned"
            for due, moved, instead in ((earth, "the earth rate alone moves it", _BEFORE), usual):
                if np.any(same := _in_every_pose(collects.conditions, own, errors, due)):
                    words = f"sensor {number}: {name} {_STANDS.format(moved, np.ptp(due[same]), instead)}"
                    yield [collects], same, words
                    break


def _mostly(c: Conditions, rates: FloatArray) -> FloatArray:
    """Return what a channel that shows `rates` mostly does at each one's position, deg/hr, (n,) each."""
    middle = {
        label: np.nanmedian(of)
        for label in {*c.position.tolist()}
        if np.any(np.isfinite(of := rates[c.position == label]))
    }
    return np.array([middle.get(label, np.nan) for label in c.position])


def _in_every_pose(c: Conditions, rates: FloatArray, errors: FloatArray, due: FloatArray) -> BoolArray:
    """Tell in which collects, (n,), a channel shows the same as in all of their run, where it is `due` to move far.

    That is far beyond its scatter, and its standard errors where they are stated; (n,) deg/hr each.
    """
    same = np.full(len(c), False)
    for own in c.of_each_run.values():
        rows = own[np.isfinite(rates[own]) & np.isfinite(due[own])]
        stated = np.all(errors[rows] > 0.0)
        if len(np.unique(c.position[rows])) >= _POSES:
            weight = 1.0 / (errors[rows] if stated else np.ones(len(rows)))
            white, mean = np.stack([rates, due])[:, rows] * weight, weight / np.linalg.norm(weight)
            shown, moves = np.linalg.norm(white - (white @ mean)[:, None] * mean, axis=1)
            same[rows] = moves > _FAR * max(shown / np.sqrt(len(rows) - 1.0), float(stated))
    return same


def _laws(campaign: Campaign, series: Mapping[int, FloatArray]) -> Iterator[_Found]:
    """Hold every record against the laws; what two sensors contradict is the fault of the one that breaks others."""
    for group in _together(campaign):
        lost = [list(_lost(each, f"sensor {each.conditions.sensor.number}")) for each in group]
        # What a thermometer shows that has lost the air is held against no other record.
        told = [_without_temperature(each, [rows for _, rows, _ in own]) for each, own in zip(group, lost, strict=True)]
        beside = [*told[1:], told[0]] if len(told) > 1 else [None]
        of = [list(laws(each, campaign.site, other, series)) for each, other in zip(told, beside, strict=True)]
        alone = [np.any([law.broken for law in own if not law.mutual], axis=0) for own in of]
        for k, (collects, own) in enumerate(zip(group, of, strict=True)):
            yield from lost[k]
            for law in own:
                if (broken := law.broken & ~alone[(k + 1) % len(group)] if law.mutual else law.broken).any():
                    yield [collects], broken, f"sensor {collects.conditions.sensor.number}: {law.words}"


def _off_the_case(campaign: Campaign, but: Collection[tuple[int, int]]) -> Iterator[str]:
    """Say in which run a thermometer is off its unit's case as in no other, but for `but`, of which more is said."""
    for number, collects in campaign.sensors.items():
        for off in off_its_case(collects.conditions):
            if (off.run, number) in but:
                continue
            which = "one of the two is off, and with it what is said of that run's temperature"
            if off.usual_degC is not None:
                which = "the thermometer is off, for beside the air the case is as in the others"
            yield (
                f"sensor {number}: in run {off.run} its thermometer shows {off.degC:z.1f} °C more than its case, in "
                f"all other runs {off.low:z.1f} to {off.high:z.1f} °C: {which}; look at both, and measure it again"
            )


def _without_temperature(collects: Collects, rows: Sequence[BoolArray]) -> Collects:
    """Return the collects with no temperature of the sensor in rows (n,) of any of these."""
    if not rows:
        return collects
    columns = collects.conditions.columns
    shown = np.where(np.any(rows, axis=0), np.nan, columns["temperature_degC"])
    return replace(collects, conditions=replace(collects.conditions, columns={**columns, "temperature_degC": shown}))


def _lost(collects: Collects, name: str) -> Iterator[_Found]:
    """Yield where a thermometer has lost the air: in one run, if the others follow it, or in all."""
    columns, run = collects.conditions.columns, collects.conditions.run
    what = "the air" if "chamber_degC" in columns else "the setpoint"
    shown, air = (
        columns.get(of) for of in ("temperature_degC", "chamber_degC" if what == "the air" else "setpoint_degC")
    )
    if shown is None or air is None:
        return
    rows = np.isfinite(shown + air)

    def said(lost: BoolArray, among: BoolArray) -> _Found:
        low, high = f"{shown[lost].min():.1f}", f"{shown[lost].max():.1f}"
        words = (
            f"{name}: its thermometer shows {low if low == high else f'{low} to {high}'} °C while "
            f"{what} went from {air[among].min():z.1f} to {air[among].max():z.1f} °C: it does not follow"
        )
        return [collects], lost, words

    # What is alive does not show one number on and on, soaked or not, while its air is another.
    in_time = np.flatnonzero(rows)[np.argsort(collects.conditions.start_s[rows], kind="stable")]
    for stretch in np.split(in_time, np.flatnonzero(np.diff(shown[in_time])) + 1):
        if len(stretch) >= _SAME_ROWS and np.ptp(air[stretch]) > _RANGE_DEGC:
            off = np.abs(shown[stretch] - air[stretch])
            there = np.abs(air[stretch] - air[stretch][np.argmin(off)]) < 0.5 * _RANGE_DEGC
            right = there & (off < _WARM_DEGC) & (len(stretch) < len(in_time))  # or may be
            among, lost = (np.isin(np.arange(len(rows)), of) for of in (stretch, stretch[~right]))
            rows &= ~among
            yield said(lost, among)
    rows &= soaked(collects.conditions)
    # What still follows has not lost the air.
    rows &= to_come_degC(slope_degC_per_min(collects.conditions)) < _RANGE_DEGC

    def follows(chosen: BoolArray) -> float:
        known = np.ptp(air[chosen]) > _RANGE_DEGC if chosen.any() else False
        return float(np.polyfit(air[chosen], shown[chosen], 1)[0]) if known else np.nan

    if follows(rows) < _FOLLOWS:
        without = {one: follows(rows & (run != one)) for one in np.unique(run[rows]).tolist()}
        wrong = [one for one, slope in without.items() if slope >= _FOLLOWS]
        lost = rows & (run == min(wrong, key=lambda one: abs(without[one] - 1.0))) if wrong else rows
        yield said(lost, rows)
