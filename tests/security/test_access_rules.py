# SPDX-License-Identifier: Apache-2.0
"""The rules by Zenoh's own reading of key expressions, and the sessions that they go into."""

from __future__ import annotations

import json
from pathlib import Path

import pytest

from softgrip_security.policy import Grant, Policy, PolicyIdentity
from softgrip_security.zenoh_access import access_control, router_config, session_config

pytest.importorskip("zenoh")
import zenoh

network = pytest.importorskip("embedded_ros.network", reason="ROS 2 has defaults of its own")

POLICY = Policy(
    (PolicyIdentity("camera", ("camera", "camera_*"), {Grant.PUBLISH: ("/image",), Grant.CALL: ("/stop",)}),)
)
TYPE = "pkg::msg::dds_::Type_/RIHS01_0"


def allows(message: str, key: str, flow: str = "ingress") -> bool:
    return any(
        zenoh.KeyExpr(expression).includes(zenoh.KeyExpr(key))
        for rule in access_control(POLICY)["rules"]
        if rule["id"].startswith("camera-") and flow in rule["flows"] and message in rule["messages"]
        for expression in rule["key_exprs"]
    )


@pytest.mark.parametrize(
    ("message", "key", "expected"),
    [
        ("put", f"0/image/{TYPE}", True),
        ("put", f"232/image/{TYPE}", True),
        ("put", f"0/image/raw/{TYPE}", False),
        ("put", f"0/other/image/{TYPE}", False),
        ("put", "**", False),
        ("put", f"*/*/{TYPE}", False),
        ("query", f"0/stop/{TYPE}", True),
        ("query", f"0/stop/now/{TYPE}", False),
        ("query", "**", False),
        ("query", "@/**", False),
        ("declare_queryable", f"0/stop/{TYPE}", False),
        ("declare_queryable", f"0/image/{TYPE}/@adv/pub/1/2/_", True),
        ("declare_subscriber", f"0/image/{TYPE}", False),
        ("liveliness_token", "@ros2_lv/0/a1/0/0/NN/%/%/camera", True),
        ("liveliness_token", "@ros2_lv/0/a1/0/0/NN/%/%/camera_urgent", True),
        ("liveliness_token", "@ros2_lv/0/a1/0/0/NN/%/%/camera2", False),
        ("liveliness_token", "@ros2_lv/0/a1/0/0/NN/%/%other/camera", False),
        ("liveliness_token", "@ros2_lv/0/a1/0/1/MP/%/%/camera/%image/T/H/::,:,:,:,,", True),
        ("liveliness_token", "@ros2_lv/0/a1/0/1/MS/%/%/camera/%image/T/H/::,:,:,:,,", False),
        ("liveliness_token", "@ros2_lv/**", False),
        ("liveliness_query", "@ros2_lv/0/**", True),
        ("liveliness_query", "**", False),
    ],
)
def test_what_an_identity_may_send(message: str, key: str, expected: bool) -> None:
    assert allows(message, key) is expected


def test_names_are_below_the_namespace_of_the_cell() -> None:
    rules = access_control(Policy(POLICY.identities, "/cell_1"))["rules"]
    tokens = [key for rule in rules if "liveliness_token" in rule["messages"] for key in rule["key_exprs"]]
    assert "@ros2_lv/*/*/*/*/NN/*/%cell_1/camera" in tokens


def test_a_secure_session_is_otherwise_as_one_of_embedded(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    """Leases, queues and limits have been measured once; a secure cell has the same."""
    monkeypatch.delenv("ZENOH_CONFIG_OVERRIDE", raising=False)
    for ours, theirs in (
        (session_config(POLICY, tmp_path), network._default_session(7447)),
        (router_config(POLICY, tmp_path), network._default_router(7447)),
    ):
        secure = zenoh.Config.from_json5(json.dumps(ours))
        for section in ("timestamping", "scouting", "routing", "queries_default_timeout", "connect/retry", "mode"):
            assert json.loads(secure.get_json(section)) == json.loads(theirs.get_json(section)), section
        for section in ("unicast", "link/tx", "shared_memory"):
            key = f"transport/{section}"
            assert json.loads(secure.get_json(key)) == json.loads(theirs.get_json(key)), key


def test_a_configuration_listens_on_this_machine_alone_unless_the_cell_has_hosts(tmp_path: Path) -> None:
    assert session_config(POLICY, tmp_path)["listen"]["endpoints"] == ["tls/localhost:0"]
    assert router_config(POLICY, tmp_path)["listen"]["endpoints"] == ["tls/localhost:7447"]
    away = session_config(POLICY, tmp_path, ["cell-pc", "camera-pc"])
    assert away["connect"]["endpoints"] == ["tls/cell-pc:7447"]
    assert router_config(POLICY, tmp_path, ["cell-pc"])["listen"]["endpoints"] == ["tls/[::]:7447"]
