"""Who may do what at the router: two robots, a camera, and intruders, over real links with each kind of security."""

from __future__ import annotations

import threading
from collections.abc import Callable, Iterator
from contextlib import ExitStack
from pathlib import Path

import pytest
import zenoh

from revnm_client import keys
from revnm_client.credentials import Credentials
from revnm_client.errors import FileError, LinkError
from revnm_client.link import open_client, open_router
from revnm_server.pki import create_authority, issue_robot
from revnm_server.robots.access import router_security
from revnm_server.settings import ZenohSettings

from .free_port import free_port
from .waiting import eventually

ROBOTS = ("rover", "crawler")
CAMERA = "cam0"
NAMES = (*ROBOTS, CAMERA, "stranger")  # the last is of the same authority, and not in the settings


class Site:
    """A router that knows two robots and a camera, and who connects to it."""

    def __init__(self, folder: Path, stack: ExitStack) -> None:
        self.folder = folder
        self._stack = stack
        self.endpoint, settings = self._set_up(free_port())
        security = router_security(settings, ROBOTS, [CAMERA])
        self.router = stack.enter_context(open_router([self.endpoint], security=security))

    def _set_up(self, port: int) -> tuple[str, ZenohSettings]:
        raise NotImplementedError

    def credentials(self, name: str) -> Credentials:
        """What one of ``NAMES`` shows."""
        raise NotImplementedError

    def strange_credentials(self) -> list[Credentials]:
        """What intruders show."""
        raise NotImplementedError

    def connect(self, name: str) -> zenoh.Session:
        """Connect as one of ``NAMES``."""
        return self._stack.enter_context(open_client([self.endpoint], credentials=self.credentials(name)))


class CertificateSite(Site):
    def _set_up(self, port: int) -> tuple[str, ZenohSettings]:
        pki, other = self.folder / "pki", self.folder / "other"
        create_authority(pki, ["127.0.0.1"])
        create_authority(other, ["127.0.0.1"])
        for name in NAMES:
            issue_robot(pki, name)
        issue_robot(other, "rover")
        endpoint = f"tls/127.0.0.1:{port}"
        files = {"certificate": pki / "server.pem", "key": pki / "server.key", "authority": pki / "authority.pem"}
        return endpoint, ZenohSettings(listen=(endpoint,), **files)

    def credentials(self, name: str) -> Credentials:
        own = self.folder / "pki" / name
        return Credentials(own / "authority.pem", own / "robot.pem", own / "robot.key")

    def strange_credentials(self) -> list[Credentials]:
        authority, other = self.folder / "pki/authority.pem", self.folder / "other/rover"
        return [Credentials(authority), Credentials(authority, other / "robot.pem", other / "robot.key")]


class PasswordSite(Site):
    def _set_up(self, port: int) -> tuple[str, ZenohSettings]:
        path = self.folder / "passwords.txt"
        path.write_text("".join(f"{name}:let {name} in\n" for name in NAMES))
        endpoint = f"tcp/127.0.0.1:{port}"
        return endpoint, ZenohSettings(listen=(endpoint,), passwords=path)

    def credentials(self, name: str) -> Credentials:
        return Credentials(user=name, password=f"let {name} in")

    def strange_credentials(self) -> list[Credentials]:
        return [
            Credentials(),
            Credentials(user="rover", password="let crawler in"),
            Credentials(user="nobody", password="let rover in"),
        ]


@pytest.fixture(params=[CertificateSite, PasswordSite], ids=["certificates", "passwords"])
def site(request: pytest.FixtureRequest, tmp_path: Path) -> Iterator[Site]:
    with ExitStack() as stack:
        yield request.param(tmp_path, stack)


class Ear:
    """Hears a key, and remembers what it heard."""

    def __init__(self, session: zenoh.Session, key: str) -> None:
        self.heard: list[str] = []
        session.declare_subscriber(key, lambda sample: self.heard.append(f"{sample.key_expr}: {_text(sample.payload)}"))


def _text(payload: zenoh.ZBytes) -> str:
    return payload.to_bytes().decode()


def ask(session: zenoh.Session, key: str) -> list[str]:
    """Return the answers to a question."""
    return [_text(reply.ok.payload) for reply in session.get(key, timeout=1.0) if reply.ok is not None]


