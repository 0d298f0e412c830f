"""R = B + K·f + w is equations (1)-(6) of RD-GC-86-1, term by term."""

from __future__ import annotations

import itertools
import re

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from hil.model.equation import RD_GC_86_1_SENSOR_2, Orientation, pickoff_rates, rotor_matrix

# Transcribed from the report by hand, independently of the code: (collect, channel) to the right-hand side.
PRINTED = {
    ("1", 0): "BA - GSA*G1 + GSB*G2 + MUB*G3 - W1",  # (1)
    ("1", 1): "BB + GSA*G2 + GSB*G1 - MUA*G3 + W2",  # (2)
    ("2", 0): "BA + GSA*G1 + GSB*G2 - MUB*G3 + W1",  # (3)
    ("2", 1): "BB + GSA*G2 - GSB*G1 + MUA*G3 + W2",  # (4)
    ("3", 0): "BA + GSA*G3 + GSB*G2 + MUB*G1 + W3",  # (5)
    ("3", 1): "BB + GSA*G2 - GSB*G3 - MUA*G1 + W2",  # (6)
}
PARAMETERS = ("BA", "BB", "GSA", "GSB", "MUA", "MUB")
G_NAMES, W_NAMES = ("G1", "G2", "G3"), ("W1", "W2", "W3")
FINITE = st.floats(-1e3, 1e3, allow_nan=False).map(lambda value: round(value, 6))


def terms(text: str) -> dict[str, float]:
    """Read "BA - GSA*G1" as {"BA": 1, "GSA*G1": -1}."""
    return {name: -1.0 if sign == "-" else 1.0 for sign, name in re.findall(r"([+-]?)\s*([A-Z][A-Z0-9*]*)", text)}


def simulated(values: dict[str, float], orientation: Orientation) -> np.ndarray:
    """Both rates by the code under test, all symbols given by name."""
    gravity = np.array([values[name] for name in G_NAMES])
    earth = np.array([values[name] for name in W_NAMES])
    k = rotor_matrix(values["GSA"], values["GSB"], values["MUA"], values["MUB"])
    bias = [values["BA"], values["BB"]]
    return pickoff_rates(bias, k, orientation.components(gravity), orientation.components(earth)[:2])


def extracted_terms(collect: str, channel: int) -> dict[str, float]:
    """Find every term of one rate by putting 1 in for one symbol (or one pair) at a time.

    The rate is linear in the parameters and in G and W, so this is the whole of it, exactly.
    """
    zero = dict.fromkeys([*PARAMETERS, *G_NAMES, *W_NAMES], 0.0)
    found = {}
    singles = [{name: 1.0} for name in [*PARAMETERS, *G_NAMES, *W_NAMES]]
    pairs = [{parameter: 1.0, g: 1.0} for parameter, g in itertools.product(PARAMETERS[2:], G_NAMES)]
    for probe in singles + pairs:
        value = float(simulated(zero | probe, RD_GC_86_1_SENSOR_2[collect])[channel])
        if value != 0.0:
            found["*".join(probe)] = value
    return found


@pytest.mark.parametrize(("collect", "channel"), PRINTED)
def test_every_term_of_the_six_equations_is_there_with_its_sign_and_nothing_else(collect: str, channel: int) -> None:
    """The terms of the one equation at the report's orientations are the printed ones, no more and no fewer."""
    assert extracted_terms(collect, channel) == terms(PRINTED[collect, channel])


@pytest.mark.parametrize(
    ("collect", "channel", "term"), [(*key, term) for key, text in PRINTED.items() for term in terms(text)]
)
def test_a_flipped_sign_in_any_term_is_caught(collect: str, channel: int, term: str) -> None:
    """Each of the thirty terms, flipped, no longer agrees: the comparison can fail."""
    flipped = terms(PRINTED[collect, channel])
    flipped[term] = -flipped[term]
    assert extracted_terms(collect, channel) != flipped


@given(st.fixed_dictionaries(dict.fromkeys([*PARAMETERS, *G_NAMES, *W_NAMES], FINITE)))
def test_the_six_equations_hold_for_arbitrary_values(values: dict[str, float]) -> None:
    """Whatever G, W and the parameters are, the simulated rates are the printed expressions."""
    for (collect, channel), text in PRINTED.items():
        expected = sum(
            sign * np.prod([values[factor] for factor in term.split("*")]) for term, sign in terms(text).items()
        )
        actual = simulated(values, RD_GC_86_1_SENSOR_2[collect])[channel]
        assert actual == pytest.approx(expected, rel=1e-12, abs=1e-9)


@pytest.mark.parametrize(("label", "theta_deg"), [("1", -90.0), ("2", 90.0), ("3", 0.0)])
def test_the_three_collects_are_rotations_about_axis_2(label: str, theta_deg: float) -> None:
    """-90, +90 and 0 degrees about axis 2 give the orientations of Figure 1."""
    turned = Orientation.from_rotation_about_2(label, theta_deg)
    np.testing.assert_allclose(turned.axes, RD_GC_86_1_SENSOR_2[label].axes, atol=1e-15)


def test_the_fourth_collect_has_the_spin_axis_down() -> None:
    """At 180 degrees f = (-G3, G2, -G1)."""
    turned = Orientation.from_rotation_about_2("4", 180.0)
    np.testing.assert_allclose(turned.components([0.9, 0.1, -0.2]), [0.2, 0.1, -0.9], atol=1e-15)


def test_the_reports_triad_is_left_handed_in_every_collect() -> None:
    """The sensor's (A, B, S) mirrors a right-handed bench frame; building it right-handed would turn one sign."""
    assert {round(np.linalg.det(orientation.axes)) for orientation in RD_GC_86_1_SENSOR_2.values()} == {-1}


@pytest.mark.parametrize("words", [("+1", "+1", "+3"), ("1", "+2", "+3"), ("+4", "+2", "+3"), ("+1", "+2")])
def test_an_orientation_that_is_none_is_refused(words: tuple[str, ...]) -> None:
    """A repeated axis, a missing sign, a fourth axis and two axes only are refused."""
    with pytest.raises(ValueError, match="orientation"):
        Orientation.from_signed_axes("x", *words)


def test_leading_dimensions_broadcast() -> None:
    """A batch of parameters over collects gives the rates that each gives alone."""
    rng = np.random.default_rng(1)
    values = rng.normal(size=(5, 1, 6))
    f_g, w = rng.normal(size=(4, 3)), rng.normal(size=(4, 2))
    k = rotor_matrix(*np.moveaxis(values[..., 2:], -1, 0))
    batch = pickoff_rates(values[..., :2], k, f_g, w)
    assert batch.shape == (5, 4, 2)
    alone = pickoff_rates(values[3, 0, :2], rotor_matrix(*values[3, 0, 2:]), f_g[2], w[2])
    np.testing.assert_allclose(batch[3, 2], alone, rtol=1e-14)
