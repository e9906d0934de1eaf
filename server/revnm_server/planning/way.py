"""Ways: polylines (P, 2) on the floor, metres, first point first. Imports numpy only."""

from __future__ import annotations

import numpy as np

from revnm_client.geometry import FloatArray

SPACING_M = 0.05


def length_m(way_m: FloatArray) -> float:
    """Return the length of a way."""
    return float(np.hypot(*np.diff(way_m, axis=0).T).sum())


def at_lengths(way_m: FloatArray, lengths_m: FloatArray) -> FloatArray:
    """Return the points (K, 2) at lengths (K,) from the way's beginning, its end where it is shorter."""
    along = np.concatenate([[0.0], np.cumsum(np.hypot(*np.diff(way_m, axis=0).T))])
    return np.stack([np.interp(lengths_m, along, way_m[:, axis]) for axis in range(2)], axis=1)


def evenly(way_m: FloatArray, spacing_m: float = SPACING_M) -> FloatArray:
    """Return the way with points at equal lengths, at most ``spacing_m`` apart, at least two; both ends stay."""
    length = length_m(way_m)
    count = max(2, int(np.ceil(length / spacing_m - 1e-9)) + 1)
    return at_lengths(way_m, np.linspace(0.0, length, count))


def bent_to(way_m: FloatArray, begin_m: FloatArray, *, over_m: float) -> FloatArray:
    """Return the way moved so that it begins at a point (2,), and leads smoothly back within a length.

    Args:
        way_m: (P, 2), evenly spaced.
        begin_m: The new first point; near to the old one.
        over_m: The shift fades over so much of the way, as a raised cosine: level at both ends. On a shorter way it
            fades over the whole, so that the last point stays.
    """
    along = np.concatenate([[0.0], np.cumsum(np.hypot(*np.diff(way_m, axis=0).T))])
    reach = min(over_m, float(along[-1]))
    phase = np.clip(along / reach, 0.0, 1.0) if reach > 0.0 else np.minimum(np.arange(len(way_m)), 1.0)
    fade = 0.5 * (1.0 + np.cos(np.pi * phase))
    return np.asarray(way_m + fade[:, None] * (begin_m - way_m[0]))


def rest_of(way_m: FloatArray, place_m: FloatArray, *, within_m: float) -> FloatArray:
    """Return the way (at least two points) from its point nearest to a place, looked for in its first metres."""
    along = np.concatenate([[0.0], np.cumsum(np.hypot(*np.diff(way_m, axis=0).T))])
    searched = way_m[: max(1, int(np.searchsorted(along, within_m, side="right")))]
    nearest = int(np.argmin(np.hypot(*(searched - place_m).T)))
    return way_m[min(nearest, len(way_m) - 2) :]


def farthest_m(way_m: FloatArray, other_m: FloatArray) -> float:
    """Return how far a way (P, 2) gets from another (Q, 2): the greatest distance of its points to the other's."""
    apart = way_m[:, None] - other_m[None]
    return float(np.sqrt(np.square(apart).sum(axis=-1).min(axis=1).max()))
