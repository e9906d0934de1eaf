"""Where the floor is in a disparity of unknown scale and shift: one-sided robust regression.

On the floor d = a · nearness + b, nearness = 1 / depth of the floor along the view. Whatever stands on the floor is
nearer than it, so obstacles lie on one side of the line however much of the picture they fill, and next to nothing
lies on the other side.
"""

from __future__ import annotations

import math
from functools import cached_property
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from revnm_client.geometry import FloatArray
from revnm_server.mapping.lift_kernels import votes
from revnm_server.order_statistics import median, quantiles

_TOLERANCES = (0.02, 0.005)  # of the disparity's span, at the start
_SHARP = 0.004  # of the span: a floor that scatters less needs no second look
_BELOW_SPAN = 0.04
_LEAST_SIGMA = 2e-4  # of the span
_ROUNDS = 10
_SAMPLES = 700  # pixels that judge a guess
_BINS = 12
_LEVELS = (0.04, 0.2)  # quantiles of the disparity in a bin that may be floor
_LEAST_PIXELS = 60
_LEAST_SHARE = 0.08
_MOST_BELOW = 0.12
_LEAST_CONTRAST = 8.0


class FloorLine(NamedTuple):
    """d = scale · nearness + shift.

    Attributes:
        scale: Positive; disparity units times metres.
        shift: Disparity units.
        sigma: Standard deviation of the floor's disparity about the line, disparity units.
        share: Of the pixels below the horizon that lie on the line.
    """

    scale: float
    shift: float
    sigma: float
    share: float

    @property
    def nearness_sigma(self) -> float:
        """Noise of the depth: standard deviation of the floor's nearness about the line, 1/m."""
        return self.sigma / self.scale


def fit_floor(nearness: FloatArray, disparity: FloatArray, previous: FloorLine | None = None) -> FloorLine | str:
    """Fit the line.

    Args:
        nearness: (M,), 1/m, of the floor at pixels below the horizon.
        disparity: (M,), at the same pixels, none of them clipped.
        previous: The fit of a picture before in the same units: where to start.

    Returns:
        The line, or why none is credible.
    """
    if len(nearness) < _LEAST_PIXELS:
        return f"the floor cannot be seen: {len(nearness)} usable pixels below the horizon"
    low, high = quantiles(disparity, (0.01, 0.99))
    span = float(high - low)
    if not span > 1e-6 * max(abs(float(high)), 1e-6):
        return "the depth picture is flat"
    best = _best(nearness, disparity, span, previous)
    if best is None:
        return "no floor in the depth picture: nothing below the horizon gets nearer towards the camera"
    line, below = best
    return _doubt(line, below, nearness, disparity) or line


def _best(
    nearness: FloatArray, disparity: FloatArray, span: float, previous: FloorLine | None
) -> tuple[FloorLine, float] | None:
    """Return the likeliest line and the share of pixels below it.

    Where things of the floor's own slope fill most of the picture, a wide look takes them and the floor for one
    scattered plane; a narrow one finds the floor alone. Which is likelier if all else is spread evenly over the span?
    """
    found: list[tuple[FloorLine, float]] = []
    starts = _Starts(nearness, disparity, previous)
    for tolerance in _TOLERANCES:
        start = starts.best(tolerance * span)
        if start is not None:
            found.append(_refine(nearness, disparity, start, span, tolerance))
            if found[-1][0].sigma < _SHARP * span:
                break
    return max(found, key=lambda fit: fit[0].share * math.log(span / fit[0].sigma), default=None)


