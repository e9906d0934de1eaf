"""What is measured between imagined and true ego depth; every number is defined here.

Symbols: M images, d features. Images are depth mapped to [0, 1], 1 at ``ego_range_m`` and beyond, at the size that
exo2ego gives.
"""

from __future__ import annotations

import numpy as np
from skimage.metrics import structural_similarity

from revnm_client.geometry import FloatArray
from revnm_training.quality.sectors import FREE_M, NEAR_M

KID_BLOCK = 500
_LEAST_MSE = 1e-9
_SSIM_WINDOW_PX = 7


def psnr_db(true: FloatArray, imagined: FloatArray) -> tuple[float, float]:
    """Return the peak signal-to-noise ratio of images (M, h, w) in [0, 1], decibels: 10 log10(1 / MSE).

    Returns:
        The mean of the images' own ratios, and the ratio of the MSE pooled over all pixels of all images. An MSE
        under 1e-9 counts as 1e-9 (90 dB).
    """
    error = ((imagined - true) ** 2).mean(axis=(1, 2))
    return float(_decibels(error).mean()), float(_decibels(error.mean()))


def _decibels(mse: FloatArray) -> FloatArray:
    return np.asarray(-10.0 * np.log10(np.maximum(mse, _LEAST_MSE)))


def mean_ssim(true: FloatArray, imagined: FloatArray) -> float:
    """Return the mean structural similarity of images (M, h, w) in [0, 1].

    Uniform 7 × 7 window, K1 = 0.01, K2 = 0.03, data range 1, sample covariance (Wang et al., 2004,
    doi:10.1109/TIP.2003.819861, as in ``skimage.metrics``).
    """
    values = [
        structural_similarity(a, b, win_size=_SSIM_WINDOW_PX, data_range=1.0, K1=0.01, K2=0.03)
        for a, b in zip(true, imagined, strict=True)
    ]
    return float(np.mean(values))


def frechet_distance(one: FloatArray, other: FloatArray) -> float:
    """Return the Fréchet distance of two sets of features (M, d), each taken for a Gaussian.

    |μ1 − μ2|² + Tr(Σ1 + Σ2 − 2 (Σ1 Σ2)^½) (Dowson and Landau, 1982), Σ with M − 1. The trace of the root is taken from
    the eigenvalues of Σ1^½ Σ2 Σ1^½, which is symmetric, so a degenerate Σ does no harm. M must be much more than d.
    """
    first, second = one.astype(np.float64), other.astype(np.float64)
    offset = first.mean(axis=0) - second.mean(axis=0)
    cov_first, cov_second = np.cov(first, rowvar=False), np.cov(second, rowvar=False)
    values, vectors = np.linalg.eigh(cov_first)
    root = (vectors * np.sqrt(np.maximum(values, 0.0))) @ vectors.T
    shared = np.sqrt(np.maximum(np.linalg.eigvalsh(root @ cov_second @ root), 0.0)).sum()
    return float(offset @ offset + np.trace(cov_first) + np.trace(cov_second) - 2.0 * shared)


def kernel_distance(one: FloatArray, other: FloatArray, *, block: int = KID_BLOCK) -> float:
    """Return the unbiased squared maximum mean discrepancy of two sets of features (M, d), the mean over blocks.

    Kernel (x·y / d + 1)³ (Bińkowski et al., 2018, arXiv:1801.01401). The sets are shuffled apart, so that an image
    hardly ever meets its own twin, and cut into disjoint blocks; a rest that fills no block is left out.

    Args:
        one: Features.
        other: As many.
        block: Items of a block; all where there are fewer.
    """
    size = min(block, len(one))
    first = one.astype(np.float64)[np.random.default_rng(0).permutation(len(one))]
    second = other.astype(np.float64)[np.random.default_rng(1).permutation(len(other))]
    starts = range(0, len(one) - size + 1, size)
    return float(np.mean([_mmd2(first[i : i + size], second[i : i + size]) for i in starts]))


def _mmd2(one: FloatArray, other: FloatArray) -> float:
    count, features = one.shape

    def kernel(x: FloatArray, y: FloatArray) -> FloatArray:
        return np.asarray((x @ y.T / features + 1.0) ** 3)

    within = [(k.sum() - np.trace(k)) / (count * (count - 1)) for k in (kernel(one, one), kernel(other, other))]
    return float(within[0] + within[1] - 2.0 * kernel(one, other).mean())


def sector_error_m(true_m: FloatArray, imagined_m: FloatArray) -> float:
    """Return the mean absolute error of the sectors' distances (M, 16), metres."""
    return float(np.abs(imagined_m - true_m).mean())


def false_free(true_m: FloatArray, imagined_m: FloatArray) -> tuple[float | None, int]:
    """Return how often a near obstacle is overlooked.

    Args:
        true_m: Distances of the sectors (M, 16), metres.
        imagined_m: The same of the imagined depth.

    Returns:
        Of the sectors that are truly free for less than 0.6 m, the share imagined free for more than 1.0 m, None
        where there is none; and their number.
    """
    near = true_m < NEAR_M
    count = int(near.sum())
    return (float((imagined_m[near] > FREE_M).mean()) if count else None), count
