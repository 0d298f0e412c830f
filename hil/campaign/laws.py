"""What each record of a sensor's collects must be, given the others: the laws that no sound campaign breaks.

    for law in laws(collects, campaign.site, series_means):
        law.broken          # (n,): in which collects the record is outside of what the others allow
        law.words           # "case_degC is 53.0, where at most 47.7 belongs by the thermometer of the sensor"

A law is generous: what a bench that is not level, a slow chamber or a spreadsheet's rounding make is within it.
"""

from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass

import numpy as np

from hil.campaign.data import EARTH_RATE_DEG_PER_HR, BoolArray, Collects, Conditions, FloatArray

_EARTH_RATE_TOLERANCE = 0.1  # deg/hr: of the vertical component; digits, and a bench that is not level, make less
_SOAKED_S = 1200.0  # after the setpoint: before, a unit may be anywhere between its last temperature and the air's
_STEADY_DEGC_PER_MIN, _TO_COME_MIN = 0.05, 30.0  # a slope beyond this is of a soak that goes on, for about so long
_COLDER_DEGC = 4.0  # than the air: nothing that draws power is; both thermometers' errors
_WARMER_DEGC = 40.0
_NEIGHBOURS_DEGC = 10.0  # two sensors of one unit; a chamber's air and what it was set to
_CASE_DEGC = 25.0  # a case and the sensor in it
_STEP_DEGC = 2.0  # from one collect to the next, beside what the slopes of both make
_NEXT_S = 1800.0
_ROUNDED_S = 90.0  # what a spreadsheet that counts in minutes makes of two times
_UNTIL = 0.25  # of a collect: so much of it is over when the next begins, whatever was rounded
_SERIES_SIGMAS = 6.0
_OF_A_RUN = {"supply_V": 1.2, "spin_period_us": 1.05}
_SAMPLE_RATE, _ERROR = 1.25, 10.0
"""By which factor a record of one collect may differ from the usual one of its run."""


@dataclass(frozen=True)
class Law:
    """One record of n collects, what it shows, and the least and the most that the others allow, all (n,).

    NaN where nothing can be said; `by` names the others, `mutual` where they may be what is wrong just as well.
    """

    record: str
    shown: FloatArray
    low: FloatArray
    high: FloatArray
    by: str
    mutual: bool = False

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
        i = int(np.argmax(self.excess))
        low, high = f"{self.low[i]:.5g}", f"{self.high[i]:.5g}"
        ends = f"at most {high}" if low == "-inf" else f"at least {low}" if high == "inf" else f"{low} to {high}"
        return f"{self.record} is {self.shown[i]:.5g}, where {ends} belongs by {self.by}"


def laws(
    collects: Collects, site: Mapping[str, float], beside: Collects | None, series: Mapping[int, FloatArray]
) -> Iterator[Law]:
    """Yield what can be said of a sensor's collects, those of another sensor of the unit `beside` them.

    `series` holds mean and standard error of each channel, (2, c), by the number of each collect that has its samples.
    """
    c = collects.conditions
    columns, none = c.columns, np.full(len(c), np.nan)

    def column(name: str, where: BoolArray | None = None) -> FloatArray:
        return np.where(True if where is None else where, columns.get(name, none), np.nan)

    def around(name: str, where: BoolArray, centre: FloatArray, below: float, above: float, by: str) -> Law:
        return Law(name, column(name, where), centre - below, centre + above, by)

    after_soak = soaked(c)
    shown, air, by = column("temperature_degC"), column("chamber_degC"), "the air around the unit, after a soak"
    slope = np.nan_to_num(np.abs(column("dTdt_degC_per_min")))
    to_come = _TO_COME_MIN * np.maximum(slope - _STEADY_DEGC_PER_MIN, 0.0)
    for name in ("temperature_degC", "case_degC"):
        yield Law(name, column(name, after_soak), air - _COLDER_DEGC - to_come, air + _WARMER_DEGC + to_come, by)
    yield around("case_degC", after_soak, shown, _CASE_DEGC, _CASE_DEGC, "the thermometer of the sensor, after a soak")
    set_to = column("setpoint_degC")
    yield around("chamber_degC", after_soak, set_to, _NEIGHBOURS_DEGC, _NEIGHBOURS_DEGC, "its setpoint, after a soak")
    if beside is not None:
        other = np.where(after_soak, beside.conditions.columns.get("temperature_degC", none), np.nan)
        by = f"the thermometer of sensor {beside.conditions.sensor.number}, in the same unit"
        yield Law("temperature_degC", shown, other - _NEIGHBOURS_DEGC, other + _NEIGHBOURS_DEGC, by, mutual=True)
    if "latitude_deg" in site:
        yield _earth_rate(c, site["latitude_deg"])
    yield from _from_one_to_the_next(c, column)
    usual = "what is usual in its run"
    yield _in_its_run("n_samples per second", c, column("n_samples") / c.duration_s, _SAMPLE_RATE, usual)
    for name, factor in _OF_A_RUN.items():
        yield _in_its_run(name, c, column(name), factor, usual)
    for k, channel in enumerate(c.sensor.channels):
        error = collects.rates_se_deg_per_hr[:, k]
        per_second = _in_its_run(f"the standard error of {channel}", c, error * np.sqrt(c.duration_s), _ERROR, usual)
        yield Law(per_second.record, error, per_second.low / np.sqrt(c.duration_s), np.full(len(c), np.inf), usual)
        if not series:
            continue
        mean, se = np.array([series.get(n, np.full((2, k + 1), np.nan))[:, k] for n in c.collect.tolist()]).T
        allowed = _SERIES_SIGMAS * np.fmax(se, error)
        yield Law(channel, collects.rates_deg_per_hr[:, k], mean - allowed, mean + allowed, "its samples in series")


