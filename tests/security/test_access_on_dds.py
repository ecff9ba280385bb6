# SPDX-License-Identifier: Apache-2.0
"""On a real ROS 2 with DDS Security, each identity can make the endpoints that the policy grants it and no other.

Whether what was made also reaches somebody is for tests/system/test_secure_roles.py.
"""

from __future__ import annotations

import importlib.util
import json
import os
import subprocess
import sys
from pathlib import Path

import pytest
import rclpy

from softgrip_security.policy import Grant, Policy, PolicyIdentity, read_policy
from softgrip_testing.free_domains import own_domain

pytestmark = [
    pytest.mark.ros,
    pytest.mark.skipif(
        importlib.util.find_spec("embedded_ros") is not None
        or rclpy.get_rmw_implementation_identifier() == "rmw_zenoh_cpp",
        reason="Zenoh lets everybody make everything, and drops what is sent: test_access_matrix.py",
    ),
]
NAMES = [one.name for one in read_policy().identities]
SCRIPT = Path(__file__).with_name("endpoints_of.py")
#: [s] for one identity on a busy machine; each of some 480 endpoints that are refused is a line in its log
TIMEOUT_S = 300.0


def all_names(policy: Policy) -> dict[str, list[str]]:
    """Return every topic and service of the cell, and one of each kind that it has not."""
    identities = policy.identities
    topics = {name for one in identities for name in one.topics(Grant.PUBLISH)} | {"/of_nobody"}
    services = {name for one in identities for name in one.services(Grant.SERVE)} | {"/of_nobody/too"}
    return {
        "publish": sorted(topics),
        "subscribe": sorted(topics),
        "serve": sorted(services),
        "call": sorted(services),
    }


def granted(identity: PolicyIdentity, grant: str, names: list[str]) -> list[str]:
    kind = Grant(grant)
    own = identity.topics(kind) if grant in {"publish", "subscribe"} else identity.services(kind)
    # DDS refuses a node without these, so a tool's nodes may publish them too (docs/security.md)
    beside = ("/rosout", "/parameter_events") if grant == "publish" and identity.is_tool else ()
    return [name for name in names if name in own or name in beside or "*" in own]


@pytest.mark.slow
@pytest.mark.timeout(TIMEOUT_S + 30.0)
@pytest.mark.parametrize("name", NAMES)
def test_it_can_make_what_it_may_and_nothing_else(keys: Path, policy: Policy, tmp_path: Path, name: str) -> None:
    identity, names = policy.identity(name), all_names(policy)
    file = tmp_path / "names.json"
    file.write_text(json.dumps(names))
    environment = os.environ | {
        "ROS_DOMAIN_ID": own_domain(),
        "ROS_SECURITY_KEYSTORE": str(keys),
        "ROS_SECURITY_ENABLE": "true",
        "ROS_SECURITY_STRATEGY": "Enforce",
        "ROS_SECURITY_ENCLAVE_OVERRIDE": identity.enclave,
    }
    node = identity.node_names[0].replace("*", "_1")
    ended = subprocess.run(
        [sys.executable, str(SCRIPT), node, str(file)],
        capture_output=True,
        text=True,
        env=environment,
        timeout=TIMEOUT_S,
        check=False,
    )
    if "does not have security support" in ended.stderr:
        pytest.skip("this middleware was built without DDS Security")
    assert ended.returncode == 0, ended.stderr[-4000:]
    made = json.loads(ended.stdout.splitlines()[-1])
    assert made == {grant: granted(identity, grant, names[grant]) for grant in names}
