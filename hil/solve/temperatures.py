"""The same temperature: which collects, and which runs, of a campaign were made at one.

    same_temperature(conditions)     # 0, 0, 0, 1, 1, 1, … of each collect, coldest first; -1 where nobody knows
    runs_by_temperature(conditions)  # ((-20.0, (1, 9)), (3.0, (2, 10)), …): runs of one temperature repeat each other

Repeats, noise, a calibration per temperature, parameters against temperature, the report and reconcile ask here.
"""

import math
from collections.abc import Iterable, Sequence
from functools import lru_cache
from itertools import groupby

import numpy as np

from hil.campaign import Conditions, FloatArray, IntArray
from hil.campaign.data import TELL_TEMPERATURE, known_mean
from hil.campaign.laws import slope_degC_per_min, to_come_degC
from hil.campaign.stand_ins import OWN, WIDEST_DEGC, own_degC, temperature_of, told
from hil.errors import InputError
from hil.model import Model
from hil.model.effects.base import Effect
from hil.model.effects.prior import UNSEEN
from hil.model.forms import LinearForm, default_form, named_form, value_form
from hil.solve.identifiability import kept_shares, orthonormal
from hil.solve.uncertain import Spread
from procedures.words import counted, listed, numbered, spelled

NARROWEST_DEGC = 1.0
"""Neighbours that are this close always belong to one temperature; setpoints that are further apart never do."""

_SETPOINT = "setpoint_degC"
_MOST = 2.0 / 3.0  # of runs: fewer that agree by how much the unit is off its setpoint do not tell it
_BY_ITSELF_DEGC = 10.0  # by so much a unit may be warmer than it was set to
_LEFT = 0.05  # of the square of what a thermometer showed: setpoints that leave more the unit did not follow
_SIGMAS, _DIGIT_DEGC = 5.0, 0.03  # by which a slope is no jitter; and what a thermometer of one digit makes of none

NOT_SETTLED = "the soak had not ended"
_OR_OFF = f"is off, or {NOT_SETTLED}"

OF_A_LAW = 3
"""Temperatures from which on it can be told how values follow temperature: of two, what lies between is anyone's."""

ELSEWHERE_DEGC = 2.0
"""Another campaign's temperature, or a printed one, is the same where it is this close: chambers differ."""
_TELL = {
    "setpoint_degC": "the thermometer is off in some runs",
    OWN: "in some runs the unit was elsewhere than it was set to",
}
"""What tells that runs are of one temperature, and what is wrong with the other where values agree at equal ones."""


def same_temperature(conditions: Conditions, apart_degC: float | None = None) -> IntArray:
    """Number the temperatures of n collects, coldest first, shape (n,); -1 where a collect's is unknown.

    The setpoint tells, if there is one and the unit followed it (setpoints explain all but little of what it showed,
    or most of it lies within `WIDEST_DEGC` of the middle at each); else the unit's own thermometer, or, where some lack
    it, what stands in for it in all; else the chamber's.
    Without any temperature all collects are of one. Given `apart_degC`, steps of more than that part two temperatures,
    and nothing else does.
    """
    name = told_by(conditions, apart_degC)
    if name is None:
        return np.zeros(len(conditions), dtype=np.int64)
    level = conditions.columns[name]
    known = np.isfinite(level)
    out = np.full(len(conditions), -1, dtype=np.int64)
    out[known] = numbered_degC(level[known], apart_degC if name != _SETPOINT else apart_degC or NARROWEST_DEGC)
    return out


@lru_cache(maxsize=8)
def runs_by_temperature(
    conditions: Conditions, apart_degC: float | None = None
) -> tuple[tuple[float | None, tuple[int, ...]], ...]:
    """Group the runs that were made at one temperature, coldest first, with the mean over a group's runs, °C.

    A run stands at the temperature at which most of its collects do. Without any temperature all runs are one group. A
    run whose own is not known is a group by itself (None): nobody can say that it repeats another. So is one that had
    not settled where most had: it was elsewhere.
    """
    every, name = conditions.of_each_run, told_by(conditions, apart_degC)
    if name is None:
        return ((None, tuple(every)),)
    level, number = conditions.columns[name], same_temperature(conditions, apart_degC)
    groups: dict[int, list[int]] = {}
    for run, rows in every.items():
        here = number[rows][number[rows] >= 0]
        groups.setdefault(int(np.argmax(np.bincount(here))) if len(here) else -run - 1, []).append(run)
    late = unsettled(conditions).keys()
    for runs in [*groups.values()]:
        elsewhere = late & set(runs)
        if 2 * len(elsewhere) < len(runs):
            groups |= {-run - 1: [run] for run in elsewhere}
            runs[:] = [run for run in runs if run not in elsewhere]
    means = {run: known_mean(level[rows]) for run, rows in every.items()}
    ordered = sorted(groups.items(), key=lambda group: (group[0] < 0, abs(group[0])))
    return tuple(
        (None if at < 0 else known_mean(np.array([means[run] for run in of])), tuple(of)) for at, of in ordered
    )