def answer(session: zenoh.Session, key: str, text: str) -> None:
    session.declare_queryable(key, lambda query: query.reply(key, text))


def arrives(session: zenoh.Session, key: str, ear: Ear, text: str = "now") -> None:
    """Say something until it is heard: what was said before on the same link has come by then, or never will."""
    eventually(lambda: session.put(key, text) or f"{key}: {text}" in ear.heard)


def refused(connect: Callable[[threading.Event], zenoh.Session]) -> bool:
    """Whether a connection does not come about within a second."""
    stop = threading.Event()
    timer = threading.Timer(1.0, stop.set)
    timer.start()
    try:
        connect(stop).close()
    except LinkError:
        return True
    finally:
        timer.cancel()
    return False


def test_a_robot_says_how_it_is_and_hears_its_plans(site: Site) -> None:
    rover, at_server = site.connect("rover"), {}
    for key in (keys.scan("rover"), keys.odom("rover"), keys.state("rover")):
        at_server[key] = Ear(site.router, key)
        arrives(rover, key, at_server[key])
    plans = Ear(rover, keys.waypoints("rover"))
    arrives(site.router, keys.waypoints("rover"), plans)
    own_scan = Ear(site.connect("rover"), keys.scan("rover"))  # such as revnm-robot watch
    arrives(rover, keys.scan("rover"), own_scan, "again")


def test_a_publisher_on_the_robot_learns_that_the_server_listens(site: Site) -> None:
    rover = site.connect("rover")
    publisher = rover.declare_publisher(keys.state("rover"))
    Ear(site.router, keys.state("rover"))
    eventually(lambda: publisher.matching_status.matching)


def test_stops_reach_the_robot_and_the_servers_time_comes_back(site: Site) -> None:
    rover = site.connect("rover")
    answer(rover, keys.stop("rover"), "stopped")
    answer(site.router, keys.time("rover"), "noon")
    eventually(lambda: ask(site.router, keys.stop("rover")) == ["stopped"])
    eventually(lambda: ask(rover, keys.time("rover")) == ["noon"])


def test_a_camera_publishes_pictures_and_nothing_else(site: Site) -> None:
    camera, everything = site.connect(CAMERA), Ear(site.router, "**")
    camera.put(keys.scan("rover"), "false")
    camera.put(keys.waypoints("rover"), "false")
    arrives(camera, keys.image(CAMERA), everything)
    assert {text.split(":")[0] for text in everything.heard} == {keys.image(CAMERA)}


@pytest.mark.parametrize("intruder", ["rover", CAMERA, "stranger"])
def test_nobody_writes_plans_or_what_another_robot_says(site: Site, intruder: str) -> None:
    crawler, bad = site.connect("crawler"), site.connect(intruder)
    plans = Ear(crawler, keys.waypoints("crawler"))
    at_server = Ear(site.router, "crawler/**")
    arrives(site.router, keys.waypoints("crawler"), plans)
    at_server.heard.clear()
    forbidden = (keys.waypoints, keys.scan, keys.odom, keys.state, keys.cmd_vel)
    for key in forbidden:
        bad.put(key("crawler"), "false")
        bad.delete(key("crawler"))
    assert ask(bad, keys.time("crawler")) == []  # by then, what was put before would have come
    arrives(site.router, keys.waypoints("crawler"), plans, "last")
    assert {text for text in at_server.heard + plans.heard if "false" in text} == set()


def test_a_robot_cannot_lead_even_itself(site: Site) -> None:
    rover, other_end = site.connect("rover"), site.connect("rover")
    plans, scans = Ear(rover, keys.waypoints("rover")), Ear(rover, keys.scan("rover"))
    arrives(site.router, keys.waypoints("rover"), plans)
    other_end.put(keys.waypoints("rover"), "false")
    arrives(other_end, keys.scan("rover"), scans)
    assert set(plans.heard) == {f"{keys.waypoints('rover')}: now"}


