"""Every effect moves the three collects as the reference table says (effects.csv, columns dRA1 … dRB3)."""

from __future__ import annotations

import csv
from collections.abc import Callable, Mapping
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from hil.model.effects.catalogue import effect_by_id
from hil.model.effects.history import joined
from tests.hil.model.effect_conditions import TERMS, W, moved, one_run, rotor_base, triad_poses

W1, W2, W3 = W
BA, BB, GSA, GSB, MUA, MUB = (TERMS[name] for name in ("BA", "BB", "GSA", "GSB", "MUA", "MUB"))
RA1, RA2, RA3 = BA - GSA - W1, BA + GSA + W1, BA + MUB + W3
RB1, RB2, RB3 = BB + GSB + W2, BB - GSB + W2, BB - MUA + W2
E = 1e-3

Row = tuple[tuple[str, ...], dict[str, float], Callable[[], tuple[float, ...]]]

# id: the reference's six cells as printed; parameter values; the same six cells as numbers.
SIGNATURES: Mapping[str, Row] = {
    "MU_real": (("0", "0", "MUB", "0", "0", "-MUA"), {"MUA": 3.0, "MUB": 5.0}, lambda: (0, 0, 5, 0, 0, -3)),
    "phase": (
        ("-psi RB1", "-psi RB2", "-psi RB3", "psi RA1", "psi RA2", "psi RA3"),
        {"psi": 1.0},
        lambda: (-E * RB1, -E * RB2, -E * RB3, E * RA1, E * RA2, E * RA3),
    ),
    "misalign": (
        (
            "mAB W2+mAS W3",
            "mAB W2-mAS W3",
            "mAB W2+mAS W1",
            "-mBA W1+mBS W3",
            "mBA W1-mBS W3",
            "mBA W3+mBS W1",
        ),
        {"mAB": 2.0, "mAS": 3.0, "mBA": 4.0, "mBS": 5.0},
        lambda: tuple(
            E * value
            for value in (
                2 * W2 + 3 * W3,
                2 * W2 - 3 * W3,
                2 * W2 + 3 * W1,
                -4 * W1 + 5 * W3,
                4 * W1 - 5 * W3,
                4 * W3 + 5 * W1,
            )
        ),
    ),
    "k2": (
        ("kAA", "kAA", "kSS", "kAA'", "kAA'", "kSS'"),
        {"kAA_A": 1.0, "kSS_A": 2.0, "kAA_B": 3.0, "kSS_B": 4.0},
        lambda: (1, 1, 2, 3, 3, 4),
    ),
    "noniso": (("-d", "+d", "0", "+e'", "-e'", "0"), {"d": 2.0, "e": 3.0}, lambda: (-2, 2, 0, 3, -3, 0)),
    "tilt": (
        ("GSB G2+MUB G3", "GSB G2-MUB G3", "GSA G3+GSB G2", "GSA G2-MUA G3", "GSA G2+MUA G3", "GSA G2-GSB G3"),
        {"G2": 2.0, "G3": 7.0},
        lambda: tuple(
            E * value
            for value in (
                2 * GSB + 7 * MUB,
                2 * GSB - 7 * MUB,
                7 * GSA + 2 * GSB,
                2 * GSA - 7 * MUA,
                2 * GSA + 7 * MUA,
                2 * GSA - 7 * GSB,
            )
        ),
    ),
    "index": (
        ("(MUB+W3)d1", "-(MUB+W3)d2", "(GSA+W1)d3", "-MUA d1", "MUA d2", "-GSB d3"),
        {"d_1": 1.0, "d_2": 2.0, "d_3": 3.0},
        lambda: tuple(E * value for value in (MUB + W3, -2 * (MUB + W3), 3 * (GSA + W1), -MUA, 2 * MUA, -3 * GSB)),
    ),
    "drift": (("-d", "0", "d", "-d", "0", "d"), {"d_A": 2.0, "d_B": 2.0}, lambda: (-2, 0, 2, -2, 0, 2)),
    "bias_Tdot": (
        ("K dT1", "K dT2", "K dT3", "K dT1", "K dT2", "K dT3"),
        {"K_Tdot_A": 3.0, "K_Tdot_B": 3.0},
        lambda: tuple(3 * rate for rate in (0.3, 0.2, 0.1) * 2),
    ),
    "supply": (("v", "v", "v", "v", "v", "v"), {"K_V_A": 2.0, "K_V_B": 2.0}, lambda: (2, 2, 2, 2, 2, 2)),
}


