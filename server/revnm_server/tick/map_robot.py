"""A robot on the map: what it looks like, and what the navigator remembers of it."""

from __future__ import annotations

import math
from dataclasses import dataclass, field

from revnm_client.geometry import Pose2
from revnm_client.messages import Odometry, Scan
from revnm_server.calibration.keyframes import TagMount, Travel
from revnm_server.calibration.odometry_track import OdometryTrack
from revnm_server.calibration.places import Anchor
from revnm_server.frame import RobotSighting
from revnm_server.mapping.floor_map import Body
from revnm_server.mapping.scan_trail import ScanTrail
from revnm_server.planning.goal_search import GoalSearch
from revnm_server.planning.map_planner import MapPlanner
from revnm_server.tick.standing_tag import StandingTag


@dataclass(frozen=True, slots=True)
class RobotShape:
    """What the map must know of a robot.

    Attributes:
        mount: Its tag.
        length_m: Along its heading, the tag in the middle.
        width_m: Across.
    """

    mount: TagMount
    length_m: float
    width_m: float

    def body(self, floor_from_robot: Pose2) -> Body:
        """Return the robot at a place."""
        return Body(floor_from_robot, self.length_m, self.width_m, self.mount.height_m)


@dataclass(slots=True)
class MapRobot:
    """What the navigator remembers of one robot.

    Attributes:
        shape: What it looks like.
        track: Its odometry.
        planner: Of its way.
        search: Where it looks for its goal.
        trail: Its scans.
        tag: Whether the picture shows it standing though it drives.
        scan: The newest.
        sighting: The last.
        seen: Its odometry then.
        driven: Where it was seen in this drive, by its odometry.
        drive: The drive in which it was seen last.
        anchor: Where it was before a restart, until it is seen.
    """

    shape: RobotShape
    track: OdometryTrack
    planner: MapPlanner
    search: GoalSearch = field(default_factory=GoalSearch)
    trail: ScanTrail = field(default_factory=ScanTrail)
    tag: StandingTag = field(default_factory=StandingTag)
    scan: Scan | None = None
    sighting: RobotSighting | None = None
    seen: Travel | None = None
    driven: list[Pose2] = field(default_factory=list)
    drive: int = -1
    anchor: Anchor = field(default_factory=lambda: Anchor(None))

    def hear(self, odometry: Odometry) -> None:
        """Take odometry."""
        self.track.push(odometry)
        self.anchor.hear(odometry, self.track.drive)

    def note_driven(self, odom_from_robot: Pose2, *, learning: bool) -> None:
        """Remember where the robot was seen in this drive; where nothing is to be learnt, only the last place."""
        if self.drive != self.track.drive or not learning:
            self.driven.clear()
        self.drive = self.track.drive
        self.driven.append(odom_from_robot)

    def hidden_m(self, travel: Travel) -> float:
        """Return how far the robot went since the camera saw it last; inf if that was not in this drive."""
        seen_now = self.seen is not None and self.drive == self.track.drive
        return travel.way_m - self.seen.way_m if seen_now and self.seen is not None else math.inf
