# SPDX-License-Identifier: Apache-2.0
"""Configurations of Zenoh from files, by the variables of rmw_zenoh_cpp: how TLS and access control come in."""

from __future__ import annotations

import json
import os
import re
import stat
from pathlib import Path
from typing import TYPE_CHECKING

import zenoh

from embedded_ros.errors import WireError

if TYPE_CHECKING:
    from collections.abc import Iterable

SESSION_VARIABLE = "ZENOH_SESSION_CONFIG_URI"
ROUTER_VARIABLE = "ZENOH_ROUTER_CONFIG_URI"
ROUTER_PORT = 7447
_OWN_MACHINE = r"(?P<where>(?:tcp|tls)/(?:localhost|127\.0\.0\.1|\[::1?\])):(?P<port>\d+)"
_KEYS = ("transport/link/tls/listen_private_key", "transport/link/tls/connect_private_key")
_OTHERS = 0o077


def read_configuration(variable: str, port: int) -> zenoh.Config | None:
    """Return the configuration of the file that a variable names; None when it names none.

    As with rmw_zenoh_cpp, the file stands in place of the defaults. Port 7447 on this machine, its usual one, stands
    for the port of the domain, so that domains do not meet here either.

    Args:
        variable: SESSION_VARIABLE or ROUTER_VARIABLE.
        port: of the router of this domain.

    Raises:
        WireError: the file cannot be read, Zenoh refuses it, or a private key in it is open to others.
    """
    text = os.environ.get(variable)
    if not text:
        return None
    try:
        configuration = zenoh.Config.from_file(text)
    except Exception as error:
        raise WireError(f"{variable}: expected a configuration of Zenoh in {text}, found: {error}") from error
    for side in ("connect", "listen"):
        endpoints = json.loads(configuration.get_json(f"{side}/endpoints"))
        if isinstance(endpoints, list):
            moved = json.dumps([_moved(endpoint, port) for endpoint in endpoints])
            configuration.insert_json5(f"{side}/endpoints", moved)
    for path in _private_keys(configuration):
        check_private(path)
    return configuration


def own_router_port(configuration: zenoh.Config) -> int | None:
    """Return the port of this machine at which a session looks for its router; None when that is on another one."""
    found = re.search(_OWN_MACHINE, configuration.get_json("connect/endpoints"))
    return int(found["port"]) if found else None


def check_private(path: Path) -> None:
    """Check that nobody but this user can read a private key.

    Raises:
        WireError: it is not there, belongs to somebody else, or is open to others.
    """
    try:
        found = path.stat()
    except OSError as error:
        raise WireError(f"{path}: expected a private key, found: {error.strerror}; make it with `make keys`") from error
    if found.st_uid != os.getuid():
        raise WireError(f"{path}: expected a key of user {os.getuid()}, found user {found.st_uid}; chown it")
    if found.st_mode & _OTHERS:
        raise WireError(f"{path}: expected mode 0600, found {stat.S_IMODE(found.st_mode):04o}; chmod go= it")


def _moved(endpoint: object, port: int) -> object:
    if isinstance(endpoint, str) and (found := re.match(_OWN_MACHINE, endpoint)) and int(found["port"]) == ROUTER_PORT:
        return f"{found['where']}:{port}{endpoint[found.end() :]}"
    return endpoint


def _private_keys(configuration: zenoh.Config) -> Iterable[Path]:
    named = {json.loads(configuration.get_json(key)) for key in _KEYS}
    return [Path(name) for name in sorted(name for name in named if name)]