def test_a_robot_hears_nothing_of_another(site: Site) -> None:
    rover, crawler = site.connect("rover"), site.connect("crawler")
    ears = [Ear(rover, "**"), Ear(rover, "crawler/**"), Ear(rover, keys.scan("crawler"))]
    at_server, own = Ear(site.router, keys.scan("crawler")), Ear(rover, keys.waypoints("rover"))
    arrives(crawler, keys.scan("crawler"), at_server)
    site.router.put(keys.waypoints("crawler"), "left")
    arrives(site.router, keys.waypoints("rover"), own)
    assert not [text for ear in ears for text in ear.heard if text.startswith("crawler")]


def test_a_robot_cannot_stop_another_nor_answer_in_the_servers_place(site: Site) -> None:
    rover, crawler = site.connect("rover"), site.connect("crawler")
    answer(crawler, keys.stop("crawler"), "stopped")
    answer(site.router, keys.time("crawler"), "noon")
    eventually(lambda: ask(site.router, keys.stop("crawler")) == ["stopped"])
    assert ask(rover, keys.stop("crawler")) == []
    assert ask(rover, keys.time("crawler")) == []
    answer(rover, keys.time("crawler"), "midnight")
    answer(rover, keys.stop("crawler"), "goes on")
    answer(crawler, keys.time("rover"), "midnight")
    eventually(lambda: ask(crawler, keys.time("crawler")) == ["noon"])
    assert ask(site.router, keys.stop("crawler")) == ["stopped"]
    assert ask(rover, keys.time("rover")) == []


def test_intruders_are_not_let_in(site: Site) -> None:
    for credentials in site.strange_credentials():
        assert refused(lambda stop: open_client([site.endpoint], credentials=credentials, stop=stop))  # noqa: B023
    assert not refused(lambda stop: open_client([site.endpoint], credentials=site.credentials("rover"), stop=stop))


@pytest.mark.parametrize("shown", ["other/server", "pki/crawler/robot"])
def test_a_robot_does_not_talk_to_a_false_server(tmp_path: Path, shown: str) -> None:
    with ExitStack() as stack:
        site = CertificateSite(tmp_path, stack)
        files = {"certificate": tmp_path / f"{shown}.pem", "key": tmp_path / f"{shown}.key"}
        endpoint = f"tls/127.0.0.1:{free_port()}"
        security = router_security(ZenohSettings(listen=(endpoint,), **files), ROBOTS, [])
        stack.enter_context(open_router([endpoint], security=security))
        assert refused(lambda stop: open_client([endpoint], credentials=site.credentials("rover"), stop=stop))


def test_a_server_at_another_address_than_its_certificate_says_is_not_trusted(tmp_path: Path) -> None:
    with ExitStack() as stack:
        site = CertificateSite(tmp_path, stack)
        elsewhere = site.endpoint.replace("127.0.0.1", "localhost")
        assert refused(lambda stop: open_client([elsewhere], credentials=site.credentials("rover"), stop=stop))


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("rover:let rover in\ncrawler\n", "passwords.txt:2: expected NAME:PASSWORD"),
        ("rover:\ncrawler:let crawler in\n", "passwords.txt:1: expected NAME:PASSWORD"),
        ("rover:let rover in\ncrawler:seven..\n", "passwords.txt:2: expected NAME:PASSWORD, the password of 8 or more"),
        ("rover:let rover in\n", "passwords.txt: expected a line crawler:PASSWORD"),
        (None, r"zenoh\.passwords: .*passwords.txt: cannot be read"),
    ],
)
def test_passwords_that_do_not_fit_keep_the_server_from_starting(tmp_path: Path, text: str | None, said: str) -> None:
    path = tmp_path / "passwords.txt"
    if text is not None:
        path.write_text(text)
    with pytest.raises(FileError, match=said):
        router_security(ZenohSettings(passwords=path), ROBOTS, [])


def test_a_missing_certificate_is_named(tmp_path: Path) -> None:
    settings = ZenohSettings(
        listen=("tls/127.0.0.1:1",), certificate=tmp_path / "server.pem", key=tmp_path / "server.key"
    )
    with pytest.raises(FileError, match=r"zenoh\.certificate: .*server\.pem: cannot be read: there is no such file"):
        router_security(settings, ROBOTS, [])
    with pytest.raises(FileError, match=r"security\.authority: .*authority\.pem: cannot be read"):
        open_client(["tls/127.0.0.1:1"], credentials=Credentials(tmp_path / "authority.pem"))
