"""A thermometer that does not follow its air, and a channel that shows one value on and on: no record of anything."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from hil.campaign import FloatArray
from hil.campaign.plausibility import judged_by_its_records
from hil.solve.omissions import in_words
from tests.hil.solve.runs_of_a_unit import campaign, with_column, with_rates


@pytest.mark.parametrize(
    ("change", "words"),
    [
        (lambda shown: np.full_like(shown, 23.0), "does not follow"),
        (lambda shown: shown - 20.0, "temperature_degC is -32, where -23.9 to 20.1 belongs by the air"),
        (lambda shown: shown + 45.0, "temperature_degC is 33, where -23.9 to 20.1 belongs by the air"),
    ],
)
def test_a_thermometer_that_cannot_be_fails(change, words: str) -> None:
    """Stuck, or so far off that a unit that draws power cannot be at it."""
    made = campaign()
    judged = with_column(made, temperature_degC=change(made.sensors[2].conditions.columns["temperature_degC"]))
    assert judged.contradicted
    assert words in " ".join(judged.warnings)


def test_a_thermometer_is_not_wrong_because_the_soak_was_cut_short() -> None:
    """It follows the air from where it was, slowly."""
    made = campaign(6, per_temperature=2)
    degrees = made.sensors[2].conditions.columns["setpoint_degC"] + np.repeat([20.0, 12.0] * 3, 3)
    degrees[:3] = 45.0
    moving = with_column(made, temperature_degC=degrees, dTdt_degC_per_min=np.full(18, -0.9))
    assert not any("does not follow" in words for words in moving.warnings)
    still = with_column(made, temperature_degC=degrees * 0.1, dTdt_degC_per_min=np.zeros(18))
    assert any("does not follow" in words for words in still.warnings)


@pytest.mark.parametrize(
    ("runs", "wrong", "accused"),
    [(9, slice(12, 15), [5]), (3, slice(6, 9), [3]), (3, slice(9), [1, 2, 3]), (2, slice(6), [1, 2])],
)
def test_one_runs_wrong_thermometer_accuses_that_run(runs: int, wrong: slice, accused: list[int]) -> None:
    """The others followed the air; only where none does, or nobody can tell which, all are doubtful."""
    made = campaign(runs, per_temperature=1)
    degrees = made.sensors[2].conditions.columns["temperature_degC"].copy()
    degrees[wrong] = 0.0
    assert sorted(with_column(made, temperature_degC=degrees).contradicted) == [(run, 2) for run in accused]


def test_a_thermometer_that_shows_one_number_at_every_setpoint_follows_nothing() -> None:
    """Whether the unit had soaked is not recorded, nor the air: the setpoints went, and it did not."""
    made = campaign(6, per_temperature=2)
    rows = made.sensors[2]
    asked = {"setpoint_degC": rows.conditions.columns["setpoint_degC"]}

    def shown(degrees: FloatArray) -> tuple[str, ...]:
        conditions = replace(rows.conditions, columns=asked | {"temperature_degC": degrees})
        return judged_by_its_records(replace(made, sensors={2: replace(rows, conditions=conditions)})).warnings

    assert "while the setpoint went from" in " ".join(shown(np.full(18, 25.0)))
    assert shown(0.2 * asked["setpoint_degC"]) == ()


@pytest.mark.parametrize(
    ("begins", "step_degC", "lost"), [(18, 0.01, 7), (18, 1.0, 7), (27, 0.01, 10), (30, 0.01, 13), (36, 5.0, 13)]
)
def test_a_thermometer_that_stands_still_from_the_middle_of_a_night_on_is_lost(
    begins: int, step_degC: float, lost: int
) -> None:
    """From the next setpoint on, however coarse it is; what only steps follows, and at one setpoint it may be right."""
    made = campaign(12, per_temperature=3)
    rows = made.sensors[2]
    shown = np.round(rows.conditions.columns["temperature_degC"] / step_degC) * step_degC
    shown[begins:] = shown[begins - 1]
    asked = {"setpoint_degC": rows.conditions.columns["setpoint_degC"], "temperature_degC": shown}
    found = judged_by_its_records(
        replace(made, sensors={2: replace(rows, conditions=replace(rows.conditions, columns=asked))})
    )
    assert {run for run, _ in found.contradicted} == {*range(lost, 13)}
    assert any("while the setpoint went from" in words for words in found.warnings) is (lost < 13)


@pytest.mark.parametrize("level", [12.0, 12.34, 12.34567])
def test_a_channel_that_stands_still_through_a_run_was_not_measured_whatever_it_shows(level: float) -> None:
    """However round the value: no noise shows it three times where digits are fine."""
    made = campaign(9)
    rates = np.round(made.sensors[2].rates_deg_per_hr, 3)
    rates[12:15, 0] = level
    found = judged_by_its_records(with_rates(made, rates))
    assert {run for run, _ in found.contradicted} == {5}
    assert "every rate is exactly" in found.contradicted[5, 2].reason


def test_a_thermometer_that_stands_still_makes_no_other_record_wrong() -> None:
    """The case went where the air did: a value that never changes tells which of two thermometers is lost."""
    made = campaign(12, per_temperature=3)
    columns = made.sensors[2].conditions.columns
    shown, case = columns["temperature_degC"].copy(), columns["temperature_degC"] + 1.0
    shown[9:] = shown[9]
    warnings = with_column(made, temperature_degC=shown, case_degC=case).warnings
    assert "does not follow" in " ".join(warnings)
    assert not any("case_degC" in words or "belongs by" in words for words in warnings)


def test_what_every_sensors_thermometer_shows_is_said_once() -> None:
    """Sixteen lines of a unit of two sensors were eight, each twice."""
    soaks = [{"sensor": n, "runs": runs, "why": f"why {runs}"} for n in (1, 2) for runs in ([1], [4])]
    soaks.append({"sensor": 2, "runs": [7], "why": "another"})
    said = ["sensors 1–2, run 1: why [1]", "sensors 1–2, run 4: why [4]", "sensor 2, run 7: another"]
    assert in_words({"runs_not_settled": soaks}) == said
