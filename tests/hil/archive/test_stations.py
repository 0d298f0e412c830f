"""A jump is told from a temperature at which the unit stood elsewhere, and from a changed dependence on temperature."""

from __future__ import annotations

import numpy as np

from hil.archive.index import ArchivedMean
from hil.archive.trend import Trend, at_usual_temperatures, differs, shifts_of, stations_of, trend
from hil.solve.repeats import Uncertain

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
