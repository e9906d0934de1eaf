"""Once a second: keeps the LiDAR running, and asks the robot how it is."""

from __future__ import annotations

import logging
import threading

import grpc

from revnm_client.drivers.kachaka.api import KachakaApi

_log = logging.getLogger(__name__)

_PERIOD_S = 1.0
_DEADLINE_S = 0.3
_LIDAR_S = 5.0  # a robot that idles stops its LiDAR


class Health:
    """What the robot says of itself, kept fresh by a thread."""

    def __init__(self, api: KachakaApi) -> None:
        self._api = api
        self._trouble: str | None = "the robot has not answered yet"
        self._stop = threading.Event()
        self._thread = threading.Thread(target=self._run, name="kachaka health")
        self._thread.start()

    def trouble(self) -> str | None:
        """Return its errors, or that it does not answer; None where all is well."""
        return self._trouble

    def close(self) -> None:
        """Stop; takes no longer than the deadlines of two calls."""
        self._stop.set()
        self._thread.join()

    def _run(self) -> None:
        while not self._stop.is_set():
            try:
                self._trouble = self._ask()
            except grpc.RpcError as error:
                self._trouble = f"the robot does not answer: {error.code().name}"
            except Exception as error:  # the outermost loop of this thread: the robot stands, and it goes on
                self._trouble = f"the driver failed: {error!r:.200}"
                _log.exception("cannot ask the robot how it is")
            self._stop.wait(_PERIOD_S)

    def _ask(self) -> str | None:
        codes = self._api.get("GetError", 0, timeout_s=_DEADLINE_S).error_codes
        self._api.set("ActivateLaserScan", duration_sec=_LIDAR_S, timeout_s=_DEADLINE_S)
        return f"the robot reports error {', '.join(map(str, codes[:5]))}" if codes else None