def at_no_temperature(conditions: Conditions, apart_degC: float | None = None) -> list[int]:
    """Return the runs of which nobody knows at which of the campaign's temperatures they were made."""
    groups = runs_by_temperature(conditions, apart_degC) if told_by(conditions, apart_degC) is not None else ()
    return [run for degC, runs in groups if degC is None for run in runs]


def visits(conditions: Conditions) -> tuple[tuple[float | None, tuple[int, ...]], ...]:
    """Return in the order of time which temperatures were gone to, and the runs that were made there."""
    groups = runs_by_temperature(conditions)
    place = {run: k for k, (_, runs) in enumerate(groups) for run in runs}
    begins_s = {run: float(np.min(conditions.start_s[rows])) for run, rows in conditions.of_each_run.items()}
    in_time = groupby(sorted(place, key=begins_s.__getitem__), place.__getitem__)
    return tuple((groups[k][0], tuple(runs)) for k, runs in in_time)


def runs_by_visit(conditions: Conditions) -> tuple[tuple[float | None, tuple[int, ...]], ...]:
    """Group the runs of one visit to a temperature: of two visits the unit's history may differ.

    Where no visit has two runs, those of one temperature are a group, as in `runs_by_temperature`.
    """
    every = visits(conditions)
    return every if any(len(runs) > 1 for _, runs in every) else runs_by_temperature(conditions)


def runs_made_alike(conditions: Conditions) -> tuple[tuple[float | None, tuple[int, ...]], ...]:
    """Group the runs of one visit that took their collects in one order: by that a drift in each moves its values.

    Where no two are so, those of a visit are a group, as in `runs_by_visit`.
    """
    every, order = runs_by_visit(conditions), order_of_runs(conditions)
    alike = tuple(
        (degC, tuple(run for run in runs if order[run] == own))
        for degC, runs in every
        for own in dict.fromkeys(order[run] for run in runs)
    )
    return alike if any(len(runs) > 1 for _, runs in alike) else every


def order_of_runs(conditions: Conditions) -> dict[int, tuple[str, ...]]:
    """Return in which order each run took its positions."""
    return {
        run: tuple(conditions.position[rows[np.argsort(conditions.start_s[rows])]].tolist())
        for run, rows in conditions.of_each_run.items()
    }


def how_many(conditions: Conditions) -> str:
    """Say how many self-calibrations were made, and at how many known temperatures."""
    made = runs_by_temperature(conditions)
    known = sum(temperature is not None for temperature, _ in made)
    at = f" at {counted(known, 'temperature')}" if known else ""
    return f"{counted(sum(len(runs) for _, runs in made), 'self-calibration')}{at}"


def too_few(temperatures: int, of_which: str = "") -> str:
    """Say that so many temperatures `of_which` do not tell how values follow temperature; empty where they do."""
    if temperatures >= OF_A_LAW:
        return ""
    return f"{counted(temperatures, 'temperature')}{of_which}; at least {spelled(OF_A_LAW)} are needed"


def law_not_told(form: LinearForm, conditions: Conditions) -> str:
    """Say that collects do not tell how the values of a form follow temperature; empty where they do, or stand.

    What the thermometer shows inside one temperature is its scatter, and a law through it a law of that.
    """
    few = "" if form.reference_degC is None else too_few(int(same_temperature(conditions).max()) + 1)
    where = f"sensor {conditions.sensor.number}: {form.name}"
    return few and f"{where}: {few} to tell how values follow it; choose --model matrix-6"


