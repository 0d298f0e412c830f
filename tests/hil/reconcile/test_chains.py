"""Noise as states handed on from row to row is the same noise as its covariance, in time that is linear in rows."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from hil.campaign import Conditions
from hil.model.effects.base import VarianceEffect
from hil.model.effects.catalogue import VARIANCE_EFFECTS
from hil.model.effects.scatter import Scatter
from hil.reconcile.search import chains
from hil.reconcile.search.chains import chain_of, in_time, joined
from hil.reconcile.search.filters import filter_of
from tests.hil.model.effect_conditions import campaign

CONDITIONS = campaign(temperatures=(0.0, 20.0, 40.0), runs_each=2)


def laid(conditions: Conditions) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Rows, channels, and places in a covariance of all rates, of channel by channel, in the order of time."""
    rows = np.tile(np.arange(len(conditions)), 2)
    channel = np.repeat([0, 1], len(conditions))
    order = in_time(conditions, rows)
    rows, channel = rows[order], channel[order]
    return rows, channel, 2 * rows + channel


@pytest.mark.parametrize("effect", VARIANCE_EFFECTS, ids=lambda e: e.id)
def test_a_chain_has_the_covariance_of_what_scatters(effect: VarianceEffect) -> None:
    """Of every effect of the catalogue, at every shape that is searched, and of rows from the middle of a campaign."""
    if effect.missing(CONDITIONS):
        pytest.skip(f"{effect.id} needs {effect.missing(CONDITIONS)}")
    rows, channel, place = laid(CONDITIONS)
    for shape in effect.shape_grid(CONDITIONS):
        dense = effect.covariance(CONDITIONS, shape)[np.ix_(place, place)]
        scatter = effect.scatter(CONDITIONS, shape)
        for first in (0, 7):
            parts = [chain_of(part, CONDITIONS, rows[first:], channel[first:]) for part in scatter]
            chain = joined(parts, len(rows) - first)
            np.testing.assert_allclose(chain.covariance, dense[first:, first:], atol=1e-9)
            np.testing.assert_allclose(chain.variance, np.diag(dense)[first:], atol=1e-9)


def test_a_group_that_is_not_together_in_time_is_still_one() -> None:
    """What is drawn anew for every position comes back with it: a state for each."""
    rows, channel, place = laid(CONDITIONS)
    position = np.unique(CONDITIONS.position, return_inverse=True)[1]
    part = Scatter(np.ones((len(CONDITIONS), 2, 1)), group=position)
    chain = chain_of(part, CONDITIONS, rows, channel)
    np.testing.assert_allclose(chain.covariance, part.covariance(CONDITIONS)[np.ix_(place, place)])


@pytest.mark.parametrize(("wanders", "piece"), [(True, 24), (True, 8), (False, 24), (False, 4)])
def test_filtered_rows_are_independent_and_keep_the_determinant(
    wanders: bool, piece: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Against what is dense: inner products of columns, the inverse, the log determinant, at every size of the states.

    Of two kinds side by side, which wander through the rows, or leave each run by itself; cut into two pieces, and into
    several of which the last is not full.
    """
    monkeypatch.setattr(chains, "PIECE", piece)
    rng = np.random.default_rng(1)
    late = replace(CONDITIONS, start_s=CONDITIONS.start_s + 3600.0)
    rows, channel, _ = laid(late)

    def drawn() -> list[Scatter]:
        sizes = rng.normal(size=(3, len(late), 2, 2))
        if wanders:
            return [Scatter(sizes[0], group=late.run), Scatter(sizes[1], tau_s=7200.0), Scatter(sizes[2], walk=True)]
        return [Scatter(each, group=late.run) for each in sizes]

    kinds = [joined([chain_of(part, late, rows, channel) for part in drawn()], len(rows)) for _ in range(2)]
    assert len(kinds[0].begins) == (1 if wanders else len(np.unique(late.run)))
    of = np.array([0, 1, 1, 0])
    amounts, white = rng.uniform(0.1, 5.0, (4, 6)), rng.uniform(0.5, 2.0, (4, len(rows)))
    columns = rng.normal(size=(len(rows), 3))
    found, by_run = filter_of(kinds, of, amounts, white), filter_of(kinds, of, amounts, white, late.run[rows])
    whitened = found.whiten(columns)
    pulled, several = found.back(whitened), [(each.rows, each.inner()) for each in by_run.stretches]
    for t in range(4):
        sized = replace(kinds[of[t]], columns=kinds[of[t]].columns * amounts[t])
        covariance = sized.covariance + np.diag(white[t])
        inner = whitened[t].T @ whitened[t]
        np.testing.assert_allclose(inner, columns.T @ np.linalg.solve(covariance, columns), rtol=1e-9)
        np.testing.assert_allclose(pulled[t], np.linalg.solve(covariance, columns), rtol=1e-9, atol=1e-12)
        places, by_themselves = several[0]
        within = np.linalg.inv(covariance)[places[..., None], places[..., None, :]]
        np.testing.assert_allclose(by_themselves[:, :, t], within, rtol=1e-9, atol=1e-12)
        assert found.half_log_det[t] == pytest.approx(0.5 * np.linalg.slogdet(covariance)[1], rel=1e-10)
