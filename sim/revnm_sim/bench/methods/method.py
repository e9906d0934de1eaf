"""What every method of the benchmark is."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Literal, Protocol

from revnm_client.geometry import FloatArray
from revnm_client.messages import Odometry, Scan
from revnm_sim.expert.planner import CostToGo
from revnm_sim.scenario import Scenario
from revnm_sim.simulation import Simulation

Perception = Literal["truth", "models"]

WAYPOINTS = 5
SPACING_M = 0.4


@dataclass(frozen=True, slots=True)
class RobotFeed:
    """What the robot has sent since the method last looked; the method empties the lists.

    Attributes:
        odometry: Oldest first.
        scans: Oldest first.
    """

    odometry: list[Odometry] = field(default_factory=list)
    scans: list[Scan] = field(default_factory=list)


@dataclass(frozen=True, slots=True)
class MethodContext:
    """What a method may build on; how much of the truth it uses is its own affair, and is documented there.

    Attributes:
        scenario: World, camera, start and goal.
        simulation: The running trial.
        field: The expert's cost to the goal.
        perception: Whether depth comes from the simulator or from the rendered picture.
        bundle: Folder of the model bundle.
        feed: What the robot sends.
    """

    scenario: Scenario
    simulation: Simulation
    field: CostToGo
    perception: Perception
    bundle: str
    feed: RobotFeed


class Method(Protocol):
    """Tells the robot where to go."""

    def look(self) -> None:
        """Take the picture of this moment; the simulator's work, so its time is no part of a tick's."""
        ...

    def waypoints(self) -> FloatArray | None:
        """Return the waypoints (H, 2) as of now, metres, in the robot's frame; None for no plan."""
        ...
