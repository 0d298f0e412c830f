"""What a unit shows at rest, through bytes: other units, dead and copied channels, axes turned round."""

from __future__ import annotations

from collections.abc import Callable, Mapping

import pytest

from drivers.imu.samples import FloatArray
from hil.bench import build_bench
from hil.bench.advice import Finding
from hil.bench.at_rest import at_rest
from hil.config import load_bench, parse_bench
from hil.errors import InputError
from procedures.collect import join

Signals = Mapping[str, FloatArray]


def _sound(_given: Signals) -> Signals:
    return {}


def _nobody(question: str, timeout_s: float) -> None:
    del question, timeout_s


def look(change: Callable[[Signals], Signals], positioner: str = "indexing") -> list[Finding]:
    """Return what is found of the simulated unit, its signals changed before they are bytes."""
    shipped = load_bench("simulated")
    text = shipped.text.replace("positioner: indexing", f"positioner: {positioner}")
    with build_bench(parse_bench(text, shipped.source), ask=_nobody) as live:
        assert live.simulators is not None
        unit = live.simulators.unit
        physics = unit.signals
        unit.signals = lambda times_s: {**(s := physics(times_s)), **change(s)}  # type: ignore[method-assign]
        imu, clock = live.devices.imu, live.devices.clock
        imu.identify()
        imu.discard()
        blocks = []
        for _ in range(20):
            clock.sleep(0.1)
            blocks.append(imu.read_block())
        return list(at_rest(live, join(blocks)))


def times(factor: float, *names: str) -> Callable[[Signals], Signals]:
    """Change the fields whose names begin so."""
    return lambda given: {name: values * factor for name, values in given.items() if name.startswith(names)}


def test_a_sound_unit_is_described_and_nothing_is_wrong() -> None:
    """Rates with their scatter, the earth rate that can be, accelerations, and the position."""
    found = look(_sound)
    assert all(each.good for each in found)
    assert "RA" in found[0].message
    assert "the earth rate is at most 15.04" in found[0].message
    assert "accelerations A" in found[0].message
    assert found[-1].message == "the unit lies as in position 3"


@pytest.mark.parametrize(
    ("change", "words"),
    [
        (times(1.0 / 57.29578, "rate"), "sent in rad/s and read as deg/s"),
        (times(57.29578, "rate"), "sent in deg/s and read as rad/s"),
        (times(3600.0, "rate"), "sent in deg/hr and read as deg/s"),
        (times(1.0 / 3600.0, "rate"), "sent in deg/s and read as deg/hr"),
        (times(0.05, "rate"), "an angle per sample and read as one per second"),
        (times(16384.0, "rate"), "counts without their scale"),
        (times(0.0, "rate_A2"), "without any noise: not being measured"),
        (lambda given: {"rate_A2": 0.0 * given["rate_A2"] + 2147483.0}, "saturated, at 2.14748e+06"),
        (lambda given: {"rate_A2": given["rate_A2"] + 5000.0}, "more than the description says"),
        (lambda given: {"rate_A1": given["rate_B2"]}, "sensor 1 RA and sensor 2 RB show the very same samples"),
        (times(9.80665, "accel"), "in m/s², not in g"),
        (lambda given: {"accel_A1": given["accel_B1"], "accel_B1": given["accel_A1"]}, "A and B are exchanged"),
        (times(-1.0, "accel_A1"), "position 3 was asked for, but"),
    ],
)
def test_what_contradicts_the_description_is_not_ok_and_says_why(
    change: Callable[[Signals], Signals], words: str
) -> None:
    """The nearest reading in another unit is named."""
    wrong = [each for each in look(change) if not each.good]
    assert words in " ".join(f"{each.message} {each.advice}" for each in wrong)


def test_a_unit_that_is_turned_by_hand_may_lie_anywhere_before_it_is_asked_for() -> None:
    """It is said, with advice, and is no reason not to begin."""
    found = look(lambda given: {"accel_B1": given["accel_B1"] + 0.5}, positioner="operator")
    assert found[-1].good
    assert found[-1].message.startswith("as in no position")
    assert look(_sound, positioner="operator")[-1].message == "the unit lies as in position 3"


def test_an_orientation_that_no_unit_can_be_turned_to_is_refused() -> None:
    """One sign too many makes a mirror image of the unit."""
    shipped = load_bench("simulated")
    wrong = shipped.text.replace('"3": {A: +3, B: +2, S: +1}', '"3": {A: +3, B: +2, S: -1}')
    with pytest.raises(InputError, match=r"orientations\.3: the mirror image of position 1"):
        parse_bench(wrong, shipped.source)
    other = shipped.text.replace('"3": {A: +1, B: +2, S: -3}', '"3": {A: +2, B: -1, S: -3}')
    with pytest.raises(InputError, match=r"sensors\.1\.orientations\.3: sensor 1 stands otherwise to sensor 2 than at"):
        parse_bench(other, shipped.source)
