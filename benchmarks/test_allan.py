"""Overlapping Allan deviation and fit of a million samples, octaves, beside an explicit loop over second differences.

python -m pytest benchmarks/test_allan.py --benchmark-only --benchmark-disable-gc -p no:randomly
"""

from __future__ import annotations

import time

import numpy as np
from pytest_benchmark.fixture import BenchmarkFixture

from hil.analysis.allan.document import AllanResult
from hil.analysis.allan.sources import Recording

SAMPLES = 1_000_000


def by_means(rates: np.ndarray, multiple: int) -> float:
    """The definition: every pair of neighbouring averages, by convolution."""
    means = np.convolve(rates, np.full(multiple, 1.0 / multiple), "valid")
    return float(np.sqrt(0.5 * np.mean((means[multiple:] - means[:-multiple]) ** 2)))


def test_a_million_samples(benchmark: BenchmarkFixture) -> None:
    """Deviations, intervals and the fit of Q, N, B, K in under two seconds."""
    rng = np.random.default_rng(0)
    rates = rng.normal(0.0, 100.0, SAMPLES) + np.cumsum(rng.normal(0.0, 0.01, SAMPLES))
    result: AllanResult = benchmark.pedantic(
        lambda: AllanResult(Recording("benchmark", [rates], 0.01)), rounds=5, warmup_rounds=1
    )
    started = time.perf_counter()
    for place in (0, 3, 6):
        np.testing.assert_allclose(result.fit.deviation.deviation[place], by_means(rates, 2**place), rtol=1e-8)
    print(f"\na million samples: {benchmark.stats['median']:.2f} s; ", end="")
    print(f"three taus by convolution: {time.perf_counter() - started:.2f} s")
    assert benchmark.stats["min"] < 2.0
