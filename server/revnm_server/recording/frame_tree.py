"""The coordinate frames of a record, as a tree that viewers can follow.

``floor`` is the root, the camera's own floor frame; below it stand the camera and every robot whose place is known, as
``ROBOT/base_link``, with the origin of its odometry, ``ROBOT/odom``, below it, so that both hang on what was seen.
Frames that a robot names in its own messages lie on these, where they are not taken by another robot.
"""

from __future__ import annotations

from revnm_client.cdr import ROBOT_FRAME
from revnm_client.geometry import Pose2
from revnm_server.recording import topics
from revnm_server.recording.heard_log import Listening
from revnm_server.recording.ros import Transform, frames_of
from revnm_server.recording.wire_tap import WireEntry
from revnm_server.tick.site_report import SiteReport

FLOOR = "floor"


class FrameTree:
    """Learns frames from what is recorded. Used by one thread.

    Args:
        camera: The camera's name, which is its optical frame's, too.
        robots: The robots' names; plans say ``base_link`` whoever they are for, which is the first one's.
    """

    def __init__(self, camera: str, robots: tuple[str, ...]) -> None:
        self._camera = camera
        self._bound: dict[str, str] = {}
        self._heard: set[tuple[str, str]] = set()
        self._odometry: dict[str, Pose2] = {}
        for robot in robots[:1]:
            self._bind(ROBOT_FRAME, robot_frame(robot))

    @property
    def still(self) -> list[Transform]:
        """The frames that lie on others for good."""
        return [Transform(parent, child) for child, parent in self._bound.items()]

    def learn(self, entry: WireEntry) -> bool:
        """Look at the first message of each topic; return whether it names a frame that is new.

        Raises:
            MessageError: It is malformed.
        """
        topic, robot = entry.topic, entry.robot
        if (robot, topic.name) in self._heard:
            return False
        if topic == topics.scan(robot):
            parents = [robot_frame(robot)]
        elif topic == topics.odometry(robot):
            parents = [odometry_frame(robot), robot_frame(robot)]
        else:
            return False
        named = frames_of(entry.payload, topic.type)
        self._heard.add((robot, topic.name))
        before = len(self._bound)
        for child, parent in zip(named, parents, strict=True):
            self._bind(child, parent)
        return len(self._bound) > before

    def hear(self, listenings: tuple[Listening, ...]) -> None:
        """Take what a tick heard."""
        for robot, heard in listenings:
            if heard.odometry:
                self._odometry[robot] = heard.odometry[-1].odom_from_robot

    def moving(self, site: SiteReport) -> list[Transform]:
        """Return where camera and robots are, as far as it is known."""
        found = []
        if site.calibration.camera is not None:
            found.append(Transform.of_camera(FLOOR, self._camera, site.calibration.camera))
        for robot, floor_from_robot in site.places.items():
            found.append(Transform.planar(FLOOR, robot_frame(robot), floor_from_robot))
            if robot in self._odometry:
                robot_from_odom = self._odometry[robot].inverse()
                found.append(Transform.planar(robot_frame(robot), odometry_frame(robot), robot_from_odom))
        return found

    def _bind(self, child: str, parent: str) -> None:
        if child and child not in self._bound and child not in (parent, FLOOR, self._camera):
            self._bound[child] = parent


def robot_frame(robot: str) -> str:
    """Return the name of a robot's frame in the record."""
    return f"{robot}/{ROBOT_FRAME}"


def odometry_frame(robot: str) -> str:
    """Return the name of the frame in which a robot's odometry counts."""
    return f"{robot}/odom"
