"""What contradicts itself in the cases of `reliability.contradictions`: between physics and bytes, one thing each."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, replace
from itertools import permutations

import numpy as np

from drivers.imu.samples import FloatArray
from hil.bench import LiveBench

Signals = dict[str, FloatArray]
Tamper = Callable[[FloatArray, Signals, LiveBench], Mapping[str, FloatArray]]
"""What is changed of the signals at n times, (n,), before they are bytes."""


@dataclass(frozen=True)
class Case:
    """One contradiction: what is wrong, the words that name it, and how it comes about.

    `file` are replacements in the shipped bench file, `faults` lines of its faults section.
    """

    name: str
    words: str
    tamper: Tamper | None = None
    faults: tuple[str, ...] = ()
    file: tuple[tuple[str, str], ...] = ()
    positions: str = "1, 2, 3"
    temperatures: str = "23 degC"
    runs: int = 1
    laid: tuple[str, str] | None = None  # when it is asked for the first position, the unit comes to the second
    history: bool = False  # the unit's last campaign, with nothing wrong, is at hand (`hil report --against`)


def _times(factor: float, *names: str) -> Tamper:
    return lambda _t, given, _live: {n: v * factor for n, v in given.items() if n.startswith(names)}


def _exchanged(*pairs: tuple[str, str]) -> Tamper:
    return lambda _t, given, _live: {a: given[b] for one, other in pairs for a, b in ((one, other), (other, one))}


def _set(name: str, value: Callable[[FloatArray, FloatArray], FloatArray]) -> Tamper:
    return lambda times_s, given, _live: {name: value(times_s, given[name])}


def _held(times_s: FloatArray, values: FloatArray) -> FloatArray:
    """Renew every second sample only."""
    place = np.round(times_s * 20.0).astype(int)
    return values[np.maximum(np.arange(len(values)) - place % 2, 0)]


def _spiked(times_s: FloatArray, values: FloatArray) -> FloatArray:
    struck = np.round(times_s * 20.0).astype(int) % 1000 == 0
    return np.where(struck, values + 2e6, values)


def _frozen(times_s: FloatArray, values: FloatArray) -> FloatArray:
    """Stand still for 20 s of every minute."""
    return np.where(times_s % 60.0 < 20.0, 17.0, values)


def _toggling(times_s: FloatArray, values: FloatArray) -> FloatArray:
    del times_s
    return np.where(values > np.median(values), 64.0, 0.0)


def cases() -> Iterator[Case]:
    """Yield every case."""
    yield from _poses()
    yield from _sweeps()
    yield from _accelerometers()
    yield from _rates()
    yield from _temperatures()
    yield from _rows()
    yield from _sites()


BY_HAND = (
    ("  positioner: indexing ", "  positioner: operator "),
    (
        '      "4": {A: -3, B: +2, S: -1}  #',
        '      "5": {A: +3, B: +1, S: -2}\n      "6": {A: +3, B: -1, S: +2}\n      "4": {A: -3, B: +2, S: -1}  #',
    ),
    (
        '      "4": {A: -1, B: +2, S: +3}\n',
        '      "4": {A: -1, B: +2, S: +3}\n      "5": {A: -2, B: +1, S: -3}\n      "6": {A: +2, B: -1, S: -3}\n',
    ),
)


def _poses() -> Iterator[Case]:
    """The unit lies as in another position, of sequences of 3, 4 and 6: every pair, by hand and by an index."""
    for how in ("by hand", "indexed"):
        for positions in ("1, 2, 3", "1, 3, 2, 4", "1, 3, 4, 2, 5, 6"):
            for asked, lies in permutations(positions.split(", "), 2):
                yield Case(
                    f"{how}, {positions}: at {asked} it lies as in {lies}",
                    rf"position {asked} was asked for, but the unit lies as in position {lies}",
                    file=BY_HAND if how == "by hand" else BY_HAND[1:],
                    positions=positions,
                    laid=(asked, lies),
                )


def _sweeps() -> Iterator[Case]:
    """Every collect at a position is wrong, so that the runs agree with each other."""
    yield Case(
        "never turned to position 2",
        "position 2 was asked for, but the unit lies as in position 1",
        faults=tuple(f"{{at: T1/S{n}/C2/index, device: imu, kind: index_slips, duration: 3 min}}" for n in (1, 2)),
        runs=2,
    )
    yield Case(
        "positions 1 and 2 exchanged in the whole sweep",
        "position 1 was asked for, but the unit lies as in position 2",
        tamper=_turned_over,
        runs=2,
    )


def _turned_over(times_s: FloatArray, given: Signals, live: LiveBench) -> Mapping[str, FloatArray]:
    """Show of sensor 2 what a unit with its codes 1 and 2 exchanged shows: f and the rates that follow it turned."""
    del times_s, live
    return {"accel_A2": -given["accel_A2"], "rate_A2": -given["rate_A2"]}


def _accelerometers() -> Iterator[Case]:
    yield Case("accelerometers in m/s²", "m/s²", _times(9.80665, "accel"))
    yield Case("accelerometers dead", "not being measured|measures nothing", _times(0.0, "accel"))
    yield Case("accelerometers with a gain of 1.1", r"1\.10 times what gravity is", _times(1.1, "accel"))
    yield Case("sign of accelerometer A turned", "sign of its accelerometer A", _times(-1.0, "accel_A2"))
    swapped = _exchanged(("accel_A1", "accel_B1"), ("accel_A2", "accel_B2"))
    yield Case("accelerometers A and B exchanged", "accelerometers A and B are exchanged", swapped)
    one = _exchanged(("accel_A2", "accel_B2"))
    yield Case("accelerometers A and B of one sensor exchanged", "accelerometers A and B are exchanged", one)
    plugs = _exchanged(("accel_A1", "accel_A2"), ("accel_B1", "accel_B2"))
    yield Case("accelerometers of the two sensors exchanged", "where|asked for|exchanged", plugs)
    turned = "sign of its accelerometer B|along B where"  # in positions where B is upright: level, it shows nothing
    six = {"file": BY_HAND[1:], "positions": "1, 3, 4, 2, 5, 6"}
    yield Case("sign of accelerometer B turned", turned, _times(-1.0, "accel_B2"), **six)  # type: ignore[arg-type]
    tilted = _set("accel_B2", lambda _t, v: v + 0.3)
    yield Case("tilted by 17 degrees", "along B where", tilted)


def _rates() -> Iterator[Case]:
    yield Case("rates in rad/s", "sent in rad/s", _times(1.0 / 57.29578, "rate"))
    yield Case("rates times 3600", "sent in deg/hr and read as deg/s", _times(3600.0, "rate"))
    yield Case("rates in deg/s", "sent in deg/s and read as deg/hr", _times(1.0 / 3600.0, "rate"))
    yield Case("rates in deg/s, read as rad/s", "sent in deg/s and read as rad/s", _times(57.29578, "rate"))
    yield Case("rates per second, read as per sample", "sent per second and read as", _times(20.0, "rate"))
    yield Case("rates per sample", "angle per sample", _times(0.05, "rate"))
    yield Case("counts without scale", "counts without their scale", _times(1000.0 * 16.0, "rate"))
    yield Case("RA dead", "not being measured", _times(0.0, "rate_A2"))
    yield Case("RA stuck", "not being measured", _set("rate_A2", lambda _t, v: 0.0 * v + 42.0))
    yield Case("RA saturated", "saturated|clipped", _set("rate_A2", lambda _t, v: 0.0 * v + 2147483.0))
    yield Case("RA clipped", "clipped", _set("rate_A2", lambda _t, v: np.minimum(v, 30.0)))
    yield Case("RA renewed at half the rate", "renewed less often", _set("rate_A2", _held))
    copied: Tamper = lambda _t, given, _live: {"rate_A2": given["rate_B2"]}  # noqa: E731
    yield Case("RA a copy of RB", "very same samples", copied)
    yield Case("RA toggles one bit", "shows only", _set("rate_A2", _toggling))
    yield Case("RA spikes in 0.1 % of the samples", "from the others, which move its mean", _set("rate_A2", _spiked))
    yield Case("RA frozen for 20 of 60 s", "did not change for", _set("rate_A2", _frozen))
    for name, words, change in (
        ("RA and RB exchanged", "RA and RB look exchanged", _exchanged(("rate_A2", "rate_B2"))),
        ("RA of both sensors exchanged", "RA and RA look exchanged", _exchanged(("rate_A1", "rate_A2"))),
        ("sign of RA turned", "the sign of RA looks turned", _times(-1.0, "rate_A2")),
        ("RA with a gain of 1.2", r"one cause: RA is 1\.(19|20)\d* ±[0-9.]+ times what it was", _times(1.2, "rate_A2")),
    ):
        yield Case(f"{name}, the last campaign at hand", words, change, history=True)
    doubled = ("{at: 0 s, device: imu, kind: repeated_frames, size: 1.0}",)
    yield Case("every frame twice", "frames that came twice", None, doubled)
    exchanged = ("{at: T1/S1/C2/collect, device: imu, kind: exchanged}",)
    yield Case("another unit behind the port", "the unit says serial|is now .* S/N", None, exchanged)
    jump = ("{at: T1/S1/C2/collect, device: clock, kind: jump, size: 2 h}",)
    yield Case("the clock jumps by two hours", "the wall clock is off by", None, jump)


def _temperatures() -> Iterator[Case]:
    both = "23 degC, 50 degC"
    for name, tamper, words in (
        (
            "rotor thermometers stuck at 23 °C",
            _set("rotor_2_degC", lambda _t, v: 0.0 * v + 23.0),
            "does not follow|thermometer",
        ),
        (
            "rotor thermometer 20 °C too high",
            _set("rotor_2_degC", lambda _t, v: v + 20.0),
            "by the thermometer of sensor",
        ),
        (
            "rotor thermometer 20 °C too low",
            _set("rotor_2_degC", lambda _t, v: v - 20.0),
            "by the air|by the thermometer of sensor",
        ),
    ):
        yield Case(name, words, tamper, temperatures=both)
    kelvin, fahrenheit = ((lambda _t, v: v + 273.15), (lambda _t, v: 1.8 * v + 32.0))
    yield Case("rotor temperature in K", "unit-limits: the unit is outside", _set("rotor_2_degC", kelvin))
    yield Case("rotor temperature in °F", "by the air|by the thermometer of sensor", _set("rotor_2_degC", fahrenheit))
    yield Case("case thermometer 30 °C too high", "case_degC is", _set("case_degC", lambda _t, v: v + 30.0))
    for name, factor, words in (("supply_V", 0.2, "supply_V is"), ("spin_period_2_us", 0.9, "spin_period_us is")):
        yield Case(f"{name} falls in one collect", words, _in_collect(1, 2, _times(factor, name)))


def _rows() -> Iterator[Case]:
    """What only the other runs can show: rates of whole collects."""
    many = {"temperatures": "23 degC, 50 degC", "runs": 3}
    off = _in_collect(3, 2, lambda _t, given, _live: {n: v + 300.0 for n, v in given.items() if n.startswith("rate")})
    yield Case("one collect off by 300 deg/hr", "from what all others show", off, **many)  # type: ignore[arg-type]
    turned = _in_collect(3, None, _times(-1.0, "rate"))
    yield Case(
        "rates of one run with the other sign",
        "sign is turned|minus|from what (all others|the other runs) show",
        turned,
        **many,
    )  # type: ignore[arg-type]
    plugs = _in_collect(3, None, _exchanged(("rate_A1", "rate_A2")))
    yield Case("RA of both sensors exchanged in one run", "from what all others show", plugs, **many)  # type: ignore[arg-type]
    loud = _noisy(1150.0)
    yield Case("rates with standard errors of 33 deg/hr", "not measured well enough|scatter about", loud)


TWO_HEADINGS = (
    BY_HAND[0],
    (
        BY_HAND[1][0],
        BY_HAND[1][0].replace(
            '      "4"',
            "\n".join(
                f'      "{label}": {axes}'
                for label, axes in zip(
                    "567", ("{A: -1, B: +3, S: -2}", "{A: -2, B: +3, S: +1}", "{A: +1, B: +3, S: +2}"), strict=True
                )
            )
            + '\n      "4"',
        ),
    ),
    (
        BY_HAND[2][0],
        BY_HAND[2][0]
        + "".join(
            f'      "{label}": {axes}\n'
            for label, axes in zip(
                "567", ("{A: -2, B: +3, S: +1}", "{A: +1, B: +3, S: +2}", "{A: +2, B: +3, S: -1}"), strict=True
            )
        ),
    ),
)
"""Positions 1, 3 and 2 once more, turned by 90 degrees about the vertical."""


def _sites() -> Iterator[Case]:
    """The bench stands elsewhere than its file says. Collects of one heading cannot tell; two, or the history, can."""
    moved = ("latitude: 34.6 deg", "latitude: 44.6 deg")
    yield Case("latitude off by 10 degrees, the last campaign at hand", "latitude", file=(moved,), history=True)
    turned = ("heading: 30 deg", "heading: 60 deg")
    yield Case("heading off by 30 degrees, the last campaign at hand", "heading", file=(turned,), history=True)
    for what, latitude_deg, heading_deg in (("latitude", 10.0, 0.0), ("heading", 0.0, 30.0)):
        yield Case(
            f"{what} wrong, collects at two headings",
            "earth rate|latitude|heading",
            _stands(latitude_deg, heading_deg),
            file=TWO_HEADINGS,
            positions="1, 2, 3, 5, 6, 7",
            runs=2,
        )


def _stands(latitude_deg: float, heading_deg: float) -> Tamper:
    """Show the earth rate of a site that is so far from the bench file's."""

    def tamper(times_s: FloatArray, given: Signals, live: LiveBench) -> Mapping[str, FloatArray]:
        here = live.bench.site
        there = replace(here, latitude_deg=here.latitude_deg + latitude_deg, heading_deg=here.heading_deg + heading_deg)
        off = there.earth_rate_deg_per_hr() - here.earth_rate_deg_per_hr()
        legs = live.simulators.unit._timeline.legs if live.simulators else []
        last = [leg for leg in legs if leg.ends_s <= times_s[0] or not np.isfinite(leg.begins_s)][-1]
        turned = {n: axes @ off for n, axes in last.stop.items()}
        return {f"rate_{'AB'[k]}{n}": given[f"rate_{'AB'[k]}{n}"] + turned[n][k] for n in turned for k in (0, 1)}

    return tamper


def _noisy(sigma: float) -> Tamper:
    def tamper(times_s: FloatArray, given: Signals, live: LiveBench) -> Mapping[str, FloatArray]:
        del live
        rng = np.random.default_rng(int(1e3 * times_s[0]))
        return {n: v + rng.normal(0.0, sigma, len(v)) for n, v in given.items() if n.startswith("rate")}

    return tamper


def _in_collect(run: int, collect: int | None, change: Tamper) -> Tamper:
    """Change what is sent while the unit stays for the given run and collect (None: all three)."""

    def tamper(times_s: FloatArray, given: Signals, live: LiveBench) -> Mapping[str, FloatArray]:
        legs = live.simulators.unit._timeline.legs if live.simulators else []
        here = [leg for leg in legs if leg.run == run and np.isfinite(leg.begins_s)]
        if not here or (collect is not None and len(here) != collect) or times_s[0] < here[-1].ends_s:
            return {}
        return change(times_s, given, live)

    return tamper
