"""What an onlooker sees of a collect while it is being taken: means, and standard errors that shrink."""

from __future__ import annotations

import numpy as np
import pytest

from drivers.frames.roles import SensorRole
from drivers.imu import SampleBlock
from procedures.collect import _Running

SENSORS = {2: SensorRole(rates={"RA": "s2_ra", "RB": "s2_rb"})}
POLLS, PER_POLL, SIGMA = 240, 50, 40.0


def blocks(seed: int, level: float = 12.0) -> list[SampleBlock]:
    """White noise on two channels, poll by poll."""
    values = np.random.default_rng(seed).normal(level, SIGMA, (2, POLLS, PER_POLL))
    return [SampleBlock(np.arange(PER_POLL) * 0.01, {"s2_ra": a, "s2_rb": b}) for a, b in zip(*values, strict=True)]


def test_the_running_mean_is_that_of_all_samples_and_its_error_that_of_white_noise():
    """Batches of a poll each, taken together, are worth as much as the samples one by one."""
    taken, running = blocks(1), _Running(SENSORS)
    for block in taken:
        means, errors = running.add(block)
    everything = np.concatenate([block.fields["s2_ra"] for block in taken])
    assert means["2.RA"] == pytest.approx(everything.mean())
    assert errors["2.RA"] == pytest.approx(SIGMA / np.sqrt(POLLS * PER_POLL), rel=0.15)


def test_the_error_shrinks_with_the_square_root_of_time():
    """Four times the polls, half the error; nothing is claimed from fewer than three."""
    running = _Running(SENSORS)
    errors = [running.add(block)[1].get("2.RB") for block in blocks(2)]
    assert errors[0] is None
    assert errors[1] is None  # two polls say next to nothing about their own scatter
    assert errors[-1] == pytest.approx(errors[59] / 2.0, rel=0.25)


def test_polls_of_different_length_count_by_their_samples():
    """A late poll brings more samples, and so weighs more."""
    values = np.random.default_rng(3).normal(0.0, SIGMA, 12000)
    cuts = np.sort(np.random.default_rng(4).choice(np.arange(1, 12000), 199, replace=False))
    running = _Running(SENSORS)
    for part in np.split(values, cuts):
        means, errors = running.add(SampleBlock(np.zeros(len(part)), {"s2_ra": part, "s2_rb": part}))
    assert means["2.RA"] == pytest.approx(values.mean())
    assert errors["2.RA"] == pytest.approx(SIGMA / np.sqrt(12000), rel=0.25)


def test_what_is_not_finite_is_left_out_and_a_silent_poll_changes_nothing():
    """A channel that was not measured has no mean, rather than a wrong one."""
    running = _Running(SENSORS)
    with_gap = SampleBlock(np.zeros(3), {"s2_ra": np.array([1.0, np.nan, 3.0]), "s2_rb": np.full(3, np.nan)})
    assert running.add(with_gap) == ({"2.RA": 2.0}, {})
    assert running.add(SampleBlock(np.empty(0), {})) == ({"2.RA": 2.0}, {})
