"""How the unit lies by its own accelerometers, and what is said where it does not lie as it should."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import pytest

from procedures.pose import PoseTable, PoseTolerance
from procedures.quality import FloatArray, not_measured, same_samples
from procedures.verdict import Verdict

_POSES = {
    "1": np.array([[-1.0, 0.0, 0.0]]),
    "2": np.array([[1.0, 0.0, 0.0]]),
    "3": np.array([[0.0, 0.0, 1.0]]),
    "4": np.array([[0.0, 0.0, -1.0]]),
    "5": np.array([[0.0, 1.0, 0.0]]),
}
_TABLE = PoseTable({2: ("A", "B", "S")}, _POSES)
_LABELS = list(_POSES)


def said(measured: FloatArray, labels: Sequence[str] = _LABELS) -> str:
    """Return what is said of collects at these positions."""
    expected = np.array([_POSES[label] for label in labels])
    return "; ".join(each.words for each in _TABLE.contradictions(labels, measured, expected))


def true() -> FloatArray:
    """Return what sound accelerometers show at the five positions, (5, 1, 3)."""
    rng = np.random.default_rng(4)
    return np.array(list(_POSES.values())) + rng.normal(0.0, 0.005, (5, 1, 3))


def test_nothing_is_said_of_accelerometers_within_their_errors() -> None:
    """A bias of 20 mg, 2 % of scale and a degree of fixture are no finding; neither are unmeasured axes."""
    turn = np.deg2rad(1.0)
    shown = 1.02 * true() + 0.02 * np.array([1.0, -1.0, 1.0])
    shown = shown @ np.array([[1, -turn, 0], [turn, 1, 0], [0, 0, 1]])
    assert said(shown) == ""
    shown[..., 1:] = np.nan
    assert said(shown) == ""
    assert _TABLE.contradiction("7", {2: {"A": 9.0}}) == ""  # of a position without a pose nothing is known
    assert _TABLE.contradiction("3", {}) == ""


@pytest.mark.parametrize("asked", _LABELS)
@pytest.mark.parametrize("seen", _LABELS)
def test_every_pair_of_positions_is_told_apart(asked: str, seen: str) -> None:
    """One collect is enough to say in which position the unit lies instead."""
    f_g = dict(zip("ABS", _POSES[seen][0], strict=True))
    told = _TABLE.contradiction(asked, {2: f_g})
    expected = "" if asked == seen else f"position {asked} was asked for, but the unit lies as in position {seen}"
    assert told == expected


@pytest.mark.parametrize(
    ("change", "words"),
    [
        (lambda m: m * 9.80665, "in m/s², not in g"),
        (lambda m: m * 1.1, "1.10 times what gravity is"),
        (lambda m: m * 0.0, "exactly 0 g: they are not being measured"),
        (lambda m: m * np.array([1.0, 1.0, 0.0]), "its accelerometer S measures nothing"),
        (lambda m: m * np.array([-1.0, 1.0, 1.0]), "the sign of its accelerometer A is turned"),
        (lambda m: m[..., [1, 0, 2]], "its accelerometers A and B are exchanged"),
        (lambda m: m[..., [2, 0, 1]], "shows"),
    ],
)
def test_what_is_wrong_with_the_accelerometers_is_named(change, words: str) -> None:
    """What is alike in all collects is the accelerometers', not the pose's."""
    assert words in said(change(true()))


def test_an_exchange_of_positions_and_a_turned_sign_are_both_said_where_nobody_can_tell() -> None:
    """Positions 1 and 2 differ in the sign of A alone."""
    labels = ["1", "2", "3"]
    measured = np.array([_POSES[label] for label in ("2", "1", "3")])
    told = said(measured, labels)
    assert "position 1 was asked for, but the unit lies as in position 2" in told
    assert "or else sensor 2: the sign of its accelerometer A is turned" in told


def test_a_tilt_that_is_no_position_says_what_is_shown() -> None:
    """Seventeen degrees about S."""
    measured = true()
    measured[0, 0] = [-0.956, 0.292, 0.0]
    assert "sensor 2 shows +0.292 g along B where +0.000 g belong" in said(measured)


def test_the_tolerance_refuses_what_would_tell_no_pose_from_another() -> None:
    """Half a g of bias, or 45 degrees, is no tolerance."""
    with pytest.raises(ValueError, match=r"pose: bias_g must lie between 0 and 0\.3"):
        PoseTolerance(bias_g=0.5)
    with pytest.raises(ValueError, match="fixture_deg"):
        PoseTolerance(fixture_deg=45.0)
    assert PoseTolerance(0.0, 0.0, 0.0).allowed_g(np.array([1.0])) == pytest.approx(0.0)


# The samples of one collect


def noise(n: int = 1200) -> FloatArray:
    """Return the rate of a sound channel, (n,), deg/hr, in steps of 0.001."""
    return np.round(40.0 + np.random.default_rng(7).normal(0.0, 30.0, n), 3)


def test_a_sound_channel_has_nothing_to_be_said_of() -> None:
    """White, coarse, slow and shaken noise are all measured."""
    rate, t = noise(), np.arange(1200) / 20.0
    walk = np.cumsum(np.random.default_rng(2).normal(0.0, 1.0, 1200))
    for values in (rate, np.round(rate / 15.0) * 15.0, rate + 100.0 * np.sin(7.0 * t), rate + walk, -rate):
        assert not_measured(values, frozen=100.0) is None


@pytest.mark.parametrize(
    ("values", "verdict", "words"),
    [
        (np.full(1200, 3.0), Verdict.FAIL, "did not change for 1200 samples"),
        (np.where(noise() > 40.0, 64.0, 0.0), Verdict.INCONCLUSIVE, "shows only 0 and 64"),
        (np.minimum(noise(), 50.0), Verdict.FAIL, "is clipped at 50"),
        (np.where(np.arange(1200) == 600, 2e6, noise()), Verdict.FAIL, "has 1 of 1200 samples up to 2e+06"),
        (np.repeat(noise(600), 2), Verdict.MARGINAL, "repeats 50% of its samples"),
    ],
)
def test_what_no_measured_rate_does_is_named(values: FloatArray, verdict: Verdict, words: str) -> None:
    """Dead, toggling, clipped, struck, held."""
    found = not_measured(values, frozen=100.0)
    assert found is not None
    assert found.verdict is verdict
    assert words in found.reason


def test_a_copy_is_noticed_also_with_the_other_sign() -> None:
    """Two channels never agree to the last bit by chance; two dead ones are no copies of each other."""
    rate = noise()
    channels = {"RA": rate, "RB": noise(1200) + 1.0, "RC": -rate}
    assert list(same_samples(channels)) == [("RA", "RC")]
    assert not list(same_samples({"RA": np.zeros(99), "RB": np.zeros(99)}))
