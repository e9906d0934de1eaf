"""Prints what packages of this repository need from others, a requirement a line.

So that an image has its foreign packages, which are large and seldom change, in a layer of their own. Runs in the build
stage of the Dockerfiles, with nothing but Python.
"""

from __future__ import annotations

import argparse
import re
import tomllib
from pathlib import Path

ACCELERATORS = {
    "cpu": "onnxruntime",
    "cuda": "onnxruntime-gpu[cuda,cudnn]",
    "openvino": "onnxruntime-openvino",
}
_PROJECT = re.compile(r"(?P<folder>\w+)(\[(?P<extra>\w*)\])?")


def requirements(projects: list[str], accelerator: str, root: Path) -> list[str]:
    """Return what projects need, without the packages of this repository, sorted.

    Args:
        projects: Folders with a ``pyproject.toml``, each perhaps with an extra: ``robot_client[kachaka]``.
        accelerator: A key of ``ACCELERATORS``: which build of onnxruntime takes the place of the usual one.
        root: Where the folders lie.
    """
    needed: set[str] = set()
    for project in projects:
        match = _PROJECT.fullmatch(project)
        if match is None:
            raise SystemExit(f"{project}: expected FOLDER or FOLDER[EXTRA]")
        table = tomllib.loads((root / match["folder"] / "pyproject.toml").read_text())["project"]
        needed.update(table["dependencies"])
        if match["extra"]:
            needed.update(table["optional-dependencies"][match["extra"]])
    foreign = {each for each in needed if not each.startswith("revnm-")}
    return sorted(ACCELERATORS[accelerator] if each == "onnxruntime" else each for each in foreign)


def main() -> None:
    """Print the requirements of the projects on the command line."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0] if __doc__ else None)
    parser.add_argument("projects", nargs="+", metavar="FOLDER[EXTRA]")
    parser.add_argument("--accelerator", choices=sorted(ACCELERATORS), default="cpu", help="(default: cpu)")
    options = parser.parse_args()
    print("\n".join(requirements(options.projects, options.accelerator, Path.cwd())))


if __name__ == "__main__":
    main()
