"""What a rollout costs: one critic a file, each a pure function from (K, T) arrays to costs (K,)."""

from revnm_client.mppi.critics.align import align_cost
from revnm_client.mppi.critics.follow import follow_cost
from revnm_client.mppi.critics.heading import heading_cost
from revnm_client.mppi.critics.obstacle import obstacle_cost
from revnm_client.mppi.critics.turning import turning_cost

__all__ = ["align_cost", "follow_cost", "heading_cost", "obstacle_cost", "turning_cost"]
