# SPDX-License-Identifier: Apache-2.0
"""Configurations of Zenoh from files, and what ZENOH_CONFIG_OVERRIDE is laid over."""

from __future__ import annotations

import json
import os
import socket
from pathlib import Path
from typing import Any

import pytest

from embedded_ros import network
from embedded_ros.errors import WireError
from embedded_ros.network_files import ROUTER_VARIABLE, SESSION_VARIABLE, own_router_port, read_configuration


@pytest.fixture(autouse=True)
def no_variables(monkeypatch: pytest.MonkeyPatch) -> None:
    for name in (SESSION_VARIABLE, ROUTER_VARIABLE, "ZENOH_CONFIG_OVERRIDE", "EMBEDDED_ROUTER_PORT"):
        monkeypatch.delenv(name, raising=False)


def write(path: Path, monkeypatch: pytest.MonkeyPatch, variable: str, **values: Any) -> None:
    path.write_text("// JSON5, as Zenoh reads it\n" + json.dumps(values))
    monkeypatch.setenv(variable, str(path))


def endpoints(configuration: Any, side: str) -> Any:
    return json.loads(configuration.get_json(f"{side}/endpoints"))


def test_no_variable_no_configuration() -> None:
    assert read_configuration(SESSION_VARIABLE, 7463) is None


def test_an_empty_variable_is_none(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv(SESSION_VARIABLE, "")
    assert read_configuration(SESSION_VARIABLE, 7463) is None


def test_zenohs_usual_port_on_this_machine_is_that_of_the_domain(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    stated = [
        "tls/localhost:7447",
        "tcp/[::]:7447",
        "tls/cell-pc:7447",
        "tls/localhost:7500",
        "tls/localhost:7447#iface=lo",
    ]
    write(tmp_path / "session.json5", monkeypatch, SESSION_VARIABLE, connect={"endpoints": stated})
    found = read_configuration(SESSION_VARIABLE, 7463)
    assert endpoints(found, "connect") == [
        "tls/localhost:7463",
        "tcp/[::]:7463",
        "tls/cell-pc:7447",
        "tls/localhost:7500",
        "tls/localhost:7463#iface=lo",
    ]


@pytest.mark.parametrize(
    ("endpoint", "port"), [("tls/localhost:7463", 7463), ("tcp/127.0.0.1:99", 99), ("tls/cell-pc:7447", None)]
)
def test_a_router_is_hosted_only_where_it_is_looked_for(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, endpoint: str, port: int | None
) -> None:
    write(tmp_path / "session.json5", monkeypatch, SESSION_VARIABLE, connect={"endpoints": [endpoint]})
    assert own_router_port(network.session_configuration(16)) == port


def test_the_override_is_laid_over_the_file(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    write(tmp_path / "session.json5", monkeypatch, SESSION_VARIABLE, connect={"endpoints": ["tcp/localhost:7447"]})
    monkeypatch.setenv("ZENOH_CONFIG_OVERRIDE", 'connect/endpoints=["tcp/localhost:7600"];mode="client"')
    found = network.session_configuration(16)
    assert endpoints(found, "connect") == ["tcp/localhost:7600"]
    assert json.loads(found.get_json("mode")) == "client"


def test_the_router_takes_the_override_but_not_what_is_the_sessions(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv(
        "ZENOH_CONFIG_OVERRIDE",
        'queries_default_timeout=5;connect/endpoints=["tcp/localhost:7600"];listen/endpoints=["tcp/localhost:0"];mode="client"',
    )
    found = network.router_configuration(7463)
    assert json.loads(found.get_json("queries_default_timeout")) == 5
    assert endpoints(found, "listen") == ["tcp/localhost:7463"]
    assert endpoints(found, "connect") == []
    assert json.loads(found.get_json("mode")) == "router"


def test_the_router_takes_its_file(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    write(
        tmp_path / "router.json5", monkeypatch, ROUTER_VARIABLE, mode="router", listen={"endpoints": ["tcp/[::]:7447"]}
    )
    assert endpoints(network.router_configuration(7463), "listen") == ["tcp/[::]:7463"]


def test_a_session_with_a_file_hosts_no_router_of_ours(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    assert network.may_host()
    write(tmp_path / "session.json5", monkeypatch, SESSION_VARIABLE)
    assert not network.may_host()
    write(tmp_path / "router.json5", monkeypatch, ROUTER_VARIABLE, mode="router")
    assert network.may_host()


def test_what_cannot_be_read_is_refused(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv(SESSION_VARIABLE, str(tmp_path / "none.json5"))
    with pytest.raises(WireError, match=SESSION_VARIABLE):
        network.session_configuration(16)
    write(tmp_path / "session.json5", monkeypatch, SESSION_VARIABLE, moed="peer")
    with pytest.raises(WireError, match="moed"):
        network.session_configuration(16)


def with_key(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, mode: int | None) -> None:
    key = tmp_path / "key.pem"
    if mode is not None:
        key.write_text("secret")
        key.chmod(mode)
    tls = {"listen_private_key": str(key), "connect_private_key": str(key)}
    write(tmp_path / "session.json5", monkeypatch, SESSION_VARIABLE, transport={"link": {"tls": tls}})


@pytest.mark.parametrize("mode", [0o644, 0o640, 0o620, 0o601])
def test_a_private_key_that_lies_open_is_refused(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, mode: int) -> None:
    with_key(tmp_path, monkeypatch, mode)
    with pytest.raises(WireError, match=f"expected mode 0600, found {mode:04o}"):
        network.session_configuration(16)


def test_a_private_key_of_this_user_alone_is_taken(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    with_key(tmp_path, monkeypatch, 0o600)
    network.session_configuration(16)


def test_a_missing_private_key_is_named(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    with_key(tmp_path, monkeypatch, None)
    with pytest.raises(WireError, match="make keys"):
        network.session_configuration(16)


@pytest.mark.skipif(os.getuid() != 0, reason="only root can give a file away")
def test_the_private_key_of_somebody_else_is_refused(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    with_key(tmp_path, monkeypatch, 0o600)
    os.chown(tmp_path / "key.pem", 12345, 12345)
    with pytest.raises(WireError, match="found user 12345"):
        network.session_configuration(16)


def test_a_look_at_the_port_connects_to_nobody() -> None:
    """A router with TLS accepts nobody for a tenth of a second after a connection that says nothing."""
    with socket.create_server(("127.0.0.1", 0)) as router:
        port = router.getsockname()[1]
        router.setblocking(False)
        assert network.port_is_open(port)
        with pytest.raises(BlockingIOError):
            router.accept()
    assert not network.port_is_open(port)
