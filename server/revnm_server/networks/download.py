"""Downloads a big file whose sha256 is known: over https, again from where it was cut, and there only when it is right.

httpx, because it gives redirects one at a time, to be looked at before they are followed, has a time limit for each
step, and one base for its errors; the standard library has none of these.
"""

from __future__ import annotations

import fcntl
import json
import os
import re
import shutil
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import BinaryIO

import httpx
from tqdm import tqdm

from revnm_client.errors import ConfigError, FileError, LinkError
from revnm_server.networks.checked_file import file_sha256
from revnm_server.settings.address import is_loopback

MAX_BYTES = 4 * 1024**3
_MAX_REDIRECTS = 5
_TIMEOUT = httpx.Timeout(30.0, connect=15.0)
_CONTENT_RANGE = re.compile(r"bytes (\d+)-\d+/(\d+|\*)")


@dataclass(frozen=True, slots=True)
class RemoteFile:
    """A file to download.

    Attributes:
        url: Where it is; https, or http on this machine.
        sha256: Its sum, hexadecimal, lower case.
        size_bytes: Its size, where it is known.
    """

    url: str
    sha256: str
    size_bytes: int | None = None


@dataclass(frozen=True, slots=True)
class _Answer:
    """What a server is about to send.

    Attributes:
        response: Its answer, body not yet read.
        start: Where in the file the body begins.
        total: Size of the whole file, if it tells.
    """

    response: httpx.Response
    start: int
    total: int | None


def check_url(url: str) -> None:
    """Check that a URL is https, or http on this machine, and holds no credentials.

    Raises:
        ConfigError: It is not.
    """
    try:
        parsed = httpx.URL(url)
    except httpx.InvalidURL as error:
        raise ConfigError(f"{url}: no URL: {error}") from error
    if parsed.userinfo:
        raise ConfigError(f"{parsed.scheme}://***@{parsed.host}: expected a URL without credentials")
    if not parsed.host or not _secure(parsed):
        raise ConfigError(f"{url}: expected https://…")


def http_client() -> httpx.Client:
    """Return what speaks HTTP here; it trusts the usual authorities and uses the proxies of the environment."""
    return httpx.Client(timeout=_TIMEOUT)


def free_bytes(folder: Path) -> int:
    """Return how much may be written to a folder's disk."""
    return shutil.disk_usage(folder).free


def download(
    wanted: RemoteFile, target: Path, *, client: httpx.Client, free: Callable[[Path], int] = free_bytes
) -> bool:
    """Download a file, or go on with a download that was interrupted.

    Until it is whole and has the right sum, it is ``target`` with ``.part`` behind its name.

    Args:
        wanted: The file.
        target: Where it shall lie; its folder is made.
        client: Speaks HTTP.
        free: Tells how many bytes may be written to a folder.

    Returns:
        Whether anything had to be done; not where the file is there already.

    Raises:
        ConfigError: The URL is none that is allowed.
        LinkError: The server cannot be reached, refuses, breaks off, or leads away from https; try again later.
        FileError: Another file has the name, the disk is full, or the file has another sum than expected.
    """
    check_url(wanted.url)
    part = target.with_name(target.name + ".part")
    try:
        if target.exists():
            if file_sha256(target) == wanted.sha256:
                return False
            raise FileError(f"{target}: is there, but with another sha256 than {wanted.sha256}; move it away")
        target.parent.mkdir(parents=True, exist_ok=True)
        with _alone(part) as file:
            _fill(file, part, wanted, client, free)
            _finish(file, part, wanted, target)
        return True
    except OSError as error:
        raise FileError(f"{error.filename or part}: {error.strerror}; what was downloaded is kept") from error


