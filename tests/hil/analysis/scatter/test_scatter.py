"""What made repeats scatter: named when the data can say, "cannot tell" when they cannot, and calibrated in between."""

from __future__ import annotations

import csv
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from hil.analysis.published.closed_forms import contractor_solution, matrix_solution
from hil.analysis.scatter.signature import (
    HYPOTHESES,
    NAMED,
    PUBLISHED_RAMP,
    QUIET_COLLECT_DEG_PER_HR,
    Repeats,
    correlation_interval,
    log_evidence,
    more_in_collect_3_p,
    posterior,
    repeats_of_sigmas,
    scatter_signature,
)
from hil.analysis.scatter.sources import campaign_signatures
from hil.campaign import Campaign, Collects, Conditions, Sensor
from hil.model.equation import RD_GC_86_1_SENSOR_2, pickoff_rates, rotor_matrix

WHITE = 0.81 * np.diag([1.0, 0.5])
RAMP = np.array(PUBLISHED_RAMP)
SENSOR = Sensor(2, ("A", "B", "S"), {"RA": "A", "RB": "B"})
TRUTH = np.array([10.0, 5.0, 60.0, -25.0, 3.0, -4.0])


def shape_of(name: str, sizes: np.ndarray) -> np.ndarray:
    """Covariance of (C, M) that physics.md §A.4 gives each hypothesis, beside the white noise; sizes (n, 2) in C."""
    one, two = np.moveaxis(sizes**2, -1, 0)[:, :, None, None]
    constant, alone = np.ones((2, 2)), np.diag([1.0, 0.0])
    return {
        "white": one * np.diag([1.0, 0.5]),
        "bias": one * constant,
        "collect_3": one * alone,
        "bias_and_collect_3": one * constant + two * alone,
        "drift": one * np.array([[1.0, -0.5], [-0.5, 0.25]]),
    }[name]


