"""The OpenAPI document: what FastAPI reads off the routes, completed by what it cannot know.

That is who may do what, what the guard answers, examples, and what the fields of our dataclasses mean.
"""

from __future__ import annotations

import re
from collections.abc import Iterable
from typing import Any

from fastapi import FastAPI
from fastapi.routing import APIRoute

from revnm_server.api.examples import EXAMPLES
from revnm_server.api.guard import COOKIE, REFUSALS, least_role, refusals
from revnm_server.api.problems import Problem, responses

_SUMMARY = "A camera on the wall guides robots without cameras: click a pixel, the robot drives there."
_DESCRIPTION = """\
**Who may.** Where the server has tokens, a request needs one: as `Authorization: Bearer TOKEN`, as `?token=TOKEN`, or
in the page's cookie. The viewer's token lets look and stop robots, the operator's everything.

**Errors** are problem documents (RFC 9457) of type `about:blank`: their status says what kind of problem it is,
`detail` what is wrong. Besides those that are listed with a request, any may be answered with 500 where the server
fails; its log says why.

**Events.** `/api/v1/events` is a WebSocket that sends what `GET /api/v1/state` answers, ten times a second, and listens
to nothing. It is closed with 1001 when the server ends; without a token that is known it does not open.

**Units** stand in the names. Pixels are those of the camera's picture, u to the right and v down; a robot's frame has x
forward and y to the left.
"""
_SCHEMES = {
    "bearer": {"type": "http", "scheme": "bearer"},
    "query": {"type": "apiKey", "in": "query", "name": "token"},
    "cookie": {"type": "apiKey", "in": "cookie", "name": COOKIE},
}
_FIELD = re.compile(r"^    (\w+): (.+(?:\n {8}.+)*)", re.MULTILINE)


class DocumentedApplication(FastAPI):
    """An application whose OpenAPI document is complete.

    Args:
        version: Of the server.
        guarded: Tokens are asked for.
    """

    def __init__(self, version: str, *, guarded: bool) -> None:
        super().__init__(
            title="ReVNM server",
            version=version,
            summary=_SUMMARY,
            description=_DESCRIPTION,
            license_info={"name": "Apache-2.0", "identifier": "Apache-2.0"},
            docs_url=None,
            redoc_url=None,
            openapi_url="/api/v1/openapi.json",
            generate_unique_id_function=_operation_id,
        )
        self._guarded = guarded

    def openapi(self) -> dict[str, Any]:
        """Return the document; the same one until a route is added."""
        known = self.openapi_schema
        document = super().openapi()
        if document is not known:
            self._complete(document)
        return document

    def _complete(self, document: dict[str, Any]) -> None:
        components = document["components"]
        components["securitySchemes"] = _SCHEMES
        components["schemas"]["Problem"] = Problem.model_json_schema()
        components["responses"] = {str(status): answer for status, answer in responses(REFUSALS).items()}
        for name in (
            "HTTPValidationError",
            "ValidationError",
        ):  # FastAPI's own: what it finds invalid is a Problem, too
            components["schemas"].pop(name, None)
        for schema in components["schemas"].values():
            _describe_fields(schema)
        for path, operations in document["paths"].items():
            for method, operation in operations.items():
                operation["security"] = self._security(method.upper(), path)
                _complete_answers(operation, refused=refusals(method.upper(), path))

    def _security(self, method: str, path: str) -> list[dict[str, list[str]]]:
        """Return by which schemes, in which role, a request may be made; an empty one is a request without a token."""
        role = least_role(method, path)
        if role is None:
            return []
        return [{scheme: [role.value]} for scheme in _SCHEMES] + ([] if self._guarded else [{}])


def _operation_id(route: APIRoute) -> str:
    return f"{route.tags[0]}_{route.name}" if route.tags else route.name


def _complete_answers(operation: dict[str, Any], *, refused: Iterable[int]) -> None:
    """Add the guard's answers and the example, and take out what FastAPI supposes to be answered to bad parameters.

    Where a request can be malformed, its route says so; a robot's name is any text.
    """
    answers = operation["responses"]
    if "HTTPValidationError" in str(answers.get("422")):
        del answers["422"]
    answers.update({str(status): {"$ref": f"#/components/responses/{status}"} for status in refused})
    operation["responses"] = dict(sorted(answers.items()))
    if operation["operationId"] in EXAMPLES:
        answers["200"]["content"]["application/json"]["example"] = EXAMPLES[operation["operationId"]]


def _describe_fields(schema: dict[str, Any]) -> None:
    """Move what a docstring says of its attributes to the fields that they are in JSON."""
    described = schema.get("description", "").replace("None", "null")  # what it is in JSON
    text, _, attributes = described.partition("\n\nAttributes:\n")
    if attributes:
        schema["description"] = text
        for name, meaning in _FIELD.findall(attributes):
            if name in schema["properties"]:
                schema["properties"][name]["description"] = " ".join(meaning.split())
