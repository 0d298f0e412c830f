"""What each record of a sensor's collects must be, given the others: the laws that no sound campaign breaks.

    for law in laws(collects, campaign.site, series_means):
        law.broken          # (n,): in which collects the record is outside of what the others allow
        law.words           # "case_degC is 53.0, where at most 47.7 belongs by the thermometer of the sensor"

A law is generous: what a bench that is not level, a slow chamber or a spreadsheet's rounding make is within it.
"""

from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, replace

import numpy as np

from hil.campaign.data import EARTH_RATE_DEG_PER_HR, BoolArray, Collects, Conditions, FloatArray, IntArray, Series
from procedures.words import listed

_EARTH_RATE_TOLERANCE = 0.1  # deg/hr: of the vertical component; digits, and a bench that is not level, make less
FIXTURE_G = 0.1  # six degrees: far more than an index or a hand is off
_HEADING_DEG_PER_HR = 1.0  # five degrees of heading
_SOAKED_S = 1200.0  # after the setpoint: before, a unit may be anywhere between its last temperature and the air's
_STEADY_DEGC_PER_MIN, _TO_COME_MIN = 0.05, 30.0  # a slope beyond this is of a soak that goes on, for about so long
_COLDER_DEGC = 4.0  # than the air: nothing that draws power is; both thermometers' errors
_WARMER_DEGC = 40.0
_NEIGHBOURS_DEGC = 10.0  # two sensors of one unit; a chamber's air and what it was set to
_CASE_DEGC = 25.0  # a case and the sensor in it
_STEP_DEGC = 1.0  # from one collect to the next, beside what the slopes of both make
_NEXT_S = 1800.0
_ROUNDED_S = 90.0  # what a spreadsheet that counts in minutes makes of two times
_UNTIL = 0.25  # of a collect: so much of it is over when the next begins, whatever was rounded
_SIGMAS, _DRIFTS = 6.0, 3.0  # by how much samples that are not in a series may be off its mean: noise, and a drift
_SAMPLES = 0.5  # of the samples stand in the series: its rows are samples, or say how many each is of
_SHORTER, _ERRORS = 0.5, 2.0  # what is lost at an end of a collect; digits, and few samples
_FEW = 10  # rows that do not tell how others scatter
_DIGITS, _ULPS, _SUMS = 12, 8.0, 1e-9
_NEAR = 1e-4  # five digits would not show a difference
_OF_A_RUN = {"supply_V": 1.2, "spin_period_us": 1.05}
_RUNS, _ALIKE, _SIGN_SIGMAS = 6, 0.9, 20.0  # changes far beyond noise, along one line in so many runs, tell a sign
_SAMPLE_RATE, _ERROR = 1.25, 10.0
"""By which factor a record of one collect may differ from the usual one of its run."""


@dataclass(frozen=True)
class Law:
    """One record of n collects, what it shows, (n,), and the least and the most that the others allow: (n,), or of all.

    NaN where nothing can be said; `by` names the others, `mutual` where they may be what is wrong just as well;
    `plainly` is what is said of a number that stands in no file.
    """

    record: str
    shown: FloatArray
    low: FloatArray | float
    high: FloatArray | float
    by: str
    mutual: bool = False
    plainly: str = ""

    @property
    def excess(self) -> FloatArray:
        """By how much it is outside, (n,); 0 within."""
        outside = np.fmax(self.low - self.shown, self.shown - self.high)
        return np.where(outside > 0.0, outside, 0.0)

    @property
    def broken(self) -> BoolArray:
        """In which collects it is outside, (n,)."""
        return np.asarray(self.excess > 0.0)

    @property
    def words(self) -> str:
        """What the worst of them shows, and what belongs there."""
        if self.plainly:
            return self.plainly
        i = int(np.argmax(self.excess))
        shown, low, high = (each[i] for each in np.broadcast_arrays(self.shown, self.low, self.high))
        near = min(abs(shown - low), abs(shown - high)) < _NEAR * abs(shown)
        is_, least, most = (f"{each:.{10 if near else 5}g}" for each in (shown, low, high))
        ends = f"at most {most}" if np.isinf(low) else f"at least {least}" if np.isinf(high) else f"{least} to {most}"
        ends = least if least == most else ends
        return f"{self.record} is {is_}, where {ends} belongs by {self.by}"


