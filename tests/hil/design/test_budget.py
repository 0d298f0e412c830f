"""The error budget: both columns agree for every source, and the sensitivities are those that the algebra gives.

The closed forms are the physics notes' (§B.3), for the report's three collects: what a solver that does not know of an
error makes of it.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from hil.campaign import Conditions, Sensor
from hil.campaign.data import EARTH_RATE_DEG_PER_HR
from hil.config.site import UncertaintySection
from hil.design.budget.budget import Budget, response
from hil.design.budget.sources import (
    Accelerometer,
    Drift,
    EarthRate,
    Gravity,
    Heading,
    Index,
    Latitude,
    Noise,
    Scene,
    Soak,
    Source,
    Tilt,
    sources,
)
from hil.model.earth import Site
from hil.model.effects.base import Base
from hil.model.equation import Orientation, rotor_matrix
from hil.model.forms import matrix_6_form

SENSOR = Sensor(2, ("A", "B", "S"), {"RA": "A", "RB": "B"})
NAMES = ["BA", "BB", "GSA", "GSB", "MUA", "MUB"]
THETA_DEG = {"1": -90.0, "2": 90.0, "3": 0.0, "4": 180.0}
BA, BB, GSA, GSB, MUA, MUB = TRUTH = np.array([22.08, -37.83, 46.8, -19.8, -37.23, -7.53])
LEVEL = np.array([1.0, 0.0, 0.0])
W = np.array([8.54, 10.72, 6.19])


def scene(
    order: str = "123",
    gravity: np.ndarray = LEVEL,
    earth: np.ndarray = W,
    minutes_apart: float = 2.0,
    truth: np.ndarray = TRUTH,
) -> Scene:
    """One self-calibration at the report's angles."""
    turned = [Orientation.from_rotation_about_2(label, THETA_DEG[label]) for label in order]
    n = len(order)
    f_g = np.array([each.components(gravity) for each in turned])
    w = np.array([each.components(earth) for each in turned])
    conditions = Conditions(
        SENSOR,
        collect=np.arange(1, n + 1),
        run=np.ones(n, dtype=np.int64),
        position=np.array(list(order)),
        start_s=np.arange(n) * 60.0 * minutes_apart,
        duration_s=np.full(n, 60.0),
        f_g=f_g,
        w_deg_per_hr=w,
    )
    k = np.broadcast_to(rotor_matrix(*truth[2:]), (n, 2, 3))
    bias = np.broadcast_to(truth[:2], (n, 2))
    return Scene(conditions, np.array([each.axes for each in turned]), Base(bias, k, bias), np.full((n, 2), 0.93))


def every_source() -> tuple[Source, ...]:
    """All sources, at their defaults."""
    return sources(UncertaintySection(), "test", 0.03, "test", "test")


def errors(source: Source, of: Scene) -> np.ndarray:
    """Return what a solver that does not know of it makes of a unit of each component, (6, k)."""
    columns = source.columns(of)
    return response(of, matrix_6_form(SENSOR)) @ columns.reshape(-1, columns.shape[-1])


ORDERS = ("132", "1234", "12344321")
"""Those that a quick test leaves out."""


@pytest.mark.parametrize("order", ["123", "132231", *(pytest.param(each, marks=pytest.mark.slow) for each in ORDERS)])
@pytest.mark.parametrize("gravity", [LEVEL, np.array([0.9, 0.3, -0.3])], ids=["level", "leaning"])
def test_calculation_and_draws_agree_for_every_source_and_parameter(order: str, gravity: np.ndarray) -> None:
    """Within the draws' own error, every source alone and all of them together."""
    budget = Budget(scene(order, gravity), every_source(), matrix_6_form(SENSOR), draws=20_000)
    assert [each.source.id for each in budget.shares] == [
        "noise", "instability", "tilt", "accelerometer", "heading", "latitude", "earth_rate", "gravity", "index",
        "drift", "soak",
    ]  # fmt: skip
    for share in budget.shares:
        allowed = 4.5 * budget.simulation_error(share.analytic) + 1e-4
        assert np.all(np.abs(share.analytic - share.simulated) <= allowed), share.source.id
    assert budget.agrees


def test_a_size_that_is_not_small_is_said_not_to_agree() -> None:
    """A bench that leans by 20 degrees is no small error: the linear column is wrong there, and it is noticed."""
    leaning = Budget(scene(), [Tilt(20.0, "test")], matrix_6_form(SENSOR), draws=20_000)
    assert not leaning.agrees
    assert set(leaning.too_large) == {"tilt"}


def test_a_difference_that_the_total_does_not_show_is_none() -> None:
    """Of the second order is a source to which a parameter is immune: a thousandth of what noise makes of it."""
    given = [*every_source(), Noise(1.0, "test")]
    budget = Budget(scene(), given, matrix_6_form(SENSOR), draws=20_000)
    share, total = next(each for each in budget.shares if each.source.id == "heading"), budget.total()
    for part, agrees in ((0.001, True), (0.1, False)):
        simulated = share.analytic + part * total
        shares = tuple(replace(each, simulated=simulated) if each is share else each for each in budget.shares)
        budget.shares = shares
        assert budget.agrees == agrees
        budget.shares = tuple(share if each.source is share.source else each for each in shares)


