# SPDX-License-Identifier: Apache-2.0
"""Write a policy as Zenoh's access control, and the configuration of sessions and of the router.

Every session and the router have the same rules: what each *other* one, known by its certificate's common name, may
send and be sent. So a session that was taken over is held to its own identity's grants by everybody it talks to.

Key expressions are those of rmw_zenoh_cpp (its docs/design.md), which embedded/ speaks too:
``<domain>/<name>/<type>/<hash>``, liveliness tokens below ``@ros2_lv``, and ``@adv`` below the key of a transient-local
topic (zenoh-ext's advanced publisher). A grant holds in every domain: a cell ends where its keys end, not at a domain.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import Any

from softgrip_security.policy import EVERY_TOPIC, ROUTER, Grant, Policy, PolicyIdentity

ROUTER_PORT = 7447
#: What every session may look at: who is there.
_WHO_IS_THERE = "@ros2_lv/*/**"
_ADVANCED = "@adv"
_QUERIES = ("liveliness_query", "declare_liveliness_subscriber")


class _Rules:
    """Collects the rules of one identity."""

    def __init__(self, identity: str) -> None:
        self._identity = identity
        self.rules: list[dict[str, Any]] = []

    def allow(self, flow: str, messages: Iterable[str], keys: Iterable[str]) -> None:
        """Let messages on these keys pass: ingress is what the identity sends, egress what it is sent."""
        expressions = sorted(set(keys))
        if expressions:
            self.rules.append(
                {
                    "id": f"{self._identity}-{flow}-{len(self.rules)}",
                    "messages": list(messages),
                    "flows": [flow],
                    "permission": "allow",
                    "key_exprs": expressions,
                }
            )

    @property
    def ids(self) -> list[str]:
        """Return the names of the rules."""
        return [rule["id"] for rule in self.rules]


def access_control(policy: Policy) -> dict[str, object]:
    """Return Zenoh's ``access_control`` of a policy: deny, except what the policy grants."""
    rules: list[dict[str, object]] = []
    policies = []
    subjects = []
    for name, enclave, found in [
        *((one.name, one.enclave, _identity_rules(one, policy.namespace)) for one in policy.identities),
        (ROUTER, f"/softgrip/{ROUTER}", _router_rules()),
    ]:
        rules += found.rules
        subjects.append({"id": name, "cert_common_names": [enclave]})
        policies.append({"rules": found.ids, "subjects": [name]})
    return {
        "enabled": True,
        "default_permission": "deny",
        "rules": rules,
        "subjects": subjects,
        "policies": policies,
    }


def _identity_rules(identity: PolicyIdentity, namespace: str) -> _Rules:
    """Return what others let an identity send (ingress), and what they send it (egress)."""
    rules = _Rules(identity.name)
    publish, subscribe = (identity.topics(grant) for grant in (Grant.PUBLISH, Grant.SUBSCRIBE))
    serve, call = (identity.services(grant) for grant in (Grant.SERVE, Grant.CALL))
    for flow, sends, hears, answers, asks in (
        ("ingress", publish, subscribe, serve, call),
        ("egress", subscribe, publish, call, serve),
    ):
        rules.allow(flow, ["put", "delete"], [*_data(sends), *_advanced(sends, "pub")])
        rules.allow(flow, ["declare_subscriber"], [*_data(hears), *_advanced(hears, "pub")])
        rules.allow(flow, ["query"], [*_data(asks), *_advanced(hears)])
        rules.allow(flow, ["declare_queryable"], [*_data(answers), *_advanced(sends)])
        rules.allow(flow, ["reply"], [*_data(answers), *_data(sends), *_advanced(sends)])
        rules.allow(flow, ["liveliness_token"], [*_advanced(sends, "pub"), *_advanced(hears, "sub")])
        rules.allow(flow, _QUERIES, [*_advanced(hears, "pub"), *_advanced(sends, "sub")])
    rules.allow("ingress", ["liveliness_token"], _tokens(identity, namespace))
    rules.allow("egress", ["liveliness_token"], [_WHO_IS_THERE])
    for flow in ("ingress", "egress"):
        rules.allow(flow, _QUERIES, [_WHO_IS_THERE])
    return rules


def _router_rules() -> _Rules:
    """Let the router be asked, and ask, who is there: sessions wait for its answer. It has and is told nothing."""
    rules = _Rules(ROUTER)
    for flow in ("ingress", "egress"):
        rules.allow(flow, _QUERIES, [_WHO_IS_THERE])
    return rules


def _data(names: Iterable[str]) -> list[str]:
    """Return the keys of topics or services, whatever their type."""
    return ["*/**" if name == EVERY_TOPIC else f"*/{name.strip('/')}/*/*" for name in names]


def _advanced(names: Iterable[str], side: str = "") -> list[str]:
    """Return the keys by which transient-local endpoints of topics meet; of their ``pub`` or ``sub`` side only."""
    end = "/".join([_ADVANCED, side, "**"] if side else [_ADVANCED, "**"])
    return [f"{key}/{end}" for key in _data(names)]