def draws(name: str, cases: int, runs: int, rng: np.random.Generator) -> np.ndarray:
    """Sums of squares of repeats that scatter as a hypothesis says, sizes as likely as it says; shape (cases, 2, 2)."""
    sizes = 0.9 * np.exp(rng.uniform(np.log(0.5), np.log(40.0), (cases, 2)))
    if name == "white":
        sizes[: cases // 2] = 0.0  # in half of the cases there is nothing beyond the stated noise
    factor = np.linalg.cholesky(WHITE + shape_of(name, sizes))
    points = np.einsum("kij,krj->kri", factor, rng.standard_normal((cases, runs, 2)))
    away = points - points.mean(axis=1, keepdims=True)
    return np.einsum("kri,krj->kij", away, away)


@pytest.fixture(scope="module")
def three_runs() -> tuple[np.ndarray, np.ndarray]:
    """Posterior (10000, 5) of cases with n = 3, 2000 of each hypothesis, and which one each case was made with."""
    rng = np.random.default_rng(7)
    squares = np.concatenate([draws(name, 2000, 3, rng) for name in HYPOTHESES])
    return posterior(log_evidence(squares, 2, WHITE, RAMP)), np.repeat(np.arange(5), 2000)


@pytest.mark.parametrize(("low", "high"), [(0.02, 0.2), (0.2, 0.5), (0.5, 0.8), (0.8, 0.97)])
def test_of_the_cases_given_a_probability_that_fraction_is_so(
    three_runs: tuple[np.ndarray, np.ndarray], low: float, high: float
) -> None:
    """At n = 3, over every hypothesis and every size, the probabilities are calibrated."""
    probability, made = three_runs
    within = (probability >= low) & (probability < high)
    is_so = np.arange(5) == made[:, None]
    count = within.sum()
    assert count > 200
    expected = probability[within].mean()
    assert is_so[within].mean() == pytest.approx(expected, abs=4.0 * np.sqrt(expected * (1 - expected) / count))


def test_three_runs_name_a_cause_seldom_and_then_rightly(three_runs: tuple[np.ndarray, np.ndarray]) -> None:
    """Most triples of repeats cannot tell; those that name a cause are right at least nine times in ten."""
    probability, made = three_runs
    named = probability.max(axis=1) >= NAMED
    assert 0.05 < named.mean() < 0.5
    assert np.mean(probability.argmax(axis=1)[named] == made[named]) >= NAMED


@pytest.mark.parametrize("name", HYPOTHESES)
def test_many_runs_name_what_made_them(name: str) -> None:
    """Repeats enough, scattering by six times the white noise, leave little doubt."""
    rng = np.random.default_rng(3)
    factor = np.linalg.cholesky(WHITE + shape_of(name, np.full((1, 2), 6.0))[0])
    points = rng.standard_normal((150, 2)) @ factor.T
    away = points - points.mean(axis=0)
    signature = scatter_signature([Repeats(2, "A", 20.0, 150, away.T @ away, WHITE, RAMP)])
    assert signature.verdict == name
    assert HYPOTHESES[name] in signature.sentence


def test_the_interval_of_a_correlation_covers_as_often_as_it_says() -> None:
    """Exact at n = 4, where Fisher's approximation has one degree of freedom left."""
    rng = np.random.default_rng(5)
    true, inside = 0.6, 0
    factor = np.linalg.cholesky(np.array([[1.0, true], [true, 1.0]]))
    for _ in range(400):
        points = rng.standard_normal((4, 2)) @ factor.T
        found = correlation_interval(float(np.corrcoef(points.T)[0, 1]), 3)
        assert found.low is not None
        assert found.high is not None
        inside += found.low <= true <= found.high
    assert inside / 400 == pytest.approx(0.95, abs=0.035)


def conditions(order: str, runs: int, gravity: tuple[float, float, float] = (1.0, 0.0, 0.0)) -> Conditions:
    """Runs of collects in an order such as "1-3-2", at one temperature, without earth rate."""
    positions = order.split("-") * runs
    f_g = np.array([RD_GC_86_1_SENSOR_2[label].components(gravity) for label in positions])
    n, each = len(positions), len(positions) // runs
    return Conditions(
        SENSOR,
        collect=np.arange(1, n + 1),
        run=np.repeat(np.arange(1, runs + 1), each),
        position=np.array(positions),
        start_s=np.arange(n) * 120.0,
        duration_s=np.full(n, 60.0),
        f_g=f_g,
        w_deg_per_hr=np.zeros((n, 3)),
        columns={"temperature_degC": np.full(n, 20.0)},
    )


def night(order: str, runs: int, spread: dict[str, float], drift: float = 0.0, sigma: float = 0.9) -> Campaign:
    """A campaign whose parameters change from run to run by normal draws of the given sizes."""
    rng = np.random.default_rng(11)
    rows = conditions(order, runs)
    names = ["BA", "BB", "GSA", "GSB", "MUA", "MUB"]
    rates = np.empty((len(rows), 2))
    for run in range(1, runs + 1):
        own = TRUTH + np.array([spread.get(name, 0.0) for name in names]) * rng.standard_normal(6)
        chosen = rows.run == run
        ramp = drift * rng.standard_normal() * (np.arange(chosen.sum()) - 1.0)[:, None]
        rates[chosen] = pickoff_rates(own[:2], rotor_matrix(*own[2:]), rows.f_g[chosen], np.zeros(2)) + ramp
    rates += sigma * rng.standard_normal(rates.shape)
    return Campaign("made", "test", {2: Collects(rows, rates, np.full(rates.shape, sigma))})


def test_a_nights_repeats_name_what_changed_in_each_channel() -> None:
    """Bias in one channel, MU in the other, from the same runs."""
    found = {each.axis: each for each in campaign_signatures(night("1-2-3", 24, {"BA": 8.0, "MUA": 8.0}))}
    assert found["A"].verdict == "bias"
    assert found["A"].correlation.value == pytest.approx(1.0, abs=0.05)
    assert found["B"].verdict == "collect_3"


def test_c_is_the_contractors_bias_and_m_the_matrix_one_in_both_channels() -> None:
    """Where bias and MU go together, a wrong sign of MU would make C stand still: compared with the closed forms."""
    campaign = night("1-2-3", 6, {"BA": 5.0, "BB": 5.0})
    rows = campaign.sensors[2]
    rates = rows.rates_deg_per_hr.reshape(6, 3, 2).copy()
    rates[:, 2] += rates.mean(axis=1)  # what the bias does, Collect 3 does twice
    moved = replace(campaign, sensors={2: replace(rows, rates_deg_per_hr=rates.reshape(-1, 2))})
    contractor = contractor_solution(rates, [1.0, 0.0, 0.0], np.zeros(3))
    matrix = matrix_solution(rates, [1.0, 0.0, 0.0], np.zeros(3))
    for channel, found in enumerate(campaign_signatures(moved)):
        assert found.sigma_c.value == pytest.approx(np.std(contractor[:, channel], ddof=1))
        assert found.sigma_m.value == pytest.approx(np.std(matrix[:, channel], ddof=1))
        assert found.sigma_mu.value == pytest.approx(np.std(matrix[:, 5 - channel], ddof=1))


def test_a_drift_shows_in_the_order_1_2_3_only() -> None:
    """The order 1-3-2 keeps a steady drift out of bias and MU: it can be no reason there, and has no probability."""
    assert {each.verdict for each in campaign_signatures(night("1-2-3", 24, {}, drift=8.0))} == {"drift"}
    immune = campaign_signatures(night("1-3-2", 24, {}, drift=8.0))
    assert all(max(each.probabilities, key=each.probabilities.__getitem__) == "white" for each in immune)
    assert all(each.probabilities["drift"] == 0.0 for each in immune)


def test_temperatures_are_told_one_by_one_and_together() -> None:
    """Three repeats at each of eight temperatures cannot tell singly; all together they can."""
    campaign = night("1-2-3", 24, {"BA": 4.0, "BB": 4.0})
    rows = campaign.sensors[2]
    at = np.repeat(np.arange(8) * 10.0, 9)
    apart = replace(rows, conditions=replace(rows.conditions, columns={"temperature_degC": at}))
    found = [each for each in campaign_signatures(replace(campaign, sensors={2: apart})) if each.axis == "A"]
    assert [each.temperature_degC for each in found] == [*np.arange(8) * 10.0, None]
    assert [each.runs for each in found] == [3] * 8 + [24]
    assert found[-1].degrees_of_freedom == 16
    assert "cannot tell" in " ".join(each.sentence for each in found[:8])
    assert found[-1].verdict == "bias"


def test_runs_that_were_not_repeated_say_nothing() -> None:
    """One run has no scatter; and a hand-made group of one is refused."""
    assert campaign_signatures(night("1-2-3", 1, {})) == ()
    with pytest.raises(ValueError, match="nothing was repeated"):
        scatter_signature([Repeats(2, "A", 20.0, 1, np.zeros((2, 2)), WHITE, RAMP)])


def printed(reference: Path) -> dict[tuple[str, float], Repeats]:
    """Table 1's printed sigmas, by channel and temperature in degF."""
    with (reference / "table1.csv").open(encoding="utf-8") as file:
        sigma = {
            (float(row["temperature_F"]), row["parameter"]): (float(row["sigma_printed"]), int(row["n_inferred"]))
            for row in csv.DictReader(file)
        }
    found = {}
    for axis, mu in (("A", "MUB2_matrix"), ("B", "MUA2_matrix")):
        for at in sorted({temperature for temperature, _ in sigma}):
            (c, runs), (m, _) = sigma[at, f"B{axis}2_collins"], sigma[at, f"B{axis}2_matrix"]
            found[axis, at] = repeats_of_sigmas(axis, c, m, sigma[at, mu][0], runs, temperature_degC=at)
    return found


# physics.md §A.4: correlation of C with M, and sigma of C over sigma of M, at Table 1's eight temperatures.
TABLE_1_READINGS = {
    "A": [(0.98, 0.8), (1.27, 2.7), (0.93, 4.7), (0.45, 4.1), (-0.15, 0.7), (-0.43, 1.7), (0.36, 3.6), (-0.49, 2.3)],
    "B": [(-0.98, 1.7), (0.78, 0.8), (0.91, 1.5), (0.98, 0.9), (-0.09, 4.6), (0.89, 1.2), (0.53, 0.8), (0.72, 2.7)],
}


def test_table_1_gives_the_audited_correlations(reference: Path) -> None:
    """From the raw sigmas: every cell, the impossible one at 6.1 °F included, which is said to contradict itself."""
    cells = printed(reference)
    for axis, expected in TABLE_1_READINGS.items():
        found = [scatter_signature([group]) for (own, _), group in cells.items() if own == axis]
        for signature, (correlation, ratio) in zip(found, expected, strict=True):
            assert signature.sigma_c.value is not None
            assert signature.sigma_m.value is not None
            assert signature.correlation.value == pytest.approx(correlation, abs=0.0051)
            assert signature.sigma_c.value / signature.sigma_m.value == pytest.approx(ratio, abs=0.051)
    impossible = scatter_signature([cells["A", 6.1]])
    assert impossible.probabilities == {}
    assert "contradict each other" in impossible.sentence


def test_table_1_pooled_shows_more_than_white_noise_in_axis_a(reference: Path) -> None:
    """18 degrees of freedom: A 4.64, 1.90, 4.11 and B 8.75, 6.28, 5.03; the excess in A has p = 0.013."""
    cells = printed(reference)
    mu = np.array([1.0, -1.0])
    sums = {axis: sum(group.squares for (own, _), group in cells.items() if own == axis) for axis in "AB"}
    for axis, expected in (("A", (4.64, 1.90, 4.11)), ("B", (8.75, 6.28, 5.03))):
        spread = np.sqrt(np.array([sums[axis][0, 0], sums[axis][1, 1], mu @ sums[axis] @ mu]) / 18)
        assert spread == pytest.approx(expected, abs=0.0051)
    assert more_in_collect_3_p(sums["A"], 18, WHITE) == pytest.approx(0.013, abs=0.0005)


def test_the_noise_taken_where_none_is_stated_is_that_of_table_1s_quiet_cells(reference: Path) -> None:
    """The matrix bias of 74.1 A, 140 A, 120 B and 140 B, a mean of two collects each: 0.96 deg/hr per collect."""
    cells = printed(reference)
    quiet = [cells[key] for key in (("A", 74.1), ("A", 140.0), ("B", 120.0), ("B", 140.0))]
    of_a_collect = np.sqrt(np.mean([2.0 * group.squares[1, 1] / (group.runs - 1) for group in quiet]))
    assert of_a_collect == pytest.approx(0.96, abs=0.005)
    assert pytest.approx(of_a_collect, rel=0.25) == QUIET_COLLECT_DEG_PER_HR  # eight degrees of freedom


def test_table_1s_triples_cannot_tell_what_the_indicative_reading_says(reference: Path) -> None:
    """Of sixteen cells, all but a few cannot tell; the reading of physics.md is never excluded where one was made."""
    found = {key: scatter_signature([group]) for key, group in printed(reference).items()}
    undecided = [key for key, signature in found.items() if signature.verdict is None and signature.probabilities]
    assert len(undecided) >= 12
    assert found["B", -21.5].verdict == "drift"
    assert max(found["A", -21.5].probabilities, key=lambda name: found["A", -21.5].probabilities[name]) == "bias"
    assert found["A", 74.1].probabilities["white"] == max(found["A", 74.1].probabilities.values())
    assert found["B", 74.1].probabilities["collect_3"] == max(found["B", 74.1].probabilities.values())
    pooled = scatter_signature([group for (axis, _), group in printed(reference).items() if axis == "A"])
    assert pooled.temperatures == 7
    assert "left out" in pooled.sentence
