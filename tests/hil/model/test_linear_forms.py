"""The named models' columns agree with the one equation."""

from __future__ import annotations

import numpy as np
import pytest

from hil.campaign import Conditions, Sensor
from hil.errors import InputError
from hil.model.equation import pickoff_rates, rotor_matrix
from hil.model.forms import (
    bias_columns,
    default_form,
    excites_every_axis,
    gs_columns,
    mu_columns,
    named_form,
    sensitivity_columns,
)

ROTOR = Sensor(2, ("A", "B", "S"), {"RA": "A", "RB": "B"})
TRIAD = Sensor(1, ("X", "Y", "Z"), {"GX": "X", "GY": "Y", "GZ": "Z"})


def conditions(sensor: Sensor, f_g: np.ndarray, **columns: np.ndarray) -> Conditions:
    """Collects of one sensor at given f, (n, 3)."""
    n = len(f_g)
    counts = np.arange(1, n + 1)
    positions = np.array([f"pose-{i:02d}" for i in counts])
    return Conditions(
        sensor, counts, np.ones(n, int), positions, counts * 60.0, np.full(n, 60.0), f_g, f_g * 0, columns
    )


def random_f(n: int, seed: int = 0) -> np.ndarray:
    """Directions of |f| = 1 at random."""
    f_g = np.random.default_rng(seed).normal(size=(n, 3))
    return f_g / np.linalg.norm(f_g, axis=-1, keepdims=True)


def test_matrix_6_columns_are_the_one_equation() -> None:
    """Columns times parameters are B + K f for any f and any values."""
    rows = conditions(ROTOR, random_f(20))
    values = np.random.default_rng(1).normal(size=6)
    form = named_form("matrix-6", rows)
    assert form.names == ("BA", "BB", "GSA", "GSB", "MUA", "MUB")
    expected = pickoff_rates(values[:2], rotor_matrix(*values[2:]), rows.f_g, np.zeros(2))
    np.testing.assert_allclose(form.columns(rows) @ values, expected, rtol=1e-12, atol=1e-14)


def test_collins_4_is_matrix_6_without_mu() -> None:
    """The first four columns are the same."""
    rows = conditions(ROTOR, random_f(5))
    collins, matrix = named_form("collins-4", rows), named_form("matrix-6", rows)
    assert collins.names == matrix.names[:4]
    np.testing.assert_array_equal(collins.columns(rows), matrix.columns(rows)[..., :4])


def test_triad_12_is_row_by_channel_and_column_by_axis() -> None:
    """GXY is the rate of channel GX per g along Y: a transposed matrix would show in a non-symmetric truth."""
    f_g = random_f(8)
    rows = conditions(TRIAD, f_g)
    form = named_form("triad-12", rows)
    g = np.arange(1.0, 10.0).reshape(3, 3)
    values = np.concatenate([[0.1, 0.2, 0.3], g.ravel()])
    assert form.names[:3] == ("BX", "BY", "BZ")
    assert form.names[3:] == ("GXX", "GXY", "GXZ", "GYX", "GYY", "GYZ", "GZX", "GZY", "GZZ")
    np.testing.assert_allclose(form.columns(rows) @ values, [0.1, 0.2, 0.3] + f_g @ g.T)
    only_gxy = np.where(np.array(form.names) == "GXY", 1.0, 0.0)
    np.testing.assert_allclose(form.columns(rows) @ only_gxy, np.outer(f_g[:, 1], [1, 0, 0]))


def test_thermal_columns_are_quadratics_about_the_stated_reference() -> None:
    """The mean to a whole degree, and columns times the distance from it and its square."""
    temperature = np.array([10.0, 20.0, 30.0]) + np.array([0.5, 0.4, 0.3])
    rows = conditions(ROTOR, random_f(3), temperature_degC=temperature)
    form = named_form("matrix-6-thermal", rows)
    assert form.reference_degC == 20.0
    assert "20 degC" in form.reason
    assert form.names[:4] == ("BA", "BA_per_degC", "BA_per_degC2", "BB")
    assert form.units[:3] == ("deg/hr", "deg/hr/degC", "deg/hr/degC2")
    plain = named_form("matrix-6", rows).columns(rows)
    columns = form.columns(rows)
    np.testing.assert_allclose(columns[..., 0::3], plain)
    delta = np.array([-9.5, 0.4, 10.3])[:, None, None]
    np.testing.assert_allclose(columns[..., 1::3], plain * delta)
    np.testing.assert_allclose(columns[..., 2::3], plain * delta**2)