@pytest.mark.parametrize("source", every_source(), ids=lambda each: each.id)
def test_the_exact_change_begins_as_the_calculated_one_does(source: Source) -> None:
    """For errors a hundred-thousandth of a unit large, component by component, with their signs."""
    of = scene("1324", np.array([0.9, 0.3, -0.3]))
    columns = source.columns(of)
    step = 1e-5 * np.eye(columns.shape[-1])
    np.testing.assert_allclose(np.moveaxis(source.changes(of, step), 0, -1) / 1e-5, columns, atol=1e-3, rtol=1e-4)


def test_a_bias_instability_leaves_two_thirds_of_itself_in_every_average() -> None:
    """0.664 B, the floor of the Allan deviation: of 0.5 deg/hr 0.332, and 0.235 in a bias."""
    shares = Budget(scene(), every_source(), matrix_6_form(SENSOR), draws=100).shares
    found = next(each for each in shares if each.source.id == "instability")
    np.testing.assert_allclose(found.analytic[:2], 0.332 / np.sqrt(2.0))


def test_noise_gives_the_covariance_of_the_solver() -> None:
    """sqrt(1/2), sqrt(1/2) and sqrt(3/2) of a collect's noise in bias, GS and MU (§B.2)."""
    share = Budget(scene(), [Noise(1.0, "test")], matrix_6_form(SENSOR), draws=100).shares[0]
    np.testing.assert_allclose(share.analytic, 0.93 * np.sqrt([0.5, 0.5, 0.5, 0.5, 1.5, 1.5]))


@pytest.mark.parametrize("g3", [0.0, -0.016, 0.3])
def test_an_earth_rate_error_spares_ba_gsb_and_mua(g3: float) -> None:
    """It gives dGSA = (dW1 G1 + dW3 G3)/g², dMUB = (dW3 G1 - dW1 G3)/g², dBB = dW2, where the rates hold dW more."""
    gravity = np.array([np.sqrt(1 - g3**2), 0.0, g3])
    g1 = gravity[0]
    found = errors(EarthRate(1.0, "test"), scene(gravity=gravity))
    expected = np.zeros((6, 3))
    expected[2] = [g1, 0.0, g3]
    expected[5] = [-g3, 0.0, g1]
    expected[1] = [0.0, 1.0, 0.0]
    np.testing.assert_allclose(found, expected, atol=1e-12)


def test_heading_and_latitude_move_the_earth_rate_by_the_published_amounts() -> None:
    """At 34.6 N a degree of heading is at most 0.216 deg/hr, a tenth of a degree of latitude 0.015 to 0.022."""
    worst = 0.0
    for heading in np.arange(0.0, 360.0, 15.0):
        site = Site(34.6, heading)
        of = scene(earth=site.earth_rate_deg_per_hr())
        by_heading = errors(Heading(1.0, "test"), of)[:, 0]
        turned = Site(34.6, heading + 1e-3).earth_rate_deg_per_hr() - site.earth_rate_deg_per_hr()
        np.testing.assert_allclose(np.abs(by_heading[[2, 5, 1]]), np.abs(turned[[0, 2, 1]]) / 1e-3, atol=1e-4)
        worst = max(worst, float(np.abs(by_heading).max()))
        moved = Site(34.6 + 1e-3, heading).earth_rate_deg_per_hr() - site.earth_rate_deg_per_hr()
        by_latitude = errors(Latitude(1.0, "test"), of)[:, 0]
        np.testing.assert_allclose(np.abs(by_latitude[[2, 5, 1]]), np.abs(moved[[0, 2, 1]]) / 1e-3, atol=1e-4)
    assert worst == pytest.approx(0.216, abs=5e-4)
    vertical, level = (
        EARTH_RATE_DEG_PER_HR * np.deg2rad(0.1) * np.array([np.cos(np.deg2rad(34.6)), np.sin(np.deg2rad(34.6))])
    )
    assert (round(level, 3), round(vertical, 3)) == (0.015, 0.022)


def test_a_tilt_that_is_not_known_mixes_gs_into_mu_and_mu_into_gs() -> None:
    """It gives dMUA = GSB G3, dMUB = GSA G3, dGSA = -MUB G3, dGSB = -MUA G3; dBA = GSB G2, dBB = GSA G2 (without W)."""
    tilt = Tilt(1.0, "test")
    found = errors(tilt, scene(earth=np.zeros(3))) * 180.0 / np.pi
    about_2, about_3 = found.T
    g3 = np.cross([0.0, 1.0, 0.0], LEVEL)[2]
    g2 = np.cross([0.0, 0.0, 1.0], LEVEL)[1]
    np.testing.assert_allclose(about_2, g3 * np.array([0.0, 0.0, -MUB, -MUA, GSB, GSA]), atol=1e-9)
    np.testing.assert_allclose(about_3, g2 * np.array([GSB, GSA, 0.0, 0.0, 0.0, 0.0]), atol=1e-9)
    large = errors(tilt, scene(earth=np.zeros(3), truth=np.array([0, 0, 500.0, 0, 0, 0])))[5, 0] * 180.0 / np.pi
    assert abs(large) * 0.016 == pytest.approx(8.0)  # |GS| = 500 deg/hr/g and 16 mrad: a real rival of MU
    accelerometer = errors(Accelerometer(1.0, "test"), scene(earth=np.zeros(3)))
    np.testing.assert_allclose(accelerometer, found, atol=1e-9)


