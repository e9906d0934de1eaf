"""A server as a process that can be killed and started again, and what one asks of it over HTTP."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import httpx
from tests.server.tiny_bundle import write_tiny_bundle
from tests.server.waiting import eventually

from revnm_sim.simulation import TAG_ID

from .hall import CAMERA, ROBOT, SCENARIO, pixel_of
from .process import Process


class Server:
    """The server of one camera and one robot, with the tiny bundle.

    Attributes:
        process: The one that was started last.
        listen: Where it listens, from its next start on.
        url: Address of page and API.
        camera: Address of its camera.
    """

    def __init__(
        self,
        folder: Path,
        *,
        listen: str,
        http: str,
        camera: str = f"zenoh://{CAMERA}",
        options: Sequence[str] = (),
        prefix: Sequence[str] = (),
    ) -> None:
        """Prepare it.

        Args:
            folder: For the bundle, the log and the state file.
            listen: Zenoh endpoint.
            http: Host and port of page and API.
            camera: Address of the camera.
            options: More for the command.
            prefix: What stands before the command, as :class:`Process` takes it.
        """
        self.process: Process
        self.listen, self.url = listen, f"http://{http}"
        self.camera = camera
        self._folder, self._options, self._prefix = folder, options, prefix
        self._bundle = write_tiny_bundle(folder / "bundle")
        self._http = httpx.Client(base_url=self.url, timeout=5.0, trust_env=False)

    def start(self) -> Process:
        """Start it and wait until it answers; also after it was killed."""
        arguments = ["serve", "--listen", self.listen, "--http", self.url.removeprefix("http://")]
        arguments += ["--camera", self.camera, "--robot", f"{ROBOT}={TAG_ID}"]
        arguments += ["--bundle", str(self._bundle), "--state-file", str(self.state_file), *self._options]
        self.process = Process("revnm-server", arguments, log=self._folder / "server.log", prefix=self._prefix)
        eventually(self._answers, within_s=90.0)
        return self.process

    @property
    def state_file(self) -> Path:
        """Where it keeps goals and stops."""
        return self._folder / "state.json"

    def call(self, method: str, path: str, **options: Any) -> httpx.Response:
        """Call the API."""
        return self._http.request(method, path, **options)

    def state(self) -> dict[str, Any]:
        """Return its state."""
        document: dict[str, Any] = self.call("GET", "/api/v1/state").json()
        return document

    def rover(self) -> dict[str, Any]:
        """Return what it knows of the robot."""
        view: dict[str, Any] = self.state()["robots"][0]
        return view

    def ready(self) -> bool:
        """Whether it would drive the robot now."""
        return self.call("GET", "/readyz").status_code == 200

    def set_goal(self, place_m: tuple[float, float] = SCENARIO.goal_m) -> httpx.Response:
        """Send the robot to a place on the floor, as a click would."""
        u, v = pixel_of(place_m)
        return self.call("PUT", f"/api/v1/robots/{ROBOT}/goal", json={"u": u, "v": v})

    def close(self) -> None:
        """End it."""
        if hasattr(self, "process"):
            self.process.__exit__()
        self._http.close()

    def _answers(self) -> bool:
        self.process.check()
        try:
            return self.call("GET", "/healthz").status_code == 200
        except httpx.TransportError:
            return False
