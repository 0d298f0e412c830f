"""A standard error as large as the parameter: not measured well enough to say, whatever the residuals do."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import yaml

from hil.campaign import Campaign, Sensor
from hil.campaign.reader import HEADER_FILE, read_campaign
from hil.campaign.writer import write_campaign
from hil.errors import InputError
from hil.solve import repeats, solve_campaign
from hil.solve.precision import usual_size
from procedures.verdict import Verdict
from tests.hil.solve.runs_of_a_unit import campaign, repeated, with_rates

ROTOR = Sensor(2, ("A", "B", "S"), {"RA": "A", "RB": "B"})
TRIAD = Sensor(1, ("A", "B", "S"), {"RA": "A", "RB": "B", "RS": "S"})


def noisy(se: float | None, accepted: float | None) -> Campaign:
    """Return one run whose rates have this standard error."""
    made = campaign(runs=1)
    rows = made.sensors[2]
    errors = np.full_like(rows.rates_deg_per_hr, np.nan if se is None else se)
    return replace(made, sensors={2: replace(rows, rates_se_deg_per_hr=errors)}, largest_se=accepted)


@pytest.mark.parametrize(
    ("se", "accepted", "verdict", "words"),
    [
        (0.7, None, Verdict.PASS, ""),
        (33.0, None, Verdict.INCONCLUSIVE, "more than such a parameter usually is (8.94)"),
        (33.0, 100.0, Verdict.PASS, ""),
        (0.7, 0.1, Verdict.INCONCLUSIVE, "more than is accepted (0.1)"),
        (None, 0.1, Verdict.PASS, "a run alone tells no uncertainty"),
    ],
)
def test_a_parameter_lost_in_its_error_is_no_pass(
    se: float | None, accepted: float | None, verdict: Verdict, words: str
) -> None:
    """What is accepted is as the campaign says, else as large as the parameter usually is; unstated is said as that."""
    (solved,) = solve_campaign(noisy(se, accepted))
    assert solved.verdict is verdict
    assert words in solved.reason
    assert ("not measured well enough to say" in solved.reason) is (verdict is not Verdict.PASS)


def test_rates_without_errors_are_judged_by_the_noise_that_all_runs_show() -> None:
    """As their ± is: by few residuals of its own a run was not measured well enough beside the ± of one that was."""
    one = repeated(9, 3, (0, 1, 2, 1, 0), seed=63)
    noise = np.random.default_rng(0).normal(0.0, 8.0, (45, 2))
    rows = with_rates(one, one.sensors[2].rates_deg_per_hr + noise).sensors[2]
    one = replace(one, sensors={2: replace(rows, rates_se_deg_per_hr=np.full((45, 2), np.nan))})
    solutions = solve_campaign(one)
    shown = repeats(one, solutions)[2]
    assert max(each.parameters["MUA"].se or 0.0 for each in solutions) > 10.0
    assert {round(shown.of_run(each)["MUA"].sd, 2) for each in solutions} == {8.38}
    assert {each.verdict for each in solutions} == {Verdict.PASS}
    strict = solve_campaign(replace(one, largest_se=5.0))  # and what is too large is that of all runs
    assert {each.verdict for each in strict} == {Verdict.INCONCLUSIVE}
    assert all("of MUA, without what runs scatter by beyond it, is 8.38 deg/hr/g" in each.reason for each in strict)


def test_what_runs_scatter_by_makes_none_of_them_worse_measured() -> None:
    """It is in each ±, and what is too large to say anything is told to be the standard error without it."""
    scattering = replace(noisy(0.7, None), run_scatter={2: {"MUA": 12.0}})
    (well,), (badly,) = (solve_campaign(one) for one in (scattering, noisy(33.0, None)))
    assert repeats(scattering, [well])[2].of_run(well)["MUA"].sd > 12.0
    assert well.verdict is Verdict.PASS
    assert "the standard error of MUA, without what runs scatter by beyond it, is 40.4 deg/hr/g" in badly.reason


def test_what_is_usual_depends_on_the_sensor() -> None:
    """A rotor's typical range is known; of a triad nobody knows the technology, so the coarsest is allowed."""
    assert [round(usual_size(name, ROTOR), 1) for name in ("BA", "GSA", "GSB", "MUB")] == [15.8, 63.2, 22.4, 8.9]
    assert [round(usual_size(name, TRIAD), 1) for name in ("BA", "B_RS", "GSA")] == [500.0, 500.0, 70.7]


def test_the_limit_travels_with_the_campaign(tmp_path: Path) -> None:
    """Written and read; one that is none is refused with its key."""
    path = tmp_path / "campaign"
    write_campaign(noisy(0.7, 2.5), path)
    assert read_campaign(path).largest_se == 2.5
    keys = yaml.safe_load((path / HEADER_FILE).read_text())
    (path / HEADER_FILE).write_text(yaml.safe_dump({**keys, "largest_standard_error_deg_per_hr": 0}))
    with pytest.raises(InputError, match="key largest_standard_error_deg_per_hr: must be more than 0, not 0"):
        read_campaign(path)