def test_index_errors_enter_as_the_algebra_says() -> None:
    """They give dMUB = (GSA+W1) d3 - (MUB+W3)(d1-d2)/2 and five more; a milliradian makes under 0.1 deg/hr, not 37."""
    found = errors(Index(1.0, "test"), scene()) * 180.0 / np.pi
    w1, _, w3 = W
    half = 0.5
    expected = np.array(
        [
            [half * (MUB + w3), -half * (MUB + w3), 0.0],
            [-half * MUA, half * MUA, 0.0],
            [-half * (MUB + w3), -half * (MUB + w3), 0.0],
            [-half * MUA, -half * MUA, 0.0],
            [half * -MUA, half * MUA, GSB],
            [half * -(MUB + w3), half * (MUB + w3), GSA + w1],
        ]
    )
    np.testing.assert_allclose(found, expected, atol=1e-9)
    assert np.abs(found).max() * 1e-3 < 0.1


def test_a_collect_that_was_not_moved_to_shares_the_index_error() -> None:
    """In 1-3-2-2-3-1 nothing moves between the two at position 2: six collects, five moves."""
    assert Index(1.0, "test").columns(scene("132231")).shape[-1] == 5
    assert Index(1.0, "test").columns(scene("123")).shape[-1] == 3


@pytest.mark.parametrize(
    ("order", "expected"),
    [
        ("123", [-0.5, -0.5, 0.5, -0.5, -1.5, 1.5]),
        ("132", [0.0, 0.0, 1.0, -1.0, 0.0, 0.0]),
        ("132231", [0.0] * 6),
        ("13231", [0.0] * 6),
        ("12344321", [0.0] * 6),
    ],
)
def test_a_drift_per_collect_is_what_the_order_makes_of_it(order: str, expected: list[float]) -> None:
    """In 1-2-3 BA -d/2, GSA +d/2, MUB +3d/2 (BB, GSB, MUA the other way where signs differ); palindromes are immune.

    The bias is about its value in the middle of the self-calibration.
    """
    of = scene(order, minutes_apart=1.0)
    np.testing.assert_allclose(errors(Drift(1.0, "test"), of).sum(axis=1), expected, atol=1e-12)


def test_a_soak_that_is_not_complete_explains_one_deg_per_hr_per_g_and_no_more() -> None:
    """1.5 |dB/dT| |dT/dt| dt, with the steepest 1.8 deg/hr/degC, 0.19 degC/min, and two minutes: 1.03."""
    found = errors(Soak(1.0, "test", bias_slope=1.8), scene(minutes_apart=2.0))[:, 0] * 0.19
    assert abs(found[5]) == pytest.approx(1.5 * 1.8 * 0.19 * 2.0)
    assert abs(found[5]) == pytest.approx(1.0, abs=0.03)


def test_a_gravity_that_is_larger_scales_gs_and_mu() -> None:
    """By their own size; the biases do not feel it on a level bench."""
    np.testing.assert_allclose(errors(Gravity(1.0, "test"), scene())[:, 0], [0, 0, *TRUTH[2:]], atol=1e-9)


def test_repeats_average_what_varies_from_run_to_run_only() -> None:
    """Of nine runs, noise is a third; the heading is what it was."""
    given = [Noise(1.0, "test"), Heading(1.0, "test")]
    budget = Budget(scene(), given, matrix_6_form(SENSOR), draws=100)
    noise, heading = (each.analytic for each in budget.shares)
    np.testing.assert_allclose(budget.total(9), np.sqrt(noise**2 / 9 + heading**2))


def test_collects_that_cannot_know_a_parameter_give_no_number_for_it() -> None:
    """Two positions: MU and GS are not separately known, so their budget is not a number, and nothing is invented."""
    budget = Budget(scene("12"), every_source(), matrix_6_form(SENSOR), draws=200)
    assert np.all(np.isnan(budget.total()[4:]))
    assert np.all(np.isfinite(budget.total()[2:4]))
    assert budget.agrees  # in what is known; what is not known contradicts nothing


def test_the_same_seed_gives_the_same_numbers() -> None:
    """And another one others."""
    one, same, other = (
        Budget(scene(), every_source(), matrix_6_form(SENSOR), draws=500, seed=seed).everything for seed in (1, 1, 2)
    )
    np.testing.assert_array_equal(one, same)
    assert not np.array_equal(one, other)