@pytest.mark.parametrize("identifier", SIGNATURES)
def test_effect_moves_the_three_collects_as_the_reference_says(identifier: str) -> None:
    """The columns times values are the six changes of the reference table, as numbers."""
    _, values, expected = SIGNATURES[identifier]
    assert np.allclose(_six(identifier, values), expected(), rtol=1e-12, atol=1e-12)


@pytest.mark.parametrize("identifier", SIGNATURES)
def test_signatures_are_quoted_from_the_reference(identifier: str, reference: Path) -> None:
    """The cells quoted here are those of the table."""
    cells, _, _ = SIGNATURES[identifier]
    with (reference / "effects.csv").open(encoding="utf-8") as file:
        row = next(row for row in csv.DictReader(file) if row["id"] == identifier)
    assert tuple(row[f"dR{channel}{k}"] for channel in "AB" for k in "123") == cells


def test_scale_factor_multiplies_the_whole_rate_of_both_channels() -> None:
    """R' = (1 + e) R: the reference's cells are this less the constant e·B that the bias absorbs."""
    assert np.allclose(_six("scale", {"e": 1000.0}), E * np.array([RA1, RA2, RA3, RB1, RB2, RB3]))


def test_earth_rate_error_moves_what_the_reference_says_and_leaves_axis_b_alone() -> None:
    """RA moves by +dW1, -dW1, -dW3 and RB by -dW2 in every collect, for dW = used - true along the bench's axes."""
    up, north, east = np.array([1.0, 0.0, 0.0]), np.array([0.0, W2, W3]), np.array([0.0, -W3, W2])
    level = float(np.hypot(W2, W3))
    wrong = np.array([0.3, 0.2, -0.4])
    # The sensor's triad is left-handed, so its east is the bench's mirrored.
    values = {"dW_up": wrong @ up, "dW_north": wrong @ north / level, "dW_east": -(wrong @ east) / level}
    assert np.allclose(_six("earth", values), [0.3, -0.3, 0.4, -0.2, -0.2, -0.2])


def test_an_earth_rate_that_nobody_recorded_turns_with_the_unit_about_its_index_axis() -> None:
    """Three collects about the B axis: what all of the earth's does to them is known but for that axis's heading."""
    known, earth = one_run(), effect_by_id("earth")
    unknown = replace(known, w_deg_per_hr=np.zeros((3, 3)))
    left_out = known.w_channels_deg_per_hr.ravel()
    columns = earth.columns(unknown, None, {}).reshape(6, 3)
    values, *_ = np.linalg.lstsq(columns, -left_out)
    assert np.allclose(columns @ values, -left_out, atol=1e-9)
    assert np.hypot(values[1], values[2]) == pytest.approx(np.hypot(W2, W3))
    assert earth.odds_for(unknown) > earth.odds_for(known)


def test_of_a_unit_that_was_turned_over_the_level_part_is_each_positions_own() -> None:
    """Poses of a triad, each at some heading: the columns are whatever the earth does to them."""
    known, earth = joined(triad_poses(), triad_poses()), effect_by_id("earth")
    for left_in in (0.0, 1.0):  # of the vertical part, as where only the latitude was known
        up = known.f_g / np.linalg.norm(known.f_g, axis=1, keepdims=True)
        vertical = np.sum(known.w_deg_per_hr * up, axis=1, keepdims=True) * up
        unknown = replace(known, w_deg_per_hr=left_in * vertical)
        columns = earth.columns(unknown, None, {}).reshape(3 * len(known), -1)
        assert columns.shape[1] == len(earth.parameters_for(unknown)) == 1 + 2 * len(triad_poses())
        left_out = (known.w_deg_per_hr - vertical).ravel()
        assert np.allclose(columns @ np.linalg.lstsq(columns, left_out)[0], left_out, atol=1e-9)
        assert earth.odds_for(unknown) > earth.odds_for(known)
        assert "latitude" in earth.untold_by(unknown)
        assert not earth.untold_by(known)


