"""Errors as problem documents (RFC 9457): every answer that is no success is one."""

from __future__ import annotations

import logging
from collections.abc import Mapping
from http import HTTPStatus
from typing import Any

from fastapi import FastAPI, Request
from fastapi.exceptions import RequestValidationError
from fastapi.responses import JSONResponse
from pydantic import BaseModel
from starlette.exceptions import HTTPException
from starlette.routing import compile_path

from revnm_server.recording.errors import RecordingError
from revnm_server.robots.mission import GoalError, StoppedError, UnknownRobotError

logger = logging.getLogger(__name__)

MEDIA_TYPE = "application/problem+json"


class Problem(BaseModel):
    """A problem document.

    Attributes:
        type: Always this: the status says what kind of problem it is.
        title: The status in words.
        status: That of the answer.
        detail: What is wrong.
        reasons: All that is wrong, where it may be more than one thing.
    """

    type: str = "about:blank"
    title: str
    status: int
    detail: str | None = None
    reasons: list[str] | None = None


def problem(
    status: int,
    detail: str | None = None,
    *,
    reasons: list[str] | None = None,
    headers: dict[str, str] | None = None,
) -> JSONResponse:
    """Return an error answer."""
    document = Problem(title=HTTPStatus(status).phrase, status=status, detail=detail, reasons=reasons)
    return JSONResponse(
        document.model_dump(exclude_none=True), status_code=status, headers=headers, media_type=MEDIA_TYPE
    )


def responses(reasons: Mapping[int, str]) -> dict[int | str, dict[str, Any]]:
    """Return the OpenAPI description of problems, by what each status means."""
    content = {MEDIA_TYPE: {"schema": {"$ref": "#/components/schemas/Problem"}}}
    return {status: {"description": reason, "content": content} for status, reason in reasons.items()}


def install(app: FastAPI) -> None:
    """Turn every error of the application into a problem document."""

    async def unknown_robot(_: Request, error: Exception) -> JSONResponse:
        return problem(404, str(error))

    async def bad_goal(_: Request, error: Exception) -> JSONResponse:
        return problem(422, str(error))

    async def conflict(_: Request, error: Exception) -> JSONResponse:
        return problem(409, str(error))

    async def http(request: Request, error: Exception) -> JSONResponse:
        assert isinstance(error, HTTPException)
        detail = error.detail if error.detail != HTTPStatus(error.status_code).phrase else None
        headers = dict(error.headers or {})
        if error.status_code == HTTPStatus.METHOD_NOT_ALLOWED:
            headers["Allow"] = ", ".join(_methods(request)) or headers.get("Allow", "")
        return problem(error.status_code, detail, headers=headers)

    async def invalid(_: Request, error: Exception) -> JSONResponse:
        assert isinstance(error, RequestValidationError)
        # Without the values: a NaN among them could not be written as JSON.
        reasons = [f"{'.'.join(str(part) for part in e['loc'])}: {e['msg']}" for e in error.errors()]
        return problem(422, "the request is malformed", reasons=reasons)

    async def failed(_: Request, error: Exception) -> JSONResponse:
        logger.error("request failed: %s", type(error).__name__)
        return problem(500, "the server failed; its log says why")

    app.add_exception_handler(UnknownRobotError, unknown_robot)
    app.add_exception_handler(GoalError, bad_goal)
    app.add_exception_handler(StoppedError, conflict)
    app.add_exception_handler(RecordingError, conflict)
    app.add_exception_handler(HTTPException, http)
    app.add_exception_handler(RequestValidationError, invalid)
    app.add_exception_handler(Exception, failed)


def _methods(request: Request) -> list[str]:
    """Return the methods that the API has at the request's path; the router names those of one of its routes alone."""
    paths: dict[str, dict[str, Any]] = request.app.openapi()["paths"]
    matching = [methods for path, methods in paths.items() if compile_path(path)[0].match(request.url.path)]
    return sorted({method.upper() for methods in matching for method in methods})
