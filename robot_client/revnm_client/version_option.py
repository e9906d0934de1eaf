"""``--version`` of every command line: the version of the installed package, looked up when it is asked for."""

from __future__ import annotations

import argparse
from collections.abc import Sequence


class VersionAction(argparse.Action):
    """Prints the version of the package that ``const`` names, and ends the program."""

    def __init__(self, option_strings: Sequence[str], dest: str, const: str) -> None:
        super().__init__(option_strings, dest, nargs=0, const=const, help="print the version and exit")
        self._package = const

    def __call__(self, parser: argparse.ArgumentParser, *_: object) -> None:
        """Print it."""
        from importlib.metadata import version  # to import it takes as long as all the rest of the command line

        print(f"{parser.prog} {version(self._package)}")
        parser.exit()
