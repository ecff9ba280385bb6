# SPDX-License-Identifier: Apache-2.0
"""A secure network of real Zenoh sessions in this process: the router, each identity, and strangers."""

from __future__ import annotations

import datetime as dt
import json
import socket
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import TYPE_CHECKING, Any

import pytest

from softgrip_security.certificates import make_authority, make_certificate, read_credential
from softgrip_security.keystore import Keystore
from softgrip_security.policy import Policy, read_policy
from softgrip_testing.waiting import wait_until

if TYPE_CHECKING:
    import zenoh

DOMAIN = 16


class Network:
    """Sessions on one router; each with an identity's configuration as the keystore holds it."""

    def __init__(self, keys: Path, policy: Policy) -> None:
        self.keys = keys
        self.policy = policy
        self.sessions: list[zenoh.Session] = []
        self.port = self.free_port()
        self.router = self.open("router")

    def values(self, name: str) -> dict[str, Any]:
        """Return an identity's configuration, on this network's port."""
        values: dict[str, Any] = json.loads((self.keys / "zenoh" / f"{name}.json5").read_text())
        side = "listen" if name == "router" else "connect"
        values[side]["endpoints"] = [f"tls/localhost:{self.port}"]
        # thirty sessions share one process here: on a busy machine none of them is to be given up
        values["transport"]["link"]["tx"]["lease"] = 60_000
        return values

    def open(self, name: str, change: Callable[[dict[str, Any]], None] = lambda _: None) -> zenoh.Session:
        values = self.values(name)
        change(values)
        import zenoh  # noqa: PLC0415  not there on ROS 2: its tests are skipped

        session = zenoh.open(zenoh.Config.from_json5(json.dumps(values)))
        self.sessions.append(session)
        return session

    def meet(self, *sessions: zenoh.Session) -> None:
        """Wait until sessions have met each other."""
        for one in sessions:
            others = {str(other.info.zid()) for other in sessions} - {str(one.info.zid())}
            wait_until(
                lambda one=one, others=others: others <= {str(zid) for zid in one.info.peers_zid()}, "peers meet"
            )

    @staticmethod
    def free_port() -> int:
        with socket.socket() as probe:
            probe.bind(("127.0.0.1", 0))
            return int(probe.getsockname()[1])

    @staticmethod
    def data_key(name: str) -> str:
        return f"{DOMAIN}/{name.strip('/')}/pkg::msg::dds_::Type_/RIHS01_0"

    @staticmethod
    def node_token(session: zenoh.Session, node: str) -> str:
        return f"@ros2_lv/{DOMAIN}/{session.info.zid()}/0/0/NN/%/%/{node}"

    @staticmethod
    def endpoint_token(session: zenoh.Session, node: str, kind: str, name: str) -> str:
        mangled = name.replace("/", "%")
        return f"@ros2_lv/{DOMAIN}/{session.info.zid()}/0/1/{kind}/%/%/{node}/{mangled}/type/hash/::,:,:,:,,"

    @staticmethod
    def without_rules(values: dict[str, Any]) -> None:
        """What somebody does who has taken an identity over: keep the keys, drop the rules."""
        values.pop("access_control")

    def close(self) -> None:
        for session in reversed(self.sessions):
            session.close()


@pytest.fixture(scope="session")
def policy() -> Policy:
    return read_policy()


@pytest.fixture(scope="session")
def keys(tmp_path_factory: pytest.TempPathFactory, policy: Policy) -> Path:
    folder = tmp_path_factory.mktemp("secure") / "keys"
    Keystore(folder, policy).make()
    return folder


@pytest.fixture(scope="class")
def class_network(keys: Path, policy: Policy) -> Iterator[Network]:
    """One network for all tests of a class."""
    made = Network(keys, policy)
    yield made
    made.close()


@pytest.fixture
def network(keys: Path, policy: Policy) -> Iterator[Network]:
    made = Network(keys, policy)
    yield made
    made.close()


@pytest.fixture(scope="session")
def forged(keys: Path, tmp_path_factory: pytest.TempPathFactory) -> Callable[[str], Path]:
    """Return a folder with cert.pem, key.pem and identity_ca.cert.pem of somebody who does not belong here."""
    now = dt.datetime.now(dt.UTC)
    authority = read_credential((keys / "public/ca.cert.pem").read_bytes(), (keys / "private/ca.key.pem").read_bytes())
    own = {
        "another authority": make_certificate(make_authority(now), "/softgrip/engineer", [], now, 10),
        "expired": make_certificate(authority, "/softgrip/engineer", [], now - dt.timedelta(days=20), 10),
        "not in the policy": make_certificate(authority, "/softgrip/nobody", [], now, 10),
    }

    def folder_of(kind: str) -> Path:
        folder = tmp_path_factory.mktemp("forged")
        (folder / "cert.pem").write_bytes(own[kind].certificate_pem)
        (folder / "key.pem").write_bytes(own[kind].key_pem)
        (folder / "identity_ca.cert.pem").write_bytes((keys / "public/ca.cert.pem").read_bytes())
        return folder

    return folder_of
