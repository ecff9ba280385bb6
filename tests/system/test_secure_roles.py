# SPDX-License-Identifier: Apache-2.0
"""Clients of a running secure cell, each in a process of its own: the roles, and strangers of every kind.

Each tries everything (secure_client.py); a listener with the keys of `engineer` notes which of them were heard.
"""

from __future__ import annotations

import datetime as dt
import importlib.util
import json
import os
import shutil
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest
import rclpy

from softgrip_security.keystore import Keystore
from softgrip_security.policy import ACTION_SERVICES, ACTION_TOPICS, read_policy
from softgrip_testing.waiting import wait_until

pytestmark = [pytest.mark.ros, pytest.mark.slow]
CLIENT = Path(__file__).with_name("secure_client.py")
ROLES = ("look", "operate", "engineer")
IS_EMBEDDED = importlib.util.find_spec("embedded_ros") is not None
ON_ZENOH = IS_EMBEDDED or rclpy.get_rmw_implementation_identifier() == "rmw_zenoh_cpp"
#: What each attempt of the client is granted to (docs/security.md, People).
MATRIX: dict[str, tuple[str, ...]] = {
    "hears tendon/state": ROLES,
    "hears cell/state": ROLES,
    "hears emulator/truth": ("engineer",),
    "publishes tendon/trajectory": ("engineer",),
    "publishes tendon/heartbeat": ("operate", "engineer"),
    "publishes gripper/joint_commands": ("engineer",),
    "publishes safety/state": (),
    "calls cell/list_products": ROLES,
    "calls camera/get_parameters": ROLES,
    "calls tendon/lease": ("operate", "engineer"),
    "calls camera/set_parameters": ("engineer",),
    "calls emulator/place_object": ("engineer",),
    "calls tendon_driver/change_state": ("engineer",),
    "orders tendon/move": ("operate", "engineer"),
    "orders cell/grasp": ("operate", "engineer"),
}
OF_EVERY_NODE = {"/parameter_events", "/rosout"}
#: [s] that each client goes on for at least: several times what the last of a cell's nodes takes to be discovered
STAY_S = 20.0 if ON_ZENOH else 45.0


def may(role: str) -> set[str]:
    return {attempt for attempt, roles in MATRIX.items() if role in roles}


def identity_of(keys: Path, name: str) -> dict[str, str]:
    """Return the environment of who has an identity's keys."""
    return {
        "ZENOH_SESSION_CONFIG_URI": str(keys / "zenoh" / f"{name}.json5"),
        "ROS_SECURITY_KEYSTORE": str(keys),
        "ROS_SECURITY_ENABLE": "true",
        "ROS_SECURITY_STRATEGY": "Enforce",
        "ROS_SECURITY_ENCLAVE_OVERRIDE": f"/softgrip/{name}",
    }


def another_authority(_: Path, folder: Path) -> dict[str, str]:
    Keystore(folder, read_policy()).make()
    return identity_of(folder, "engineer")


def expired(keys: Path, folder: Path) -> dict[str, str]:
    shutil.copytree(keys, folder, symlinks=True)
    for name in ("cert.pem", "key.pem", "permissions.xml"):
        (folder / "enclaves" / "softgrip" / "engineer" / name).unlink()
    Keystore(folder, read_policy(), now=dt.datetime.now(dt.UTC) - dt.timedelta(days=20)).make(days=10)
    return identity_of(folder, "engineer")


def rules_of_another(keys: Path, folder: Path) -> dict[str, str]:
    """Somebody of role `look` who has put the rules of `engineer` beside the own keys."""
    shutil.copytree(keys, folder, symlinks=True)
    enclaves = folder / "enclaves" / "softgrip"
    shutil.copy(enclaves / "engineer" / "permissions.p7s", enclaves / "look" / "permissions.p7s")
    session = folder / "zenoh" / "look.json5"
    values = json.loads(session.read_text())
    values.pop("access_control")
    session.write_text(json.dumps(values))
    return identity_of(folder, "look")


#: Who does not belong here, and how they come.
STRANGERS: dict[str, Callable[[Path, Path], dict[str, str]]] = {
    "no keys": lambda *_: {},
    "another authority": another_authority,
    "expired": expired,
}


