"""What the coefficients mean, from the command line: scatter, the report given again, the budget after a night."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from hil.campaign.reader import read_campaign


@pytest.mark.slow
@pytest.mark.usefixtures("searched_once")
def test_a_night_says_what_repeats_show_with_its_solution(hil: Any, night: Path) -> None:
    """Two repeats at two temperatures: both sensors' means with their uncertainty, and what four runs cannot tell."""
    solved = json.loads(hil("solve", night, "--json").stdout)
    assert {number: len(each["means"]) for number, each in solved["repeats"].items()} == {"1": 2, "2": 2}
    assert {each["degrees_of_freedom"] for each in solved["repeats"]["2"]["run_to_run"].values()} == {2}
    assert solved["both_sensors"]["sensors"] == [1, 2]
    people = hil("solve", night).stdout
    assert "what repeats show included" in people
    told = json.loads(hil("scatter", night, "--json").stdout)
    assert told["schema"] == "hil.scatter/2"
    assert {(each["sensor"], each["channel"]) for each in told["noise"]} == {
        (s, c) for s in (1, 2) for c in ("RA", "RB")
    }
    assert sum(each["probability"] for each in told["causes"]) > 1.0 - 1e-6  # two may scatter at once
    shown = hil("scatter", night).stdout
    assert told["sentences"][0][:40] in shown


@pytest.mark.slow
def test_a_nights_noise_is_that_of_its_export(hil: Any, night: Path, tmp_path: Path) -> None:
    """Every row of an exported series is the mean of a whole block, so that both records have the same white noise."""
    assert hil("export", night, tmp_path / "c").returncode == 0
    campaign = read_campaign(tmp_path / "c")
    for collect in campaign.recorded:
        t_s = campaign.series(collect).t_s
        assert np.ptp(np.diff(t_s)) < 0.1 * np.median(np.diff(t_s)), collect
    white = []
    for folder in (night, tmp_path / "c"):
        ended = hil("allan", folder, "--sensor", "2", "--channel", "RA", "--json")
        told = json.loads(ended.stdout)
        assert told["averaging"]["collect_s"] == campaign.sensors[2].conditions.duration_s[0]  # its own, not 60 s
        white.append(told["fit"]["N"])
    assert max(each["low"] for each in white) < min(each["high"] for each in white)


def test_the_reports_tables_are_given_again_from_a_night(hil: Any, night: Path) -> None:
    """For people beside the printed ones; as a document; and what has not the three collects is refused."""
    told = json.loads(hil("reproduce", night, "--json").stdout)
    assert told["schema"] == "hil.reproduction/1"
    assert len(told["table_a1"]) == 4
    assert told["simulated"] is True
    people = hil("reproduce", night).stdout
    assert "plain mean" in people  # hil solve and hil report weigh runs
    assert "SIMULATED" in people
    assert "MUA2 matrix, deg/hr/g" in people
    assert "printed 10" in people
    assert hil("reproduce", night, "--sensor", "1").returncode == 2


@pytest.mark.slow
def test_the_budget_after_a_night_is_of_what_was_measured(hil: Any, night: Path) -> None:
    """On the night's own bench: measured standard errors and slopes, and what scattered beside what was expected."""
    told = json.loads(hil("budget", night, "--draws", "2000", "--json").stdout)
    assert told["simulated"] is True
    for sensor in told["sensors"].values():
        by_id = {each["id"]: each for each in sensor["sources"]}
        assert by_id["noise"]["origin"] == "measured standard errors"
        assert by_id["soak"]["origin"].startswith("as measured")
        assert sensor["left_out"] == []
        assert sensor["observed_run_to_run"]["BA"]["degrees_of_freedom"] == 2
        assert sensor["agrees"] is True
    people = hil("budget", night, "--draws", "2000").stdout
    assert "repeats scatter by" in people
    assert "SIMULATED" in people
