"""Prints ``docs/api.md``: the server's OpenAPI document for people. ``make api-docs`` writes it."""

from __future__ import annotations

import json
import re
from collections.abc import Iterator
from types import SimpleNamespace
from typing import Any, cast

from pydantic import SecretStr

from revnm_server.api import create_application
from revnm_server.service import NavigationService
from revnm_server.settings import HttpSettings

Json = dict[str, Any]

HEAD = """\
# The HTTP API

Made from the server's OpenAPI document by `make api-docs`. A running server gives that document at
`/api/v1/openapi.json`, for programs that make clients of it. `SERVER` is its address, `$TOKEN` one of its tokens.
Where the server has a certificate, it is `https://`, and curl needs `--cacert pki/authority.pem`.
"""
NUMBERS = re.compile(r"\[[\s\d.,\[\]-]*\]")  # lists of numbers stand in one line
WHO = {None: "everyone, without a token", "viewer": "viewer, operator", "operator": "operator"}


def document() -> Json:
    """Return the OpenAPI document of a server that asks for tokens; describing it asks nothing of the service."""
    service = SimpleNamespace(mission=SimpleNamespace(names=()), ticking=None)
    settings = HttpSettings(token=SecretStr("0" * 16), viewer_token=SecretStr("1" * 16))
    return create_application(cast(NavigationService, service), settings).openapi()


def reference(api: Json) -> Iterator[str]:
    """Yield the lines of the page."""
    operations = [(m.upper(), path, each) for path, item in api["paths"].items() for m, each in item.items()]
    yield HEAD
    yield api["info"]["description"]
    yield "| request | who may | what it does |\n|---|---|---|"
    for method, path, operation in operations:
        title = f"{method} {path}"
        yield f"| [`{title}`](#{anchor(title)}) | {who(operation)} | {first_sentence(operation['description'])} |"
    yield "\n## Requests"
    for method, path, operation in operations:
        yield f"\n### `{method} {path}`\n"
        yield from described(method, path, operation, api["components"]["schemas"])
    yield from refused(api["components"]["responses"])
    yield "\n## Documents\n"
    for name, schema in sorted(api["components"]["schemas"].items()):
        yield from fields(name, schema)


def described(method: str, path: str, operation: Json, schemas: Json) -> Iterator[str]:
    """Yield one request: who may make it, what it takes, how it is made, what is answered."""
    yield code(operation["description"]) + f"\n\nWho may: {who(operation)}.\n"
    parameters = operation.get("parameters", [])
    if parameters:
        yield "| parameter | where | type | meaning |\n|---|---|---|---|"
    for each in parameters:
        default = f"; `{each['schema']['default']}` if left out" if "default" in each["schema"] else ""
        yield f"| `{each['name']}` | {each['in']} | {kind(each['schema'])}{default} | {code(each['description'])} |"
    body = operation.get("requestBody", {}).get("content", {}).get("application/json", {}).get("schema")
    if body:
        yield f"\nBody: {kind(body)}, as JSON."
    schema = body and schemas[body["$ref"].rpartition("/")[2]]
    yield "\n<!-- needs: hardware -->\n```sh\n" + call(method, path, operation, schema) + "\n```\n"
    yield from answers(operation["responses"])


def call(method: str, path: str, operation: Json, body: Json | None) -> str:
    """Return a command line that makes the request."""
    words = ["curl"] if method == "GET" else ["curl", "-X", method]
    words += ['-H "Authorization: Bearer $TOKEN"'] if operation["security"] else []
    words += [f"-H 'Content-Type: application/json' -d '{json.dumps(body['example'])}'"] if body else []
    return " ".join([*words, "http://SERVER:8000" + path.replace("{robot}", "rover")])


def answers(responses: Json) -> Iterator[str]:
    """Yield a table of what is answered, and an example."""
    yield "| status | content | |\n|---|---|---|"
    own = {status: answer for status, answer in responses.items() if "$ref" not in answer}
    for status, answer in own.items():
        contents = [
            kind(content["schema"]) if "json" in media else f"`{media}`"
            for media, content in answer.get("content", {}).items()
        ]
        meaning = code(answer["description"]).replace("Successful Response", "Done.")
        headers = [f"`{name}`: {header['description']}" for name, header in answer.get("headers", {}).items()]
        yield f"| {status} | {' '.join(contents) or 'none'} | {' '.join([meaning, *headers])} |"
    common = [status for status in responses if status not in own]
    if common:
        yield f"| {', '.join(common)} | [Problem](#problem) | [see below](#what-every-request-may-be-answered) |"
    for answer in own.values():
        example = answer.get("content", {}).get("application/json", {}).get("example")
        if example is not None:
            text = NUMBERS.sub(lambda numbers: " ".join(numbers[0].split()), json.dumps(example, indent=2))
            yield f"\n```json\n{text}\n```"


def refused(responses: Json) -> Iterator[str]:
    """Yield a table of what any request may be answered."""
    yield "\n## What every request may be answered\n\n| status | |\n|---|---|"
    for status, answer in responses.items():
        yield f"| {status} | {answer['description']} |"


def fields(name: str, schema: Json) -> Iterator[str]:
    """Yield a table of the fields of a schema."""
    yield f"\n### {name}\n\n{code(schema.get('description', ''))}\n"
    if "enum" in schema:
        yield "One of " + kind(schema) + "."
        return
    yield "| field | type | meaning |\n|---|---|---|"
    for field, each in schema["properties"].items():
        optional = "" if field in schema.get("required", ()) else " (may be left out)"
        yield f"| `{field}` | {kind(each)}{optional} | {code(each.get('description', ''))} |"


def kind(schema: Json) -> str:
    """Return what a value is, in words."""
    if "$ref" in schema:
        name = schema["$ref"].rpartition("/")[2]
        return f"[{name}](#{name.lower()})"
    if "anyOf" in schema:
        return " or ".join(kind(each) for each in schema["anyOf"])
    if "enum" in schema:
        return ", ".join(f"`{each}`" for each in schema["enum"])
    if "prefixItems" in schema:
        return "[" + ", ".join(kind(each) for each in schema["prefixItems"]) + "]"
    if schema.get("type") == "array":
        return f"list of {kind(schema['items'])}"
    values = schema.get("additionalProperties")
    if isinstance(values, dict):
        return f"object of {kind(values)} by name"
    return str(schema["type"])


def who(operation: Json) -> str:
    """Return who may make a request."""
    return WHO[next((role for scheme in operation["security"] for roles in scheme.values() for role in roles), None)]


def code(text: str) -> str:
    """Return a docstring's text as Markdown."""
    return text.replace("``", "`")


def first_sentence(text: str) -> str:
    """Return what a description begins with."""
    return code(text).partition("\n\n")[0].partition(". ")[0].removesuffix(".").replace("\n", " ")


def anchor(title: str) -> str:
    """Return the anchor that a heading has on the usual forges."""
    return "".join(c for c in title.lower().replace(" ", "-") if c.isalnum() or c in "-_")


if __name__ == "__main__":
    print(re.sub(r"\n{3,}", "\n\n", "\n".join(reference(document()))))
