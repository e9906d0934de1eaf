"""``revnm-server pki``: a small authority of one's own, so that robots and server know each other."""

from __future__ import annotations

import argparse
from pathlib import Path

from revnm_server.pki import create_authority, issue_robot, issue_server, issued

_HOST = "name or address by which robots and browsers reach the server; may be repeated"
_FOLDER = Path("pki")


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the command's options."""
    actions = parser.add_subparsers(required=True, metavar="ACTION")
    init = actions.add_parser("init", help="make the authority, and a certificate for the server")
    init.set_defaults(action=_init)
    server = actions.add_parser("server", help="make a new certificate for the server: it has another address")
    server.set_defaults(action=_server)
    robot = actions.add_parser("robot", help="make the folder that is copied to a robot")
    robot.add_argument("name", metavar="NAME", help="of the robot, as in the settings")
    robot.set_defaults(action=_robot)
    listing = actions.add_parser("list", help="show all certificates, and until when they are good")
    listing.set_defaults(action=_list)
    for parser_ in (init, server):
        parser_.add_argument("--host", action="append", required=True, metavar="ADDRESS", help=_HOST)
    for parser_ in (init, server, robot, listing):
        parser_.add_argument("--pki", type=Path, default=_FOLDER, metavar="DIR", help="the authority's folder (pki)")


def run(options: argparse.Namespace) -> int:
    """Do what is asked; return 0.

    Raises:
        RevnmError: A name or a file is wrong; the text says which and why.
    """
    options.action(options)
    return 0


def _init(options: argparse.Namespace) -> None:
    folder: Path = options.pki
    create_authority(folder, options.host)
    print(f"{folder}: made. Who has {folder}/authority.key can let in any robot: keep it to yourself.")
    _print_settings(folder)


def _server(options: argparse.Namespace) -> None:
    issue_server(options.pki, options.host)
    print(f"{options.pki}/server.pem: made for {', '.join(options.host)}; it counts when the server is started anew")


def _robot(options: argparse.Namespace) -> None:
    folder = issue_robot(options.pki, options.name)
    print(f"{folder}: made. Copy it to the robot, readable for its client only, and add to its settings:\n")
    print("server: tls/SERVER:7447        # by a name or address that was given to pki init")
    print("security: {authority: authority.pem, certificate: robot.pem, key: robot.key}     # with their folder")


def _list(options: argparse.Namespace) -> None:
    for each in issued(options.pki):
        print(f"{each.ends:%Y-%m-%d}  {each.name:32}  {each.path}")


def _print_settings(folder: Path) -> None:
    print("The server's settings:\n")
    print('zenoh:\n  listen: ["tls/0.0.0.0:7447"]')
    print(f"  certificate: {folder}/server.pem\n  key: {folder}/server.key\n  authority: {folder}/authority.pem")
