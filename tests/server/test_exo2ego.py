from __future__ import annotations

import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

from revnm_server.networks.bundle import load_bundle
from revnm_server.observation import Image32, ImagePose
from revnm_server.ports import EgoRequest
from revnm_server.stages.exo2ego import (
    DdimSchedule,
    OnnxExo2Ego,
    cosine_alpha_bar,
    ddim_sample,
    ddim_schedule,
    start_image,
)


def _request(robot: str, level: float, *, history: int = 1) -> EgoRequest:
    pose = ImagePose(np.array([0.5, 0.5]), np.array([0.0, -1.0]))
    return EgoRequest(robot, 0, pose, np.full((history, 32, 32), level, np.float32))


def test_steps_trail_from_pure_noise() -> None:
    # 1000 * (8 … 1) / 8 − 1
    assert ddim_schedule(8).steps.tolist() == [999, 874, 749, 624, 499, 374, 249, 124]
    assert ddim_schedule(1).steps.tolist() == [999]
    assert ddim_schedule(2).steps.tolist() == [999, 499]
    # Where the count does not divide 1000 the steps are still distinct and fall: 1000, 833.3, 666.7, …
    assert ddim_schedule(6).steps.tolist() == [999, 832, 666, 499, 332, 166]
    assert ddim_schedule(1000).steps.tolist() == list(range(999, -1, -1))


@pytest.mark.parametrize("count", [0, -1, 1001])
def test_an_impossible_step_count_is_refused(count: int) -> None:
    with pytest.raises(ValueError, match="sampling steps"):
        ddim_schedule(count)


def test_the_cosine_schedule() -> None:
    alpha_bar = cosine_alpha_bar()
    assert alpha_bar.shape == (1000,)
    assert (np.diff(alpha_bar) < 0).all()
    # In the middle the cap is far away: cos²((0.5 + 0.008) / 1.008 · π/2) / cos²(0.008 / 1.008 · π/2)
    # = cos²(0.791631) / cos²(0.012467) = 0.493767 / 0.999845 = 0.493844
    assert alpha_bar[499] == pytest.approx(0.493844, abs=1e-6)
    # The last β is capped at 0.999: ᾱ_999 = 0.001 · cos²(0.998413…·π/2)/… = 0.001 · 2.4288e-6
    assert alpha_bar[999] == pytest.approx(2.4288e-9, rel=1e-3)


def test_two_steps_by_hand() -> None:
    # ᾱ = (0.25, 0.64), ᾱ_next = (0.64, 1). Start with noise 1. The network says 0.5, then −0.2.
    # Step 1: ε = (1 − 0.5·0.5)/√0.75 = 0.8660254; next = 0.8·0.5 + 0.6·0.8660254 = 0.9196152.
    # Step 2: the clean image −0.2, whatever ε.
    schedule = DdimSchedule(np.array([999, 499]), np.array([0.25, 0.64]), np.array([0.64, 1.0]))
    seen: list[tuple[float, int]] = []

    def denoise(noisy: Image32, step: int) -> Image32:
        seen.append((float(noisy[0]), step))
        return np.array([0.5 if step == 999 else -0.2], np.float32)

    result = ddim_sample(denoise, np.array([1.0], np.float32), schedule)
    assert seen == [(1.0, 999), (pytest.approx(0.9196152, abs=1e-6), 499)]
    np.testing.assert_allclose(result, [-0.2], rtol=1e-6)


def test_noise_is_recomputed_from_the_clipped_image() -> None:
    # The network says 3, clipped to 1: ε = (1 − 0.5·1)/√0.75 = 0.5773503; next = 0.8 + 0.6·0.5773503 = 1.1464102.
    schedule = DdimSchedule(np.array([999, 499]), np.array([0.25, 0.64]), np.array([0.64, 1.0]))
    seen = []

    def denoise(noisy: Image32, step: int) -> Image32:
        seen.append(float(noisy[0]))
        return np.array([3.0], np.float32)

    result = ddim_sample(denoise, np.array([1.0], np.float32), schedule)
    assert seen[1] == pytest.approx(1.1464102, abs=1e-6)
    assert result[0] == 1.0


@pytest.mark.parametrize("count", [1, 2, 3, 8, 50, 1000])
def test_a_network_that_knows_the_truth_gives_it_at_any_step_count(count: int) -> None:
    truth = np.random.default_rng(1).uniform(-1, 1, (3, 1, 32, 32)).astype(np.float32)
    noise = np.random.default_rng(2).standard_normal(truth.shape).astype(np.float32)
    alpha_bar = cosine_alpha_bar()

    def denoise(noisy: Image32, step: int) -> Image32:
        # What the sampler feeds is exactly the forward process of the truth with the start noise; at 999 hardly
        # any signal is left in the start.
        forward = np.sqrt(alpha_bar[step]) * truth + np.sqrt(1 - alpha_bar[step]) * noise
        np.testing.assert_allclose(noisy, forward, atol=2e-4)
        return truth

    np.testing.assert_array_equal(ddim_sample(denoise, noise, ddim_schedule(count)), truth)


def test_the_start_is_standard_normal_and_always_the_same() -> None:
    noise = start_image(32, noise=True)
    assert noise.shape == (32, 32)
    np.testing.assert_array_equal(noise, start_image(32, noise=True))
    assert not start_image(32, noise=False).any()
    assert abs(noise.mean()) < 0.1
    assert noise.std() == pytest.approx(1.0, abs=0.1)


@pytest.mark.parametrize("count", [0, 1, 16])
def test_one_batch_over_all_robots(tiny_bundle: Path, count: int) -> None:
    exo2ego = OnnxExo2Ego(load_bundle(tiny_bundle))
    egos = exo2ego.synthesise([_request(str(i), i / 16) for i in range(count)])
    assert egos.shape == (count, 32, 32)
    assert egos.dtype == np.float32
    for i, ego in enumerate(egos):
        np.testing.assert_allclose(ego, 2 * i / 16 - 1, atol=1e-6)  # the tiny model: the crop, mapped to [−1, 1]


def test_training_needs_no_onnxruntime() -> None:
    code = "import sys; from revnm_server.stages import exo2ego; from revnm_server.networks import manifest; "
    code += "sys.exit('onnxruntime' in sys.modules)"
    assert subprocess.run([sys.executable, "-c", code], timeout=60).returncode == 0
