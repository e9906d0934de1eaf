"""Synthesises what a robot would see ahead from what the remote camera sees (paper, section III-C).

DDIM (Song et al., arXiv 2010.02502) with a network that predicts the clean image. Training imports the
schedule and the sampler from here, so the module needs numpy only; the model comes in from outside.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from revnm_client.geometry import FloatArray
from revnm_server.observation import Image32

if TYPE_CHECKING:
    from revnm_server.networks.bundle import Bundle
    from revnm_server.ports import EgoRequest

DIFFUSION_STEPS = 1000
_COSINE_OFFSET = 0.008
_LARGEST_BETA = 0.999
_NOISE_SEED = 20250

Denoiser = Callable[[Image32, int], Image32]


@dataclass(frozen=True, slots=True)
class DdimSchedule:
    """The diffusion steps that sampling visits, noisiest first.

    Attributes:
        steps: (n,) int64, from 999 down.
        alpha_bar: (n,) share of signal variance at each of the steps.
        alpha_bar_next: (n,) the same at the step that follows; the last is 1, the clean image.
    """

    steps: NDArray[np.int64]
    alpha_bar: FloatArray
    alpha_bar_next: FloatArray


def cosine_alpha_bar() -> FloatArray:
    """Return ᾱ (1000,), the share of signal variance at each diffusion step, falling.

    The cosine schedule of Nichol and Dhariwal (arXiv 2102.09672, eq. 17), β capped at 0.999. Noise is added
    as x_t = √ᾱ_t x_0 + √(1 − ᾱ_t) ε.
    """
    time = np.arange(DIFFUSION_STEPS + 1) / DIFFUSION_STEPS
    signal = np.cos((time + _COSINE_OFFSET) / (1.0 + _COSINE_OFFSET) * np.pi / 2.0) ** 2
    betas = np.minimum(1.0 - signal[1:] / signal[:-1], _LARGEST_BETA)
    return np.asarray(np.cumprod(1.0 - betas))


def ddim_schedule(count: int) -> DdimSchedule:
    """Spread ``count`` sampling steps over the schedule, starting from pure noise (trailing: 999, …).

    Leading steps would start below 999, where training never saw pure noise (Lin et al., arXiv 2305.08891).

    Raises:
        ValueError: ``count`` is not in 1..1000.
    """
    if not 1 <= count <= DIFFUSION_STEPS:
        raise ValueError(f"{count} sampling steps: expected 1 to {DIFFUSION_STEPS}")
    spread = np.arange(count, 0, -1) * DIFFUSION_STEPS / count
    steps = np.round(spread).astype(np.int64) - 1
    alpha_bar = cosine_alpha_bar()[steps]
    return DdimSchedule(steps, alpha_bar, np.append(alpha_bar[1:], 1.0))


def ddim_sample(denoise: Denoiser, noise: Image32, schedule: DdimSchedule) -> Image32:
    """Turn noise into an image: deterministic DDIM (η = 0), clean-image prediction.

    The prediction is clipped to [−1, 1] first and the noise recomputed from the clipped one; otherwise the
    two contradict each other.

    Args:
        denoise: Maps a noisy image and its diffusion step to the clean image.
        noise: Standard normal, any shape.
        schedule: The steps to visit.

    Returns:
        The image, of the noise's shape, float32 in [−1, 1].
    """
    noisy = noise.astype(np.float32)
    clean = noisy
    for step, now, after in zip(schedule.steps, schedule.alpha_bar, schedule.alpha_bar_next, strict=True):
        clean = np.clip(denoise(noisy, int(step)), -1.0, 1.0)
        epsilon = (noisy - np.sqrt(now) * clean) / np.sqrt(1.0 - now)
        noisy = (np.sqrt(after) * clean + np.sqrt(1.0 - after) * epsilon).astype(np.float32)
    return clean.astype(np.float32)


def start_image(ego_px: int, *, noise: bool) -> Image32:
    """Return what every sampling starts from, (ego_px, ego_px): standard normal noise, or zeros for a regression.

    One fixed noise: the same scene gives the same depth, whatever the tick and the other robots.
    """
    if not noise:
        return np.zeros((ego_px, ego_px), dtype=np.float32)
    generator = np.random.default_rng(_NOISE_SEED)
    return generator.standard_normal((ego_px, ego_px), dtype=np.float32)


class OnnxExo2Ego:
    """Exo2ego by a bundle's denoiser, one batch over all robots."""

    def __init__(self, bundle: Bundle) -> None:
        """Take the denoiser and how it is sampled from the bundle."""
        config = bundle.exo2ego
        self._model, self._prior = config.model, config.prior
        self._schedule = ddim_schedule(config.steps)
        self._start = start_image(bundle.spec.ego_px, noise=config.noise)

    def synthesise(self, requests: Sequence[EgoRequest]) -> Image32:
        """Return ego depth (R, ego_px, ego_px) in [−1, 1], one per request; R may be 0."""
        count = len(requests)
        start = np.tile(self._start, (count, 1, 1, 1)).reshape(count, 1, *self._start.shape)  # (R, 1, px, px)
        if count == 0:
            return start[:, 0]
        seen = {
            "crop": np.stack([request.crops for request in requests]).astype(np.float32),  # (R, N, c, c)
            "robot": np.stack([request.pose.p_rob for request in requests]).astype(np.float32),  # (R, 2)
            "heading": np.stack([request.pose.q_rel for request in requests]).astype(np.float32),  # (R, 2)
        }
        if self._prior:
            priors = [request.prior for request in requests if request.prior is not None]
            seen["prior"] = np.stack(priors).astype(np.float32)  # (R, 2, px, px)

        def denoise(noisy: Image32, step: int) -> Image32:
            return self._model.run(noisy=noisy, step=np.full(count, step, dtype=np.int64), **seen)["clean"]

        return ddim_sample(denoise, start, self._schedule)[:, 0]
