"""How far predicted waypoints are from the expert's."""

from __future__ import annotations

import numpy as np

from revnm_server.observation import Image32

_SHORTEST_M = 0.2


def waypoint_errors(predicted: Image32, true: Image32) -> dict[str, float]:
    """Compare waypoints (M, H, 2), metres.

    Returns:
        ``l1_m`` over all coordinates; ``waypoint_1_m`` … the mean distance of each waypoint; ``first_deg`` and
        ``last_deg``, the mean angle between the directions to the first and to the last, where that is far enough.
    """
    distance = np.linalg.norm(predicted - true, axis=2).mean(axis=0)
    measured = {"l1_m": float(np.abs(predicted - true).mean())}
    measured |= {f"waypoint_{i + 1}_m": float(value) for i, value in enumerate(distance)}
    for name, place in (("first_deg", 0), ("last_deg", -1)):
        a, b = predicted[:, place], true[:, place]
        far = np.linalg.norm(b, axis=1) > _SHORTEST_M
        turn = np.arctan2(a[far, 0] * b[far, 1] - a[far, 1] * b[far, 0], (a[far] * b[far]).sum(axis=1))
        measured[name] = float(np.degrees(np.abs(turn)).mean())
    return measured