def _tokens(identity: PolicyIdentity, namespace: str) -> list[str]:
    """Return the liveliness tokens that an identity may put up: its nodes, and the endpoints of its grants."""
    kinds = (
        ("MP", identity.topics(Grant.PUBLISH)),
        ("MS", identity.topics(Grant.SUBSCRIBE)),
        ("SS", identity.services(Grant.SERVE)),
        ("SC", identity.services(Grant.CALL)),
    )
    keys = []
    for node in identity.node_names:
        own = f"{_mangle(namespace)}/{node.replace('*', '$*')}"
        keys.append(f"@ros2_lv/*/*/*/*/NN/*/{own}")
        for kind, names in kinds:
            for name in names:
                mangled = "*" if name == EVERY_TOPIC else _mangle(name)
                keys.append(f"@ros2_lv/*/*/*/*/{kind}/*/{own}/{mangled}/*/*/*")
    return keys


def _mangle(name: str) -> str:
    """Return a name as it stands in a token."""
    return name.replace("/", "%")


def session_config(policy: Policy, enclave: Path, hosts: Iterable[str] = ("localhost",)) -> dict[str, object]:
    """Return the configuration of a session, for ZENOH_SESSION_CONFIG_URI.

    Args:
        policy: who may do what.
        enclave: folder with the identity's cert.pem, key.pem and identity_ca.cert.pem.
        hosts: names of the machines of the cell; the router is on the first, sessions listen on all that are this one.
    """
    router, *_ = hosts
    return {
        **_common(policy, enclave),
        "mode": "peer",
        "connect": {
            "endpoints": [f"tls/{router}:{ROUTER_PORT}"],
            "timeout_ms": {"router": -1, "peer": -1, "client": 0},
            "exit_on_failure": {"router": False, "peer": False, "client": True},
            "retry": {"period_init_ms": 200, "period_max_ms": 1000, "period_increase_factor": 2},
        },
        "listen": {"endpoints": ["tls/localhost:0" if router == "localhost" else "tls/[::]:0"]},
        "scouting": {
            "delay": 100,
            "multicast": {"enabled": False},
            "gossip": {
                "enabled": True,
                "target": {"router": ["router", "peer"], "peer": ["router"]},
                "autoconnect": {"router": [], "peer": ["router", "peer"]},
                "autoconnect_strategy": {"peer": {"to_router": "always", "to_peer": "greater-zid"}},
            },
        },
    }


def router_config(policy: Policy, enclave: Path, hosts: Iterable[str] = ("localhost",)) -> dict[str, object]:
    """Return the configuration of the router, for ZENOH_ROUTER_CONFIG_URI; the arguments are those of a session."""
    router, *_ = hosts
    return {
        **_common(policy, enclave),
        "mode": "router",
        "connect": {"endpoints": []},
        "listen": {
            "endpoints": [f"tls/{'localhost' if router == 'localhost' else '[::]'}:{ROUTER_PORT}"],
            "exit_on_failure": True,
        },
        "scouting": {
            "delay": 0,
            "multicast": {"enabled": False},
            "gossip": {
                "enabled": True,
                "target": {"router": ["router", "peer"], "peer": ["router"]},
                "autoconnect": {"router": [], "peer": ["router", "peer"]},
                "autoconnect_strategy": {"router": {"to_router": "always", "to_peer": "always"}},
            },
        },
        "routing": {"router": {"peers_failover_brokering": False}},
    }


def _common(policy: Policy, enclave: Path) -> dict[str, object]:
    tls: Mapping[str, object] = {
        "root_ca_certificate": str(enclave / "identity_ca.cert.pem"),
        "listen_private_key": str(enclave / "key.pem"),
        "listen_certificate": str(enclave / "cert.pem"),
        "connect_private_key": str(enclave / "key.pem"),
        "connect_certificate": str(enclave / "cert.pem"),
        "enable_mtls": True,
        "verify_name_on_connect": True,
        # A link that stands when a certificate runs out goes on: the product in the hand must not fall at midnight.
        "close_link_on_expiration": False,
    }
    return {
        "timestamping": {"enabled": {"router": True, "peer": True, "client": True}},
        "queries_default_timeout": 600_000,
        "adminspace": {"enabled": False},
        "access_control": access_control(policy),
        "transport": {
            "unicast": {
                "open_timeout": 3_000,
                "accept_timeout": 60_000,
                "max_sessions": 10_000,
                "accept_pending": 10_000,
            },
            "link": {
                "protocols": ["tls"],
                "tx": {
                    "lease": 10_000,
                    "keep_alive": 4,
                    "queue": {
                        "size": {"data": 16},
                        "congestion_control": {"drop": {"wait_before_drop": 5_000}},
                    },
                },
                # a frame of 64 MiB and its header; Zenoh would gather 1 GiB
                "rx": {"max_message_size": 65 << 20},
                "tls": tls,
            },
            "shared_memory": {"enabled": False},
        },
    }
