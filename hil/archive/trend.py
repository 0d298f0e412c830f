"""What became of a parameter between calibrations: nothing, a drift, a jump; what cannot be told apart is not.

    found = trend(months, values, sd)    # (n,) each, in the order of time
    found.word    # nothing shown, scatters beyond its ±, drift, jump, jump and back, drift and jump, drift or jump …
    found.per_month    # Uncertain: of the model that was chosen, or of a straight line

Five models are held against each other by the Bayesian information criterion: a constant, a straight line, a step
between two calibrations (with two at least on either side), one that comes back, and line and step. Scatter between
calibrations beyond the stated standard deviations widens every interval (Birge); less than stated narrows none. A step
pays for the places where it might have been, and few values pay more (half the correction of Hurvich and Tsai). Nothing
is named that is not better than its rivals by `MARGIN`, odds of twenty to one.

A parameter has a mean at several temperatures: which belong together, and what all of them have in common, comes first.

    values = at_usual_temperatures(stations_of(means))     # brought to where the unit usually was
    for own in that_share(values):                         # calibrations that temperatures make comparable
        entries, shifts, sd, left = shifts_of(own)         # of each against the others
"""

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from scipy.special import chdtrc

from hil.archive.index import ArchivedMean
from hil.campaign import FloatArray
from hil.solve.temperatures import nearest
from hil.solve.uncertain import Uncertain

MARGIN = 2.0 * math.log(20.0)
LEAST = 4
"""Calibrations that it takes to tell anything: a line has two left then."""

Values = Mapping[float | None, Mapping[str, tuple[float, float]]]
_EACH_SIDE = 2
_UNKNOWN, _NOTHING, _SCATTERS = "cannot tell", "nothing shown", "scatters beyond its ±"
_BEYOND = 3.0  # times the stated deviations: few repeats, by which these are known, explain no more
_OF_A_PAIR = math.sqrt(2.0 / math.pi)  # how far two values are apart on average, by that difference's own deviation
_OTHERWISE = 0.01  # as improbable as this a jump must be alike at all temperatures, to be called a change with them


class Fit:
    """One model: values (p,) of its columns with covariance (p, p), where its step is, and what it costs (lower wins).

    `step` is the place of the first calibration after it, 0 where there is none, and `back` of that after it came back;
    `line` says that it has a slope, `scatters` how many times the stated deviations values are off, 1 at least.
    """

    def __init__(
        self,
        months: FloatArray,
        values: FloatArray,
        sd: FloatArray,
        *,
        line: bool,
        step: int = 0,
        back: int = 0,
        places: int = 1,
    ) -> None:
        """Fit a constant to values (n,), with a `line` and a `step` that might have been at so many `places`."""
        columns = columns_of(months, months, line=line, step=step, back=back) / sd[:, None]
        count, parameters = columns.shape
        inverse = np.linalg.pinv(columns.T @ columns)
        found = inverse @ (columns.T @ (values / sd))
        squares = float(np.sum((values / sd - columns @ found) ** 2))
        freedom = max(count - parameters, 1)
        scale = max(1.0, squares / freedom)
        told = parameters + (step > 0) + (back > 0)  # where a step is, is told by the values as well
        few = told * (told + 1.0) / max(count - told - 1, 0.5)
        cost = count * math.log(scale) + squares / scale + told * math.log(count) + 2.0 * math.log(places) * (step > 0)
        self.line, self.step, self.back, self.values, self.covariance = line, step, back, found, inverse * scale
        self.freedom, self.cost, self.scatters = freedom, cost + few, math.sqrt(scale)

    def of(self, place: int) -> Uncertain:
        """Return one of the values with its uncertainty."""
        sd = math.sqrt(float(self.covariance[place, place]))
        return Uncertain(float(self.values[place]), sd, self.freedom, self.freedom, "")


@dataclass(frozen=True)
class Trend:
    """What was found, with the model by which `per_month` and `jump` are stated."""

    word: str
    fit: Fit | None
    per_month: Uncertain | None = None
    jump: Uncertain | None = None

    @property
    def step(self) -> int:
        """The place of the first calibration after a jump; 0 where none was found."""
        return self.fit.step if self.fit is not None and self.jump is not None else 0

    @property
    def back(self) -> int:
        """The place of the first calibration after it came back; 0 where it stayed."""
        return self.fit.back if self.fit is not None and self.step else 0


