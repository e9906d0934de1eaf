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
        findings: list[Finding] = []
        session = _reached("server", settings.server, findings, stack)
        server = None if session is None else _server(session, settings.robot, stack)
        senses = _senses(settings, session, server, findings, stack)
        if server is not None or senses is not None:
            findings += examine(observe(senses, server, options.seconds), settings)
    _print(findings)
    return SICK if any(each.verdict is Verdict.FAULT for each in findings) else 0


def _reached(
    subject: str, endpoints: tuple[str, ...], findings: list[Finding], stack: ExitStack
) -> zenoh.Session | None:
    """Return a session, or None where nobody answers in three seconds; say so among the findings."""
    stop = threading.Event()
    timer = threading.Timer(_OPEN_S, stop.set)
    timer.daemon = True
    try:
        problem = unreachable(endpoints)
        if problem is not None:
            raise LinkError(problem)
        timer.start()
        session = stack.enter_context(open_client(endpoints, stop=stop))
    except LinkError as error:
        findings.append(Finding(Verdict.FAULT, subject, str(error)))
        return None
    finally:
        timer.cancel()
    findings.append(Finding(Verdict.OK, subject, f"reached at {', '.join(endpoints)}"))
    return session


def _server(session: zenoh.Session, robot: str, stack: ExitStack) -> Server:
    ears, probe = ServerEars(session, robot), ClockProbe(session, robot)
    return Server(stack.enter_context(ears), stack.enter_context(probe))


def _senses(
    settings: RobotSettings,
    session: zenoh.Session | None,
    server: Server | None,
    findings: list[Finding],
    stack: ExitStack,
) -> Senses | None:
    """Return what sees by the robot's LiDAR; None where that cannot be reached.

    A bridge's keys are only listened to. Another driver is opened, unless a client runs that has it open and sends on
    what it says.
    """
    kind, options = settings.driver.kind, settings.driver.options
    if kind == "zenoh" and "connect" in options:
        session = _reached("robot's router", options["connect"], findings, stack)
    if session is None:
        return None
    if kind == "zenoh" or (server is not None and observe(None, server, _CLIENT_S).state is not None):
        return stack.enter_context(closing(KeySenses.of(session, settings.robot)))
    try:
        driver = open_driver(kind, options, DriverContext(settings.robot, session))
    except LinkError as error:
        findings.append(Finding(Verdict.FAULT, f"driver {kind}", str(error)))
        return None
    return stack.enter_context(closing(driver))


def _print(findings: list[Finding]) -> None:
    width = max(len(each.subject) for each in findings)
    for each in findings:
        print(f"{each.verdict.value:5}  {each.subject:{width}}  {each.text}")
    print("Whether the base obeys was not tried: the doctor never moves a robot.")
