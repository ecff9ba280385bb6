# SPDX-License-Identifier: Apache-2.0
"""The shipped cell with secure:=true, and whether the policy has a place for all that runs without it."""

from __future__ import annotations

import importlib.util
import subprocess
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

from softgrip_security.keystore import Keystore
from softgrip_security.policy import Policy, PolicyIdentity, read_policy
from softgrip_security.zenoh_access import access_control

IS_EMBEDDED = importlib.util.find_spec("embedded_ros") is not None
CELL = {
    "emulated_cell",
    "recorder",
    "tendon_driver",
    "friction_rig",
    "kinematics_predictor",
    "gdfe_simulator",
    "camera",
    "marker_tracker",
    "grasp_mix_manager",
}


def ask(cell: Any, identity: str | None, keys: Path, *arguments: str, timeout: float = 30.0) -> str:
    """Return what a command prints that an identity runs in a cell's domain; None is somebody without keys."""
    environment = dict(cell.environment)
    if identity is not None:
        environment |= {
            "ZENOH_SESSION_CONFIG_URI": str(keys / "zenoh" / f"{identity}.json5"),
            "ROS_SECURITY_KEYSTORE": str(keys),
            "ROS_SECURITY_ENABLE": "true",
            "ROS_SECURITY_STRATEGY": "Enforce",
            "ROS_SECURITY_ENCLAVE_OVERRIDE": f"/softgrip/{identity}",
        }
    try:
        answer = subprocess.run(
            ["ros2", *arguments], capture_output=True, text=True, env=environment, timeout=timeout, check=False
        )
    except subprocess.TimeoutExpired as error:
        return error.stdout.decode() if error.stdout else ""
    return answer.stdout + answer.stderr


def tokens(domain: int, monkeypatch: pytest.MonkeyPatch) -> set[str]:
    """Return the liveliness tokens of all nodes of a domain."""
    network = importlib.import_module("embedded_ros.network")
    found: set[str] = set()
    monkeypatch.delenv("EMBEDDED_ROUTER_PORT", raising=False)
    session, _ = network.open_session(domain, host=False)
    try:
        session.liveliness().declare_subscriber(
            f"@ros2_lv/{domain}/**", lambda sample: found.add(str(sample.key_expr)), history=True
        )
        deadline = time.monotonic() + 30.0
        while not {key.split("/")[8] for key in set(found)} >= CELL:  # the session's thread adds to it meanwhile
            assert time.monotonic() < deadline, f"expected {CELL} within 30 s, found {found}"
            time.sleep(0.05)
        return set(found)
    finally:
        session.close()


def owner(policy: Policy, node: str) -> PolicyIdentity | None:
    """Return the identity that a node belongs to."""
    for one in policy.identities:
        for pattern in one.node_names:
            if node == pattern or (pattern.endswith("*") and node.startswith(pattern[:-1])):
                return one
    return None


@pytest.mark.ros
@pytest.mark.skipif(not IS_EMBEDDED, reason="the graph is walked by the sessions of embedded/")
def test_all_that_a_running_cell_has_is_in_the_policy(
    launch: Callable[..., Any], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    zenoh = importlib.import_module("zenoh")
    cell = launch("ros2", "launch", "softgrip_bringup", "cell.launch.yaml", f"out:={tmp_path}/out")
    cell.wait_for("bus loop: 100 Hz", 60.0)
    policy = read_policy()
    rules = access_control(policy)["rules"]
    missing = []
    for token in tokens(cell.domain, monkeypatch):
        identity = owner(policy, token.split("/")[8])
        granted = [
            zenoh.KeyExpr(key)
            for rule in rules
            if identity
            and rule["id"].startswith(f"{identity.name}-ingress-")
            and "liveliness_token" in rule["messages"]
            for key in rule["key_exprs"]
        ]
        if not any(key.includes(zenoh.KeyExpr(token)) for key in granted):
            missing.append("/".join(token.split("/")[5:10]))
    assert sorted(missing) == []


@pytest.mark.ros
@pytest.mark.timeout(300)  # who gets no answer waits for it
def test_a_secure_cell_serves_who_may_and_nobody_else(
    launch: Callable[..., Any], secure_router: Callable[[Path], None], tmp_path: Path
) -> None:
    keys = tmp_path / "keys"
    Keystore(keys, read_policy()).make()
    secure_router(keys)
    cell = launch(
        *("ros2", "launch", "softgrip_bringup", "cell.launch.yaml"),
        *(f"out:={tmp_path}/out", "secure:=true", f"keys:={keys}"),
    )
    cell.wait_for("bus loop: 100 Hz", 60.0)
    deadline = time.monotonic() + 60.0
    # [s] DDS discovers each process through a handshake of certificates; embedded/ does not wait
    patient = ("--no-daemon", "--spin-time", "12")
    nodes = ("node", "list", *patient)
    while not {f"/{node}" for node in CELL} <= set((found := ask(cell, "look", keys, *nodes)).split()):
        assert time.monotonic() < deadline, f"expected {CELL}, found {found}"
    stop = ("service", "call", "/estop", "std_srvs/srv/Trigger")
    assert "/camera" not in ask(cell, None, keys, *nodes)
    assert "success=True" not in ask(cell, None, keys, *stop, timeout=15.0)
    assert "success=True" not in ask(cell, "look", keys, *stop, timeout=15.0)
    set_parameter = ("param", "set", *patient, "/kinematics_predictor", "use_sim_time", "false")
    reached = "use_sim_time' may be set at the start only"
    assert reached not in ask(cell, "operate", keys, *set_parameter)
    assert reached in ask(cell, "engineer", keys, *set_parameter)
    assert "success=True" in ask(cell, "operate", keys, *stop)
    cell.interrupt()
    cell.wait_for_end(30.0)
    assert cell.survivors() == []


@pytest.mark.ros
def test_a_cell_without_its_keys_does_not_start(launch: Callable[..., Any], tmp_path: Path) -> None:
    cell = launch(
        *("ros2", "launch", "softgrip_bringup", "cell.launch.yaml"),
        *(f"out:={tmp_path}/out", "secure:=true", f"keys:={tmp_path}/none"),
    )
    cell.wait_for_end(100.0)
    assert ("ZENOH_SESSION_CONFIG_URI" if IS_EMBEDDED else "SECURITY ERROR") in cell.output
    assert "bus loop" not in cell.output


@pytest.mark.ros
@pytest.mark.skipif(
    not IS_EMBEDDED, reason="the middlewares of ROS 2 read a key that lies open; `keys --check` reports it"
)
def test_a_cell_whose_key_lies_open_does_not_start(launch: Callable[..., Any], tmp_path: Path) -> None:
    keys = tmp_path / "keys"
    Keystore(keys, read_policy()).make()
    (keys / "enclaves" / "softgrip" / "tendon_driver" / "key.pem").chmod(0o644)
    cell = launch(
        *("ros2", "launch", "softgrip_bringup", "cell.launch.yaml"),
        *(f"out:={tmp_path}/out", "secure:=true", f"keys:={keys}"),
    )
    cell.wait_for_end(100.0)
    assert "expected mode 0600, found 0644" in cell.output