class Clients:
    """Processes of clients in a cell's domain."""

    def __init__(self, cell: Any, folder: Path) -> None:
        self._environment = {
            name: value for name, value in cell.environment.items() if not name.startswith(("ROS_SECURITY", "ZENOH_"))
        }
        self._heard = folder / "heard.txt"
        self._processes: dict[str, subprocess.Popen[str]] = {}

    def listen(self, identity: dict[str, str]) -> None:
        self._start("the listener", identity, "--hear", str(self._heard))
        wait_until(self._heard.exists, "a listener")

    def begin(self, name: str, identity: dict[str, str], required: set[str]) -> None:
        # what is published comes to somebody else: the listener
        own = sorted(what for what in required if not what.startswith("publishes"))
        self._start(name, identity, name.replace(" ", "_"), str(STAY_S), *own)

    def _start(self, name: str, identity: dict[str, str], *arguments: str) -> None:
        command = [sys.executable, str(CLIENT), *arguments]
        self._processes[name] = subprocess.Popen(
            command, env=self._environment | identity, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True
        )

    def result(self, name: str) -> dict[str, Any]:
        """Return what came of a client's attempts; nothing where it was not even let begin."""
        output, errors = self._processes[name].communicate(timeout=STAY_S + 180.0)
        nothing: dict[str, Any] = {"came": [], "refused": {}, "nodes": [], "topics": [], "services": []}
        found = json.loads(output.splitlines()[-1]) if output.strip() else nothing | {"ended": errors[-2000:]}
        lines = self._heard.read_text().splitlines()
        heard = {line.split()[0] for line in lines if line.split()[-1] == name.replace(" ", "_")}
        found["came"] = {*found["came"], *(f"publishes {topic}" for topic in heard)}
        if report := os.environ.get("SOFTGRIP_ROLES_REPORT"):
            with Path(report).open("a") as file:
                print(name, json.dumps(found, default=sorted), file=file)
        return found

    def close(self) -> None:
        for process in self._processes.values():
            process.kill()
            process.communicate()


@pytest.mark.long
@pytest.mark.timeout(900)
def test_each_role_does_what_it_may_and_a_stranger_sees_and_does_nothing(
    launch: Callable[..., Any], secure_router: Callable[[Path], None], tmp_path: Path
) -> None:
    keys = tmp_path / "keys"
    Keystore(keys, read_policy()).make()
    secure_router(keys)
    cell = launch(
        *("ros2", "launch", "softgrip_bringup", "cell.launch.yaml"),
        *(f"out:={tmp_path}/out", "secure:=true", f"keys:={keys}"),
    )
    cell.wait_for("bus loop: 100 Hz", 180.0)
    clients = Clients(cell, tmp_path)
    try:
        clients.listen(identity_of(keys, "engineer"))
        strangers = {
            name: make(keys, tmp_path / f"keys of {name}".replace(" ", "_")) for name, make in STRANGERS.items()
        }
        thief = rules_of_another(keys, tmp_path / "keys_of_thief")
        for role in ROLES:
            clients.begin(role, identity_of(keys, role), may(role))
        for name, identity in strangers.items():
            clients.begin(name, identity, set())
        # Zenoh knows who it is and holds it to that; DDS does not let it in with permissions that are not its own
        clients.begin("thief", thief, may("look") if ON_ZENOH else set())
        results = {name: clients.result(name) for name in (*ROLES, *strangers, "thief")}
    finally:
        clients.close()
    came = {name: result["came"] for name, result in results.items()}
    assert came == {
        **{role: may(role) for role in ROLES},
        **{name: set() for name in strangers},
        "thief": may("look") if ON_ZENOH else set(),
    }, results
    for role in ROLES:
        assert {"tendon_driver", "grasp_mix_manager", "camera"} <= set(results[role]["nodes"])
    for name in strangers:
        seen = {*results[name]["topics"], *results[name]["services"], *results[name]["nodes"]}
        assert seen - OF_EVERY_NODE <= own_endpoints(), f"{name} sees what is not its own"
    cell.interrupt()
    cell.wait_for_end(30.0)
    assert cell.survivors() == []


def own_endpoints() -> set[str]:
    """Return the topics and services that the client itself makes, which the graph shows to it."""
    names = {attempt.split()[1] for attempt in MATRIX if not attempt.startswith("orders")}
    actions = [attempt.split()[1] for attempt in MATRIX if attempt.startswith("orders")]
    parts = (*ACTION_TOPICS, *ACTION_SERVICES)
    return {f"/{name}" for name in (*names, *(f"{action}/_action/{part}" for action in actions for part in parts))}
