"""A triad that was turned over by hand, and of which nobody recorded which way north lay."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from hil.campaign import Campaign, Collects, Conditions, Sensor
from hil.reconcile import Reconciliation, reconcile

AXES = ("X", "Y", "Z")
ERROR = 0.2  # deg/hr
FACES = np.array([sign * axis for axis in np.eye(3) for sign in (1.0, -1.0)])


def six_faces(seed: int, k2_deg_per_hr_per_g2: float = 0.0, *, recorded: bool = False) -> Campaign:
    """Six faces up, each four times at a heading of its own, under the earth rate of 48 degrees of latitude."""
    rng = np.random.default_rng(seed)
    north = np.roll(FACES, 1, axis=1) * np.array([1.0, -1.0, 1.0, 1.0, -1.0, 1.0])[:, None]
    angle = rng.uniform(0.0, 2.0 * np.pi, (6, 1))
    level = np.cos(angle) * north + np.sin(angle) * np.cross(FACES, north)
    f, w = (np.tile(own, (4, 1)) for own in (FACES, 11.2 * FACES + 10.1 * level))
    rates = rng.normal(0.0, 20.0, 3) + f @ rng.normal(0.0, 3.0, (3, 3)) + w + ERROR * rng.normal(size=w.shape)
    rates += k2_deg_per_hr_per_g2 * f**2 @ np.array([[1.0, 0.0, 0.0], [-1.0, 0.5, 0.0], [0.0, -0.7, 1.0]])
    n = len(f)
    conditions = Conditions(
        sensor=Sensor(1, AXES, {f"G{axis}": axis for axis in AXES}),
        collect=np.arange(1, n + 1),
        run=np.ones(n, dtype=np.int64),
        position=np.array([f"pose-{1 + k % 6}" for k in range(n)]),
        start_s=60.0 * np.arange(n),
        duration_s=np.full(n, 30.0),
        f_g=f,
        w_deg_per_hr=w if recorded else np.zeros_like(w),
        columns={"n_samples": np.full(n, 3000.0)},
    )
    return Campaign(
        "faces", "test, simulated", {1: Collects(conditions, rates, np.full(w.shape, ERROR))}, simulated=True
    )


def names(result: Reconciliation) -> list[str]:
    """The first effect's id, and those of its rivals."""
    first = result.effects[0]
    return [first.id, *(rival.id for rival in first.confusable_with)]


@pytest.mark.parametrize("seed", [1, 2])
def test_the_earths_level_part_that_nobody_recorded_is_not_named_anisoelasticity(seed: int) -> None:
    """In six faces the two are one, and the heading is what to record: no collect at an unknown one tells."""
    result = reconcile(six_faces(seed), "triad-12", prove=False)
    assert result.verdict == "ambiguous"
    assert names(result) == ["earth", "k2"]
    assert result.next_experiment is not None
    assert "record w (latitude, and which way north lay) in each position" in result.next_experiment["why"]


@pytest.mark.slow
@pytest.mark.parametrize(("hidden", "verdict"), [(8.0, "named"), (0.0, "none")])
def test_a_recorded_earth_rate_is_no_rival_of_anisoelasticity(hidden: float, verdict: str) -> None:
    """Eight deg/hr/g² in the same six faces, and nothing."""
    result = reconcile(six_faces(1, hidden, recorded=True), "triad-12", prove=False)
    assert result.verdict == verdict
    assert [effect.id for effect in result.effects] == ["k2"] * (hidden > 0.0)


def test_what_the_earth_cannot_do_is_called_anisoelasticity_whatever_was_recorded() -> None:
    """Sixty deg/hr/g² is four times what the whole earth rate comes to."""
    result = reconcile(six_faces(1, 60.0), "triad-12", prove=False)
    assert result.effects[0].id == "k2"
    assert result.effects[0].probability > 0.95


def test_a_place_is_where_the_unit_lay_whatever_its_pose_is_called() -> None:
    """A log numbers its stretches: no pose of it is met again, and accelerations tell that a face was, to a degree."""
    (collects,) = six_faces(1).sensors.values()
    conditions, rng = collects.conditions, np.random.default_rng(1)
    numbered = np.array([f"pose-{collect}" for collect in conditions.collect])
    f = conditions.f_g + 0.01 * rng.normal(size=conditions.f_g.shape)
    log = replace(collects, conditions=replace(conditions, position=numbered, f_g=f))
    result = reconcile(replace(six_faces(1), sensors={1: log}), "triad-12", prove=False)
    assert names(result) == ["earth", "k2"]
    assert {of["name"] for of in result.effects[0].parameters} >= {f"dW_level_pose-{k}" for k in range(1, 7)}
