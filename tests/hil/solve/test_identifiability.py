"""Linear algebra of what can be told apart: whitening, projection, overlaps, classes, power."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from hil.model.effects.columns import flattened
from hil.model.forms import mu_columns
from hil.solve.identifiability import (
    Visible,
    classes,
    independent_columns,
    kept_shares,
    orthonormal,
    overlap_table,
    project_out,
    smallest_fit,
    visible,
    whitener,
)
from tests.hil.model.effect_conditions import campaign

EMPTY = np.zeros((6, 0))


def columns(*rows: tuple[float, ...]) -> np.ndarray:
    """Return columns (6, k) from k tuples of six."""
    return np.array(rows, dtype=np.float64).T


def overlap(first: Visible, second: Visible) -> float:
    """Return how alike two effects without shapes are."""
    return float(overlap_table([[first], [second]])[0, 1])


def test_whitened_noise_has_unit_covariance() -> None:
    """W V Wᵀ = 1 for the covariance of collects with scatter from run to run, written out in full."""
    conditions = campaign(temperatures=(0.0, 20.0))
    conditions = conditions.rows(np.random.default_rng(4).permutation(len(conditions)))  # runs need not stand together
    sigma = np.full((len(conditions), 2), 0.9)
    sigma[3, 1] = sigma[7] = np.nan
    same_run = np.equal.outer(np.repeat(conditions.run, 2), np.repeat(conditions.run, 2))
    mu = flattened(mu_columns(conditions))
    covariance = np.kron(np.ones((len(conditions),) * 2), np.diag([1.8**2, 4.3**2])) + 3.0**2 * mu @ mu.T
    covariance = covariance * same_run + np.diag(np.full(sigma.size, 0.9**2))
    biases = np.broadcast_to(np.eye(2), (len(conditions), 2, 2))
    columns = np.concatenate([biases, mu_columns(conditions)], axis=2)
    white = whitener(conditions, sigma, columns, np.array([1.8, 4.3, 3.0, 3.0]))
    w = white @ np.eye(sigma.size)
    assert w.shape == (sigma.size - 3, sigma.size)
    assert not w[:, [7, 14, 15]].any()
    covariance = np.nan_to_num(covariance)
    assert np.allclose(w @ covariance @ w.T, np.eye(len(w)))


@given(st.integers(0, 2**32 - 1))
def test_projection_leaves_nothing_along_the_base_and_changes_nothing_beside_it(seed: int) -> None:
    """P is a projection, also where base columns depend on one another."""
    rng = np.random.default_rng(seed)
    base = rng.standard_normal((12, 3))
    basis = orthonormal(np.concatenate([base, base @ rng.standard_normal((3, 2))], axis=1))
    assert basis.shape == (12, 3)
    left = project_out(basis, rng.standard_normal((12, 4)))
    assert np.allclose(base.T @ left, 0.0, atol=1e-9)
    assert np.allclose(project_out(basis, left), left)


def test_kept_is_one_beside_nothing_and_zero_inside_the_base() -> None:
    """And the fraction in between is that of the norm."""
    effect = columns((1, 1, 0, 0, 0, 0))
    assert visible(effect, EMPTY, np.ones(1)).kept == pytest.approx(1.0)
    inside = visible(effect, orthonormal(columns((1, 1, 0, 0, 0, 0), (0, 0, 1, 0, 0, 0))), np.ones(1))
    assert inside.kept == 0.0
    assert inside.rank == 0
    half = visible(effect, orthonormal(columns((1, 0, 0, 0, 0, 0))), np.ones(1))
    assert half.kept == pytest.approx(np.sqrt(0.5))


def test_each_column_is_weighed_by_itself() -> None:
    """A share is of a column's own norm; zero has none."""
    base = orthonormal(columns((1, 0, 0, 0, 0, 0)))
    two = columns((3, 4, 0, 0, 0, 0), (0, 0, 0, 0, 0, 0))
    assert kept_shares(base, two) == pytest.approx([0.8, 0.0])


def test_a_fit_takes_the_smallest_values_of_what_the_rows_leave_open_whatever_the_units() -> None:
    """Two like columns share a value by their size; values of independent ones are those that made the target."""
    both = columns((1, 1, 1, 1, 1, 1), (1e6, 1e6, 1e6, 1e6, 1e6, 1e6), (0, 1, 2, 3, 4, 5))
    values = smallest_fit(both, both[:, 0] + 2.0 * both[:, 2], 1e-6)
    assert values == pytest.approx([0.5, 0.5e-6, 2.0])
    assert np.allclose(independent_columns(both), both[:, [0, 2]])


def test_numerical_dust_is_no_column() -> None:
    """What is left of an absorbed effect is rounding, whatever its unit."""
    rng = np.random.default_rng(0)
    base = rng.standard_normal((30, 4))
    seen = visible(1e6 * base @ rng.standard_normal((4, 2)), orthonormal(base), np.ones(2))
    assert seen.kept == 0.0


