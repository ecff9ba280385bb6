# SPDX-License-Identifier: Apache-2.0
"""`ros2 run softgrip_panel users`: who may log in at the panel."""

from __future__ import annotations

import argparse
import getpass
import sys
from collections.abc import Sequence
from pathlib import Path

from softgrip_panel.access.accounts import Accounts, add_account, remove_account
from softgrip_panel.errors import AccessError
from softgrip_panel.model.roles import Role
from softgrip_panel.texts import say


def main(args: Sequence[str] | None = None) -> int:
    """Add, remove or list accounts."""
    parser = argparse.ArgumentParser(prog="users", description="Who may log in at the panel, and with which role.")
    parser.add_argument("file", type=Path, help="users file; made where there is none, for this user alone")
    does = parser.add_subparsers(dest="does", required=True)
    add = does.add_parser("add", help="add somebody, or change role and password; asks for the password")
    add.add_argument("name")
    add.add_argument("role", choices=[role.word for role in Role])
    does.add_parser("remove", help="take somebody out").add_argument("name")
    does.add_parser("list", help="who may log in")
    options = parser.parse_args(args)
    try:
        if options.does == "add":
            add_account(options.file, options.name, Role[options.role.upper()], _password())
        elif options.does == "remove":
            remove_account(options.file, options.name)
        else:
            print("\n".join(Accounts(options.file).names))
    except AccessError as error:
        print(error, file=sys.stderr)
        return 1
    return 0


def _password() -> str:
    """Ask twice at a terminal; else take the first line of what is piped in."""
    if not sys.stdin.isatty():
        return sys.stdin.readline().rstrip("\n")
    first = getpass.getpass("password: ")
    if first != getpass.getpass("again: "):
        raise AccessError(say("error.password_twice"))
    return first


if __name__ == "__main__":
    sys.exit(main())
