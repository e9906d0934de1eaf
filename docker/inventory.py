"""Prints the packages in an image, with versions and licences, as JSON. Runs inside of it, with nothing but Python."""

from __future__ import annotations

import json
import re
import subprocess
from importlib.metadata import Distribution, distributions
from pathlib import Path

_LONGEST = 80
_IN_DEBIAN = re.compile(
    r"^License:[ \t]*(\S.*)$", re.MULTILINE
)  # https://www.debian.org/doc/packaging-manuals/copyright-format/1.0/
_ELSEWHERE = "see the text that it brings"


def python_packages() -> list[dict[str, object]]:
    """Return name, version, licence, address and bundled libraries of each Python package, sorted."""
    found = [
        {
            "name": each.name,
            "version": each.version,
            "licence": licence(each),
            "address": address(each),
            "libraries": sorted({file.name for file in each.files or [] if file.parts[0].endswith(".libs")}),
        }
        for each in distributions()
    ]
    return sorted(found, key=lambda each: str(each["name"]).lower())


def licence(distribution: Distribution) -> str:
    """Return the licence by the metadata: its SPDX expression, its classifiers, or a text that is a name."""
    metadata = distribution.metadata
    classified = [
        each.split(" :: ")[-1] for each in metadata.get_all("Classifier") or [] if each.startswith("License ::")
    ]
    text = (metadata.get("License") or "").strip()
    named = text if text and len(text) <= _LONGEST and "\n" not in text else _ELSEWHERE
    return (
        metadata.get("License-Expression") or "; ".join(each for each in classified if each != "OSI Approved") or named
    )


def address(distribution: Distribution) -> str:
    """Return where a package comes from."""
    urls = [each.split(", ", 1)[-1] for each in distribution.metadata.get_all("Project-URL") or []]
    return distribution.metadata.get("Home-page") or next(iter(urls), "")


def debian_packages() -> list[dict[str, object]]:
    """Return name, version and licences of each Debian package, sorted; their texts are in ``/usr/share/doc``."""
    command = ["/usr/bin/dpkg-query", "-W", "-f", "${Package} ${Version}\n"]
    shown = subprocess.run(command, capture_output=True, text=True, check=True)  # noqa: S603 - a constant
    return [
        {"name": name, "version": version, "licence": debian_licence(Path("/usr/share/doc") / name / "copyright")}
        for name, version in sorted(line.split() for line in shown.stdout.splitlines())
    ]


def debian_licence(copyright_file: Path) -> str:
    """Return the licences that a copyright file names, if it is written for machines."""
    names = _IN_DEBIAN.findall(copyright_file.read_text(errors="replace"))
    return ", ".join(sorted({name.strip() for name in names})) or _ELSEWHERE


if __name__ == "__main__":
    print(json.dumps({"python": python_packages(), "debian": debian_packages()}))
