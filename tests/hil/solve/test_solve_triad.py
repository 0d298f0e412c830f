"""`hil solve` on three-axis units in static poses: the whole matrix, or the reason why not."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from hil.campaign import Campaign, Collects, Conditions, Sensor
from hil.campaign.plausibility import judged_by_its_records
from hil.campaign.reader import read_campaign
from hil.solve import solve_campaign
from procedures.verdict import Verdict
from tests.hil.solve.runs_of_a_unit import repeated
from tests.hil.solve.solved_campaigns import TRIAD_YAML, Row, only, values_of, write

G_TRUTH = np.array([[1.0, 20.0, -3.0], [-7.0, 5.0, 40.0], [11.0, -13.0, 2.0]])


def triad_row(i: int, f_g: np.ndarray, noise: np.ndarray | float = 0.0) -> Row:
    """One pose of a triad with a matrix G that is not symmetric, and an earth rate of its own."""
    w = np.array([5.0, -4.0, 3.0]) * np.cos(i)
    return 1, f"pose-{i:02d}", f_g, w, np.array([100.0, -50.0, 25.0]) + G_TRUTH @ f_g + w + noise


def triad(folder: Path, rows: Sequence[Row], se: float | None = 1.0) -> Campaign:
    """Write and read a campaign of a triad."""
    return write(folder, TRIAD_YAML, "XYZ", ("GX", "GY", "GZ"), rows, se)


def test_a_triad_gets_its_whole_matrix_untransposed(tmp_path: Path) -> None:
    """Twenty poses, non-symmetric truth: GXY is 20, not -7."""
    poses = np.random.default_rng(4).normal(size=(20, 3))
    poses /= np.linalg.norm(poses, axis=-1, keepdims=True)
    solution = only(triad(tmp_path, [triad_row(i, f_g) for i, f_g in enumerate(poses)]))
    assert solution.model == "triad-12"
    np.testing.assert_allclose(values_of(solution)[:3], [100, -50, 25], rtol=1e-9)
    np.testing.assert_allclose(np.reshape(values_of(solution)[3:], (3, 3)), G_TRUTH, rtol=1e-9)
    assert solution.parameters["GXY"].value == pytest.approx(20.0)
    assert solution.degrees_of_freedom == 48
    assert solution.verdict is Verdict.PASS


def test_a_triad_in_four_poses_has_no_residual(tmp_path: Path) -> None:
    """Twelve equations, twelve unknowns."""
    poses = [[1.0, 0, 0], [-1.0, 0, 0], [0, 1.0, 0], [0, 0, 1.0]]
    solution = only(triad(tmp_path, [triad_row(i, np.array(f_g)) for i, f_g in enumerate(poses)]))
    np.testing.assert_allclose(np.reshape(values_of(solution)[3:], (3, 3)), G_TRUTH, rtol=1e-9)
    assert "twelve equations, twelve unknowns" in solution.reason


def test_a_triad_in_three_poses_gets_the_bias_with_the_reason(tmp_path: Path) -> None:
    """Too few to separate G from the bias: constant, and it says why."""
    solution = only(triad(tmp_path, [triad_row(i, np.eye(3)[i]) for i in range(3)]))
    assert solution.model == "constant"
    assert list(solution.parameters) == ["BX", "BY", "BZ"]
    assert "cannot excite all three axes" in solution.reason


def test_triad_12_by_name_on_poses_in_a_plane_refuses_the_columns_it_cannot_see(tmp_path: Path) -> None:
    """Rotation about Y only, to a tenth of a milliradian: the Y column is named, the rest is right."""
    angles = np.deg2rad([0, 60, 120, 180, 240, 300])
    jitter = [1e-4, -1e-4, 0.0, 1e-4, 1e-4, -1e-4]
    rows = [
        triad_row(i, np.array([np.cos(a), y, np.sin(a)])) for i, (a, y) in enumerate(zip(angles, jitter, strict=True))
    ]
    solution = only(triad(tmp_path, rows), "triad-12")
    assert solution.verdict is Verdict.INCONCLUSIVE
    assert solution.unobservable == ("GXY is not seen", "GYY is not seen", "GZY is not seen")
    assert solution.parameters["GYZ"].value == pytest.approx(40.0, abs=0.01)
    assert solution.parameters["BX"].value == pytest.approx(100.0, abs=0.01)
    assert solution.parameters["GXY"].value is None


def test_one_missing_channel_of_a_triad_costs_only_its_row(tmp_path: Path) -> None:
    """GY missing in all but two poses: GX and GZ are solved, the row of GY is not."""
    poses = np.random.default_rng(5).normal(size=(8, 3))
    poses /= np.linalg.norm(poses, axis=-1, keepdims=True)
    rows = [triad_row(i, f_g) for i, f_g in enumerate(poses)]
    for row in rows[2:]:
        row[4][1] = np.nan
    solution = only(triad(tmp_path, rows))
    assert solution.parameters["GXZ"].value == pytest.approx(G_TRUTH[0, 2])
    assert solution.parameters["GYZ"].value is None
    assert all("GX" not in text and "GZ" not in text for text in solution.unobservable)


def test_real_triads_are_solved(reference_data: Path) -> None:
    """Campaigns measured by others give triad-12 with a usable condition number."""
    for folder in sorted((reference_data / "campaigns").iterdir()):
        solution = only(read_campaign(folder))
        assert solution.model == "triad-12"
        assert solution.condition_number is not None
        assert solution.condition_number < 5
        assert all(estimate.se is not None for estimate in solution.parameters.values())


@pytest.mark.parametrize(
    ("turns", "noise", "stated", "verdict"),
    [
        (False, 0.3, 1.0, "FAIL"),
        (False, 0.3, 0.6, "FAIL"),
        (False, 0.3, 0.0, "FAIL"),
        (True, 0.5, 1.0, "PASS"),
        (False, 5.0, 1.0, "PASS"),
    ],
)
def test_a_channel_that_does_not_turn_with_the_others_is_no_pass(
    turns: bool, noise: float, stated: float, verdict: str
) -> None:
    """It would have minus the earth rate as its sensitivity, and no residual; in much noise nobody can tell.

    Whatever is stated of that noise: all, too little, or nothing.
    """
    rng = np.random.default_rng(1)
    f = rng.normal(size=(24, 3))
    f /= np.linalg.norm(f, axis=1, keepdims=True)
    w, k = 8.54 * f, np.arange(24)
    rates = np.array([10.0, -5.0, 3.0]) + w * [True, turns, True] + rng.normal(0.0, noise, (24, 3))
    sensor = Sensor(1, ("X", "Y", "Z"), {"GX": "X", "GY": "Y", "GZ": "Z"})
    labels = np.array([f"pose {i}" for i in k])
    conditions = Conditions(sensor, k + 1, np.ones(24, dtype=np.int64), labels, 100.0 * k, np.full(24, 60.0), f, w, {})
    made = Campaign("poses", "", {1: Collects(conditions, rates, np.full((24, 3), stated * noise))})
    (solved,) = solve_campaign(judged_by_its_records(made))
    assert solved.verdict.value == verdict
    assert ("GY shows the same in every pose" in solved.reason) is (verdict == "FAIL")
    assert solved.parameters["GYY"].value == pytest.approx(0.0 if turns else -8.54, abs=noise)


def test_a_channel_that_stands_in_one_run_is_named_though_no_earth_rate_is_known() -> None:
    """It moves with gravity in all others: one that does not is no jump, and no other sensitivity."""
    made = repeated(8, 4, (0, 1, 2, 3, 4))
    rows = made.sensors[2]
    nowhere = replace(rows.conditions, w_deg_per_hr=0.0 * rows.conditions.w_deg_per_hr)
    noise = np.random.default_rng(2).normal(0.0, 0.3, len(rows.conditions))
    dead = (rows.conditions.run == 5)[:, None] & np.array([True, False])
    rates = np.where(dead, 12.0 + noise[:, None], rows.rates_deg_per_hr)
    laid = Collects(nowhere, rates, rows.rates_se_deg_per_hr)
    late = judged_by_its_records(replace(made, sensors={2: laid}))
    failed = [each for each in solve_campaign(late) if "RA shows the same in every pose, where mostly" in each.reason]
    assert [(each.runs, each.verdict.value) for each in failed] == [((5,), "FAIL")]
