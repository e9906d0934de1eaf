"""What can fail while a robot drives, one at a time; and how the system bears it."""

from __future__ import annotations

import signal
import time
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from functools import partial

import numpy as np

from revnm_sim.live.demo import ROBOT
from revnm_sim.live.rtsp_server import Fault as CameraFault
from revnm_sim.live.simulator import Sensor
from revnm_sim.measures.camera_trial import BREAKAGES
from revnm_sim.soak.motion import last_motion_s
from revnm_sim.soak.system import System, wait

_HOLD_S = (3.0, 6.0)
_RESTART_S = (1.0, 1.0)  # RestartSec of the robot's systemd unit
_DELAY_S = 0.25
_NOTICE_S = 2.0
_PATIENCE_S = 30.0


@dataclass(frozen=True, slots=True)
class Fault:
    """Something that fails.

    Attributes:
        kind: Its name.
        begin: Makes it fail.
        end: Ends what made it fail; the system recovers by itself.
        hold_s: For how long it lasts, the least and the most; 0 is over at once.
        takes_plan: The robot must stand.
        kills: A process ends and is started again.
    """

    kind: str
    begin: Callable[[], None]
    end: Callable[[], None]
    hold_s: tuple[float, float] = _HOLD_S
    takes_plan: bool = True
    kills: bool = False


@dataclass(frozen=True, slots=True)
class FaultTiming:
    """How the system bore a fault.

    Attributes:
        kind: The fault's name.
        takes_plan: The robot had to stand.
        kills: A process was started again.
        stood_after_s: From the fault until the robot's last motion; None if it did not move.
        recovered_after_s: From the fault's end until the robot drove or had arrived; None if it did neither in 30 s.
    """

    kind: str
    takes_plan: bool
    kills: bool
    stood_after_s: float | None
    recovered_after_s: float | None


def faults_of(system: System, *, resume: Callable[[], None]) -> list[Fault]:
    """Return all that can fail.

    Args:
        system: What fails.
        resume: Lets a robot that the operator stopped go on to its goal.
    """
    children, network, live = system.children, system.network, system.live

    def silence(*sensors: Sensor) -> None:
        live.silent = frozenset(sensors)

    return [
        *_camera_faults(system),
        Fault("server_killed", partial(children.kill, "server"), partial(children.restart, "server"), kills=True),
        Fault(
            "server_frozen",
            partial(children.send_signal, "server", signal.SIGSTOP),
            partial(children.send_signal, "server", signal.SIGCONT),
        ),
        Fault(
            "robot_killed", partial(children.kill, "robot"), partial(children.restart, "robot"), _RESTART_S, kills=True
        ),
        Fault("network_refused", network.refuse, network.mend),
        Fault("network_blackhole", network.stop_up, network.mend),
        Fault("network_delayed", partial(network.delay, _DELAY_S), network.mend, takes_plan=False),
        Fault("scan_silent", partial(silence, "scan"), silence),
        Fault("odometry_silent", partial(silence, "odometry"), silence),
        Fault("operator_stop", partial(system.api.order, ROBOT, "stop"), resume),
    ]


def _camera_faults(system: System) -> Iterator[Fault]:
    """Yield the camera's; connections that are dropped come back at once, so that fault lasts until it is noticed."""
    camera = system.camera

    def mend() -> None:
        camera.set_fault(CameraFault.NONE)

    def drop() -> None:
        camera.drop()
        wait(lambda: not system.works(), within_s=_NOTICE_S)

    yield Fault("camera_dropped", drop, mend, (0.0, 0.0), takes_plan=False)
    for name, breakage in BREAKAGES.items():
        if name != "dropped":
            yield Fault(f"camera_{name}", partial(breakage, camera), mend)


def shuffled(faults: Sequence[Fault], rng: np.random.Generator) -> Iterator[Fault]:
    """Yield faults without end: each once in random order, then again in another."""
    while True:
        for index in rng.permutation(len(faults)):
            yield faults[index]


def inflict(fault: Fault, system: System, *, hold_s: float) -> FaultTiming:
    """Let a fault happen, last and end, and wait until the system works again.

    Raises:
        ChildError: A process has ended by itself.
        LinkError: The server takes no order of the operator's.
    """
    began_s = time.monotonic()
    with ThreadPoolExecutor(1) as pool:  # the robot may stand before a server has answered
        watched = pool.submit(last_motion_s, system.simulation, until_s=began_s + hold_s)
        fault.begin()
    fault.end()
    ended_s = time.monotonic()
    works = wait(system.works, within_s=_PATIENCE_S)
    return FaultTiming(
        fault.kind,
        fault.takes_plan,
        fault.kills,
        None if (moved_s := watched.result()) is None else moved_s - began_s,
        time.monotonic() - ended_s if works else None,
    )
