"""A chamber is safe when its air says so: SAFE, NOT SAFE and NOT KNOWN, over an air that is made to measure."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import replace
from itertools import pairwise

import pytest

from drivers.chambers import ChamberReading, SafeState
from drivers.clock import VirtualClock
from drivers.errors import CommandRefused, DeviceTimeout
from procedures.progress import Progress
from procedures.safe_air import Left, Word, not_commanded, watch_air
from procedures.settings import Polling
from procedures.sweep_outcome import SweepState

STANDBY, HOLD = SafeState("standby"), SafeState("hold", 25.0)


class Air:
    """A chamber whose air is a function of the time since the command; None where it does not answer then."""

    def __init__(self, clock: VirtualClock, air: Callable[[float], float | None], setpoint: float) -> None:
        self._clock, self._air, self._setpoint, self._began_s = clock, air, setpoint, clock.now()

    def read(self) -> ChamberReading:
        """Read it."""
        air = self._air(self._clock.now() - self._began_s)
        if air is None:
            raise DeviceTimeout("the chamber sent nothing within 1 s")
        return ChamberReading(air, self._setpoint, 80.0, -50.0, "STANDBY")


def left(safe: SafeState, air: Callable[[float], float | None], setpoint: float, within_s: float = 900.0) -> Left:
    """Watch such an air."""
    clock = VirtualClock()
    chamber = Air(clock, air, setpoint)
    polling = Polling(safe_air_s=within_s)
    found = watch_air(chamber, clock, safe, polling, lambda _: None)  # type: ignore[arg-type]
    assert clock.now() <= within_s + 1.0
    return found


def leak(begins: float, minutes: float = 60.0) -> Callable[[float], float]:
    """Nothing conditions: towards 22 °C, by a factor e in so many minutes."""
    return lambda t: 22.0 + (begins - 22.0) * math.exp(-t / 60.0 / minutes)


def ramp(begins: float, setpoint: float, per_min: float = 3.0) -> Callable[[float], float]:
    """It conditions all the same, with a ripple once it is there."""

    def air(t: float) -> float:
        way = setpoint - begins
        gone = min(per_min * t / 60.0, abs(way))
        return begins + math.copysign(gone, way) + 0.4 * math.sin(t / 30.0) * (gone >= abs(way))

    return air


@pytest.mark.parametrize(
    ("safe", "air", "setpoint", "word"),
    [
        (STANDBY, leak(60.0), 60.0, Word.SAFE),
        (STANDBY, leak(60.0, 180.0), 60.0, Word.SAFE),  # a well insulated one
        (STANDBY, leak(-30.0), -30.0, Word.SAFE),
        (STANDBY, leak(23.0), 23.0, Word.SAFE),
        (STANDBY, leak(-10.0), 60.0, Word.SAFE),  # on its way through the cold, stopped: it goes home too slowly
        (STANDBY, leak(20.0), 60.0, Word.SAFE),  # on its way through the room's temperature, stopped there
        (STANDBY, ramp(60.0, 60.0), 60.0, Word.NOT_SAFE),
        (STANDBY, ramp(-30.0, -30.0), -30.0, Word.NOT_SAFE),
        (STANDBY, ramp(-10.0, 60.0), 60.0, Word.NOT_SAFE),  # it moves home, and past it
        (STANDBY, ramp(20.0, 60.0), 60.0, Word.NOT_SAFE),
        (STANDBY, ramp(23.0, -30.0), -30.0, Word.NOT_SAFE),
        (STANDBY, lambda _: 60.0, 23.0, Word.NOT_SAFE),  # a setpoint that lies too, or air that nothing moves
        (STANDBY, lambda _: math.nan, 23.0, Word.NOT_SAFE),
        (STANDBY, lambda _: None, 60.0, Word.NOT_KNOWN),
        (STANDBY, lambda t: 60.0 if t < 100.0 else None, 60.0, Word.NOT_KNOWN),
        (STANDBY, lambda t: None if t < 100.0 else leak(60.0)(t), 60.0, Word.SAFE),
        (HOLD, ramp(60.0, 25.0), 25.0, Word.SAFE),
        (HOLD, ramp(25.0, 25.0), 25.0, Word.SAFE),
        (HOLD, ramp(60.0, 60.0), 25.0, Word.NOT_SAFE),
    ],
)
def test_the_air_decides(safe: SafeState, air: Callable[[float], float | None], setpoint: float, word: Word) -> None:
    """Neither the mode nor the setpoint that the chamber shows makes it safe."""
    found = left(safe, air, setpoint)
    assert found.word is word, found
    assert found.reason
    assert str(word) in str(found)


def test_a_safe_state_that_failed_is_not_safe_where_it_was_refused_and_not_known_where_nobody_answers() -> None:
    """A refusal is a statement."""
    assert not_commanded(CommandRefused("locked"), "x").word is Word.NOT_SAFE
    assert not_commanded(DeviceTimeout("silent"), "x").word is Word.NOT_KNOWN
    assert str(not_commanded(DeviceTimeout("silent"), "x")) == "WHETHER THE CHAMBER IS SAFE IS NOT KNOWN: x"


def test_a_safe_state_that_is_not_carried_out_fails_a_sweep_that_was_otherwise_done(bench) -> None:
    """Every collect is there; the last step is not done, and the sweep says NOT SAFE after both looks."""
    bench.sweep = replace(bench.sweep, temperatures_degC=(60.0,), final_degC=None)
    bench.chamber.lies = True
    outcome = bench.run()
    assert (outcome.state, outcome.left.word) == (SweepState.FAILED, Word.NOT_SAFE)
    assert outcome.missing == (bench.plan.steps[-1].key,)
    assert "acknowledged and is not carried out: in 15 min the air went from 60.0 to 60.0 °C" in outcome.left.reason
    kinds = bench.record.kinds()
    assert "safe-state-commanded" in kinds
    assert kinds[-1] == "safe-state-not-reached"
    assert bench.record.events[-1][2] == {"chamber": "NOT SAFE"}


def test_the_look_at_the_air_is_bounded_and_shows_signs_of_life(bench) -> None:
    """A watchdog hears of the controller all the while, and onlookers see what is waited for."""
    beats, shown = [], []

    def vital(silent_s: float) -> None:
        beats.append((bench.clock.now(), silent_s))

    class Onlooker(Progress):
        def update(self, snapshot: object) -> None:
            if bench.clock.now() > 1500.0:
                bench.stop.request("stopped by SIGINT")

        def event(self, kind: str, message: str, at_s: float) -> None:
            if kind == "safe-state-commanded":
                shown.append((message, at_s))

    bench.sweep = replace(bench.sweep, temperatures_degC=(60.0,), final_degC=None)
    bench.chamber.lies = True
    bench.polling = replace(bench.polling, safe_air_s=300.0)
    outcome = bench.run(vital=vital, onlookers=[Onlooker()])
    assert (outcome.state, outcome.left.word) == (SweepState.ABORTED, Word.NOT_SAFE)
    assert bench.clock.now() < 1500.0 + 330.0
    assert len(shown) > 20
    assert all(earlier < later for (_, earlier), (_, later) in pairwise(shown))  # the time that is shown goes on, too
    assert all(later <= at + 60.0 + silent for (at, silent), (later, _) in pairwise([*beats, (bench.clock.now(), 0.0)]))
