# SPDX-License-Identifier: Apache-2.0
"""Opens the Zenoh session of a context, and lets any process host the router that sessions meet at."""

from __future__ import annotations

import contextlib
import errno
import json
import os
import socket
import stat
import threading
import time
from typing import Any

import zenoh

from embedded_ros import limits, network_files
from embedded_ros.errors import WireError
from embedded_ros.network_files import ROUTER_PORT

PORT_VARIABLE = "EMBEDDED_ROUTER_PORT"
OVERRIDE_VARIABLE = "ZENOH_CONFIG_OVERRIDE"
#: What ZENOH_CONFIG_OVERRIDE says of these is meant for the session of a process, not for a router that it hosts.
_OF_SESSIONS = ("mode", "id", "connect", "listen")
_KEEPER_PERIOD_S = 1.0
_LEASE_MS = 10_000
_ROUTER_DEADLINE_S = 10.0
_LOOK_PERIOD_S = 0.002
_PROBE_PERIOD_S = 0.1
_FILE_DESCRIPTORS = 1024
_INTERNET = (socket.AF_INET, socket.AF_INET6)

_COMMON = {
    "timestamping/enabled": {"router": True, "peer": True, "client": True},
    "queries_default_timeout": 600_000,
    "scouting/multicast/enabled": False,
    "scouting/gossip/enabled": True,
    "transport/unicast/open_timeout": 3_000,  # closing waits for it; connecting is tried again
    "transport/unicast/accept_timeout": 60_000,
    "transport/unicast/max_sessions": 10_000,
    "transport/unicast/accept_pending": 10_000,
    # Zenoh's own, and about that of DDS; rmw_zenoh uses 60 s. A shorter one takes a process for gone that a busy
    # computer has given no processor for so long. Who must know of a frozen node sooner pings it.
    "transport/link/tx/lease": _LEASE_MS,
    "transport/link/tx/keep_alive": 4,
    # A Python receiver that has just been off the processor must not cost messages: 1 MB waits for it before any is
    # dropped, and the sender a few milliseconds.
    "transport/link/tx/queue/size/data": 16,
    "transport/link/tx/queue/congestion_control/drop/wait_before_drop": 5_000,
    "transport/shared_memory/enabled": False,
    # Zenoh's default is 1 GiB: gathered in memory before anybody can refuse it.
    "transport/link/rx/max_message_size": limits.LINK_BYTES,
}


def router_port(domain: int) -> int:
    """Return the port of the router: EMBEDDED_ROUTER_PORT, else 7447 + domain, so that domains never meet."""
    text = os.environ.get(PORT_VARIABLE)
    if text is None:
        return ROUTER_PORT + domain
    if not text.isdigit() or not 0 < int(text) < 65536:
        raise WireError(f"{PORT_VARIABLE}: expected a TCP port 1..65535, found {text!r}")
    return int(text)


def overrides() -> dict[str, Any]:
    """Return ZENOH_CONFIG_OVERRIDE (``key/path=json5;key2=...``) as a dict of JSON5 texts."""
    found: dict[str, Any] = {}
    for item in os.environ.get(OVERRIDE_VARIABLE, "").split(";"):
        if item.strip():
            key, separator, value = item.partition("=")
            if not separator:
                raise WireError(f"{OVERRIDE_VARIABLE}: expected key/path=value, found {item!r}")
            found[key.strip()] = value.strip()
    return found


def _configuration(values: dict[str, Any]) -> zenoh.Config:
    configuration = zenoh.Config()
    for key, value in values.items():
        configuration.insert_json5(key, json.dumps(value))
    return configuration


def _override(configuration: zenoh.Config, patch: dict[str, Any]) -> zenoh.Config:
    for key, text in patch.items():
        try:
            configuration.insert_json5(key, text)
        except Exception as error:
            raise WireError(f"{OVERRIDE_VARIABLE}: Zenoh refuses {key}={text}: {error}") from error
    return configuration


