"""How long the discrepancy workflow takes: one campaign with its page, and one unit of a fleet.

pytest benchmarks/test_reconcile_speed.py --benchmark-only
"""

from __future__ import annotations

import time
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from pytest_benchmark.fixture import BenchmarkFixture

from hil.reconcile import reconcile, write_result
from hil.reconcile.fleet import Screen
from tests.hil.reconcile.hidden_effects import base_rates, both, campaign_of, hidden_campaign, lay_out, noise


def test_a_24_run_campaign_with_the_whole_catalogue_and_its_page(benchmark: BenchmarkFixture, tmp_path: Path) -> None:
    """24 runs of four collects, one effect hidden, nested held-out proof, page written: under 10 s on two cores."""
    campaign = hidden_campaign(7, lambda rows: both(rows.supply - 28.0, 9.0, -8.0), runs_each=3)
    benchmark.pedantic(lambda: write_result(reconcile(campaign, "matrix-6-thermal"), tmp_path), rounds=3)
    assert benchmark.stats.stats.min < 10.0


def test_two_sensors_with_three_effects_and_their_page(benchmark: BenchmarkFixture, tmp_path: Path) -> None:
    """24 runs of four collects, two sensors, three effects hidden in both, proof and page: under 20 s of processor."""
    rows = lay_out(np.random.default_rng(0), runs_each=3)
    hidden = both(rows.supply - 28.0, 12.0, -11.0) + both(rows.run > 13, 9.0, -8.0)
    hidden = hidden + both(np.exp(-rows.start_s / 5000.0), 20.0, 20.0)
    units = [campaign_of(rows, base_rates(rows) + noise(rows, np.random.default_rng(k)) + hidden) for k in (1, 2)]
    second, first = (unit.sensors[2] for unit in units)
    other = replace(first.conditions, sensor=replace(first.conditions.sensor, number=1))
    campaign = replace(units[0], sensors={1: replace(first, conditions=other), 2: second})
    began = time.process_time()
    benchmark.pedantic(lambda: write_result(reconcile(campaign, "matrix-6-thermal"), tmp_path), rounds=1)
    assert time.process_time() - began < 20.0


@pytest.mark.parametrize("runs", [24, 96, 384, 3000])
def test_one_sensor_of_more_and_more_runs(benchmark: BenchmarkFixture, runs: int) -> None:
    """Four collects a run, one effect hidden, proof and no page: under 0.1 s a run, of a unit's year and life too."""
    campaign = hidden_campaign(7, lambda rows: both(rows.supply - 28.0, 9.0, -8.0), runs_each=runs // 8)
    benchmark.pedantic(lambda: reconcile(campaign, "matrix-6-thermal"), rounds=1)
    assert benchmark.stats.stats.min < 0.1 * runs


def test_screening_a_unit_of_a_known_layout(benchmark: BenchmarkFixture) -> None:
    """A hundred units of one layout: under 10 ms each."""
    rows = lay_out(np.random.default_rng(0), runs_each=3)
    units = [campaign_of(rows, base_rates(rows) + noise(rows, np.random.default_rng(seed))) for seed in range(100)]
    screen = Screen.of(units, "matrix-6-thermal")
    benchmark.pedantic(lambda: screen.units(units), rounds=3)
    assert benchmark.stats.stats.min < 1.0