def laws(
    collects: Collects, site: Mapping[str, float], beside: Collects | None, series: Mapping[int, FloatArray]
) -> Iterator[Law]:
    """Yield what can be said of a sensor's collects, those of another sensor of the unit `beside` them.

    `series` holds what `average` says, (4, c + 3), by the number of each collect that has its samples.
    """
    c = collects.conditions
    columns, none = c.columns, np.full(len(c), np.nan)

    def column(name: str, where: BoolArray | None = None) -> FloatArray:
        return np.where(True if where is None else where, columns.get(name, none), np.nan)

    def around(name: str, centre: FloatArray, below: FloatArray | float, above: FloatArray | float, by: str) -> Law:
        return Law(name, column(name), centre - below, centre + above, by)

    soak = soaked(c)
    air, by = column("chamber_degC", soak), "the air around the unit, after a soak"
    to_come = to_come_degC(slope_degC_per_min(c))
    for name in ("temperature_degC", "case_degC"):
        yield around(name, air, _COLDER_DEGC + to_come, _WARMER_DEGC + to_come, by)
    shown, set_to = column("temperature_degC", soak), column("setpoint_degC", soak)
    yield around("case_degC", shown, _CASE_DEGC, _CASE_DEGC, "the thermometer of the sensor, after a soak")
    yield around("chamber_degC", set_to, _NEIGHBOURS_DEGC, _NEIGHBOURS_DEGC, "its setpoint, after a soak")
    if beside is not None:
        other = np.where(soak, beside.conditions.columns.get("temperature_degC", none), np.nan)
        by = f"the thermometer of sensor {beside.conditions.sensor.number}, in the same unit"
        yield replace(around("temperature_degC", other, _NEIGHBOURS_DEGC, _NEIGHBOURS_DEGC, by), mutual=True)
    yield from _by_position(c)
    yield from _earth_rate(c, site.get("latitude_deg"))
    yield from _from_one_to_the_next(c, column)
    yield from _from_run_to_run(collects)
    yield _in_its_run("n_samples per second", c, column("n_samples") / c.duration_s, _SAMPLE_RATE)
    for name, factor in _OF_A_RUN.items():
        yield _in_its_run(name, c, column(name), factor)
    for k, channel in enumerate(c.sensor.channels):
        error = collects.rates_se_deg_per_hr[:, k]
        per_second = _in_its_run(f"the standard error of {channel}", c, error * np.sqrt(c.duration_s), _ERROR)
        yield replace(per_second, shown=error, low=per_second.low / np.sqrt(c.duration_s), high=np.inf)
    records = [*zip(c.sensor.channels, collects.rates_deg_per_hr.T, strict=True)]
    records += [(name, column(name)) for name in ("temperature_degC", "n_samples")] + [("duration_s", c.duration_s)]
    for k, (name, averages) in enumerate(records if series else ()):
        unknown = np.full((4, len(records)), np.nan)
        mean, off, least, most = np.array([series.get(n, unknown)[:, k] for n in c.collect.tolist()]).T
        off = off + digit(averages)
        yield Law(name, averages, mean - off, mean + off, "its samples in series")
        if k < len(c.sensor.channels):
            error = collects.rates_se_deg_per_hr[:, k]
            yield Law(f"the standard error of {name}", error, least, most, "how its samples in series scatter")