def fitted_form(model: Model, conditions: Conditions) -> LinearForm:
    """Return the form to fit to a sensor: the model's own, or the sensor's where it is of another kind.

    Where too few temperatures tell how values follow it, those that the model has stand, and one set corrects them;
    raises `InputError` where it has none.
    """
    try:
        one_set = value_form(model.form, conditions.sensor)
    except InputError:
        return default_form(conditions)
    form = named_form(model.form, conditions)
    if untold := law_not_told(form, conditions):
        if conditions.sensor.number not in model.sensors:
            raise InputError(untold)
        return one_set
    return form


def told_parameters(effect: Effect, conditions: Conditions) -> tuple[int, ...]:
    """Return the places of an effect's parameters that temperatures tell from those of lower powers.

    Of two temperatures nobody knows what lies between: a line, and no bend. Whether they tell a line the base says.
    """
    temperature = conditions.columns.get("temperature_degC", np.zeros(0))
    every = enumerate(effect.parameters_for(conditions))
    known = temperature[np.isfinite(temperature)]
    about = known - (known.mean() if len(known) else 0.0)

    def left_of(power: int) -> float:
        powers = np.vander(about, power + 1)
        return float(kept_shares(orthonormal(powers[:, 1:]), powers[:, :1])[0])

    return tuple(k for k, each in every if each.power < 2 or left_of(each.power) > UNSEEN)


def nearest(temperature_degC: float | None, others_degC: Iterable[float | None]) -> float | None:
    """Return the one of `others_degC` that is the same temperature in another campaign, None where none is."""
    if temperature_degC is None or not np.isfinite(temperature_degC):
        return None
    close = [other for other in others_degC if other is not None and abs(other - temperature_degC) <= ELSEWHERE_DEGC]
    return min(close, key=lambda other: abs(other - temperature_degC), default=None)


def apart(unit_degC: tuple[float, float] | None, other_degC: tuple[float, float] | None) -> bool:
    """Whether what the unit's own thermometer showed in two campaigns, from … to, is not the same temperature."""
    if unit_degC is None or other_degC is None:
        return False
    return max(unit_degC[0] - other_degC[1], other_degC[0] - unit_degC[1]) > ELSEWHERE_DEGC


def level_degC(conditions: Conditions) -> FloatArray | None:
    """Return the column that tells temperatures from each other, shape (n,), NaN where it does not; None for none."""
    name = told_by(conditions)
    return None if name is None else conditions.columns[name]


def of_runs_degC(conditions: Conditions) -> dict[int, float]:
    """Return the mean of what tells each run's temperature, by run; runs of which nothing does lack."""
    level = level_degC(conditions)
    known = {} if level is None else {run: level[rows] for run, rows in conditions.of_each_run.items()}
    return {run: known_mean(of) for run, of in known.items() if np.isfinite(of).any()}


def told_by(conditions: Conditions, apart_degC: float | None = None) -> str | None:
    """Return the column that tells temperatures from each other: setpoint, unit's own or chamber's; None for none."""
    columns = conditions.columns
    said = [name for name in TELL_TEMPERATURE if name in columns and np.any(np.isfinite(columns[name]))]
    if said[:1] == [OWN]:
        name, _ = told(conditions)
        return temperature_of(conditions) if name == OWN else name
    if len(said) < 2 or said[0] != _SETPOINT:
        return said[0] if said else None
    setpoint, own = (columns[name] for name in said[:2])
    here = np.isfinite(own)
    if not np.all(np.isfinite(setpoint[here])):
        return said[1]
    number = numbered_degC(setpoint[here], apart_degC or NARROWEST_DEGC)
    off = own[here] - np.array([np.median(own[here][number == place]) for place in range(number.max() + 1)])[number]
    explained = np.sum(off**2) < _LEFT * np.sum((own[here] - own[here].mean()) ** 2)
    return said[0] if explained or np.mean(np.abs(off) < WIDEST_DEGC) > 0.5 else said[1]


def unit_range_degC(conditions: Conditions, runs: Sequence[int]) -> tuple[float, float] | None:
    """Return the lowest and highest that the unit's own thermometer showed in some runs; None where it did not."""
    own = own_degC(conditions)[np.isin(conditions.run, runs)]
    known = own[np.isfinite(own)]
    return (float(known.min()), float(known.max())) if len(known) else None


