"""``revnm-server doctor``: look at camera, tags, models, tick and robots, and say what to mend.

Looks at the server that runs with these settings, or, where none does, at one of its own that drives nobody.
"""

from __future__ import annotations

import argparse
import sys
import threading
from datetime import UTC, datetime

from pydantic import TypeAdapter, ValidationError

from revnm_client.errors import LinkError
from revnm_server.api_client import NoServerError, ServerAddress, call
from revnm_server.commands.setting_options import add_setting_options, settings_of
from revnm_server.doctor import Finding, Verdict, examine
from revnm_server.log_output import start_log
from revnm_server.settings import HttpSettings, RecordingSettings, Settings
from revnm_server.views.view import ServerView

SICK = 1


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the command's options."""
    add_setting_options(parser)
    parser.add_argument(
        "--seconds", type=float, default=10.0, metavar="S", help="how long to watch where no server runs yet (10)"
    )


def run(options: argparse.Namespace) -> int:
    """Print what was found; return 0, or 1 where something keeps robots from driving.

    Raises:
        RevnmError: The settings are wrong, or the models are altered, or an address is taken by something else.
    """
    settings = settings_of(options)
    start_log(settings.log.model_copy(update={"level": "error"}))
    from revnm_server.assembly import load_models  # may compile for seconds

    load_models(settings.perception, settings.depth)
    findings = [Finding(Verdict.GOOD, "models", "all files are there and as their manifest says")]
    findings += _certificates(settings)
    view = _running_view(settings.http)
    if view is None:
        print(
            f"no server runs with these settings: starting one that drives nobody for {options.seconds:g} s", flush=True
        )
        view = _own_view(settings, options.seconds)
    findings += examine(view, tags=settings.robots, tick_hz=settings.perception.tick_hz)
    _print(findings)
    return SICK if any(each.verdict is Verdict.FAULT for each in findings) else 0


def _certificates(settings: Settings) -> list[Finding]:
    from revnm_server.pki import endings

    found = list(endings(settings.certificates, datetime.now(UTC)))
    if settings.certificates and not found:
        return [Finding(Verdict.GOOD, "certificates", "none ends within a month")]
    verdicts = {True: Verdict.FAULT, False: Verdict.WARNING}
    return [Finding(verdicts[each.over], "certificates", each.text) for each in found]


def _print(findings: list[Finding]) -> None:
    width = max(len(each.subject) for each in findings)
    for each in findings:
        print(f"{each.verdict.value:8} {each.subject:{width}}  {each.text}")


def _running_view(http: HttpSettings) -> ServerView | None:
    """Return what the server at the settings' address shows; None where nothing answers there.

    Raises:
        LinkError: Something answers that is no server of ours, or does not take the token.
    """
    try:
        return TypeAdapter(ServerView).validate_python(call(ServerAddress.of(http), "GET", "/api/v1/state"))
    except NoServerError:
        return None
    except ValidationError as error:
        raise LinkError(f"what answers on port {http.port} is no server of this version") from error


def _own_view(settings: Settings, seconds: float) -> ServerView:
    """Start a server that has no goals and leaves no state, and return what it shows after some seconds."""
    from revnm_server.app import running_server

    http = settings.http.model_copy(update={"host": "127.0.0.1", "port": 0})
    perception = settings.perception.model_copy(update={"calibration_dir": None})
    alone = settings.model_copy(
        update={"http": http, "state_file": None, "perception": perception, "recording": RecordingSettings()}
    )
    with running_server(alone) as server:
        done = threading.Event()
        try:
            done.wait(seconds)
        except KeyboardInterrupt:
            print("stopped early: this is what was seen so far", file=sys.stderr)
        return server.service.view()