def average(series: Series, n_samples: float, duration_s: float) -> FloatArray:
    """Return of c channels and the temperature the mean, how far off it may be, the least and the largest of its error.

    The shape is (4, c + 3), the last two columns how many samples that is of, and how long they last. The error of a
    mean is at least that of samples of which each takes back what the one before added, as differences of angles do,
    and at most that of samples that are all alike. Where the series has all `n_samples` (NaN: unknown) of the collect,
    a mean is no further off than digits go; otherwise as far as what it does not have can move it.
    """
    t_s, rates, temperature = series.t_s, series.rates_deg_per_hr, series.temperature_degC
    values = np.column_stack([rates, np.full(len(t_s), np.nan) if temperature is None else temperature])
    of_each = series.n_samples
    each = of_each if of_each is not None and np.all(of_each > 0.0) else np.ones(len(t_s))
    weights = np.where(np.isfinite(values), each[:, None], 0.0)
    held, rows = weights.sum(axis=0), np.count_nonzero(weights, axis=0)
    with np.errstate(invalid="ignore", divide="ignore"):
        mean = np.nansum(weights * values, axis=0) / held
        sd = np.sqrt(np.nansum(weights * np.square(values - mean), axis=0) / held)
        missing, of = np.abs(n_samples - held), np.fmax(n_samples, held)
        expected = duration_s / float(np.median(np.diff(t_s))) if len(t_s) > 1 else np.inf
        as_rows = (np.abs(expected - rows) + 1.0) / np.fmax(expected, rows)  # means over some time, of who knows what
        share = np.where(missing < _SAMPLES * of, missing / of, as_rows)
        off = sd * (_SIGMAS * np.sqrt(share / rows) + _DRIFTS * share)
        off = np.where((rows < _FEW) & (share > 0.0), np.inf, off)
    digits = np.array([digit(column) for column in values.T])
    off += digits + _SUMS * np.abs(mean)
    lasts = t_s[-1] if len(t_s) >= _FEW else np.nan
    count = np.nan if each is not of_each else each.sum()
    mean, off = np.append(mean, [count, lasts]), np.append(off, [0.0, _SHORTER * lasts])
    sd[rows < _FEW] = np.nan
    least, most = (np.append(each, [np.nan] * 2) for each in (sd / (_ERRORS * rows), _ERRORS * sd + digits))
    return np.stack([mean, off, least, most])


def digit(values: FloatArray) -> float:
    """Return the size of the last digit that numbers, (n,), are written with."""
    known, digits = values[np.isfinite(values)], _DIGITS
    while digits:
        finer = known * 10.0 ** (digits - 1)
        if np.any(np.abs(finer - np.rint(finer)) > _ULPS * np.spacing(np.abs(finer))):
            break
        digits -= 1
    return float(10.0**-digits)


def soaked(c: Conditions) -> BoolArray:
    """Tell in which collects the unit has been in its air for long, (n,); nowhere where that is not recorded."""
    return np.asarray(c.columns.get("time_since_setpoint_s", np.zeros(len(c))) > _SOAKED_S)


def slope_degC_per_min(c: Conditions, otherwise: FloatArray | float = 0.0) -> FloatArray:
    """Return how fast the unit's temperature moves, (n,), °C/min, as it was recorded, or `otherwise`."""
    recorded = c.columns.get("dTdt_degC_per_min", np.full(len(c), np.nan))
    return np.abs(np.where(np.isfinite(recorded), recorded, otherwise))


def to_come_degC(slope_degC_per_min: FloatArray) -> FloatArray:
    """Return by how much a temperature is still to change in each collect, (n,), °C, that moves so fast, (n,)."""
    return np.asarray(_TO_COME_MIN * np.maximum(slope_degC_per_min - _STEADY_DEGC_PER_MIN, 0.0))


def from_the_usual_g(c: Conditions) -> FloatArray:
    """Return how far f is from what it usually is at the position that each collect is labelled with, (n,)."""
    usual = np.empty_like(c.f_g)
    for label in np.unique(c.position):
        usual[c.position == label] = np.median(c.f_g[c.position == label], axis=0)
    return np.asarray(np.linalg.norm(c.f_g - usual, axis=1))


def _by_position(c: Conditions) -> Iterator[Law]:
    """What the collects at one position have in common: f, and w at one heading, of which a run has more than one."""
    _, label = np.unique(c.position, return_inverse=True)
    w, nearest = c.w_deg_per_hr, np.empty_like(c.w_deg_per_hr)
    for rows in (np.flatnonzero(label == each) for each in range(label.max(initial=-1) + 1)):
        for k in range(3):
            order = rows[np.argsort(w[rows, k], kind="stable")]
            gaps = np.diff(w[order, k], prepend=-np.inf, append=np.inf)
            nearest[order, k] = w[order, k] + np.where(gaps[1:] < gaps[:-1], gaps[1:], -gaps[:-1])
    off = np.max(np.abs(w - nearest), axis=1)
    same = off <= _HEADING_DEG_PER_HR
    told = np.isin(label, label[same]) & np.isin(c.run, c.run[same]) & np.isfinite(off)
    for record, apart, most in (
        ("f, g, from the usual,", from_the_usual_g(c), FIXTURE_G),
        ("w, deg/hr, from the nearest,", np.where(told, off, np.nan), _HEADING_DEG_PER_HR),
    ):
        yield Law(
            f"the distance of {record}", apart, -np.inf, most, "the others at its position: a label or sign is wrong"
        )