def unit_mean_degC(conditions: Conditions, runs: Sequence[int]) -> float:
    """Return the mean over their collects of what the unit's own thermometer showed in some runs; NaN where nothing."""
    return known_mean(own_degC(conditions)[np.isin(conditions.run, runs)])


def unsettled(conditions: Conditions) -> dict[int, str]:
    """Return the runs in which the unit, at several temperatures where one was meant, had not settled, and why.

    One is meant at a setpoint, and in a run where no setpoints were recorded. It was at another than its runs at other
    setpoints are off theirs by; or, where these do not tell, than mostly there, or, where no most agree, than it was
    left at last: if that is near to the setpoint, or nearest, else nobody knows which it is, and it is said of all.
    Or its temperature moved so fast that it was still to be another. How fast the thermometer tells through each run,
    where nobody recorded it.
    """
    own, setpoint = own_degC(conditions), conditions.columns.get(_SETPOINT)
    found: dict[int, str] = {}
    if OWN not in conditions.columns:
        return found
    if setpoint is not None and not np.isfinite(setpoint).all():
        setpoint = None
    meant = conditions.run if setpoint is None else numbered_degC(setpoint, NARROWEST_DEGC)
    line, through = _through_runs(conditions, own)
    slope, far = slope_degC_per_min(conditions, line), 0.5 * WIDEST_DEGC
    to_come = to_come_degC(slope)
    for place in np.unique(meant):
        here = np.flatnonzero((meant == place) & np.isfinite(own))
        several = here.size and np.ptp(own[here]) > WIDEST_DEGC
        moves = (to_come[here] > WIDEST_DEGC) & (through[here] > NARROWEST_DEGC) & (setpoint is not None)
        if several or np.any(moves):
            middle, last = np.median(own[here]), own[here[np.argmax(conditions.start_s[here])]]
            settled = middle if np.mean(np.abs(own[here] - middle) < far) > 0.5 else last
            at, of = ("", "the run") if setpoint is None else (f"setpoint {setpoint[here][0]:.4g} °C: ", "its runs")
            if setpoint is not None:
                usual = _mostly((own - setpoint)[(meant != place) & np.isfinite(own)], far)
                nearest = own[here[np.argmin(np.abs((own - setpoint)[here] - (usual or 0.0)))]]
                by_itself = abs(settled - setpoint[here[0]]) < _BY_ITSELF_DEGC
                unknown = usual is None and abs(settled - nearest) > far and not by_itself
                settled = nearest if usual is not None else np.inf if unknown else settled
            elsewhere = np.fmax(to_come[here], np.abs(own[here] - settled)) > far
            off = here[elsewhere if several else moves]
            began, ended = np.min(conditions.start_s[here]), np.max(conditions.start_s[here])
            again = np.any((meant != place) & (conditions.start_s > began) & (conditions.start_s < ended))
            still = setpoint is not None and not to_come[off].any()
            moving, why = f"went from {own[here].min():z.1f} to {own[here].max():z.1f} °C through {of}", NOT_SETTLED
            if not several:
                moving = f"moved by up to {slope[off].max():.2g} °C/min, at {known_mean(own[off]):z.1f} °C in the mean"
            elif still or again:
                moving, why = f"shows {_levels(conditions, own, here)}", f"it {_OR_OFF}" if still else NOT_SETTLED
            words = f"{at}the unit's own thermometer {moving}: {why}"
            found |= dict.fromkeys(np.unique(conditions.run[off]).tolist(), words)
    return found


def why_unsettled(words: Iterable[str]) -> str:
    """Return why of what `unsettled` says of runs, without where it shows: both where either may be."""
    return f"the thermometer {_OR_OFF}" if any(each.endswith(_OR_OFF) for each in words) else NOT_SETTLED


def _mostly(off: FloatArray, far: float) -> float | None:
    """Return what most of some numbers are near to, as far as nearly all agree; else None."""
    middle = float(np.median(off)) if off.size else np.nan
    return middle if off.size and np.mean(np.abs(off - middle) < far) > _MOST else None


def _levels(conditions: Conditions, own: FloatArray, rows: IntArray) -> str:
    """Say at which temperatures a thermometer stood in which runs."""
    level = numbered_degC(own[rows], None)
    of_each = [(rows[level == k], known_mean(own[rows[level == k]])) for k in np.unique(level)]
    return listed(f"{degC:z.1f} °C in {numbered('run', conditions.run[of].tolist())}" for of, degC in of_each)