def test_kept_weighs_parameters_by_their_typical_sizes() -> None:
    """A tiny parameter that is visible does not make up for a large one that is not."""
    effect, base = columns((1, 0, 0, 0, 0, 0), (0, 1, 0, 0, 0, 0)), orthonormal(columns((1, 0, 0, 0, 0, 0)))
    assert visible(effect, base, np.array([100.0, 1.0])).kept == pytest.approx(0.01, abs=1e-3)
    assert visible(effect, base, np.array([1.0, 100.0])).kept == pytest.approx(1.0, abs=1e-3)


def test_units_do_not_change_overlaps() -> None:
    """A column in other units, its typical size with it, is the same effect."""
    first, second = columns((1, 2, 3, 0, 0, 0)), columns((1, 2, 0, 4, 0, 0))
    plain = overlap(visible(first, EMPTY, np.ones(1)), visible(second, EMPTY, np.ones(1)))
    scaled = overlap(visible(1e3 * first, EMPTY, np.array([1e-3])), visible(-7.0 * second, EMPTY, np.ones(1)))
    assert plain == pytest.approx(scaled)
    assert plain == pytest.approx(5.0 / np.sqrt(14.0 * 21.0))


def test_a_narrow_effect_inside_a_broad_one_is_explained_by_it_but_is_not_the_same() -> None:
    """One way round only; the cosine of the principal angle between them is 1."""
    narrow = visible(columns((1, 0, 0, 0, 0, 0)), EMPTY, np.ones(1))
    broad = visible(columns((1, 0, 0, 0, 0, 0), (0, 1, 0, 0, 0, 0), (0, 0, 1, 0, 0, 0)), EMPTY, np.ones(3))
    assert overlap(narrow, broad) == overlap(broad, narrow) == pytest.approx(np.sqrt(1.0 / 3.0))


def test_overlap_of_shape_families_asks_how_well_each_can_copy_the_other() -> None:
    """One coincidence among many shapes does not make two families the same."""
    axes = [visible(columns(tuple(np.eye(6)[k])), EMPTY, np.ones(1)) for k in range(6)]
    assert overlap_table([axes[:3], axes[2:5], []])[0] == pytest.approx([1.0, 1.0 / 3.0, 0.0])


def test_a_shape_of_which_the_base_leaves_nothing_makes_families_no_less_alike() -> None:
    """Of a hysteresis that shows in half of its shapes those are compared: what none sees is no other thing."""
    base, axis = columns((1, 0, 0, 0, 0, 0)), visible(columns((0, 1, 0, 0, 0, 0)), EMPTY, np.ones(1))
    absorbed = visible(base, orthonormal(base), np.ones(1))
    assert overlap_table([[absorbed, axis], [axis], [absorbed]])[0] == pytest.approx([1.0, 1.0, 0.0])


def test_overlaps_of_all_pairs_at_once_are_those_of_each_pair() -> None:
    """Families of one to three shapes, one of them absorbed by the base altogether."""
    rng = np.random.default_rng(12)
    base = orthonormal(rng.standard_normal((20, 4)))
    families = [[visible(rng.standard_normal((20, 2)), base, np.ones(2)) for _ in range(k)] for k in (1, 3, 2)]
    families.append([visible(base[:, :1], base, np.ones(1))])
    table = overlap_table(families)
    for i, first in enumerate(families):
        for j, second in enumerate(families):
            each = np.array([[overlap(one, other) for other in second] for one in first])
            expected = min(each.max(axis=1).mean(), each.max(axis=0).mean())
            assert table[i, j] == pytest.approx(1.0 if i == j else expected)


def test_classes_link_what_overlaps_and_keep_the_rest_alone() -> None:
    """0-1 and 1-3 overlap: one class of three; 2 stays alone."""
    table = np.eye(4)
    for a, b in ((0, 1), (1, 3)):
        table[a, b] = table[b, a] = 0.97
    table[2, 3] = table[3, 2] = 0.9
    assert classes(table) == ((0, 1, 3), (2,))


def test_flattened_rows_are_collect_by_collect() -> None:
    """(n, c, p) to (n·c, p): the channels of a collect stand together, as in run_covariance."""
    conditions = replace(campaign(temperatures=(0.0,), runs_each=1))
    assert np.array_equal(flattened(mu_columns(conditions))[4], mu_columns(conditions)[2, 0])


def test_of_several_each_has_the_basis_that_it_has_alone() -> None:
    """Directions that are combinations of others are zero there, as none: they explain nothing of any rate."""
    several = np.random.default_rng(3).normal(size=(3, 6, 2))
    several[1, :, 1], several[2, :, 0] = -2.0 * several[1, :, 0], 0.0
    found = orthonormal(several)
    assert found.shape == (3, 6, 2)
    for own, basis in zip(several, found, strict=True):
        alone = orthonormal(own)
        assert np.allclose(basis @ basis.T, alone @ alone.T)
        assert np.count_nonzero(np.any(basis, axis=0)) == alone.shape[1]
