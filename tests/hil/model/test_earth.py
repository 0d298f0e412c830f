"""Gravity and earth rate in the bench frame."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from hil.campaign.data import EARTH_RATE_DEG_PER_HR
from hil.model.earth import Site

LATITUDES = st.floats(-90.0, 90.0)
HEADINGS = st.floats(-360.0, 360.0)
SMALL = st.floats(-40.0, 40.0)


def test_redstone_at_heading_30_has_the_earth_rate_of_the_physics_notes() -> None:
    """Level at 34.6 degrees north, axis 2 heading 30 degrees: W = (8.54, 10.72, 6.19) deg/hr and G = (1, 0, 0)."""
    site = Site(latitude_deg=34.6, heading_deg=30.0)
    np.testing.assert_allclose(site.earth_rate_deg_per_hr(), [8.54, 10.72, 6.19], atol=0.005)
    np.testing.assert_allclose(site.gravity_g(), [1.0, 0.0, 0.0], atol=1e-15)


@pytest.mark.parametrize(
    ("heading_deg", "expected"),
    [(0.0, (0, 1, 0)), (90.0, (0, 0, 1)), (180.0, (0, -1, 0)), (270.0, (0, 0, -1))],
)
def test_at_the_equator_the_earth_turns_about_north(heading_deg: float, expected: tuple[int, ...]) -> None:
    """Axis 2 turned clockwise from north brings north to axis 3 = axis 1 × axis 2, which then points north."""
    rate = Site(0.0, heading_deg).earth_rate_deg_per_hr()
    np.testing.assert_allclose(rate / EARTH_RATE_DEG_PER_HR, expected, atol=1e-12)


def test_in_the_south_the_vertical_rate_is_negative() -> None:
    """Below the equator the Earth turns clockwise seen from above."""
    assert Site(-34.6, 30.0).earth_rate_deg_per_hr()[0] == pytest.approx(-8.541, abs=1e-3)


@given(LATITUDES, HEADINGS, SMALL, SMALL)
def test_the_frame_is_right_handed_and_keeps_lengths(lat: float, heading: float, rise_2: float, rise_3: float) -> None:
    """Whatever the attitude: axis 3 = axis 1 × axis 2, |G| = 1 g, |W| the Earth's, and G·W = Ω sin L."""
    site = Site(lat, heading, rise_2, rise_3)
    axis_1, axis_2, axis_3 = site.frame()
    np.testing.assert_allclose(np.cross(axis_1, axis_2), axis_3, atol=1e-12)
    gravity, rate = site.gravity_g(), site.earth_rate_deg_per_hr()
    assert np.linalg.norm(gravity) == pytest.approx(1.0)
    assert np.linalg.norm(rate) == pytest.approx(EARTH_RATE_DEG_PER_HR)
    assert gravity @ rate == pytest.approx(EARTH_RATE_DEG_PER_HR * np.sin(np.deg2rad(lat)), abs=1e-9)


@given(LATITUDES, HEADINGS, SMALL, SMALL)
def test_elevations_are_what_a_level_shows(lat: float, heading: float, rise_2: float, rise_3: float) -> None:
    """G2 and G3 are the sines of the elevations, and axis 2 keeps its heading."""
    site = Site(lat, heading, rise_2, rise_3)
    np.testing.assert_allclose(site.gravity_g()[1:], np.sin(np.deg2rad([rise_2, rise_3])), atol=1e-12)
    east, north, _ = site.frame()[1]
    turned = np.arctan2(east, north) - np.deg2rad(heading)
    assert np.cos(turned) == pytest.approx(1.0)


def test_the_attitude_of_the_notes_can_be_expressed() -> None:
    """G = (0.9999, 0.001, -0.016) is an attitude; tilting turns the earth rate with it."""
    site = Site.from_gravity(34.6, 30.0, 0.001, -0.016)
    np.testing.assert_allclose(site.gravity_g(), [0.9999, 0.001, -0.016], atol=5e-5)
    level = Site(34.6, 30.0).earth_rate_deg_per_hr()
    turned = site.earth_rate_deg_per_hr()
    # A small rotation: dW = W1 times the tilts onto axes 2 and 3, and back.
    assert turned[2] - level[2] == pytest.approx(-0.016 * level[0], abs=0.01)
    assert turned[0] - level[0] == pytest.approx(0.016 * level[2] - 0.001 * level[1], abs=0.01)


@pytest.mark.parametrize(
    "wrong", [(91.0, 0.0, 0.0, 0.0), (float("nan"), 0.0, 0.0, 0.0), (0.0, float("inf"), 0, 0), (0.0, 0.0, 60.0, 30.0)]
)
def test_an_impossible_site_is_refused(wrong: tuple[float, float, float, float]) -> None:
    """Beyond the poles, not a number, or elevations that leave axis 1 level."""
    with pytest.raises(ValueError, match=r"latitude|elevations"):
        Site(*wrong)
