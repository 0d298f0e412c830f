"""What is computed once and shared by many bases: the same as computed anew for each."""

from __future__ import annotations

import numpy as np
import pytest

from hil.model import load_model
from hil.model.effects.catalogue import BASE_EFFECTS, EFFECTS
from hil.reconcile.explanations import posed
from hil.reconcile.search.evidence import relevant_points
from hil.reconcile.search.hypotheses import Layout, hypotheses
from hil.reconcile.search.scan import Search
from hil.solve.likelihood import RichMeans
from tests.hil.reconcile.hidden_effects import both, hidden_campaign


@pytest.fixture(scope="module")
def search() -> Search:
    """A night of one sensor with a supply effect, before anything is searched for."""
    campaign = hidden_campaign(5, lambda rows: both(rows.supply - 28.0, 9.0, -8.0))
    problem, tables, rich = posed(campaign, load_model("matrix-6-thermal"), (*BASE_EFFECTS, *EFFECTS))
    return Search(problem.blocks, tables, rich, hypotheses(problem.candidates, problem.blocks))


def test_some_hypotheses_of_a_layout_weigh_what_they_weigh_alone(search: Search) -> None:
    """Parts of a layout give the evidence of the whole, and of a layout of their own."""
    tables = [table.take(np.arange(4)) for table in search.noise]
    joint = [i for i, h in enumerate(search.hypotheses) if any(unit.is_joint for unit in h.units)]
    some = sorted({*range(0, len(search.hypotheses), 25), *joint[-2:]})
    y = [block.y[:, None] for block in search.blocks]
    whole, of_units = Layout.of(search.hypotheses, tables).beside(search.blocks).log_factors(y)
    part, part_units = Layout.of(search.hypotheses, tables).take(some).beside(search.blocks).log_factors(y)
    alone, _ = Layout.of([search.hypotheses[i] for i in some], tables).beside(search.blocks).log_factors(y)
    assert joint
    assert part == pytest.approx(whole[some], abs=1e-9)
    assert alone == pytest.approx(whole[some], abs=1e-9)
    assert all(a == pytest.approx(of_units[i], abs=1e-9) for a, i in zip(part_units, some, strict=True))


def test_a_base_that_has_grown_is_judged_as_if_it_had_been_so_from_the_start(search: Search) -> None:
    """What is kept of the smaller base gives the probabilities that the larger one would by itself."""
    block, table, rich = search.blocks[0], search.noise[0], search.rich[0]
    units = [unit for h in search.hypotheses[::40] for unit in h.units if unit.blocks == (0,)]
    grown = block.with_base(np.hstack([unit.columns[0] for unit in units[:3]]))
    assert grown.base.shape[1] > block.base.shape[1]
    kept = RichMeans.of(block, table, rich)
    assert kept.serves(grown, rich)
    assert kept.best_of_any(grown.base) == pytest.approx(RichMeans.of(grown, table, rich).best_of_any(grown.base))


def test_what_is_known_of_other_data_is_not_used(search: Search) -> None:
    """Other rates, or other rich models, are computed anew."""
    block, table, rich = search.blocks[0], search.noise[0], search.rich[0]
    other = search.blocks[1]
    assert not RichMeans.of(block, table, rich).serves(other, rich)
    assert not RichMeans.of(block, table, rich).serves(block, rich[1:])
    first = relevant_points(block, table, rich)
    relevant_points(block, table, rich[1:])
    assert relevant_points(block, table, rich).tolist() == first.tolist()
