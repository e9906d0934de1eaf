"""What the paper reports, to stand beside our figures (tables I and II; 250 trials, 95 % intervals as half widths)."""

from __future__ import annotations

from collections.abc import Mapping
from types import MappingProxyType
from typing import NamedTuple


class PaperFigure(NamedTuple):
    """One cell of the paper's tables: success rate and SPL, each with its half width."""

    success_rate: float
    success_half: float
    spl: float
    spl_half: float

    def __str__(self) -> str:
        return f"{self.success_rate:.2f} ± {self.success_half:.2f} / {self.spl:.2f} ± {self.spl_half:.2f}"


_TABLES = {
    "random_pillar": {
        "nomad_without_fine_tuning": (0.05, 0.03, 0.02, 0.01),
        "nomad_fine_tuned": (0.40, 0.03, 0.33, 0.03),
        "ibvs": (0.78, 0.02, 0.61, 0.05),
        "revnm": (0.88, 0.03, 0.78, 0.03),
        "no_exo2ego": (0.91, 0.03, 0.79, 0.03),
        "oracle_ego": (0.99, 0.01, 0.89, 0.01),
        "no_dagger": (0.87, 0.04, 0.69, 0.04),
    },
    "bookstore": {
        "nomad_without_fine_tuning": (0.18, 0.05, 0.08, 0.02),
        "nomad_fine_tuned": (0.22, 0.03, 0.09, 0.02),
        "ibvs": (0.75, 0.05, 0.53, 0.04),
        "revnm": (0.88, 0.05, 0.65, 0.05),
        "no_exo2ego": (0.84, 0.05, 0.61, 0.05),
        "oracle_ego": (0.90, 0.04, 0.78, 0.04),
        "no_dagger": (0.74, 0.06, 0.59, 0.06),
    },
    "warehouse": {
        "nomad_without_fine_tuning": (0.20, 0.05, 0.08, 0.02),
        "nomad_fine_tuned": (0.22, 0.04, 0.09, 0.02),
        "ibvs": (0.52, 0.07, 0.36, 0.06),
        "revnm": (0.70, 0.06, 0.46, 0.05),
        "no_exo2ego": (0.26, 0.08, 0.17, 0.06),
        "oracle_ego": (0.83, 0.05, 0.58, 0.05),
        "no_dagger": (0.43, 0.06, 0.29, 0.05),
    },
}

PAPER: Mapping[tuple[str, str], PaperFigure] = MappingProxyType(
    {(world, method): PaperFigure(*cell) for world, table in _TABLES.items() for method, cell in table.items()}
)
"""By world and method."""

DIFFERENCES = (
    "The paper's trials are not ours. It simulates in Gazebo, we in PyBullet; its random pillars come from its own "
    "generator; its bookstore and warehouse are the original meshes, ours are boxes and cylinders of the same "
    "measures. Ours are harder: unless `--pairs any` is set, something stands in the straight way of every drawn "
    "pair, and the shortest way is longer by 0.1 m, in the bookstore by 2.0 m and in the warehouse by 1.5 m, so that "
    "going straight solves at most half; the paper does not say how often its straight ways are blocked. SPL refers "
    "to Nav2's path there and to our planner's here, which has Nav2's costs. Its depth comes from a monocular "
    "network; perception `truth` here is exact."
)
"""What must be read beside the two."""

METHOD_NOTES: Mapping[str, str] = MappingProxyType(
    {
        "revnm": "the server's pipeline with the bundle's models",
        "no_exo2ego": "the same models, with an ego depth that shows nothing; the paper trains a policy without it",
        "oracle_ego": "the same models, with the true ego depth",
        "no_dagger": "models trained without recovery data, from a bundle of their own",
        "bev": "the planner on a map of the camera's depth; calibrates itself anew in every trial, by the tag's "
        "corners with 0.5 px of noise while it is seen, and hears odometry and scans",
        "bev_no_lidar": "the same without scans in the map",
        "ibvs": "as the paper's, but the floor mask is the simulator's, not SAM 3's: an upper bound",
        "ibvs_scale": "the same mask, with a margin in metres and the tag's own scale",
        "straight": "makes for the goal and knows no obstacle: what the controller solves alone",
        "expert": "the planner on the true map: the ceiling",
    }
)
"""What each method is, for the report."""