def session_configuration(domain: int) -> zenoh.Config:
    """Return the configuration of a session: ZENOH_SESSION_CONFIG_URI or ours, with ZENOH_CONFIG_OVERRIDE on top."""
    port = router_port(domain)
    configuration = network_files.read_configuration(network_files.SESSION_VARIABLE, port)
    return _override(configuration or _default_session(port), overrides())


def _default_session(port: int) -> zenoh.Config:
    values = {
        **_COMMON,
        "mode": "peer",
        "connect/endpoints": [f"tcp/localhost:{port}"],
        "connect/timeout_ms": {"router": -1, "peer": -1, "client": 0},
        "connect/exit_on_failure": {"router": False, "peer": False, "client": True},
        "connect/retry": {"period_init_ms": 200, "period_max_ms": 1000, "period_increase_factor": 2},
        "listen/endpoints": ["tcp/localhost:0"],
        "scouting/delay": 100,
        "scouting/gossip/target": {"router": ["router", "peer"], "peer": ["router"]},
        "scouting/gossip/autoconnect": {"router": [], "peer": ["router", "peer"]},
        "scouting/gossip/autoconnect_strategy": {"peer": {"to_router": "always", "to_peer": "greater-zid"}},
    }
    return _configuration(values)


def router_configuration(port: int) -> zenoh.Config:
    """Return the configuration of the router: ZENOH_ROUTER_CONFIG_URI or ours, with ZENOH_CONFIG_OVERRIDE on top."""
    configuration = network_files.read_configuration(network_files.ROUTER_VARIABLE, port)
    patch = {key: text for key, text in overrides().items() if key.split("/")[0] not in _OF_SESSIONS}
    return _override(configuration or _default_router(port), patch)


def _default_router(port: int) -> zenoh.Config:
    values = {
        **_COMMON,
        "mode": "router",
        "connect/endpoints": [],
        "listen/endpoints": [f"tcp/localhost:{port}"],
        "listen/exit_on_failure": True,
        "scouting/delay": 0,
        "scouting/gossip/target": {"router": ["router", "peer"], "peer": ["router"]},
        "scouting/gossip/autoconnect": {"router": [], "peer": ["router", "peer"]},
        "scouting/gossip/autoconnect_strategy": {"router": {"to_router": "always", "to_peer": "always"}},
        "routing/router/peers_failover_brokering": False,
    }
    return _configuration(values)


def may_host() -> bool:
    """Whether this process may host the router: sessions that a file configures meet no router that none does."""
    environment = os.environ.get
    return not environment(network_files.SESSION_VARIABLE) or bool(environment(network_files.ROUTER_VARIABLE))


def port_is_open(port: int) -> bool:
    """Whether something on this machine listens on a port.

    Asked of the kernel, by taking the port and giving it back: a connection that says nothing would cost a router with
    TLS a tenth of a second in which it accepts nobody (zenoh-link-tls throttles after a failed handshake).
    """
    return any(_is_taken(family, host, port) for family, host in ((_INTERNET[0], "127.0.0.1"), (_INTERNET[1], "::1")))


def _is_taken(family: socket.AddressFamily, host: str, port: int) -> bool:
    try:
        with socket.socket(family, socket.SOCK_STREAM) as probe:
            probe.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)  # only a listener is in the way
            probe.bind((host, port))
    except OSError as error:
        return error.errno == errno.EADDRINUSE  # else there is no such family here
    return False


def drop_connection(port: int) -> None:
    """Cut this process's connections to a port of this machine; Zenoh, which has no call for it, connects again."""
    for number in range(_FILE_DESCRIPTORS):
        with contextlib.suppress(OSError):
            if stat.S_ISSOCK(os.fstat(number).st_mode):
                with socket.socket(fileno=os.dup(number)) as connection:
                    if connection.family in _INTERNET and connection.getpeername()[1] == port:
                        connection.shutdown(socket.SHUT_RDWR)


