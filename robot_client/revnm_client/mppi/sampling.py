"""Control sequences to try: the last solution with smooth noise, and a fan of constant ones."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from revnm_client.mppi.config import MppiConfig

Array32 = NDArray[np.float32]

_FAN_SPEEDS = (0.0, 0.4, 0.7, 1.0)  # fractions of the top speed


class Sampler:
    """Draws samples, the same ones for the same seed and the same calls.

    Noise is drawn at a few knots and drawn out by straight lines: white noise of the same spread averages out
    over a rollout and explores little. A tenth of the samples are constant velocities, turning on the spot
    among them: they find the way out when the last solution has become useless. Sample 0 is the last solution.

    Arrays are (K, T) as everywhere, but lie in memory step by step, since rollouts walk along the steps.
    """

    def __init__(self, config: MppiConfig, seed: int) -> None:
        self._rng = np.random.default_rng(seed)
        fan = _fan(config)
        free = config.samples - fan.shape[1]
        self._knots = np.ones((2, config.knots + 1, free), dtype=np.float32)
        self._weights = np.empty((2, config.steps, config.knots + 1), dtype=np.float32)
        sigma = np.array([config.sigma_v_mps, config.sigma_w_radps])
        self._weights[:, :, :-1] = sigma[:, None, None] * _interpolation(config.steps, config.knots)
        self._samples = np.empty((2, config.steps, config.samples), dtype=np.float32)
        self._samples[:, :, free:] = fan[:, None, :]

    def draw(self, nominal: Array32) -> tuple[Array32, Array32]:
        """Return sampled speeds and turning rates, each (K, T), not yet limited; valid until the next call.

        One product does it all: the last knot is 1 everywhere, and its weights are the last solution.

        Args:
            nominal: (2, T), speeds and turning rates of the last solution.
        """
        for knots in self._knots:
            self._rng.standard_normal(out=knots[:-1], dtype=np.float32)
        self._knots[:, :-1, 0] = 0.0
        self._weights[:, :, -1] = nominal
        np.matmul(self._weights, self._knots, out=self._samples[:, :, : self._knots.shape[2]])
        return self._samples[0].T, self._samples[1].T


def _interpolation(steps: int, knots: int) -> NDArray[np.float64]:
    """Return the weights (T, knots) of straight lines between evenly spread knots, the first and last at the ends."""
    place = np.linspace(0.0, knots - 1, steps)
    return np.maximum(1.0 - np.abs(place[:, None] - np.arange(knots)), 0.0)


def _fan(config: MppiConfig) -> Array32:
    """Return the constant samples (2, F): all speeds of the fan times evenly spread turning rates."""
    rates = max(config.samples // 10 // len(_FAN_SPEEDS), 1)
    rates += 1 - rates % 2  # odd, so that straight on is among them
    w = np.linspace(-config.max_w_radps, config.max_w_radps, rates) if rates > 1 else np.zeros(1)
    v = np.array(_FAN_SPEEDS) * config.max_v_mps
    return np.stack([np.repeat(v, rates), np.tile(w, len(v))]).astype(np.float32)
