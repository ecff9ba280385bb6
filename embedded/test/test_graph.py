# SPDX-License-Identifier: Apache-2.0
"""The graph of a large cell."""

from __future__ import annotations

import subprocess
import sys

#: More than the 256 replies that Zenoh's default channel holds. In a process of its own: a deadlock in Zenoh's own code
#: lets neither signals nor other threads end it.
WATCH = """
import zenoh
from embedded_ros.graph import Graph
from embedded_ros.wire import Entity, EntityKind, encode_token

configuration = zenoh.Config()
configuration.insert_json5("scouting/multicast/enabled", "false")
configuration.insert_json5("listen/endpoints", "[]")
with zenoh.open(configuration) as session:
    liveliness = session.liveliness()
    tokens = [
        liveliness.declare_token(encode_token(Entity(7, "ab", n, n, EntityKind.NODE, "/", f"node_{n}")))
        for n in range(300)
    ]
    graph = Graph()
    graph.watch(session, 7)
    print(len(graph.snapshot()))
"""


def test_more_tokens_than_a_channel_holds() -> None:
    run = subprocess.run([sys.executable, "-c", WATCH], capture_output=True, text=True, timeout=60.0, check=True)
    assert run.stdout.split() == ["300"]
