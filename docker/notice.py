"""Writes ``NOTICE``: what the built images contain, and under which licences. ``make notice`` runs it."""

from __future__ import annotations

import json
import subprocess
from pathlib import Path
from typing import Any

_HERE = Path(__file__).parent
_IMAGES = ("revnm-robot", "revnm-server", "revnm-simulator")


def inventory(image: str) -> dict[str, list[dict[str, Any]]]:
    """Return what an image contains, as ``inventory.py`` tells."""
    command = ["podman", "run", "--rm", "--interactive", "--network", "none", "--entrypoint", "python3", image, "-"]
    shown = subprocess.run(  # noqa: S603 - our own images
        command, input=(_HERE / "inventory.py").read_text(), capture_output=True, text=True, check=True
    )
    found: dict[str, list[dict[str, Any]]] = json.loads(shown.stdout)
    return found


def notice(inventories: dict[str, dict[str, list[dict[str, Any]]]]) -> str:
    """Return the text of ``NOTICE``.

    Args:
        inventories: By image.
    """
    parts = [(_HERE / "notice_head.txt").read_text()]
    for image, found in inventories.items():
        parts.append(f"Python packages of {image}\n")
        parts += [_python_line(each) for each in found["python"] if not each["name"].startswith("revnm-")]
        parts.append("")
    debian = {each["name"]: each for found in inventories.values() for each in found["debian"]}
    parts.append("Debian packages of all images\n")
    parts += [f"{each['name']} {each['version']}  {each['licence']}" for _, each in sorted(debian.items())]
    return "\n".join(parts) + "\n"


def _python_line(package: dict[str, Any]) -> str:
    line = f"{package['name']}=={package['version']}  {package['licence']}  {package['address']}".rstrip()
    libraries = ", ".join(package["libraries"])
    return f"{line}\n    brings {libraries}" if libraries else line


if __name__ == "__main__":
    (_HERE.parent / "NOTICE").write_text(notice({image: inventory(image) for image in _IMAGES}))
