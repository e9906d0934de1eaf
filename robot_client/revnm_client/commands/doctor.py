"""``revnm-robot doctor``: look at server, clock, LiDAR and odometry, and say what to mend. It never moves the robot."""

from __future__ import annotations

import argparse
import threading
from contextlib import ExitStack, closing

import zenoh

from revnm_client.clock_probe import ClockProbe
from revnm_client.commands.setting_options import add_setting_options, settings_of
from revnm_client.doctor import Finding, Server, Verdict, examine, observe, unreachable
from revnm_client.drivers import DriverContext, open_driver
from revnm_client.errors import LinkError
from revnm_client.link import open_client
from revnm_client.log_output import start_log
from revnm_client.senses import KeySenses, Senses
from revnm_client.server_ears import ServerEars
from revnm_client.settings import LogSettings, RobotSettings

SICK = 1

_OPEN_S = 3.0
_CLIENT_S = 1.2


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the options of the command."""
    add_setting_options(parser)
    parser.add_argument("--seconds", type=float, default=5.0, metavar="S", help="how long to look (5)")


def run(options: argparse.Namespace) -> int:
    """Print what was found; return 0, or 1 where something keeps the robot from driving.

    Raises:
        RevnmError: The settings are wrong; the text says what to mend.
    """
    settings = settings_of(options)
    start_log(LogSettings(level="error"))
    with ExitStack() as stack:
        visit = _Visit(settings, stack)
        server = visit.server()
        senses = visit.senses(server)
        if server is not None or senses is not None:
            visit.findings += examine(observe(senses, server, options.seconds), settings)
    _print(visit.findings)
    return SICK if any(each.verdict is Verdict.FAULT for each in visit.findings) else 0


class _Visit:
    """Goes to the server and to the robot's own router, and notes whether they answer.

    Attributes:
        findings: What was found so far.
    """

    def __init__(self, settings: RobotSettings, stack: ExitStack) -> None:
        """Prepare; what is opened is closed with ``stack``.

        Raises:
            FileError: The robot's password cannot be read.
        """
        self.findings: list[Finding] = []
        self._settings, self._stack = settings, stack
        self._credentials = settings.security.credentials(settings.robot)
        self._session = self._reached("server", settings.server)

    def server(self) -> Server | None:
        """Return what hears the server; None where it cannot be reached."""
        if self._session is None:
            return None
        session, robot = self._session, self._settings.robot
        enter = self._stack.enter_context
        return Server(enter(ServerEars(session, robot)), enter(ClockProbe(session, robot)))

    def senses(self, server: Server | None) -> Senses | None:
        """Return what sees by the robot's LiDAR; None where that cannot be reached.

        A bridge's keys are only listened to. Another driver is opened, unless a client runs that has it open and sends
        on what it says.
        """
        kind, options = self._settings.driver.kind, self._settings.driver.options
        robot, session = self._settings.robot, self._session
        if kind == "zenoh" and "connect" in options:
            session = self._reached("robot's router", options["connect"])
        if session is None:
            return None
        if kind == "zenoh" or (server is not None and observe(None, server, _CLIENT_S).state is not None):
            return self._stack.enter_context(closing(KeySenses.of(session, robot)))
        context = DriverContext(robot, session, credentials=self._credentials)
        try:
            return self._stack.enter_context(closing(open_driver(kind, options, context)))
        except LinkError as error:
            self.findings.append(Finding(Verdict.FAULT, f"driver {kind}", str(error)))
            return None

    def _reached(self, subject: str, endpoints: tuple[str, ...]) -> zenoh.Session | None:
        """Return a session, or None where nobody answers in three seconds; say so among the findings."""
        stop = threading.Event()
        timer = threading.Timer(_OPEN_S, stop.set)
        timer.daemon = True
        try:
            problem = unreachable(endpoints, self._credentials)
            if problem is not None:
                raise LinkError(problem)
            timer.start()
            session = open_client(endpoints, credentials=self._credentials, stop=stop)
        except LinkError as error:
            self.findings.append(Finding(Verdict.FAULT, subject, str(error)))
            return None
        finally:
            timer.cancel()
        self.findings.append(Finding(Verdict.OK, subject, f"reached at {', '.join(endpoints)}"))
        return self._stack.enter_context(session)


def _print(findings: list[Finding]) -> None:
    width = max(len(each.subject) for each in findings)
    for each in findings:
        print(f"{each.verdict.value:5}  {each.subject:{width}}  {each.text}")
    print("Whether the base obeys was not tried: the doctor never moves a robot.")
