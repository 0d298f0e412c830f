"""Series of rates with known N, B and K."""

from __future__ import annotations

import numpy as np


def rates(
    rng: np.random.Generator, samples: int, *, n: float = 1.0, b: float = 0.0, k: float = 0.0, interval_s: float = 1.0
) -> np.ndarray:
    """White, flicker and random-walk noise, shape (samples,), with coefficients in the data's unit and seconds."""
    out = rng.normal(0.0, n / np.sqrt(interval_s), samples)
    if k:
        out += np.cumsum(rng.normal(0.0, k * np.sqrt(interval_s), samples))
    if b:
        frequency = np.fft.rfftfreq(2 * samples, interval_s)
        frequency[0] = frequency[1]
        density = b**2 / (np.pi * frequency)  # one-sided, so that the Allan variance is (2 ln2/pi) b²
        spectrum = rng.normal(size=(2, len(frequency))) * np.sqrt(density * 2 * samples / (4 * interval_s))
        out += np.fft.irfft(spectrum[0] + 1j * spectrum[1], 2 * samples)[:samples]
    return out
