"""A sensor's sampling: a value with low-pass and noise of a given density, computed on demand."""

import math

import numpy as np
from numpy.typing import NDArray

MAX_SAMPLES = 64
"""Samples kept (FIFO depths); older ones are not computed individually."""


class Sampler:
    """Samples at a fixed rate behind a one-pole low-pass.

    White noise of one-sided density d has rms d * sqrt(rate / 2) at the sampling rate; the low-pass leaves d *
    sqrt(bandwidth) of it, so that averaging over a time T gives d / sqrt(2 T) for any filter.

    The first ``unsettled`` samples after a start are too small: the filter is not full of the signal yet.
    """

    def __init__(self, density: float, rng: np.random.Generator, unsettled: int = 0) -> None:
        self._density = density
        self._unsettled = unsettled
        self._rng = rng
        self._rate_hz = 0.0
        self._memory = 0.0
        self._started_s = 0.0
        self._taken = 0
        self._filtered: NDArray[np.float64] | None = None

    def start(self, time_s: float, rate_hz: float, rate_over_bandwidth: float) -> None:
        """Restart with another rate and bandwidth (rate 0: no samples)."""
        self._rate_hz = rate_hz
        self._memory = (rate_over_bandwidth - 2.0) / (rate_over_bandwidth + 2.0)
        self._started_s = time_s
        self._taken = 0
        self._filtered = None

    def take(self, time_s: float, value: NDArray[np.float64]) -> list[NDArray[np.float64]]:
        """The samples since the last call, oldest first; ``value`` is what is measured now."""
        due = math.floor((time_s - self._started_s) * self._rate_hz) - self._taken
        if due <= 0:
            return []
        first = self._taken + 1
        self._taken += due
        if self._filtered is None:
            self._filtered = value
        skipped = max(due - MAX_SAMPLES, 0)
        self._filtered = value + (self._filtered - value) * self._memory**skipped
        samples = []
        for number in range(first + skipped, first + due):
            noise = self._rng.normal(0.0, self._density * math.sqrt(self._rate_hz / 2), value.shape)
            self._filtered = self._memory * self._filtered + (1 - self._memory) * (value + noise)
            samples.append(self._filtered * min(number / (self._unsettled + 1), 1.0))
        return samples
