"""What makes many values of a campaign differ from an earlier one's is said as one cause, where it is one."""

from __future__ import annotations

import re
from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest

from hil.analysis import one_cause
from hil.analysis.against import Comparison
from hil.campaign import Campaign, FloatArray
from hil.report.content import gather
from hil.report.page import render
from hil.report.tables import tables_of
from tests.hil.analysis.thermal.nights import rotor_night

CURVES = {"BA": lambda t: 80.0 - 0.3 * t, "BB": lambda t: 5.0 + 0.4 * t, "GSA": lambda t: 60.0 + 0.1 * t}


def night(seed: int, change: Callable[[FloatArray], FloatArray] = lambda rates: rates, **of: object) -> Campaign:
    """Return a night of a unit whose values follow temperature, its rates changed."""
    given = {"temperatures_degC": (-20.0, 20.0, 60.0), "runs": 3, "run_to_run": {"BA": 0.4, "BB": 0.4}} | of
    made = rotor_night(np.random.default_rng(seed), CURVES, **given)  # type: ignore[arg-type]
    rows = made.sensors[2]
    return replace(made, sensors={2: replace(rows, rates_deg_per_hr=np.asarray(change(rows.rates_deg_per_hr)))})


def test_a_gain_that_changed_is_one_cause_of_all_that_did() -> None:
    """RA eight hundredths larger: BA, GSA and GSB differ by as much as that makes of each."""
    found = Comparison(night(2, lambda rates: rates * [1.08, 1.0]), night(1))
    assert len(found.flagged) > 1
    (said,) = found.causes
    size = re.match(r"sensor 2: all of that looks like one cause: RA is ([0-9.]+) ±([0-9.]+) times what it was", said)
    assert size is not None, said
    assert float(size[1]) == pytest.approx(1.08, abs=4.0 * float(size[2]))
    assert {said, found.agreeing} <= {*found.sentences()}


def test_biases_that_shifted_are_as_many_causes() -> None:
    """RA by 12 and RB by -8 at all temperatures; which parameters agree, and by how much the others do not, is said."""
    found = Comparison(night(2, lambda rates: rates + np.array([12.0, -8.0])), night(1))
    (said,) = found.causes
    assert said.startswith("sensor 2: all of that looks like two causes: BA differs by 1")
    assert " alike and BB differs by -" in said
    assert re.match(r"they differ by \d+ to \d+ times their ±; at every temperature these agree, ", found.agreeing)
    assert found.agreeing.endswith("sensor 2: GSA, GSB, MUA and MUB")
    assert said.replace(" -", " \N{MINUS SIGN}") in render(gather(night(2), comparison=found))


def test_another_temperature_is_a_cause() -> None:
    """The chamber says -20, 20 and 60 °C both times, and the unit was 10 °C warmer than before: all values follow."""
    now = night(2, temperatures_degC=(-10.0, 30.0, 70.0))
    rows = now.sensors[2].conditions
    columns = {name: of - 10.0 if name.endswith("_degC") else of for name, of in rows.columns.items()}
    now = replace(now, sensors={2: replace(now.sensors[2], conditions=replace(rows, columns=columns))})
    (said,) = Comparison(now, night(1)).causes
    assert re.search(r"one cause: at every temperature the unit looks warmer by (9|10)\.\d+ ±[0-9.]+ °C$", said), said


def test_what_has_no_one_cause_is_told_value_by_value() -> None:
    """MUA, GSB and BA each by something else at one temperature: nothing is made up of that."""
    one = night(2)
    rows = one.sensors[2]
    at = rows.conditions.columns["temperature_degC"].round(-1)
    more = np.where(at[:, None] == 20.0, rows.conditions.f_g[:, [2, 0]] * [25.0, 30.0], 0.0)
    more[:, 0] += 15.0 * (at == 60.0)
    found = Comparison(
        replace(one, sensors={2: replace(rows, rates_deg_per_hr=rows.rates_deg_per_hr + more)}), night(1)
    )
    assert len(found.flagged) > 2
    assert found.causes == []


def test_what_changed_is_beyond_chance_of_all_that_were_compared() -> None:
    """One of eighteen is beyond three sigma in one comparison of twenty, and nothing had to change for that."""
    pairs = [Comparison(night(seed), night(seed + 1)) for seed in range(100, 160, 2)]
    assert sum(bool(each.flagged) for each in pairs) <= 1
    assert all(each.causes == [] and each.agreeing == "" for each in pairs if not each.flagged)


@pytest.mark.parametrize(("times", "counts"), [(1.05, False), (1.5, True)])
def test_one_of_many_that_is_just_beyond_three_sigma_is_neither_marked_nor_counted(times: float, counts: bool) -> None:
    """A BA that differs at one temperature by a little more than three sigma is one of eighteen values."""
    one, rows = night(2), night(2).sensors[2]
    was = next(each for each in Comparison(one, night(1)).differences if each.parameter == "BA").difference
    there = rows.conditions.columns["temperature_degC"].round(-1)[:, None] == -20.0
    more = there * np.array([times * was.expanded(3.0) - was.value, 0.0])
    now = replace(one, sensors={2: replace(rows, rates_deg_per_hr=rows.rates_deg_per_hr + more)})
    found = Comparison(now, night(1))
    assert [each.parameter for each in found.differences if each.flagged] == ["BA"]
    assert bool(found.flagged) is counts
    content = gather(now, comparison=found)
    assert render(content).count(">BEYOND<") == counts
    assert sum(tables_of(content)["differences"]["beyond_chance"].to_pylist()) == counts
    assert found.causes == []  # of one temperature alone no cause says more than the value does