def _earth_rate(c: Conditions, latitude_deg: float | None) -> Iterator[Law]:
    """How large w is, and what it has along the vertical, which f points out: the same in all collects of a site."""
    size = np.linalg.norm(c.w_deg_per_hr, axis=1)
    yield Law("the size of w", size, -np.inf, EARTH_RATE_DEG_PER_HR + _EARTH_RATE_TOLERANCE, "the earth rate")
    if latitude_deg is None:
        return
    vertical = EARTH_RATE_DEG_PER_HR * float(np.sin(np.deg2rad(latitude_deg)))
    found = np.sum(c.w_deg_per_hr * c.f_g, axis=1) / np.linalg.norm(c.f_g, axis=1)
    known = np.where(np.any(size > 0.0), found, np.nan)
    low, high = vertical - _EARTH_RATE_TOLERANCE, vertical + _EARTH_RATE_TOLERANCE
    by = f"the earth rate at latitude {latitude_deg:g} deg: f, w or the latitude is wrong"
    yield Law("w along the vertical", known, low, high, by)


def _from_one_to_the_next(c: Conditions, column: Callable[[str], FloatArray]) -> Iterator[Law]:
    """What a collect shows after the one before it: times that only go on, a temperature that follows its slope."""
    order = np.argsort(c.start_s, kind="stable")
    before, here = order[:-1], order[1:]
    ends_s, until = c.start_s + _UNTIL * c.duration_s, np.full(len(c), -np.inf)
    until[here] = ends_s[before]
    begins = Law("start_s", c.start_s, until, np.inf, "the collect before it, which had not ended")
    stands, later, said = np.full(len(c), False), begins.broken, ""
    stands[here] = c.start_s[here] == c.start_s[before]
    if later.sum() > 1 and stands[later].all():
        at = listed(f"{each:.5g}" for each in np.unique(c.start_s[later]))
        said = f"start_s stands still at {at}, where each collect begins after another"
    yield replace(begins, plainly=said)
    for since in ("time_since_power_on_s", "time_since_setpoint_s", "time_since_index_s"):
        yield from _instants(since, c, column(since), ends_s)
    in_order = c.run[order]
    runs, parts = np.unique(in_order[np.flatnonzero(np.diff(in_order, prepend=np.nan))], return_counts=True)
    parts_of_its_run = parts[np.searchsorted(runs, c.run)].astype(np.float64)
    yield Law(
        "the number of parts of its run", parts_of_its_run, -np.inf, 1.0, "the other runs, one between its collects"
    )
    shown, slope = column("temperature_degC"), column("dTdt_degC_per_min")
    gone_s = c.start_s[here] - c.start_s[before]
    by_slope = 0.5 * (slope[here] + slope[before]) * gone_s / 60.0
    near = (c.run[here] == c.run[before]) & (gone_s < _NEXT_S)
    low, high = np.full((2, len(c)), np.nan)
    allowed = _STEP_DEGC + 0.5 * np.abs(by_slope)
    low[here], high[here] = np.where(near, shown[before] + by_slope + np.array([[-1.0], [1.0]]) * allowed, np.nan)
    yield Law("temperature_degC", shown, low, high, "dTdt_degC_per_min and the collect before it")


