"""Gathers what is known of camera, robots and ticks into one :class:`revnm_server.views.view.ServerView`."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence

from revnm_client import keys
from revnm_server.camera import CameraSource, CameraState, CameraStatus
from revnm_server.robots.mission import Mission
from revnm_server.robots.orders import OrderCourier
from revnm_server.robots.robot_link import RobotLink
from revnm_server.tick.site_report import SiteReport
from revnm_server.tick.tick_memory import Remembered, TickMemory
from revnm_server.views.robot_overview import LastOfRobot, robot_view
from revnm_server.views.view import CalibrationView, CameraView, RecordingView, RobotView, ServerView, rounded

_ALIVE_S = 3.0


class Overview:
    """Answers what there is to show. Thread-safe.

    Args:
        camera: For its status.
        mission: For what is wanted.
        links: For what the robots say.
        courier: For what they replied.
        ticks: For what they left.
        tag_size_m: Side of the robots' tags, for drawing paths.
        robot_size_m: Length and width of a robot, for drawing it.
        notes: Tells of what is odd about how the server was put together.
        recording: Tells of the run record.
    """

    def __init__(
        self,
        camera: CameraSource,
        mission: Mission,
        links: Mapping[str, RobotLink],
        courier: OrderCourier,
        ticks: TickMemory,
        *,
        tag_size_m: float,
        robot_size_m: tuple[float, float],
        notes: Callable[[], Sequence[str]] = tuple,
        recording: Callable[[], RecordingView] | None = None,
    ) -> None:
        self._camera = camera
        self._mission = mission
        self._links = links
        self._courier = courier
        self._ticks = ticks
        self._tag_size_m, self._robot_size_m = tag_size_m, robot_size_m
        self._notes = notes
        self._recording = recording

    def view(self) -> ServerView:
        """Return what there is to show now; never waits for the tick, the network or the disk."""
        status, ticks = self._camera.status(), self._ticks.remembered()
        trouble = ticks.fault if status.state is CameraState.RUNNING else _camera_trouble(status)
        robots = [
            robot_view(
                self._links[robot],
                self._mission.of(robot),
                LastOfRobot.of(robot, ticks),
                trouble=trouble,
                refused=self._courier.refusal(robot),
                size_px=status.size_px,
                tag_size_m=self._tag_size_m,
                seq=self._mission.seq(robot),
            )
            for robot in self._mission.names
        ]
        return self._assemble(status, ticks, robots)

    def _assemble(self, status: CameraStatus, ticks: Remembered, robots: list[RobotView]) -> ServerView:
        site, reasons, frame = ticks.site, self._unready(status, ticks.fault), self._camera.latest()
        recording = self._recording() if self._recording is not None else None
        return ServerView(
            camera=CameraView(
                url=self._camera.redacted_url,
                state=status.state.value,
                size_px=status.size_px,
                fps=rounded(status.fps, 1),
                frame_age_s=rounded(status.frame_age_s, 3),
                frame_stamp_ms=round(frame.stamp_ns / 1e6, 1) if frame is not None else None,
                reason=status.reason,
                calibration=CalibrationView.of(site.calibration) if site is not None else None,
            ),
            robots=robots,
            timings_ms=ticks.timings,
            ready=not reasons,
            reasons=reasons,
            warnings=self._warnings(status, site, recording),
            rejected=self._rejected(status) | (site.rejected if site is not None else {}),
            robot_size_m=self._robot_size_m,
            recording=recording,
        )

    def _warnings(self, status: CameraStatus, site: SiteReport | None, recording: RecordingView | None) -> list[str]:
        unrecorded = recording.reason if recording is not None else None
        passing = [text for text in (status.warning, self._mission.save_error, unrecorded) if text is not None]
        return [*self._notes(), *passing, *(site.warnings if site is not None else ())]

    def _rejected(self, status: CameraStatus) -> dict[str, int]:
        counts = self._courier.rejected
        for link in self._links.values():
            counts |= link.rejected
        scheme, _, name = self._camera.redacted_url.partition("://")
        if scheme == "zenoh":
            counts[keys.image(name)] = status.rejected
        return counts

    def _unready(self, status: CameraStatus, fault: str | None) -> list[str]:
        reasons = []
        if status.state is not CameraState.RUNNING:
            reasons.append(_camera_trouble(status))
        if fault is not None:
            reasons.append(fault)
        ages = [link.state_age_s for link in self._links.values()]
        if not any(age is not None and age <= _ALIVE_S for age in ages):
            names = ", ".join(self._links) or "none is configured"
            reasons.append(f"no robot reports its state: {names}")
        return reasons


def _camera_trouble(status: CameraStatus) -> str:
    return f"camera {status.state.value}: {status.reason}"
