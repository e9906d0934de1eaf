"""What a package imports, its pyproject.toml must name: else it works only where another package brings that along."""

from __future__ import annotations

import ast
import re
import sys
import tomllib
from importlib.metadata import packages_distributions
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[2]


def normal(name: str) -> str:
    return re.sub(r"[-_.]+", "-", name).lower()


def declared(project: Path) -> set[str]:
    """The distributions that a project asks for, itself and its extras included."""
    table = tomllib.loads((project / "pyproject.toml").read_text())["project"]
    extras = [each for names in table.get("optional-dependencies", {}).values() for each in names]
    named = [re.match(r"[\w.-]+", each) for each in [*table["dependencies"], *extras]]
    return {normal(table["name"]), *(normal(each.group()) for each in named if each)}


def imported(project: Path) -> dict[str, str]:
    """The foreign modules that a project imports, each with a file that does."""
    found = {}
    for file in project.glob("revnm_*/**/*.py"):
        for node in ast.walk(ast.parse(file.read_text())):
            names = [node.module] if isinstance(node, ast.ImportFrom) and node.module and not node.level else []
            names += [each.name for each in node.names] if isinstance(node, ast.Import) else []
            found |= {name.split(".")[0]: file.name for name in names}
    return {name: file for name, file in found.items() if name not in sys.stdlib_module_names}


@pytest.mark.parametrize("folder", ["robot_client", "server", "sim", "training"])
def test_a_package_declares_what_it_imports(folder: str) -> None:
    project, owners = ROOT / folder, packages_distributions()
    undeclared = {
        module: file
        for module, file in imported(project).items()
        if not {normal(owner) for owner in owners.get(module, [module])} & declared(project)
    }
    assert undeclared == {}