class RouterKeeper:
    """Hosts the router when nobody does: tried at the start, then each second while the session sees no router.

    It also mends the mesh after this process was frozen. Peers learn from the router where the others are, and try each
    other once; when a frozen process thaws, that one attempt may come while it still tears its old connections down,
    and fails. So a moment later it leaves the router and comes back: all are told of each other once more.
    """

    def __init__(self, port: int) -> None:
        self._port = port
        self._router: zenoh.Session | None = None
        self._session: zenoh.Session | None = None
        self._stop = threading.Event()
        self._thread: threading.Thread | None = None

    def try_host(self) -> bool:
        """Host the router unless something already listens on the port; return whether one runs here."""
        if self._router is None and not port_is_open(self._port):
            try:
                self._router = zenoh.open(router_configuration(self._port))
            except zenoh.ZError as error:
                if "in use" not in str(error) and os.strerror(errno.EADDRINUSE) not in str(error):
                    raise WireError(f"cannot host the router on port {self._port}: {error}") from error
        return self._router is not None

    def watch(self, session: zenoh.Session) -> None:
        """Take over when the router that ``session`` is connected to goes away."""
        self._session = session
        self._thread = threading.Thread(target=self._keep, name="router-keeper", daemon=True)
        self._thread.start()

    def _keep(self) -> None:
        looked_at = time.monotonic()
        thawed_at: float | None = None
        while not self._stop.wait(_KEEPER_PERIOD_S):
            before, looked_at = looked_at, time.monotonic()
            if looked_at - before > _LEASE_MS / 1000:  # the others have given this process up
                thawed_at = looked_at
            elif thawed_at is not None:
                thawed_at = None
                drop_connection(self._port)
            session = self._session
            if self._router is None and session is not None and not session.info.routers_zid():
                self.try_host()

    def close(self) -> None:
        """Stop watching and give the router up."""
        self._stop.set()
        if self._thread is not None:
            self._thread.join()
        if self._router is not None:
            self._router.close()  # type: ignore[no-untyped-call]  # zenoh's stub
            self._router = None


def open_session(domain: int, *, host: bool = True) -> tuple[zenoh.Session, RouterKeeper | None]:
    """Open the session of a context.

    Args:
        domain: ROS_DOMAIN_ID.
        host: whether this process may host the router; short-lived commands do not.

    Raises:
        WireError: the configuration is refused, or something that is no Zenoh router answers on the port.
    """
    configuration = session_configuration(domain)
    port = network_files.own_router_port(configuration)
    keeper = RouterKeeper(port) if host and port is not None and may_host() else None
    if keeper is not None:
        keeper.try_host()
    try:
        session = zenoh.open(configuration)
    except zenoh.ZError as error:
        if keeper is not None:
            keeper.close()
        raise WireError(f"cannot open a Zenoh session: {error}") from error
    if port is not None:
        try:
            _meet_router(session, keeper, port)
        except WireError:
            session.close()  # type: ignore[no-untyped-call]  # zenoh's stub
            raise
    if keeper is not None:
        keeper.watch(session)
    return session, keeper


def _meet_router(session: zenoh.Session, keeper: RouterKeeper | None, port: int) -> None:
    """Wait until the session has met the router; WireError when what answers on the port is none."""
    probe_at = time.monotonic()
    end = probe_at + _ROUTER_DEADLINE_S
    while not session.info.routers_zid():
        now = time.monotonic()
        if now >= probe_at:
            probe_at = now + _PROBE_PERIOD_S
            if not port_is_open(port) and (keeper is None or keeper.try_host()):
                return  # nobody there: alone, or the host itself
        if now > end:
            raise WireError(
                f"port {port} of this machine is taken by something that is no Zenoh router, or by one that does not "
                f"accept this process's certificate (no answer within {_ROUTER_DEADLINE_S:.0f} s); end it, set "
                f"{PORT_VARIABLE} to a free port for the whole cell, or check the keys"
            )
        time.sleep(_LOOK_PERIOD_S)
