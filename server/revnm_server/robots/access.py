"""Who may do what at the server's Zenoh router: its access lists, made of the robots' names.

What no rule allows is denied. So a robot can use its own keys only, cannot send plans, not even to itself, and cannot
answer in the server's place. Who is neither a robot nor a camera of the settings can do nothing.
Source: Zenoh's manual, "Access Control" (zenoh.io/docs/manual/access-control).
"""

from __future__ import annotations

from collections.abc import Collection, Iterable
from pathlib import Path
from typing import Any, Literal, NamedTuple

from revnm_client import keys
from revnm_client.credentials import readable
from revnm_client.errors import FileError
from revnm_server.camera.url import ZenohCamera, parse_camera_url
from revnm_server.settings import Settings, ZenohSettings

_LEAST_PASSWORD = 8

Identity = Literal["cert_common_names", "usernames"]


def security_of(settings: Settings) -> dict[str, Any]:
    """Return :func:`router_security` for everybody whom the settings name.

    Raises:
        FileError: A file cannot be read, or the passwords are malformed, or lack a robot's.
    """
    camera = parse_camera_url(settings.camera.url)
    cameras = [camera.name] if isinstance(camera, ZenohCamera) else []
    return router_security(settings.zenoh, settings.robots, cameras)


def router_security(settings: ZenohSettings, robots: Collection[str], cameras: Collection[str]) -> dict[str, Any]:
    """Return the settings of Zenoh that say who may connect to the router, and what they may do there.

    Args:
        settings: Where its certificates or passwords are.
        robots: Their names.
        cameras: Names of the cameras that publish their pictures over Zenoh.

    Raises:
        FileError: A file cannot be read, or the passwords are malformed, or lack a robot's.
    """
    security: dict[str, Any] = {}
    if settings.certificate is not None and settings.key is not None:
        security["transport/link/tls/listen_certificate"] = _readable(settings.certificate, "certificate")
        security["transport/link/tls/listen_private_key"] = _readable(settings.key, "key")
    if settings.authority is not None:
        security["transport/link/tls/root_ca_certificate"] = _readable(settings.authority, "authority")
        security["transport/link/tls/enable_mtls"] = True
        security["access_control"] = access_lists(robots, cameras, known_by="cert_common_names")
    if settings.passwords is not None:
        _check_passwords(settings.passwords, [*robots, *cameras])
        security["transport/auth/usrpwd/dictionary_file"] = str(settings.passwords.absolute())
        security["access_control"] = access_lists(robots, cameras, known_by="usernames")
    return security


def _readable(path: Path, key: str) -> str:
    return readable(path, key=f"zenoh.{key}", maker="revnm-server pki")


def _check_passwords(path: Path, needed: Collection[str]) -> None:
    """Look through a file of ``NAME:PASSWORD`` lines: Zenoh would skip what it does not understand.

    Raises:
        FileError: It cannot be read, a line is malformed, or a robot or camera has none.
    """
    try:
        lines = path.read_text(encoding="utf-8").splitlines()
    except (OSError, UnicodeDecodeError) as error:
        raise FileError(f"zenoh.passwords: {path}: cannot be read: {error}") from error
    names = set()
    for number, line in enumerate(lines, start=1):
        name, colon, password = line.partition(":")
        if not name or not colon or len(password) < _LEAST_PASSWORD:
            raise FileError(f"{path}:{number}: expected NAME:PASSWORD, the password of {_LEAST_PASSWORD} or more")
        names.add(name)
    lacking = sorted(set(needed) - names)
    if lacking:
        raise FileError(f"{path}: expected a line {lacking[0]}:PASSWORD, for a robot or camera of the settings")


class _Rule(NamedTuple):
    """Messages that pass in a direction, as seen from the router, on some keys."""

    flow: Literal["ingress", "egress"]
    messages: tuple[str, ...]
    keys: tuple[str, ...]


def access_lists(robots: Iterable[str], cameras: Iterable[str], *, known_by: Identity) -> dict[str, Any]:
    """Return Zenoh's ``access_control``.

    Args:
        robots: Their names.
        cameras: Names of the cameras that publish their pictures over Zenoh.
        known_by: What tells the router the name of who has connected.
    """
    rights = {f"robot {name}": (name, _robot(name)) for name in robots}
    rights |= {f"camera {name}": (name, _camera(name)) for name in cameras}
    return {
        "enabled": True,
        "default_permission": "deny",
        "rules": [
            {
                "id": f"{who}: {number}",
                "permission": "allow",
                "flows": [rule.flow],
                "messages": list(rule.messages),
                "key_exprs": list(rule.keys),
            }
            for who, (_, rules) in rights.items()
            for number, rule in enumerate(rules)
        ],
        "subjects": [{"id": who, known_by: [name]} for who, (name, _) in rights.items()],
        "policies": [
            {"subjects": [who], "rules": [f"{who}: {number}" for number in range(len(rules))]}
            for who, (_, rules) in rights.items()
        ],
    }


def _robot(name: str) -> tuple[_Rule, ...]:
    says = (keys.scan(name), keys.odom(name), keys.cmd_vel(name), keys.state(name))
    stop, time = (keys.stop(name),), (keys.time(name),)
    return (
        _Rule("ingress", ("put", "delete"), says),
        _Rule("egress", ("put", "delete"), (*says, keys.waypoints(name))),
        # An own scan comes back to whoever shows it on the robot; a publisher is told who listens.
        _Rule("ingress", ("declare_subscriber",), (*says, keys.waypoints(name))),
        _Rule("egress", ("declare_subscriber",), says),
        _Rule("ingress", ("declare_queryable", "reply"), stop),
        _Rule("egress", ("query",), stop),
        _Rule("egress", ("declare_queryable", "reply"), time),
        _Rule("ingress", ("query",), time),
    )


def _camera(name: str) -> tuple[_Rule, ...]:
    image = (keys.image(name),)
    return (_Rule("ingress", ("put", "delete"), image), _Rule("egress", ("declare_subscriber",), image))
