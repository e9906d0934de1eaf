"""Runs a simulation in real time behind the same Zenoh keys as a real robot and a real camera."""

from __future__ import annotations

import dataclasses
import threading
import time
from collections.abc import Callable
from dataclasses import dataclass
from types import TracebackType
from typing import Literal, Self

import cv2
import numpy as np
import zenoh
from numpy.typing import NDArray

from revnm_client import cdr, keys
from revnm_client.link import Inbox, LatestSubscriber, control_publisher, image_publisher
from revnm_client.messages import CompressedImage
from revnm_sim.live.truth import Truth, encode_truth, truth_key
from revnm_sim.physics import TICK_NS
from revnm_sim.simulation import Simulation

MAX_LAG_NS = 250_000_000
_JPEG_QUALITY = 90
_SCAN_HZ, _ODOMETRY_HZ, _TRUTH_HZ = 10.0, 40.0, 5.0

Sensor = Literal["scan", "odometry"]


@dataclass(frozen=True, slots=True)
class LiveSettings:
    """Names and rates.

    Attributes:
        robot: The robot's name, first part of its keys.
        camera: The camera's name, first part of its key; None publishes no pictures.
        fps: Pictures per second.
    """

    robot: str
    camera: str | None
    fps: float = 5.0


class LiveSimulator:
    """Keeps a simulation in step with the clock, and publishes what its sensors measure.

    All stamps are wall-clock time of the simulated instant. When the machine is too slow, the simulation falls
    behind by at most ``MAX_LAG_NS`` and then skips time rather than hurrying after it.

    Attributes:
        silent: Sensors that publish nothing; may be changed at any time.
    """

    def __init__(
        self,
        simulation: Simulation,
        session: zenoh.Session,
        settings: LiveSettings,
        *,
        show: Callable[[NDArray[np.uint8]], None] | None = None,
    ) -> None:
        """Begin to listen; time starts to run now.

        Args:
            simulation: What to run.
            session: Where to publish.
            settings: Names and rates.
            show: Also gets each picture, (H, W, 3) RGB; must return soon.
        """
        self.silent: frozenset[Sensor] = frozenset()
        self._simulation, self._show = simulation, show
        # Render the still background and compile the ray caster before time starts to run.
        simulation.picture()
        simulation.scan()
        self._commands = LatestSubscriber(session, keys.cmd_vel(settings.robot))
        self._inbox = Inbox(self._commands, cdr.decode_velocity)
        self._image = image_publisher(session, keys.image(settings.camera)) if settings.camera is not None else None
        self._scan = control_publisher(session, keys.scan(settings.robot))
        self._odometry = control_publisher(session, keys.odom(settings.robot))
        self._truth = control_publisher(session, truth_key(settings.robot))
        self._jobs = [
            _Job(_ODOMETRY_HZ, self._publish_odometry),
            _Job(_SCAN_HZ, self._publish_scan),
            _Job(settings.fps, self._publish_picture),
            _Job(_TRUTH_HZ, self._publish_truth),
        ]
        self._start_ns = time.monotonic_ns() - simulation.time_ns

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self._commands.close()

    @property
    def rejected(self) -> int:
        """Velocity messages that were malformed and dropped."""
        return self._inbox.rejected

    def run(self, stop: threading.Event) -> None:
        """Run until ``stop`` is set."""
        while not stop.is_set():
            self._catch_up()
            self._obey()
            for job in self._jobs:
                job.run_if_due(self._simulation.time_ns)
            stop.wait(max(0.0, (TICK_NS - self._lag_ns()) * 1e-9))

    def _obey(self) -> None:
        velocity = self._inbox.take()
        if velocity is not None:
            self._simulation.command(velocity)

    def _lag_ns(self) -> int:
        """How far the simulation is behind the clock."""
        return time.monotonic_ns() - self._start_ns - self._simulation.time_ns

    def _catch_up(self) -> None:
        lag_ns = self._lag_ns()
        if lag_ns > MAX_LAG_NS:
            self._start_ns += lag_ns - MAX_LAG_NS
            lag_ns = MAX_LAG_NS
        for _ in range(lag_ns // TICK_NS):
            self._simulation.advance(TICK_NS * 1e-9)

    def _stamp_ns(self) -> int:
        """Wall-clock time of the simulated instant."""
        return time.time_ns() - self._lag_ns()

    def _publish_odometry(self) -> None:
        if "odometry" in self.silent:
            return
        odometry = dataclasses.replace(self._simulation.odometry(), stamp_ns=self._stamp_ns())
        self._odometry.put(cdr.encode_odometry(odometry))

    def _publish_scan(self) -> None:
        if "scan" in self.silent:
            return
        scan = dataclasses.replace(self._simulation.scan(), stamp_ns=self._stamp_ns())
        self._scan.put(cdr.encode_scan(scan))

    def _publish_picture(self) -> None:
        stamp_ns = self._stamp_ns()
        picture = self._simulation.picture()
        if self._show is not None:
            self._show(picture)
        if self._image is None:
            return
        bgr = cv2.cvtColor(picture, cv2.COLOR_RGB2BGR)
        _, jpeg = cv2.imencode(".jpg", bgr, [cv2.IMWRITE_JPEG_QUALITY, _JPEG_QUALITY])
        self._image.put(cdr.encode_image(CompressedImage(stamp_ns, "jpeg", jpeg.tobytes())))

    def _publish_truth(self) -> None:
        simulation = self._simulation
        pose = simulation.true_pose
        truth = Truth(
            x_m=pose.x_m,
            y_m=pose.y_m,
            yaw_rad=pose.yaw_rad,
            time_s=simulation.time_ns * 1e-9,
            path_m=simulation.path_m,
            closest_m=simulation.closest_m,
            contact=simulation.had_contact,
            rejected=self.rejected,
        )
        self._truth.put(encode_truth(truth))


class _Job:
    """Something to do at a rate in simulated time; when late it is done once, not several times."""

    def __init__(self, rate_hz: float, action: Callable[[], None]) -> None:
        self._period_ns = round(1e9 / rate_hz)
        self._action = action
        self._next_ns = 0

    def run_if_due(self, time_ns: int) -> None:
        """Do it if its time has come."""
        if time_ns >= self._next_ns:
            self._next_ns += self._period_ns
            if self._next_ns <= time_ns:
                self._next_ns = time_ns + self._period_ns
            self._action()