def trend(months: FloatArray, values: FloatArray, sd: FloatArray) -> Trend:
    """Say what n values (n,) with standard deviations (n,) did over `months` (n,), which rise."""
    tell = np.all(np.isfinite(sd)) and np.all(sd > 0.0) and np.ptp(months) > 0.0  # one instant tells no drift
    if len(values) < LEAST or not tell:
        if len(values) > 2 and tell:
            line = Fit(months, values, sd, line=True)
            return Trend(_UNKNOWN, line, line.of(1))
        return Trend(_UNKNOWN, None)
    steps = [step for step in range(_EACH_SIDE, len(values) - _EACH_SIDE + 1) if months[step] > months[step - 1]]
    steady, line = (Fit(months, values, sd, line=with_line) for with_line in (False, True))
    jumps = [Fit(months, values, sd, line=False, step=step, places=len(steps)) for step in steps]
    both = [Fit(months, values, sd, line=True, step=s, places=len(steps)) for s in steps if len(values) > LEAST]
    pairs = [(step, back) for step in steps for back in steps if back >= step + _EACH_SIDE]
    backs = [Fit(months, values, sd, line=False, step=s, back=b, places=len(pairs)) for s, b in pairs]
    best = {_NOTHING: steady, "drift": line}
    for word, several in (("jump", jumps), ("jump and back", backs), ("drift and jump", both)):
        if several:
            best[word] = min(several, key=lambda each: each.cost)
    order = sorted(best, key=lambda word: best[word].cost)
    if best[_NOTHING].cost - best[order[0]].cost < MARGIN:
        return Trend(_SCATTERS if steady.scatters > _BEYOND else _NOTHING, line, line.of(1))
    word, rivals = order[0], [each for each in order[1:] if best[each].cost - best[order[0]].cost < MARGIN]
    if {"drift", "jump"} <= {word, *rivals}:
        return Trend("drift or jump", line, line.of(1))
    if word == "drift and jump" and rivals:  # the simpler one that explains nearly as much
        word = rivals[0]
    found = best[word]
    slope = found.of(1) if found.line else None
    return Trend(word, found, slope, found.of(len(found.values) - 1) if found.step else None)


def at_one_temperature(
    together: Trend, since: float, until: float, months: FloatArray, values: FloatArray, sd: FloatArray
) -> Trend:
    """Return the trend of values (n,) at one temperature by the model of `together`, which stepped `since` a month.

    And back `until` another, if it did; what was not measured here on either side is no step.
    """
    if together.fit is None or len(values) < LEAST - 1:
        return Trend(_UNKNOWN, None)
    step = int(np.searchsorted(months, since)) if together.step else 0
    back = int(np.searchsorted(months, until)) if together.back else 0
    step = step if step < len(values) and step != back else 0  # nothing was measured here after it
    found = Fit(months, values, sd, line=together.fit.line, step=step, back=back if step and back < len(values) else 0)
    slope = found.of(1) if found.line else None
    return Trend(together.word, found, slope, found.of(len(found.values) - 1) if step else None)


def columns_of(at: FloatArray, months: FloatArray, *, line: bool, step: int, back: int = 0) -> FloatArray:
    """Return a model's columns (k, p) at k instants, for calibrations at `months` (n,)."""
    columns = [np.ones_like(at)]
    if line:
        columns.append(at - months.mean())
    if step:
        columns.append(((at >= months[step]) & (at < (months[back] if back else np.inf))).astype(np.float64))
    return np.stack(columns, axis=1)


def predicted(fit: Fit, at: FloatArray, months: FloatArray, sigmas: float) -> tuple[FloatArray, FloatArray]:
    """Return the parameter at k instants by a fit, (k,), and the half width of its interval at so many sigmas."""
    columns = columns_of(at, months, line=fit.line, step=fit.step, back=fit.back)
    sd = np.sqrt(np.einsum("ij,jk,ik->i", columns, fit.covariance, columns))
    return columns @ fit.values, sd * Uncertain(0.0, 1.0, fit.freedom, fit.freedom, "").expanded(sigmas)


def control_limits(earlier: FloatArray, sd: FloatArray, own_sd: float, freedom: float = 0.0) -> Uncertain | None:
    """Return where the next of a unit's values should be by its own earlier ones (m,), None for fewer than three.

    A chart of single values (Shewhart), each weighed by its standard deviation (m,); the next has its `own_sd`. How
    many times these it is, one at least, neighbours tell, so a slow drift widens nothing. Of few values it is wide.
    """
    count = len(earlier)
    if count < LEAST - 1:
        return None
    if not (told := bool(np.all(sd > 0.0) and own_sd > 0.0)):  # all alike, then
        sd, own_sd = np.ones(count), 1.0
    times = max(float(np.mean(np.abs(np.diff(earlier)) / np.hypot(sd[1:], sd[:-1]))) / _OF_A_PAIR, float(told))
    centre, error = _weighed(earlier, sd)
    behind = count - 1 + told * min(0.5 * ((count - 1) / max(times, 1.0) ** 2) ** 2, freedom)
    return Uncertain(centre, times * math.hypot(own_sd, error), behind, count, "")


def _weighed(values: FloatArray, sd: FloatArray) -> tuple[float, float]:
    """Return the mean of values (n,) by their standard deviations (n,), and its own."""
    weight = sd**-2.0
    return float(weight @ values / weight.sum()), float(weight.sum()) ** -0.5


