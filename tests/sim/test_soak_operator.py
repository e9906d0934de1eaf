"""Goals given through a real HTTP connection, and how they are judged."""

from __future__ import annotations

import json
import threading
from collections.abc import Iterator
from dataclasses import dataclass, field
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from typing import Any

import numpy as np
import pytest
from tests.sim.test_soak_goals import SCENARIO

from revnm_sim.live.server_api import ServerApi
from revnm_sim.soak.goals import GoalDraw
from revnm_sim.soak.operator import Operator


@dataclass
class Server:
    """What was asked of the server, and where the robot is."""

    api: ServerApi
    asked: list[tuple[str, Any]] = field(default_factory=list)
    place_m: tuple[float, float] = (-2.0, 0.0)
    status: int = 200


@pytest.fixture
def server() -> Iterator[Server]:
    class Answers(BaseHTTPRequestHandler):
        """Names goals by their number."""

        def do_PUT(self) -> None:
            self._note(json.loads(self.rfile.read(int(self.headers["Content-Length"]))))

        def do_POST(self) -> None:
            self._note(None)

        def _note(self, body: Any) -> None:
            made.asked.append((self.path, body))
            self.send_response(made.status)
            self.end_headers()
            self.wfile.write(json.dumps({"goal": {"id": f"g{len(made.asked)}"}}).encode())

        def log_message(self, *_: object) -> None:
            pass

    with ThreadingHTTPServer(("127.0.0.1", 0), Answers) as http:
        thread = threading.Thread(target=http.serve_forever, kwargs={"poll_interval": 0.01})
        thread.start()
        made = Server(ServerApi(f"http://127.0.0.1:{http.server_port}"))
        yield made
        http.shutdown()
        thread.join()


@pytest.fixture
def operator(server: Server) -> Operator:
    return Operator(server.api, lambda: server.place_m, GoalDraw(SCENARIO, np.random.default_rng(0)))


def place_of(asked: tuple[str, Any]) -> tuple[float, float]:
    found = SCENARIO.camera.floor_point(np.array([asked[1]["u"], asked[1]["v"]]))
    assert found is not None
    return float(found[0]), float(found[1])


def view(status: str, goal: str, reason: str | None = None) -> dict[str, Any]:
    return {"status": status, "goal": {"id": goal}, "reason": reason}


def test_a_robot_that_arrived_where_it_should_is_sent_on(server: Server, operator: Operator) -> None:
    operator.look(view("driving", "g1"))
    assert operator.drives == []
    server.place_m = place_of(server.asked[0])
    operator.look(view("arrived", "g1"))
    assert [drive.reached for drive in operator.drives] == [True]
    assert operator.drives[0].off_m < 1e-6
    assert [path for path, _ in server.asked] == ["/api/v1/robots/rover/goal"] * 2
    operator.look(view("arrived", "g1"))  # an old state: the second goal is g2
    assert len(operator.drives) == 1


def test_an_arrival_elsewhere_is_none(server: Server, operator: Operator) -> None:
    x_m, y_m = place_of(server.asked[0])
    server.place_m = (x_m + 0.3, y_m + 0.41)  # 0.508 m
    operator.look(view("arrived", "g1"))
    assert [(drive.reached, drive.reason) for drive in operator.drives] == [
        (False, "the server says arrived 0.51 m away")
    ]


def test_who_is_too_late_is_told_with_the_server_s_reason_and_sent_on(server: Server, operator: Operator) -> None:
    operator.grant(-1000.0)
    operator.look(view("waiting", "g1", "camera stale"))
    assert [(drive.reached, drive.reason) for drive in operator.drives] == [(False, "waiting: camera stale")]
    operator.look(view("driving", "g2"))
    assert len(operator.drives) == 1
    assert len(server.asked) == 2


def test_a_goal_that_the_server_does_not_take_is_given_again(server: Server, operator: Operator) -> None:
    server.place_m, server.status = place_of(server.asked[0]), 409
    operator.look(view("arrived", "g1"))
    operator.look(view("arrived", "g1"))
    server.status = 200
    operator.look(view("arrived", "g1"))
    first, *again = (body for _, body in server.asked)
    assert again == [again[0]] * 3
    assert again[0] != first
    operator.look(view("driving", "g4"))
    assert len(operator.drives) == 1
    assert len(server.asked) == 4


def test_after_a_stop_the_robot_is_released_and_goes_on_to_its_goal(server: Server, operator: Operator) -> None:
    operator.resume()
    (_, first), (path, _), (_, again) = server.asked
    assert path == "/api/v1/robots/rover/resume"
    assert again == first
    server.place_m = place_of(server.asked[0])
    operator.look(view("arrived", "g3"))
    assert [drive.reached for drive in operator.drives] == [True]