def test_a_heading_in_each_position_is_asked_for_where_it_was_measured_again() -> None:
    """Of poses that are measured once a level part in each would explain everything: only the vertical has columns."""
    once, earth = replace(triad_poses(), w_deg_per_hr=np.zeros((len(triad_poses()), 3))), effect_by_id("earth")
    assert [each.name for each in earth.parameters_for(once)] == ["dW_up", "dW_north", "dW_east"]
    columns = earth.columns(once, None, {})
    assert columns[:, :, 0].any()
    assert not columns[:, :, 1:].any()
    again = joined(once, once.rows(np.arange(1)))
    there = earth.columns(again, None, {})[[0, 1, -1], :, -2:].any(axis=(1, 2))
    assert there.tolist() == [True, False, True]


@pytest.mark.parametrize(
    ("component", "used", "expected"),
    [
        ("wrong_vertical", (-W1, W2, W3), (-2 * W1, 2 * W1, 0, 0, 0, 0)),
        ("wrong_level_2", (W1, -W2, W3), (0, 0, 0, 2 * W2, 2 * W2, 2 * W2)),
        ("wrong_level_3", (W1, W2, -W3), (0, 0, 2 * W3, 0, 0, 0)),
    ],
)
def test_wrong_sign_of_the_earth_rate_shows_as_twice_its_component(
    component: str, used: tuple[float, ...], expected: tuple[float, ...]
) -> None:
    """With -W1 used for W1 the data is off by -2 W1, +2 W1 in collects 1, 2; W3 in collect 3; W2 in channel B."""
    run = one_run()
    rows = [
        np.array([-used[0], used[1], used[2]]),
        np.array([used[0], used[1], -used[2]]),
        np.array([used[2], used[1], used[0]]),
    ]
    conditions = replace(run, w_deg_per_hr=np.array(rows))
    columns = effect_by_id("frame").columns(conditions, None, {})
    names = [parameter.name for parameter in effect_by_id("frame").parameters_for(conditions)]
    assert np.allclose(columns[:, :, names.index(component)].T.ravel(), expected)


def test_magnetic_field_turns_with_the_sensor() -> None:
    """Its vertical part is -, + in collects 1, 2 along A and on S in collect 3: the columns of GS and MU."""
    columns = effect_by_id("mag").columns(one_run(), None, {})
    along_a, along_s = columns[:, 0, 0], columns[:, 0, 2]
    assert along_a[0] == pytest.approx(-along_a[1])
    assert abs(along_a[0]) > 0.4  # most of half a gauss
    assert abs(along_s[2]) == pytest.approx(abs(along_a[0]))


def test_settling_is_larger_after_the_slew_of_180_degrees() -> None:
    """Collect 2 comes after a half turn and gets twice what collect 3, after a quarter turn, gets."""
    conditions = one_run()
    conditions = replace(conditions, columns={"time_since_index_s": np.full(3, 5.0)})
    columns = effect_by_id("settle").columns(conditions, None, {"tau_s": 10.0})
    assert columns[1, 0, 0] == pytest.approx(2.0 * columns[2, 0, 0])


def test_exchanging_collects_1_and_2_turns_the_sign_of_gs() -> None:
    """The change equals the difference of the rates that the two positions really have."""
    conditions = one_run()
    base = rotor_base(conditions)
    change = effect_by_id("swap").columns(conditions, base, {"run": 1.0, "exchange": 0.0})[..., 0]
    assert np.allclose(change[0], base.rates[1] - base.rates[0])
    assert np.allclose(change[1], base.rates[0] - base.rates[1])
    assert np.allclose(change[2], 0.0)


def _six(identifier: str, values: Mapping[str, float]) -> np.ndarray:
    """RA in collects 1, 2, 3, then RB, moved by one effect with these values in a run at 20 degC."""
    conditions = one_run()
    columns = {**conditions.columns, "dTdt_degC_per_min": np.array([0.3, 0.2, 0.1]), "supply_V": np.full(3, 28.28)}
    conditions = replace(conditions, columns=columns)
    effect = effect_by_id(identifier)
    shape = {**effect.shape_grid(conditions)[0], "nominal_V": 28.0}
    names = [parameter.name for parameter in effect.parameters_for(conditions)]
    assert set(values) <= set(names)
    changed = moved(
        effect.columns(conditions, rotor_base(conditions), shape), [values.get(name, 0.0) for name in names]
    )
    return np.asarray(changed.T.ravel())