def test_a_cause_of_many_differences_is_told_where_one_of_them_alone_is_beyond_chance() -> None:
    """GSA by 2.2 at -20 °C and 1.7 at 60 °C, of which one is beyond chance: together they say more than it does."""
    now = night(2)
    rows = now.sensors[2]
    size = 2.2 - 0.006 * (rows.conditions.columns["temperature_degC"] + 20.0)
    more = rows.conditions.f_g[:, :2] * size[:, None]
    now = replace(now, sensors={2: replace(rows, rates_deg_per_hr=rows.rates_deg_per_hr + more)})
    found = Comparison(now, night(1))
    assert len(found.flagged) == 1
    (said,) = found.causes
    assert "one cause: GSA differs by " in said


def test_another_order_of_collects_is_said() -> None:
    """What drifts through a run enters other parameters then."""
    now, rows = night(2), night(1).sensors[2]
    start_s = rows.conditions.start_s.copy()
    for of in rows.conditions.of_each_run.values():
        start_s[of[:2]] = start_s[of[1::-1]]
    before = replace(night(1), sensors={2: replace(rows, conditions=replace(rows.conditions, start_s=start_s))})
    assert any("were taken in the order" in each for each in Comparison(now, before).remarks)
    assert not any("were taken in the order" in each for each in Comparison(now, night(1)).remarks)


@pytest.mark.parametrize(("times", "doubted"), [(1.015, False), (1.025, True)])
def test_a_gain_that_no_single_value_shows_is_seen_in_all_of_them(times: float, doubted: bool) -> None:
    """No value is beyond chance, and all of them together are; by more than 2 % a channel is doubted."""
    found = Comparison(night(4, lambda rates: rates * [times, 1.0]), night(3))
    assert not found.flagged
    (said,) = found.causes
    assert said.startswith("sensor 2: none alone, but all together look like one cause: RA is 1.0")
    assert [each.lower() for each in found.doubts] == [f"{said.lower()}."] * doubted
    assert not Comparison(night(4), night(3)).causes


@pytest.mark.parametrize("seed", [2, 12, 22])
def test_one_cause_that_leaves_more_than_chance_does_is_not_told_for_two(seed: int) -> None:
    """RA by 5 % and BB by 3: no single value was left beyond chance by "2.9 °C warmer", and all together were."""
    found = Comparison(night(seed, lambda rates: rates * [1.05, 1.0] + np.array([0.0, 3.0])), night(seed + 1))
    (said,) = found.causes
    assert "two causes: " in said
    assert "BB differs by " in said
    assert "warmer" not in said


def test_both_channels_by_the_same_gain_are_one_cause() -> None:
    """A clock, or a scale in a driver, is neither of two channels by itself."""
    (said,) = Comparison(night(2, lambda rates: 1.05 * rates), night(1)).causes
    assert "one cause: each of RA and RB is 1.05" in said or "one cause: each of RA and RB is 1.04" in said


@pytest.mark.parametrize(
    ("values", "told"),
    [
        (np.full(18, 5.0) + np.resize([0.5, -0.5], 18), True),
        (np.full(18, 5.0) + np.resize([2.4, -2.4], 18), False),  # none beyond chance is left, and all are too large
        (np.array([6.0, 2.0, 2.0]), False),  # one value by itself explains more
        (np.array([6.0, 4.5, 4.5]), True),
    ],
)
def test_a_cause_leaves_chance_and_explains_more_than_values_do_one_by_one(
    monkeypatch: pytest.MonkeyPatch, values: FloatArray, told: bool
) -> None:
    """Of values with a ± of 1 each, of which 3.5 are beyond chance; the cause would move all alike."""
    count = len(values)
    cause = one_cause._Cause("all by {}", "", np.ones(count))
    monkeypatch.setattr(one_cause, "_causes", lambda *_: [cause])
    differ = one_cause.Differ([("BA", 20.0)] * count, values, np.ones(count), np.full(count, 3.5))
    said, scaled = one_cause.looks_like(2, differ, None, None, 3.5)  # type: ignore[arg-type]
    assert said.startswith("one cause: all by ") == told == bool(said)
    assert not scaled


def test_of_a_sensor_that_differs_in_all_values_together_none_is_said_to_agree() -> None:
    """And the sensor with values beyond chance comes first: the head of a report has room for one."""
    little, much, one, other = (
        each.sensors[2]
        for each in (night(4, lambda r: r * [1.025, 1.0]), night(2, lambda r: r * 1.08), night(3), night(1))
    )
    found = Comparison(replace(night(2), sensors={2: little, 3: much}), replace(night(1), sensors={2: one, 3: other}))
    assert [cause.partition(" like")[0] for cause in found.causes] == [
        "sensor 3: all of that looks",
        "sensor 2: none alone, but all together look",
    ]
    assert found.doubts[0].startswith("Sensor 3")
    assert "sensor 3: " in found.agreeing
    assert "sensor 2" not in found.agreeing