class _Starts:
    """Where to start from."""

    def __init__(self, nearness: FloatArray, disparity: FloatArray, previous: FloorLine | None) -> None:
        self._nearness, self._disparity, self._previous = nearness, disparity, previous
        step = max(1, len(nearness) // _SAMPLES)
        self._few = nearness[::step].astype(np.float32), disparity[::step].astype(np.float32)

    def best(self, tolerance: float) -> tuple[float, float] | None:
        """Return scale and shift of the best guess, None without one; the previous fit if it still holds."""
        previous = self._previous
        if previous is not None:
            kept = np.array([[previous.scale, previous.shift]])
            score = _scores(kept, *self._few, tolerance)[0]
            if score >= 0.7 * previous.share * len(self._few[0]):
                return previous.scale, previous.shift
        if not len(self._guesses):
            return None
        best = self._guesses[int(np.argmax(_scores(self._guesses, *self._few, tolerance)))]
        return float(best[0]), float(best[1])

    @cached_property
    def _guesses(self) -> FloatArray:
        return _guesses(self._nearness, self._disparity)


def _guesses(nearness: FloatArray, disparity: FloatArray) -> FloatArray:
    """Return lines (G, 2) through pairs of what may be floor: low disparities of different distances."""
    order = np.argsort(nearness)
    points = []
    for part in np.array_split(order, _BINS):
        lower, upper = nearness[part[0]], nearness[part[-1]]
        # Within a bin the floor itself slopes: its slope is nearly that of the far ends, so it is left in.
        values = quantiles(disparity[part], _LEVELS)
        middle = 0.5 * (lower + upper)
        points += [(middle, values[0]), (middle, values[1]), (lower, values[0])]
    found = np.array(points)
    i, j = np.triu_indices(len(found), 3)
    run, rise = found[j, 0] - found[i, 0], found[j, 1] - found[i, 1]
    fits = (run > 1e-3) & (rise > 0.0)
    scale = rise[fits] / run[fits]
    return np.column_stack([scale, found[i[fits], 1] - scale * found[i[fits], 0]])


def _scores(
    lines: FloatArray, nearness: NDArray[np.float32], disparity: NDArray[np.float32], tolerance: float
) -> NDArray[np.int64]:
    """Return how many pixels lie on lines (G, 2), less those below, (G,)."""
    return votes((lines / tolerance).astype(np.float32), nearness, disparity / np.float32(tolerance))


def _refine(
    nearness: FloatArray, disparity: FloatArray, start: tuple[float, float], span: float, tolerance: float
) -> tuple[FloorLine, float]:
    """Reweight least squares (Tukey's biweight); return the line and the share of pixels below it."""
    scale, shift = start
    sigma, least = tolerance * span, _LEAST_SIGMA * span
    rest = disparity - scale * nearness - shift
    for _ in range(_ROUNDS):
        near = np.abs(rest) < 3.0 * sigma
        weight = np.where(near, np.square(1.0 - np.square(rest / (3.0 * sigma))), 0.0)
        total = weight.sum()
        if total < 2.0:
            break
        mean_n, mean_d = (weight @ nearness) / total, (weight @ disparity) / total
        spread = weight @ np.square(nearness - mean_n)
        scale = float(weight @ ((nearness - mean_n) * (disparity - mean_d)) / max(spread, 1e-12))
        shift = float(mean_d - scale * mean_n)
        rest = disparity - scale * nearness - shift
        core = np.abs(rest[np.abs(rest) < 3.0 * sigma])
        before, sigma = sigma, max(1.4826 * median(core) if len(core) else sigma, least)
        if 0.98 < sigma / before < 1.02:
            break
    share = float((np.abs(rest) < 3.0 * sigma).mean())
    below = float((rest < -max(4.0 * sigma, _BELOW_SPAN * span)).mean())
    return FloorLine(max(scale, 1e-12), shift, sigma, share), below


def _doubt(line: FloorLine, below: float, nearness: FloatArray, disparity: FloatArray) -> str | None:
    """Return why a line is not credible, or None."""
    rest = np.abs(disparity - line.scale * nearness - line.shift)
    on = nearness[rest < 3.0 * line.sigma]
    if line.share < _LEAST_SHARE or len(on) < _LEAST_PIXELS // 2:
        return f"no floor in sight: {line.share:.0%} of the pixels below the horizon lie on a plane"
    if below > _MOST_BELOW:
        return f"the depth picture does not fit the floor: {below:.0%} of it would lie under the floor"
    low, high = quantiles(on, (0.1, 0.9))
    contrast = line.scale * float(high - low) / line.sigma
    if contrast < _LEAST_CONTRAST:
        return f"the depth picture is noise: the floor stands out {contrast:.1f} times from it"
    return None
