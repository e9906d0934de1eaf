"""The OpenAPI document says what the server does, and ``docs/api.md`` says what the document says."""

from __future__ import annotations

import subprocess
import sys
from collections.abc import Iterator
from importlib.metadata import version
from pathlib import Path
from typing import Any

import pytest
import zenoh
from pydantic import SecretStr

from revnm_server.api import create_application
from revnm_server.api.examples import EXAMPLES
from revnm_server.camera import open_camera
from revnm_server.robots.mission import Mission
from revnm_server.service import NavigationService
from revnm_server.settings import HttpSettings

from .http_calls import Api
from .service_parts import FakePipeline

ROOT = Path(__file__).parents[2]
OPERATOR = "operator0123456789"
VIEWER = "viewer0123456789"
GUARDED = HttpSettings(token=SecretStr(OPERATOR), viewer_token=SecretStr(VIEWER))


@pytest.fixture
def service(router: zenoh.Session) -> Iterator[NavigationService]:
    camera = open_camera("zenoh://camera", router)
    yield NavigationService(router, camera=camera, pipeline=FakePipeline(), mission=Mission(["rover"]))
    camera.close()


@pytest.fixture
def api(service: NavigationService) -> Api:
    return Api(create_application(service, GUARDED))


def operations(api: Api) -> list[tuple[str, str, dict[str, Any]]]:
    paths = api.app.openapi()["paths"]
    return [(method.upper(), path, each) for path, item in paths.items() for method, each in item.items()]


def roles(operation: dict[str, Any]) -> set[str]:
    return {role for scheme in operation["security"] for roles in scheme.values() for role in roles}


def test_the_guard_lets_in_whom_the_document_names(api: Api) -> None:
    for method, path, operation in operations(api):
        address = path.replace("{robot}", "nobody")
        said = {
            token: api.call(method, address, headers={"authorization": f"Bearer {token}"} if token else {}).status_code
            for token in (None, VIEWER, OPERATOR)
        }
        declared = operation["responses"].keys()
        assert {str(status) for status in said.values()} <= declared, address
        assert (said[None] == 401) == bool(operation["security"]), address
        assert (said[VIEWER] == 403) == (roles(operation) == {"operator"}), address
        assert said[OPERATOR] not in (401, 403), address


def test_its_version_is_that_of_the_package(api: Api) -> None:
    assert api.app.openapi()["info"]["version"] == version("revnm-server")


def test_without_tokens_none_is_asked_for(api: Api, service: NavigationService) -> None:
    assert all({} not in operation["security"] for _, _, operation in operations(api))
    open_to_all = Api(create_application(service, HttpSettings()))
    assert all({} in each["security"] or not each["security"] for _, _, each in operations(open_to_all))


def test_every_answer_in_json_has_an_example(api: Api) -> None:
    answers = {
        operation["operationId"]: content
        for _, _, operation in operations(api)
        for media, content in operation["responses"].get("200", {}).get("content", {}).items()
        if media == "application/json"
    }
    assert {name for name, content in answers.items() if "example" in content} == answers.keys() == EXAMPLES.keys()


def test_every_field_and_parameter_is_described(api: Api) -> None:
    schemas = api.app.openapi()["components"]["schemas"]
    fields = {
        f"{name}.{field}": each
        for name, schema in schemas.items()
        for field, each in schema.get("properties", {}).items()
    }
    parameters = {
        f"{path} {each['name']}": each for _, path, op in operations(api) for each in op.get("parameters", [])
    }
    assert {name for name, each in (fields | parameters).items() if not each.get("description")} == set()
    assert not any("Attributes" in schema.get("description", "") for schema in schemas.values())


def test_the_page_of_the_reference_is_current() -> None:
    made = subprocess.run([sys.executable, "docs/api_reference.py"], cwd=ROOT, capture_output=True, text=True)
    assert made.returncode == 0, made.stderr
    assert (ROOT / "docs/api.md").read_text() == made.stdout, "run `make api-docs`"