def _instants(since: str, c: Conditions, gone_s: FloatArray, ends_s: FloatArray) -> Iterator[Law]:
    """The instant since which a time in each collect counts: that of the collect before it, or one after that collect.

    Of two that contradict each other that one is wrong without which more of all go on; where none is, either may be.
    `gone_s` (n,) is that time, `ends_s` (n,) when another collect may begin.
    """
    at_s, order = c.start_s - gone_s, np.argsort(c.start_s, kind="stable")

    def goes_on(before: IntArray, here: IntArray) -> BoolArray:
        alike = (np.abs(at_s[here] - at_s[before]) <= _ROUNDED_S) | (gone_s[here] == gone_s[before])
        return np.asarray(alike | ~(at_s[here] < ends_s[before] - _ROUNDED_S))  # alike: or what it is by intention

    def most_in_order(rows: IntArray, fits: Callable[[IntArray, IntArray], BoolArray]) -> IntArray:
        most = np.ones(len(rows), np.int64)
        for k in range(1, len(rows)):
            most[k] += np.max(most[:k], where=fits(rows[:k], rows[k]), initial=0)
        return most

    clock = c.start_s[order[1:]] >= ends_s[order[:-1]]  # else start_s is wrong, and no instant is known by it
    broken = np.flatnonzero(clock & ~goes_on(order[:-1], order[1:]))
    before, here = order[broken], order[broken + 1]
    doubted = np.full(len(c), False)
    if len(broken):
        until = most_in_order(order, goes_on)
        through = until + most_in_order(order[::-1], lambda after, row: goes_on(row, after))[::-1]
        among = through == through.max()
        doubted[order] = ~among | (np.bincount(until[among], minlength=len(c) + 1)[until] > 1)
    low, high, most = (np.full(len(c), each) for each in (np.nan, np.nan, np.inf))
    most[here] = np.where(doubted[here], c.start_s[here] - ends_s[before] + _ROUNDED_S, np.inf)
    belongs_s = np.where(doubted[before], c.start_s[before] - at_s[here], np.nan)
    low[before], high[before] = belongs_s - _ROUNDED_S, belongs_s + _ROUNDED_S
    yield Law(since, gone_s, -np.inf, most, "the collect before it")
    yield Law(since, gone_s, low, high, "the collect after it")


def _from_run_to_run(collects: Collects) -> Iterator[Law]:
    """How a channel's rates change from position to position: in no run just the other way than in the others."""
    c = collects.conditions
    (runs, run), (labels, label) = (np.unique(each, return_inverse=True) for each in (c.run, c.position))
    rates = collects.rates_deg_per_hr - c.w_channels_deg_per_hr
    for k, channel in enumerate(c.sensor.channels if len(labels) > 2 else ()):
        changes = np.full((len(runs), len(labels)), np.nan)
        changes[run, label] = rates[:, k]
        changes -= changes.mean(axis=1, keepdims=True)
        size = np.linalg.norm(changes, axis=1)
        size[size == 0.0] = np.nan
        whole, errors = np.isfinite(size), collects.rates_se_deg_per_hr[:, k]
        if whole.sum() < _RUNS or not np.isfinite(errors).any():
            continue
        alike = changes @ changes[whole][0] / (size * size[whole][0])
        most = np.sign(np.sign(alike[whole]).sum())  # 0: as many the one way as the other, and none is to be believed
        alike = most * alike if most else -np.abs(alike)
        noise = _SIGN_SIGMAS * np.nanmax(errors)
        sure = size[whole].min() > max(0.5 * size[whole].max(), noise) and np.abs(alike[whole]).min() > _ALIKE
        says = (
            f"{channel} goes up from position to position where it goes down in the other runs: its sign is turned, or "
            f"collects are exchanged: ask whoever measured, and put the rates of {channel}, or position, f and w, right"
        )
        yield Law(channel, np.where(sure, alike, np.nan)[run], 0.0, np.inf, "the other runs", plainly=says)


def _in_its_run(record: str, c: Conditions, shown: FloatArray, factor: float) -> Law:
    """What the collects of one self-calibration have in common, within a factor."""
    order = np.lexsort((shown, c.run))  # what is not known stands last in its run
    inside, (_, first, group) = shown[order], np.unique(c.run[order], return_index=True, return_inverse=True)
    last = np.maximum(np.bincount(group, np.isfinite(inside)).astype(int), 1) - 1
    usual = np.empty(len(c))
    usual[order] = (0.5 * (inside[first + last // 2] + inside[first + (last + 1) // 2]))[group]
    return Law(record, shown, usual / factor, usual * factor, "what is usual in its run")