def stations_of(own: Sequence[ArchivedMean]) -> dict[float | None, list[ArchivedMean]]:
    """Group a parameter's means by temperature, coldest first; how far the unit was off it comes after."""
    found: dict[float | None, list[ArchivedMean]] = {}
    for each in own:
        at = nearest(each.temperature_degC, found)
        found.setdefault(each.temperature_degC if at is None else at, []).append(each)
    return dict(sorted(found.items(), key=lambda of: (of[0] is None, of[0] or 0.0)))


def at_usual_temperatures(stations: Mapping[float | None, Sequence[ArchivedMean]]) -> Values:
    """Return values with their sd by entry, brought to the temperature at which the unit usually was at each station.

    How a parameter depends on temperature is told by its own stations; where there is only one, nothing is changed.
    """
    own = {at: np.array([np.nan if m.own_degC is None else m.own_degC for m in of]) for at, of in stations.items()}
    usual = {at: float(np.median(of)) if np.isfinite(of).all() else np.nan for at, of in own.items()}
    level = [float(np.median([m.value.value for m in of])) for of in stations.values()]
    where = np.array(list(usual.values()))
    slopes = np.zeros(len(where))
    if len(where) > 1 and np.isfinite(where).all() and np.all(np.diff(where) > 0.0):
        slopes = np.gradient(np.array(level), where)
    return {
        at: {
            m.entry: (m.value.value - off, m.value.sd)
            for m, off in zip(of, np.nan_to_num(slope * (own[at] - usual[at])).tolist(), strict=True)
        }
        for (at, of), slope in zip(stations.items(), slopes, strict=True)
    }


def that_share(values: Values) -> list[Values]:
    """Part temperatures by calibrations at several of them: parts are not compared; the most calibrated first."""
    parts: list[dict[float | None, Mapping[str, tuple[float, float]]]] = []
    for at, of in values.items():
        linked = [part for part in parts if any(of.keys() & own.keys() for own in part.values())]
        parts = [part for part in parts if part not in linked]
        parts.append({each: own for part in linked for each, own in part.items()} | {at: of})

    def most(part: Values) -> tuple[int, str]:
        times = {name.partition("/")[2] for of in part.values() for name in of}
        return len(times), max(times)

    return sorted(parts, key=most, reverse=True)


def shifts_of(
    values: Values,
) -> tuple[list[str], FloatArray, FloatArray, Values]:
    """Return entries in order of time, the shift of each (n,) with sd, and residuals, by weighted least squares."""
    names = sorted({name for of in values.values() for name in of}, key=lambda entry: entry.partition("/")[2])
    rows = [(k, names.index(name), *of[name]) for k, of in enumerate(values.values()) for name in of]
    k, i, y, sd = (np.array(column) for column in zip(*rows, strict=True))
    weight = 1.0 / np.where(np.isfinite(sd) & (sd > 0.0), sd, np.inf)
    if not np.all(weight > 0.0):
        return names, np.zeros(len(names)), np.full(len(names), np.nan), {}
    columns = np.zeros((len(y), len(values) + len(names)))
    columns[np.arange(len(y)), k.astype(int)] = 1.0
    columns[np.arange(len(y)), len(values) + i.astype(int)] = 1.0
    weighted = columns.T * weight**2
    found = np.linalg.lstsq(weighted @ columns, weighted @ y, rcond=None)[0]  # a shift of all is an offset of all
    shifts = found[len(values) :] - found[len(values) :].mean()
    errors = np.array([1.0 / np.sqrt(np.sum(weight[i == each] ** 2)) for each in range(len(names))])
    left: dict[float | None, dict[str, tuple[float, float]]] = {}
    for place, (at, of) in enumerate(values.items()):
        offset = found[place] + found[len(values) :].mean()
        left[at] = {name: (value - offset, error) for name, (value, error) in of.items()}
    return names, shifts, errors, left


def differs(left: Values, names: Sequence[str], together: Trend) -> bool:
    """Whether what was found as a jump is not the same at all temperatures."""
    if not together.step or len(left) < 2:
        return False
    after = set(names[together.step : together.back or None])
    jumps = []
    for of in left.values():
        sides = [np.array([of[name] for name in of if (name in after) is late]) for late in (False, True)]
        if all(len(side) for side in sides):
            (before, one), (now, other) = (_weighed(*side.T) for side in sides)
            jumps.append((now - before, math.hypot(one, other)))
    sizes, errors = (np.array(column) for column in zip(*jumps, strict=True))
    mean = np.sum(sizes / errors**2) / np.sum(1.0 / errors**2)
    squares = float(np.sum(((sizes - mean) / errors) ** 2))
    return bool(len(jumps) > 1 and chdtrc(len(jumps) - 1, squares) < _OTHERWISE)
