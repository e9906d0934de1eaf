"""``revnm-server models``: which depth networks of others are known, and how to get one."""

from __future__ import annotations

import argparse
import re
import sys
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import yaml

from revnm_client.errors import ConfigError
from revnm_client.exit_status import INTERRUPTED
from revnm_server.networks.download import RemoteFile, check_url, download, http_client
from revnm_server.networks.model_catalogue import CatalogueEntry, CatalogueFile, file_name, load_catalogue

_FILE_NAME = re.compile(r"[A-Za-z0-9_-][A-Za-z0-9_.-]{0,63}")
_SHA256 = re.compile(r"[0-9a-f]{64}")


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the command's options."""
    actions = parser.add_subparsers(required=True, metavar="ACTION", dest="action")
    actions.add_parser("list", help="print the networks that are known by name")
    fetch = actions.add_parser("fetch", help="download a network, or go on with it, and print its settings")
    fetch.add_argument("model", metavar="NAME|URL", help="a name of the list, or where a network is")
    fetch.add_argument("--sha256", metavar="HEX", help="sum of the file, where the list has none")
    fetch.add_argument("--to", type=Path, default=Path("models"), metavar="DIR", help="folder (default: models)")


def run(options: argparse.Namespace) -> int:
    """List or fetch; return 0, or 130 where it was interrupted.

    Raises:
        RevnmError: It cannot be fetched; the text says why.
    """
    catalogue = load_catalogue()
    if options.action == "list":
        print("\n".join(_listed(name, entry) for name, entry in catalogue.items()))
        return 0
    sha256 = _sum(options.sha256)
    try:
        if "://" in options.model:
            settings = _fetch_url(options.model, sha256, options.to)
        else:
            settings = fetch_known(catalogue, options.model, sha256, options.to)
    except KeyboardInterrupt:
        print("\nrevnm-server: interrupted; run it again to go on", file=sys.stderr)
        return INTERRUPTED
    print(yaml.safe_dump({"depth": settings}, sort_keys=False), end="")
    return 0


def _listed(name: str, entry: CatalogueEntry) -> str:
    sizes = [file.size_bytes for file in entry.files if file.size_bytes is not None]
    size = f"{sum(sizes) / 1e6:.0f} MB" if len(sizes) == len(entry.files) else "size unknown"
    ready = all(file.sha256 for file in entry.files)
    facts = [size, entry.licence, entry.depth["kind"], "ready" if ready else "needs --sha256"]
    return f"{name}\n  {entry.about}\n  {', '.join(facts)}\n  {entry.source}"


def _sum(text: str | None) -> str | None:
    if text is not None and not _SHA256.fullmatch(text.lower()):
        raise ConfigError(f"--sha256 {text}: expected 64 hexadecimal digits")
    return text.lower() if text is not None else None


def fetch_known(catalogue: Mapping[str, CatalogueEntry], name: str, sha256: str | None, folder: Path) -> dict[str, Any]:
    """Download the files of a known network into a folder of its name.

    Args:
        catalogue: The known networks.
        name: One of them.
        sha256: Sum of its file, where the catalogue has none.
        folder: Where the network's folder shall lie.

    Returns:
        The settings of the section ``depth``.

    Raises:
        ConfigError: There is no such network, or its sum is not known or is another one.
        LinkError: The server cannot be reached, refuses or breaks off.
        FileError: A file cannot be written or has another sum.
    """
    entry = catalogue.get(name)
    if entry is None:
        raise ConfigError(f"{name}: expected a URL or one of {', '.join(catalogue)}")
    wanted = [_wanted(file, sha256, entry.source) for file in entry.files]
    for file, remote in zip(entry.files, wanted, strict=True):
        _fetch(remote, folder / name / file.name)
    settings: dict[str, Any] = {"model": str((folder / name / entry.files[0].name).resolve())}
    settings["sha256"] = wanted[0].sha256
    if len(wanted) > 1:
        settings["data"] = {file.name: remote.sha256 for file, remote in zip(entry.files, wanted, strict=True)}
        del settings["data"][entry.files[0].name]
    return settings | entry.depth


def _wanted(file: CatalogueFile, sha256: str | None, source: str) -> RemoteFile:
    if file.sha256 is None and sha256 is None:
        raise ConfigError(f"{file.url}: its sha256 is not known here; take it from {source} and give it as --sha256")
    if file.sha256 is not None and sha256 not in (None, file.sha256):
        raise ConfigError(f"--sha256 {sha256}: {file.url} is known to have {file.sha256}")
    return RemoteFile(file.url, file.sha256 or str(sha256), file.size_bytes)


def _fetch_url(url: str, sha256: str | None, folder: Path) -> dict[str, Any]:
    check_url(url)
    if sha256 is None:
        raise ConfigError(
            f"{url}: expected --sha256, the sum that its publisher tells; Hugging Face shows it on the page of the file"
        )
    name = file_name(url)
    if not _FILE_NAME.fullmatch(name):
        raise ConfigError(f"{url}: expected the name of a file at the end, of letters, digits, _, - and .")
    _fetch(RemoteFile(url, sha256), folder / name)
    return {"model": str((folder / name).resolve()), "sha256": sha256, "kind": "disparity | depth | metric_canonical"}


def _fetch(remote: RemoteFile, path: Path) -> None:
    with http_client() as client:
        done = download(remote, path, client=client)
    print(f"revnm-server: {path}: {'downloaded' if done else 'there already'}, sha256 is right", file=sys.stderr)
