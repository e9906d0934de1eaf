"""``revnm-sim viewers``: what many who look at the page cost a server that is at work, as after ``revnm-sim demo``."""

from __future__ import annotations

import argparse
import asyncio
import re
import shlex
import time
from collections.abc import Coroutine
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from revnm_client.errors import ConfigError, LinkError
from revnm_server.report import make_folder
from revnm_sim.bench.report import table, write_report
from revnm_sim.live.server_api import ServerApi

_LANES = 10  # connections that ask for the state, each its share of the requests
_PART = re.compile(rb"--frame\r\n")
_LENGTH = re.compile(rb"content-length: *(\d+)", re.IGNORECASE)
_CHUNK = 1 << 16


@dataclass(slots=True)
class _Load:
    """What those who look have got."""

    parts: int = 0
    answers_ms: list[float] = field(default_factory=list)


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the options of the command."""
    parser.add_argument(
        "--http", default="127.0.0.1:8000", metavar="HOST:PORT", help="the server (default: %(default)s)"
    )
    parser.add_argument("--viewers", type=int, default=50, help="who look at the stream (default: 50)")
    parser.add_argument("--requests", type=int, default=200, help="of the state, a second (default: 200)")
    parser.add_argument("--seconds", type=float, default=45.0, help="of each half: 200 ticks at least (default: 45)")
    parser.add_argument("--rounds", type=int, default=2, help="how often without and with them (default: 2)")
    parser.add_argument("--out", type=Path, required=True, help="folder for report.json")


def run(args: argparse.Namespace) -> int:
    """Measure the server's tick without and with those who look, write the report and print the table."""
    host, _, port = args.http.rpartition(":")
    if not host or not port.isdecimal() or min(args.viewers, args.requests, args.rounds) < 1 or args.seconds <= 0.0:
        raise ConfigError("expected --http HOST:PORT, and a positive number for each other option")
    make_folder(args.out)
    api = ServerApi(f"http://{args.http}")
    rows = []
    for _ in range(args.rounds):
        for viewers, requests in ((0, 0), (args.viewers, args.requests)):
            load = asyncio.run(_look((host, int(port)), viewers, requests, args.seconds))
            rows.append(_row(api, load, viewers, args.seconds))
    options = ["--viewers", str(args.viewers), "--requests", str(args.requests), "--seconds", str(args.seconds)]
    write_report(args.out / "report.json", rows, shlex.join(["revnm-sim", "viewers", *options]))
    print(table(rows))
    return 0


def _row(api: ServerApi, load: _Load, viewers: int, seconds: float) -> dict[str, Any]:
    tick = api.state()["timings_ms"]["tick"]
    p50, p95 = np.percentile(load.answers_ms, (50.0, 95.0)) if load.answers_ms else (np.nan, np.nan)
    return {
        "viewers": viewers,
        "requests_per_s": round(len(load.answers_ms) / seconds, 1),
        "pictures_per_viewer_s": round(load.parts / seconds / viewers, 2) if viewers else 0.0,
        "state_p50_ms": round(float(p50), 2) if load.answers_ms else None,
        "state_p95_ms": round(float(p95), 2) if load.answers_ms else None,
        "tick_p50_ms": tick["p50"],
        "tick_p95_ms": tick["p95"],
    }


async def _look(server: tuple[str, int], viewers: int, requests: int, seconds: float) -> _Load:
    """Look for some seconds; nobody looks with 0 viewers and 0 requests.

    Raises:
        LinkError: A connection failed.
    """
    load = _Load()
    jobs: list[Coroutine[Any, Any, None]] = [_view(server, load) for _ in range(viewers)]
    lanes = min(_LANES, requests)  # each asks once a second at least: the server ends connections that are idle
    jobs += [_ask(server, load, lanes / requests) for _ in range(lanes)]
    tasks = [asyncio.ensure_future(job) for job in jobs]
    if not tasks:
        await asyncio.sleep(seconds)
        return load
    done, pending = await asyncio.wait(tasks, timeout=seconds, return_when=asyncio.FIRST_EXCEPTION)
    for task in pending:
        task.cancel()
    await asyncio.gather(*pending, return_exceptions=True)
    for task in done:
        raise LinkError(f"a connection to {server[0]}:{server[1]} ended: {task.exception()}")
    return load


async def _view(server: tuple[str, int], load: _Load) -> None:
    reader, writer = await _request(server, "/api/v1/stream.mjpg")
    try:
        while data := await reader.read(_CHUNK):
            load.parts += len(_PART.findall(data))
    finally:
        writer.close()
    raise LinkError("the stream broke off")


async def _ask(server: tuple[str, int], load: _Load, period_s: float) -> None:
    """Ask for the state at a rate; what is late is not caught up with."""
    reader, writer = await asyncio.open_connection(*server)
    try:
        while True:
            began_s = time.perf_counter()
            await _request(server, "/api/v1/state", reuse=(reader, writer))
            head = await reader.readuntil(b"\r\n\r\n")
            length = _LENGTH.search(head)
            if length is None:
                raise LinkError("the state came without a length")
            await reader.readexactly(int(length[1]))
            load.answers_ms.append((time.perf_counter() - began_s) * 1e3)
            await asyncio.sleep(max(0.0, period_s - (time.perf_counter() - began_s)))
    finally:
        writer.close()


async def _request(
    server: tuple[str, int], path: str, *, reuse: tuple[asyncio.StreamReader, asyncio.StreamWriter] | None = None
) -> tuple[asyncio.StreamReader, asyncio.StreamWriter]:
    reader, writer = reuse or await asyncio.open_connection(*server)
    writer.write(f"GET {path} HTTP/1.1\r\nHost: {server[0]}:{server[1]}\r\n\r\n".encode())
    await writer.drain()
    return reader, writer
