# SPDX-License-Identifier: Apache-2.0
"""Who is not of the cell sees and does nothing: at the router, and at a node's own door."""

from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

from softgrip_testing.waiting import wait_until

pytest.importorskip("zenoh")
import zenoh

FORGED = ("another authority", "expired", "not in the policy")


def stranger(endpoint: str, tls: dict[str, Any] | None) -> zenoh.Session | None:
    """Open a session without rules; None when it is turned away at once."""
    configuration = {
        "mode": "client",
        "connect": {"endpoints": [endpoint], "timeout_ms": 1500, "exit_on_failure": True},
        "scouting": {"multicast": {"enabled": False}},
        **({"transport": {"link": {"tls": tls}}} if tls else {}),
    }
    try:
        return zenoh.open(zenoh.Config.from_json5(json.dumps(configuration)))
    except zenoh.ZError:
        return None


def certificate_in(folder: Path) -> dict[str, Any]:
    return {
        "root_ca_certificate": str(folder / "identity_ca.cert.pem"),
        "connect_private_key": str(folder / "key.pem"),
        "connect_certificate": str(folder / "cert.pem"),
        "enable_mtls": True,
    }


class Cell:
    """A driver, an engineer who may see everything, and what they have noticed."""

    def __init__(self, network: Any) -> None:
        self.network = network
        own_port = network.free_port()
        self.driver = network.open(
            "tendon_driver", lambda values: values["listen"].update(endpoints=[f"tls/localhost:{own_port}"])
        )
        self.engineer = network.open("engineer")
        network.meet(self.driver, self.engineer)
        self.node_io = [f"tls/localhost:{network.port}", f"tls/localhost:{own_port}"]
        self.asked: list[str] = []
        self.heard: list[str] = []
        self.tokens: set[str] = set()
        self.kept = [
            self.driver.declare_queryable(network.data_key("estop"), self._answer, complete=True),
            self.driver.declare_subscriber(network.data_key("tendon/trajectory"), self._hear),
            self.engineer.declare_subscriber(network.data_key("tendon/state"), self._hear),
            self.engineer.liveliness().declare_subscriber(
                "@ros2_lv/*/**", lambda sample: self.tokens.add(str(sample.key_expr)), history=True
            ),
            self.driver.liveliness().declare_token(network.node_token(self.driver, "tendon_driver")),
        ]

    def _answer(self, query: zenoh.Query) -> None:
        self.asked.append(str(query.key_expr))
        query.reply(query.key_expr, b"stopped")

    def _hear(self, sample: zenoh.Sample) -> None:
        self.heard.append(bytes(sample.payload).decode())


@pytest.fixture
def cell(network: Any) -> Cell:
    return Cell(network)


def try_everything(network: Any, session: zenoh.Session) -> set[str]:
    """Listen, speak, ask and look around; return what of others has been met."""
    own = str(session.info.zid())
    met: set[str] = set()

    def notice(sample: zenoh.Sample) -> None:
        if bytes(sample.payload) != b"stranger" and own not in str(sample.key_expr):
            met.add(str(sample.key_expr))

    for key in ("**", network.data_key("tendon/state")):
        session.declare_subscriber(key, notice)
    session.liveliness().declare_subscriber("@ros2_lv/**", notice, history=True)
    token = session.liveliness().declare_token(network.node_token(session, "tendon_driver"))
    for topic in ("tendon/trajectory", "tendon/state"):
        session.put(network.data_key(topic), b"stranger")
    for key in (network.data_key("estop"), "**", "@/**"):
        met |= {str(reply.ok.key_expr) for reply in session.get(key, timeout=1.0) if reply.ok}
    del token  # it was up all the while
    return {key for key in met if own not in key}


def check_that_it_is_shut_out(cell: Cell, session: zenoh.Session | None) -> None:
    """Try everything; then have an honest one do the same, so that silence means something."""
    network = cell.network
    met = try_everything(network, session) if session is not None else set()
    wait_until(lambda: act_honestly(cell), "the honest ones are heard and answered")
    assert met == set()
    assert "stranger" not in cell.heard
    wait_until(lambda: bool(cell.tokens), "the driver is seen")
    assert cell.tokens == {network.node_token(cell.driver, "tendon_driver")}


def act_honestly(cell: Cell) -> bool:
    key = cell.network.data_key
    cell.driver.put(key("tendon/state"), b"driver")
    cell.engineer.put(key("tendon/trajectory"), b"engineer")
    answered = any(reply.ok for reply in cell.engineer.get(key("estop"), timeout=1.0))
    return answered and {"driver", "engineer"} <= set(cell.heard)


@pytest.mark.parametrize("door", [0, 1], ids=["router", "node"])
@pytest.mark.parametrize("kind", ["no certificate", "no TLS", *FORGED])
def test_a_stranger_sees_and_does_nothing(
    cell: Cell, keys: Path, forged: Callable[[str], Path], door: int, kind: str
) -> None:
    endpoint = cell.node_io[door]
    assert endpoint.startswith("tls/")
    tls: dict[str, Any] | None
    if kind == "no certificate":
        tls = {"root_ca_certificate": str(keys / "public" / "ca.cert.pem")}
    elif kind == "no TLS":
        endpoint, tls = endpoint.replace("tls/", "tcp/"), None
    else:
        tls = certificate_in(forged(kind))
    session = stranger(endpoint, tls)
    check_that_it_is_shut_out(cell, session)
    if session is not None:
        session.close()


@pytest.mark.parametrize("door", [0, 1], ids=["router", "node"])
def test_only_who_has_no_place_in_the_policy_gets_past_the_handshake(
    cell: Cell, forged: Callable[[str], Path], door: int
) -> None:
    met = {kind: session for kind in FORGED if (session := stranger(cell.node_io[door], certificate_in(forged(kind))))}
    assert set(met) <= {"not in the policy"}
    for session in met.values():
        session.close()


def test_the_door_of_another_cells_router_is_not_entered(
    network: Any, forged: Callable[[str], Path], keys: Path
) -> None:
    """A session of the cell gives nothing to a router whose certificate is of another authority."""

    def someone_else(values: dict[str, Any]) -> None:
        folder = forged("another authority")
        tls = values["transport"]["link"]["tls"]
        for side in ("listen", "connect"):
            tls[f"{side}_private_key"], tls[f"{side}_certificate"] = str(folder / "key.pem"), str(folder / "cert.pem")
        values["access_control"]["enabled"] = False

    network.router.close()
    impostor = network.open("router", someone_else)
    driver = network.open("tendon_driver")
    tokens: list[str] = []
    impostor.liveliness().declare_subscriber("@ros2_lv/**", lambda sample: tokens.append(str(sample.key_expr)))
    token = driver.liveliness().declare_token(network.node_token(driver, "tendon_driver"))
    # the true router comes back in its place, and the driver finds it
    impostor.close()
    router = network.open("router")
    wait_until(lambda: [str(zid) for zid in driver.info.routers_zid()] == [str(router.info.zid())], "the router")
    assert tokens == []
    assert token is not None