def test_terms_gives_back_bias_and_k() -> None:
    """The base that effects act upon: B and K at each row, temperature dependence included."""
    rows = conditions(ROTOR, random_f(4), temperature_degC=np.array([0.0, 10.0, 20.0, 30.0]))
    form = named_form("matrix-6-thermal", rows)
    values = np.random.default_rng(2).normal(size=18)
    bias, k = form.terms(rows, values)
    expected = form.columns(rows) @ values
    np.testing.assert_allclose(pickoff_rates(bias, k, rows.f_g, np.zeros(2)), expected, rtol=1e-12)
    at_reference = values[0::3]
    delta = 10.0 - form.reference_degC if form.reference_degC is not None else np.nan
    shifted = at_reference + delta * values[1::3] + delta**2 * values[2::3]
    np.testing.assert_allclose(bias[1], shifted[:2])
    np.testing.assert_allclose(k[1], rotor_matrix(*shifted[2:]))


def test_the_columns_have_one_place_each() -> None:
    """Bias, GS, MU and G columns have shapes (n, c, p) of their own, for the catalogue to use."""
    rows = conditions(ROTOR, random_f(3))
    assert bias_columns(rows).shape == gs_columns(rows).shape == mu_columns(rows).shape == (3, 2, 2)
    assert sensitivity_columns(rows).shape == (3, 2, 6)


def test_a_rotor_sensor_gets_matrix_6_whatever_its_axes_are_called() -> None:
    """Names of channels and axes carry no meaning; the layout does."""
    odd = Sensor(5, ("u", "v", "n"), {"left": "u", "right": "v"})
    assert default_form(conditions(odd, random_f(3))).name == "matrix-6"
    assert named_form("constant", conditions(odd, random_f(3))).names == ("Bu", "Bv")


def test_a_triad_gets_triad_12_where_its_positions_allow_it() -> None:
    """Four poses that span space are enough; four in one plane, or three, are not, and the reason says so."""
    spread = np.array([[1.0, 0, 0], [-1, 0, 0], [0, 1, 0], [0, 0, 1]])
    assert default_form(conditions(TRIAD, spread)).name == "triad-12"
    flat = np.array([[1.0, 0, 0], [-1, 0, 0], [0, 0, 1], [0, 0, -1]])
    form = default_form(conditions(TRIAD, flat))
    assert form.name == "constant"
    assert "4 positions cannot excite all three axes" in form.reason
    assert default_form(conditions(TRIAD, spread[:3])).name == "constant"


def test_poses_that_hardly_leave_a_plane_do_not_count_as_spanning() -> None:
    """Jitter of 2 mrad out of the plane excites nothing that the poses' own accuracy would not."""
    f_g = np.array([[1.0, 0, 0], [-1, 0.002, 0], [0, -0.002, 1], [0, 0.001, -1]])
    assert not excites_every_axis(f_g)


def test_other_layouts_get_the_bias_with_the_reason() -> None:
    """One channel, or two about one axis: bias only, named by axis or by channel."""
    single = Sensor(1, ("X", "Y", "Z"), {"GZ": "Z"})
    form = default_form(conditions(single, random_f(9)))
    assert (form.name, form.names) == ("constant", ("BZ",))
    assert "neither" in form.reason
    double = Sensor(1, ("X", "Y", "Z"), {"G1": "Z", "G2": "Z"})
    assert default_form(conditions(double, random_f(9))).names == ("B_G1", "B_G2")


@pytest.mark.parametrize(
    ("name", "sensor", "message"),
    [
        ("matrix-7", ROTOR, "not built in; did you mean 'matrix-6'"),
        ("matrix-6", TRIAD, "not a two-channel rotor sensor"),
        ("collins-4", TRIAD, "not a two-channel rotor sensor"),
        ("triad-12", ROTOR, "three axes"),
        ("matrix-6-thermal", ROTOR, "temperature_degC"),
    ],
)
def test_a_model_that_does_not_fit_is_refused(name: str, sensor: Sensor, message: str) -> None:
    """Unknown names, models of the other kind of sensor, and thermal models without a temperature."""
    with pytest.raises(InputError, match=message):
        named_form(name, conditions(sensor, random_f(4)))


def test_an_empty_temperature_is_refused_by_the_thermal_model() -> None:
    """NaN in one row would spoil every coefficient."""
    rows = conditions(ROTOR, random_f(3), temperature_degC=np.array([1.0, np.nan, 2.0]))
    with pytest.raises(InputError, match="every row"):
        named_form("matrix-6-thermal", rows)
