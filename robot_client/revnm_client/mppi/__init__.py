"""The LiDAR controller: model predictive path integral control in plain numpy.

One concept a file: the distance field of the obstacles, the reference path, sampling, rollout, one critic
each, turning on the spot, and the controller that puts them together. Symbols: K samples, T steps, P path
points, M obstacle points. Everything lies in the robot frame of the current tick. Imports numpy and the
contract only. Speeds are never negative: driving backwards was not needed in any tested scene, and on many
robots the LiDAR does not see backwards. Backing off is :mod:`revnm_client.escape`'s.

Sources: Williams et al., "Information-theoretic MPC", doi:10.1109/TRO.2018.2865891; the cut into critics
follows ros-navigation/navigation2 ``nav2_mppi_controller``.
"""

from revnm_client.mppi.config import CriticWeights, Footprint, MppiConfig
from revnm_client.mppi.controller import Mppi, MppiInput

__all__ = ["CriticWeights", "Footprint", "Mppi", "MppiConfig", "MppiInput"]