def soaked(c: Conditions) -> BoolArray:
    """Tell in which collects the unit has been in its air for long, (n,); nowhere where that is not recorded."""
    return np.asarray(c.columns.get("time_since_setpoint_s", np.zeros(len(c))) > _SOAKED_S)


def _earth_rate(c: Conditions, latitude_deg: float) -> Law:
    """What w has along the vertical, which f points out."""
    vertical = np.full(len(c), EARTH_RATE_DEG_PER_HR * np.sin(np.deg2rad(latitude_deg)))
    found = np.sum(c.w_deg_per_hr * c.f_g, axis=1) / np.linalg.norm(c.f_g, axis=1)
    known = np.where(np.any(c.w_deg_per_hr != 0.0, axis=1), found, np.nan)
    low, high = vertical - _EARTH_RATE_TOLERANCE, vertical + _EARTH_RATE_TOLERANCE
    by = f"the earth rate at latitude {latitude_deg:g} deg: f, w or the latitude is wrong"
    return Law("w along the vertical", known, low, high, by)


def _from_one_to_the_next(c: Conditions, column: Callable[[str], FloatArray]) -> Iterator[Law]:
    """What a collect shows after the one before it: times that only go on, a temperature that follows its slope."""
    order = np.argsort(c.start_s, kind="stable")
    before, here = order[:-1], order[1:]
    until = np.full(len(c), -np.inf)
    until[here] = c.start_s[before] + _UNTIL * c.duration_s[before]
    yield Law("start_s", c.start_s, until, np.full(len(c), np.inf), "the collect before it, which had not ended")
    for since in ("time_since_power_on_s", "time_since_setpoint_s", "time_since_index_s"):
        gone_s = column(since)
        at, as_before = c.start_s - gone_s, np.full(len(c), False)  # the same instant, or what it is by intention
        as_before[here] = (np.abs(at[here] - at[before]) <= _ROUNDED_S) | (gone_s[here] == gone_s[before])
        most = np.where(as_before, np.inf, c.start_s - until + _ROUNDED_S)
        yield Law(since, gone_s, np.full(len(c), -_ROUNDED_S), most, "the collect before it")
    shown, slope = column("temperature_degC"), column("dTdt_degC_per_min")
    gone_s = c.start_s[here] - c.start_s[before]
    by_slope = 0.5 * (slope[here] + slope[before]) * gone_s / 60.0
    near = (c.run[here] == c.run[before]) & (gone_s < _NEXT_S)
    low, high = np.full((2, len(c)), np.nan)
    allowed = _STEP_DEGC + 0.5 * np.abs(by_slope)
    low[here], high[here] = np.where(near, shown[before] + by_slope + np.array([[-1.0], [1.0]]) * allowed, np.nan)
    yield Law("temperature_degC", shown, low, high, "dTdt_degC_per_min and the collect before it")


def _in_its_run(record: str, c: Conditions, shown: FloatArray, factor: float, by: str) -> Law:
    """What the collects of one self-calibration have in common, within a factor."""
    order = np.lexsort((shown, c.run))  # what is not known stands last in its run
    inside, (_, first, group) = shown[order], np.unique(c.run[order], return_index=True, return_inverse=True)
    last = np.maximum(np.bincount(group, np.isfinite(inside)).astype(int), 1) - 1
    usual = np.empty(len(c))
    usual[order] = (0.5 * (inside[first + last // 2] + inside[first + (last + 1) // 2]))[group]
    return Law(record, shown, usual / factor, usual * factor, by)
