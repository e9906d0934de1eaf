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
        self._config = config
        self._rng = np.random.default_rng(seed)
        self._fan = _fan(config)
        free = config.samples - self._fan.shape[1]
        self._knots = np.empty((2, config.knots, free), dtype=np.float32)
        self._samples = np.empty((2, config.steps, config.samples), dtype=np.float32)
        self._samples[:, :, free:] = self._fan[:, None, :]
        self._sigma = np.array([config.sigma_v_mps, config.sigma_w_radps], dtype=np.float32)

    def draw(self, nominal: Array32) -> tuple[Array32, Array32]:
        """Return sampled speeds and turning rates, each (K, T), not yet limited; valid until the next call.

        Args:
            nominal: (2, T), speeds and turning rates of the last solution.
        """
        config = self._config
        self._rng.standard_normal(out=self._knots, dtype=np.float32)
        self._knots *= self._sigma[:, None, None]
        self._knots[:, :, 0] = 0.0
        free = self._knots.shape[2]
        position = np.linspace(0.0, config.knots - 1, config.steps)
        for step in range(config.steps):
            left = min(int(position[step]), config.knots - 2)
            part = np.float32(position[step] - left)
            row = self._samples[:, step, :free]
            np.multiply(self._knots[:, left + 1], part, out=row)
            row += self._knots[:, left] * (np.float32(1.0) - part)
            row += nominal[:, step, None]
        return self._samples[0].T, self._samples[1].T


def _fan(config: MppiConfig) -> Array32:
    """Return the constant samples (2, F): all speeds of the fan times evenly spread turning rates."""
    rates = max(config.samples // 10 // len(_FAN_SPEEDS), 1)
    rates += 1 - rates % 2  # odd, so that straight on is among them
    w = np.linspace(-config.max_w_radps, config.max_w_radps, rates) if rates > 1 else np.zeros(1)
    v = np.array(_FAN_SPEEDS) * config.max_v_mps
    return np.stack([np.repeat(v, rates), np.tile(w, len(v))]).astype(np.float32)