@contextmanager
def _alone(part: Path) -> Iterator[BinaryIO]:
    """Open the part to write behind its end; nobody else does at the same time."""
    with part.open("ab") as file:
        try:
            fcntl.flock(file, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except BlockingIOError as error:
            raise FileError(f"{part}: another download writes to it") from error
        yield file


def _fill(file: BinaryIO, part: Path, wanted: RemoteFile, client: httpx.Client, free: Callable[[Path], int]) -> None:
    offset = os.fstat(file.fileno()).st_size
    if offset and offset == wanted.size_bytes:
        return
    short = 0 < offset < (wanted.size_bytes or MAX_BYTES)
    mark = _mark(part, wanted.url) if short else None
    try:
        with _answer(client, wanted.url, offset if mark else 0, mark) as answer:
            if answer is None:
                return
            _check_size(wanted, answer, part.parent, free(part.parent))
            if offset and answer.start == 0:
                file.truncate(0)
            _remember(part, wanted.url, answer.response)
            _copy(file, part.stem, wanted, answer)
    except httpx.TransportError as error:
        raise LinkError(f"{wanted.url}: {error or type(error).__name__}; run it again to go on") from error


def _finish(file: BinaryIO, part: Path, wanted: RemoteFile, target: Path) -> None:
    file.flush()
    os.fsync(file.fileno())
    got = file_sha256(part)
    _mark_path(part).unlink(missing_ok=True)
    if got != wanted.sha256:
        part.unlink()
        raise FileError(f"{wanted.url}: sha256 expected {wanted.sha256}, got {got}; it was deleted")
    part.replace(target)


@contextmanager
def _answer(client: httpx.Client, url: str, offset: int, mark: str | None) -> Iterator[_Answer | None]:
    """Ask for the file, or for the rest of it; None where there is no rest."""
    headers = {"Accept-Encoding": "identity"}
    if mark is not None:
        headers |= {"Range": f"bytes={offset}-", "If-Range": mark}
    with _redirected(client, url, headers) as response:
        if response.status_code == httpx.codes.OK:
            length = response.headers.get("Content-Length", "")
            yield _Answer(response, 0, int(length) if length.isdecimal() else None)
            return
        if response.status_code == httpx.codes.PARTIAL_CONTENT and mark is not None:
            found = _CONTENT_RANGE.fullmatch(response.headers.get("Content-Range", ""))
            if found is None or int(found[1]) != offset:
                raise LinkError(f"{url}: asked for the rest from byte {offset}, got another part")
            yield _Answer(response, offset, int(found[2]) if found[2].isdecimal() else None)
            return
        ended = response.headers.get("Content-Range") == f"bytes */{offset}"
        if response.status_code == httpx.codes.REQUESTED_RANGE_NOT_SATISFIABLE and ended:
            yield None
            return
        reason = response.reason_phrase or "no reason given"
        raise LinkError(f"{url}: the server says {response.status_code} {reason}")


@contextmanager
def _redirected(client: httpx.Client, url: str, headers: dict[str, str]) -> Iterator[httpx.Response]:
    """Follow redirects, but never from https to anything else."""
    request = client.build_request("GET", url, headers=headers)
    for _ in range(_MAX_REDIRECTS + 1):
        response = client.send(request, stream=True, follow_redirects=False)
        try:
            if response.next_request is None:
                yield response
                return
            following = response.next_request.url
        finally:
            response.close()
        if not _secure(following, before=request.url):
            raise LinkError(f"{url}: leads away from https, to {following.scheme}://{following.host}")
        request = client.build_request("GET", following, headers=headers)
    raise LinkError(f"{url}: more than {_MAX_REDIRECTS} redirects")


def _secure(url: httpx.URL, *, before: httpx.URL | None = None) -> bool:
    """Tell whether nobody on the way can change what comes from there, nor could have sent us there."""
    local = url.scheme == "http" and is_loopback(url.host)
    return url.scheme == "https" or (local and (before is None or before.scheme == "http"))


def _check_size(wanted: RemoteFile, answer: _Answer, folder: Path, free: int) -> None:
    if answer.total is None:
        return
    if wanted.size_bytes not in (None, answer.total):
        raise LinkError(
            f"{wanted.url}: another file: expected {wanted.size_bytes} bytes, the server has {answer.total}"
        )
    if answer.total > MAX_BYTES:
        raise LinkError(f"{wanted.url}: {answer.total} bytes, more than {MAX_BYTES}")
    needed = answer.total - answer.start
    if free < needed:
        raise FileError(f"{folder}: no room for {needed} bytes more: {free} are free")


def _copy(file: BinaryIO, name: str, wanted: RemoteFile, answer: _Answer) -> None:
    size, most = answer.start, answer.total or wanted.size_bytes or MAX_BYTES
    with tqdm(total=answer.total, initial=size, desc=name, unit="B", unit_scale=True, disable=None) as bar:
        for block in answer.response.iter_raw():
            size += len(block)
            if size > most:
                raise LinkError(f"{wanted.url}: sends more than {most} bytes")
            file.write(block)
            bar.update(len(block))
    if answer.total is not None and size < answer.total:
        raise LinkError(f"{wanted.url}: cut after {size} of {answer.total} bytes; run it again to go on")


def _mark_path(part: Path) -> Path:
    return part.with_name(part.name + ".json")


def _remember(part: Path, url: str, response: httpx.Response) -> None:
    """Keep what names this version of the file, so that the rest can be asked of the same version later."""
    tag = response.headers.get("ETag", "")
    mark = tag if tag and not tag.startswith("W/") else response.headers.get("Last-Modified")
    _mark_path(part).write_text(json.dumps({"url": url, "mark": mark}))


def _mark(part: Path, url: str) -> str | None:
    """Return what names the version of which the part is, if that is known."""
    try:
        kept = json.loads(_mark_path(part).read_text())
        return str(kept["mark"]) if kept["url"] == url and kept["mark"] else None
    except (OSError, ValueError, KeyError, TypeError):
        return None
