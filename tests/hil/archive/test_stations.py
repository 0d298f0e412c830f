"""A jump is told from a temperature at which the unit stood elsewhere, and from a changed dependence on temperature."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any

import numpy as np

from hil.archive.history import history
from hil.archive.index import ArchivedMean, Entry
from hil.archive.trend import Trend, at_usual_temperatures, differs, shifts_of, stations_of, trend
from hil.solve.uncertain import Uncertain

SLOPE, SD, COUNT = 0.5, 0.1, 10


def found(off_degC: float = 0.0, jump: float = 0.0, tilt: float = 0.0) -> tuple[Trend, bool]:
    """Return what is found where a unit later stands elsewhere, jumps, or depends otherwise on temperature."""
    rng = np.random.default_rng(5)
    means = []
    for number in range(COUNT):
        late = number >= COUNT // 2
        for asked in (-20.0, 20.0, 60.0):
            own = asked + rng.normal(0.0, 0.1) + off_degC * late
            value = SLOPE * own + (jump + tilt * asked) * late + rng.normal(0.0, SD)
            of = Uncertain(value, SD, 10.0, 3, "deg/hr")
            means.append(ArchivedMean(f"unit-1/{number:02d}", 2, "BA", asked, own, of))
    stations = stations_of(means)
    assert list(stations) == [-20.0, 20.0, 60.0]
    names, shifts, errors, left = shifts_of(at_usual_temperatures(stations))
    together = trend(3.0 * np.arange(COUNT), shifts, errors)
    return together, differs(left, names, together)


def test_a_chamber_that_stood_elsewhere_is_no_jump() -> None:
    """A degree and a half is .75 deg/hr here, seven standard deviations; a jump of as much is one."""
    assert found()[0].word == "nothing shown"
    assert found(off_degC=1.5)[0].word == "nothing shown"
    both, otherwise = found(off_degC=1.5, jump=0.75)
    assert (both.word, otherwise) == ("jump", False)
    assert both.jump is not None
    assert abs(both.jump.value - 0.75) < both.jump.half_width < 0.3


def test_a_jump_that_differs_between_temperatures_is_a_change_of_the_dependence() -> None:
    """The same mean jump, but it grows with temperature."""
    together, otherwise = found(jump=1.0, tilt=0.02)
    assert (together.word, otherwise) == ("jump", True)
    assert together.step == COUNT // 2


def outside(off_degC: float, more: float) -> list[bool]:
    """Return where the newest of ten calibrations is outside its limits, taken `off_degC` elsewhere, `more` larger."""
    rng, means, entries = np.random.default_rng(5), [], []
    for number in range(COUNT):
        name, last = f"unit-1/{number:02d}", number == COUNT - 1
        began = f"{2010 + number}-01-01T00:00:00+00:00"
        entries.append(Entry(name, "", "1", "", began_utc=began, ended_utc=began, good=True))
        for asked in (-20.0, 20.0, 60.0):
            own = asked + rng.normal(0.0, 0.1) + off_degC * last
            of = Uncertain(SLOPE * own + more * last + rng.normal(0.0, SD), SD, 10.0, 3, "deg/hr")
            means.append(ArchivedMean(name, 2, "BA", asked, own, of))
    (parameter,) = known(entries, means)["parameters"]
    return [each["control"]["outside"] for each in parameter["temperatures"]]


def known(entries: list[Entry], means: list[ArchivedMean]) -> dict[str, Any]:
    """Return the history of a unit of which an archive has these."""
    index: Any = SimpleNamespace(
        entries=lambda _="": entries,
        behind=lambda _: [],
        gone=lambda _: [],
        settings=lambda _: {},
        means=lambda _: means,
    )
    return history(index, "1")


def test_a_newest_calibration_taken_elsewhere_is_not_outside_its_limits() -> None:
    """They are of values where the unit usually was, and so is what is held against them."""
    assert outside(2.0, 0.0) == [False] * 3
    assert outside(0.0, 1.0) == [True] * 3


def test_a_thermometer_that_shows_another_temperature_than_usual_is_said() -> None:
    """As a comparison of two such campaigns refuses them, so does a history, and says so: it had laid them together."""
    for off_degC in (-2.5, 1.5):
        means, entries = [], []
        for number in range(3):
            name, began = f"unit-1/{number:02d}", f"{2010 + number}-01-01T00:00:00+00:00"
            entries.append(Entry(name, "", "1", "", began_utc=began, ended_utc=began, good=True))
            for asked in (-20.0, 60.0):
                own = asked + off_degC * (number == 2)
                means.append(ArchivedMean(name, 2, "BA", asked, own, Uncertain(SLOPE * own, SD, 10.0, 3, "deg/hr")))
        told = known(entries, means)
        said, (parameter,) = told["said"], told["parameters"]
        assert {len(each["values"]) for each in parameter["temperatures"]} == {2 if off_degC < -2.0 else 3}
        assert [each.partition(":")[0] for each in said] == ["2012-01-01"] * (off_degC < -2.0)
        assert (
            not said
            or "sensor 2's own thermometer shows -2.5 °C beside what it usually does at -20 and 60 °C" in said[0]
        )


def test_calibrations_that_share_no_temperature_are_held_against_none_of_the_others() -> None:
    """Every second one at another temperature only, where the value is another: nothing scatters, and it is said."""
    rng, means, entries = np.random.default_rng(5), [], []
    for number in range(7):
        name, apart = f"unit-1/{number:02d}", number % 2
        began = f"{2010 + number}-01-01T00:00:00+00:00"
        entries.append(Entry(name, "", "1", "", began_utc=began, ended_utc=began, good=True))
        for asked in (23.5,) if apart else (0.0, 20.0, 40.0):
            of = Uncertain(60.0 + 5.0 * apart + rng.normal(0.0, SD), SD, 10.0, 3, "deg/hr/g")
            means.append(ArchivedMean(name, 2, "GSA", asked, asked, of))
    document = known(entries, means)
    (parameter,) = document["parameters"]
    assert parameter["finding"] == "nothing shown"
    assert [each["temperature_degC"] for each in parameter["temperatures"]] == [0.0, 20.0, 23.5, 40.0]
    assert [each["finding"] for each in parameter["temperatures"]] == [
        *["nothing shown"] * 2,
        "cannot tell",
        "nothing shown",
    ]
    assert parameter["not_compared"] == [f"unit-1/{number:02d}" for number in (1, 3, 5)]
    (said,) = document["said"]
    assert said.startswith("2011-01-01, 2013-01-01 and 2015-01-01: share no temperature with the other calibrations")