def _through_runs(conditions: Conditions, degC: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return how fast a temperature (n,) goes through each run, °C/min, and over how many °C, (n,) each.

    It goes not at all where jitter may be all of it: that is what lines leave of all runs, which no run tells alone.
    """
    slopes, through, squares, freedom, lines = *np.zeros((2, len(conditions))), 0.0, 0, []
    for rows in conditions.of_each_run.values():
        if not len(known := rows[np.isfinite(degC[rows])]):
            continue
        minutes, off = (conditions.start_s[known] + 0.5 * conditions.duration_s[known]) / 60.0, degC[known]
        minutes, off = minutes - minutes.mean(), off - off.mean()
        through[rows], reach = np.ptp(off), float(minutes @ minutes)
        if len(known) > 2 and reach > 0.0:
            lines.append((rows, float(minutes @ off) / reach, math.sqrt(reach)))
            squares, freedom = squares + float(np.sum((off - lines[-1][1] * minutes) ** 2)), freedom + len(known) - 2
    jitter = _SIGMAS * max(math.sqrt(squares / max(freedom, 1)), _DIGIT_DEGC)
    for rows, slope, reach in lines:
        slopes[rows] = slope * (abs(slope) * reach > jitter)
    return slopes, through


def numbered_degC(values: FloatArray, apart_degC: float | None) -> IntArray:
    """Number values by the temperature that they belong to, smallest first, shape (n,).

    Sorted values part at gaps, and the values themselves tell at which: gaps up to `NARROWEST_DEGC` never part them,
    those above `WIDEST_DEGC` always do, and between the two the widest void among the sizes of the gaps, by ratio,
    parts scatter from steps. What is then still wider than `WIDEST_DEGC` has no plateaus (a slow ramp) and is cut into
    equal parts no wider than that.
    """
    rising = np.sort(values)
    gaps = np.diff(rising)
    low, high = (apart_degC, apart_degC) if apart_degC is not None else (NARROWEST_DEGC, WIDEST_DEGC)
    scatter = max(float(gaps[gaps <= low].max()), low / 4.0) if np.any(gaps <= low) else low
    in_doubt = np.sort(gaps[(gaps > low) & (gaps <= high)])
    sizes = np.array([scatter, *in_doubt, min(gaps[gaps > high], default=high)])
    breaks = np.flatnonzero(gaps > sizes[int(np.argmax(sizes[1:] / sizes[:-1]))])
    edges = [float(np.mean(rising[place : place + 2])) for place in breaks]
    for part in np.split(rising, breaks + 1):
        pieces = int(np.ceil(np.ptp(part) / high))
        if pieces > 1:
            edges += np.linspace(part[0], part[-1], pieces + 1)[1:-1].tolist()
    number = np.searchsorted(np.sort(np.array(edges)), values, side="right")
    return np.unique(number, return_inverse=True)[1].astype(np.int64)


def agrees(number: IntArray, values: FloatArray, errors: FloatArray, conditions: Conditions) -> list[str]:
    """Say which of setpoint and thermometer is wrong, where some of values (r, p) repeat far better at the other.

    Asked where these contradict each other, and not said where some do at one, and some at the other.
    """
    levels = [conditions.columns.get(name) for name in _TELL]
    known = [of for of in levels if of is not None and np.isfinite(of).all()]
    if len(known) < len(_TELL) or not unsettled(conditions):
        return []
    of_runs = [np.array([level[conditions.of_each_run[run]].mean() for run in number.tolist()]) for level in known]
    at = [numbered_degC(of, apart) for of, apart in zip(of_runs, (NARROWEST_DEGC, None), strict=True)]
    setpoint, own = (Spread.of(values, errors, group) for group in at)
    (one, wrong), (other, not_there) = _TELL.items()
    told = [better.far_better_than(worse) for better, worse in ((setpoint, own), (own, setpoint))]
    said = (
        f"values agree at equal {one}, and not at equal {other}: {wrong}",
        f"values agree at equal {other}, and not at equal {one}: {not_there}",
    )
    return [words for words, so in zip(said, told, strict=True) if so and not all(told)]
