"""Allan deviations agree with the published ones, their terms are what was put in, and gaps are never bridged."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from hil.analysis.allan.document import AllanResult, Averaging
from hil.analysis.allan.fit import NoiseFit, Octaves, octaves
from hil.analysis.allan.sources import Recording, cut
from hil.errors import InputError
from tests.hil.analysis.allan.noise_series import rates


@pytest.mark.slow
def test_a_real_recording_agrees_with_its_published_deviations_over_eighteen_octaves(reference_data: Path) -> None:
    """ADIS16405, 2.8 h at 100 Hz: all three gyros, every published tau, to 1e-5."""
    stored = np.load(reference_data / "static" / "adis16405-run1-gyro.npz")
    scaled = stored["counts"] * float(stored["lsb_deg_per_s"])
    published = np.genfromtxt(reference_data / "static" / "adis16405-run1-allan-reference.csv", delimiter=",")
    assert len(published) == 18
    for channel in range(3):
        found = octaves([scaled[:, channel]], 1.0 / float(stored["rate_hz"]))
        own = np.searchsorted(found.tau_s, published[:, 0] - 1e-6)
        np.testing.assert_allclose(found.tau_s[own], published[:, 0], rtol=1e-12)
        np.testing.assert_allclose(np.sqrt(found.variance[own]), published[:, channel + 1], rtol=1e-5)


def test_the_real_recording_does_not_follow_the_four_terms_and_the_result_says_so(reference_data: Path) -> None:
    """Its filter shapes the shortest averages: they are left out, and N is that of the -1/2 stretch."""
    stored = np.load(reference_data / "static" / "adis16405-run1-gyro.npz")
    x = stored["counts"][:, 0] * float(stored["lsb_deg_per_s"]) * 3600.0
    result = AllanResult(Recording("gx", [x], 0.01))
    document = result.document(60.0)
    n = document["fit"]["N"]
    assert not result.fit.describes
    assert result.fit.fitted_from_s == pytest.approx(0.08)
    assert any("do not describe" in note for note in document["notes"])
    assert n["unit"] == "deg/sqrt(hr)"
    # The -1/2 line of the published deviations themselves: at 0.64 s averages scatter by 0.0511 deg/s.
    assert n["value"] == pytest.approx(0.051066948 * 3600 * np.sqrt(0.64) / 60, rel=0.03)


def test_white_noise_gives_n_and_no_more() -> None:
    """B, K and Q are not seen, and their bounds are small."""
    fit = NoiseFit(octaves([rates(np.random.default_rng(3), 1 << 16, n=2.0)], 1.0))
    assert fit.terms["N"].value == pytest.approx(2.0, rel=0.02)
    assert not any(fit.terms[name].seen for name in "QBK")
    assert fit.terms["B"].high < 0.1
    assert fit.describes


def test_of_few_octaves_the_best_fit_is_a_possible_one() -> None:
    """Second means of 36 collects, white at 8.06 deg/hr: free of all bounds, these five are fitted best by K² < 0.

    Measured from that, the best fit that is possible was unlikely, and intervals were those of what cannot be.
    """
    deviations = np.array([8.025, 5.576, 4.164, 3.199, 2.256])
    terms = NoiseFit(Octaves(1.0, 2 ** np.arange(5), deviations**2, (60,) * 36)).terms
    assert not terms["Q"].seen
    assert terms["N"].low < 8.06 < terms["N"].high
    assert terms["B"].low < 0.1 * terms["B"].value


def test_flicker_and_random_walk_are_told_apart() -> None:
    """A long record with all three terms shows each, about as large as it is."""
    fit = NoiseFit(octaves([rates(np.random.default_rng(8), 1 << 18, n=1.0, b=0.1, k=0.002)], 1.0))
    for name, truth in {"N": 1.0, "B": 0.1, "K": 0.002}.items():
        assert fit.terms[name].seen, name
        assert fit.terms[name].value == pytest.approx(truth, rel=0.4), name
    assert not fit.terms["Q"].seen


@pytest.mark.slow
@pytest.mark.parametrize(
    "slow",
    [{"b": 1.0}, {"k": 1.0}, {"b": 1.0, "k": 0.01}],
    ids=["flicker", "walk", "both"],
)
def test_slow_noise_sampled_at_instants_shows_no_white_noise(slow: dict[str, float]) -> None:
    """Values at an instant differ more from the next than averages do, by what neither Q nor N is to be seen in."""
    for seed in range(4):
        fit = NoiseFit(octaves([rates(np.random.default_rng(seed), 1 << 16, n=0.0, **slow)], 1.0))
        assert fit.describes
        assert not fit.terms["N"].seen
        assert not fit.terms["Q"].seen


@pytest.mark.slow
@pytest.mark.parametrize("truth", [(1.0, 0.3, 0.0), (0.0, 1.0, 0.0), (1.0, 0.0, 0.01), (0.0, 1.0, 0.01)])
def test_the_intervals_of_mixtures_that_octaves_hardly_part_cover(truth: tuple[float, float, float]) -> None:
    """Of 15 records of white, flicker and random walk, alone or two together, 14 and more hold each of N, B, K.

    Of intervals that are .7 times as wide 11 and fewer do, of one coefficient at least.
    """
    held = np.zeros(3)
    for seed in range(15):
        n, b, k = truth
        fit = NoiseFit(octaves([rates(np.random.default_rng(seed), 1 << 13, n=n, b=b, k=k)], 1.0))
        held += [fit.terms[name].low <= of <= fit.terms[name].high for name, of in zip("NBK", truth, strict=True)]
    assert np.all(held >= 14), held


@pytest.mark.slow
def test_the_intervals_of_n_b_and_k_cover() -> None:
    """95 % intervals from 15 records of 4096 samples hold the truth at least 13 times."""
    rng = np.random.default_rng(20)
    truth = {"N": 1.0, "B": 0.1, "K": 0.003}
    held = dict.fromkeys(truth, 0)
    for _ in range(15):
        fit = NoiseFit(octaves([rates(rng, 1 << 12, n=1.0, b=0.1, k=0.003)], 1.0))
        for name, value in truth.items():
            held[name] += fit.terms[name].low <= value <= fit.terms[name].high
    assert all(count >= 13 for count in held.values()), held


def test_a_gap_is_never_bridged() -> None:
    """Two stretches with a step of the bias between them have the deviation of white noise, not of the step."""
    rng = np.random.default_rng(5)
    first, second = rates(rng, 5000), 100.0 + rates(rng, 3000)
    time_s = np.concatenate([np.arange(5000.0), 6000.0 + np.arange(3000.0)])
    pieces = cut("here", np.concatenate([first, second]), 1.0, time_s)
    assert [len(piece) for piece in pieces] == [5000, 3000]
    found = octaves(pieces, 1.0)
    np.testing.assert_allclose(np.sqrt(found.variance[:6] * found.tau_s[:6]), 1.0, rtol=0.15)
    assert found.tau_s[-1] == 2048.0  # set by the longer stretch


def test_missing_samples_cut_a_stretch() -> None:
    """A NaN is a gap, also without times."""
    values = np.arange(20.0)
    values[7] = np.nan
    assert [len(piece) for piece in cut("here", values, 1.0)] == [7, 12]


def test_uneven_samples_are_refused() -> None:
    """Steps that are no whole number of intervals are no gaps."""
    time_s = np.cumsum(np.random.default_rng(0).uniform(0.5, 1.5, 200))
    with pytest.raises(InputError, match="evenly spaced"):
        cut("here", np.zeros(200), 1.0, time_s)


def test_a_rate_that_never_changes_is_refused_and_a_stuck_stretch_is_named() -> None:
    """Zero noise is a dead channel; a run of equal samples is a padded file."""
    with pytest.raises(InputError, match="never changes"):
        Recording("here", [np.zeros(100)], 1.0)
    padded = np.concatenate([rates(np.random.default_rng(1), 500), np.zeros(200)])
    assert any("200 samples in a row" in note for note in Recording("here", [padded], 1.0).notes)


def test_longer_averages_stop_helping_where_the_random_walk_takes_over() -> None:
    """With N = 1 and K = 0.01 the curve is lowest at sqrt(3) N/K = 173 s, and rises after it."""
    fit = NoiseFit(octaves([rates(np.random.default_rng(4), 1 << 17, n=1.0, k=0.01)], 1.0))
    read = Averaging(fit)
    assert read.lowest_at_s == pytest.approx(np.sqrt(3.0) / 0.01, rel=0.2)
    assert read.turns
    assert read.reach_s(0.2) == pytest.approx(25.0, rel=0.1)
    assert read.reach_s(0.01) is None


def test_white_noise_alone_keeps_averaging_down() -> None:
    """An unseen random walk does not end the averaging."""
    result = AllanResult(Recording("here", [rates(np.random.default_rng(9), 1 << 14)], 1.0))
    assert not result.averaging.turns
    assert "longer keeps helping" in " ".join(result.document(60.0)["summary"])
