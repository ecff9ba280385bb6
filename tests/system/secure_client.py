# SPDX-License-Identifier: Apache-2.0
"""A client of a running cell with whatever keys are in its environment: tries everything, and prints what came of it.

    secure_client.py MARK SECONDS [WHAT ...]      until each WHAT has come, and at least for SECONDS

What it publishes carries MARK, for `hear`, the other client here, to know it by:

    secure_client.py --hear FILE                  appends the marks that it hears, until it is ended

The output is one JSON object: ``came``, ``refused`` (what the middleware did not let it make, with its words), and the
``nodes``, ``topics`` and ``services`` that it sees.
"""

from __future__ import annotations

import json
import sys
import time
from collections.abc import Callable
from functools import partial
from pathlib import Path
from typing import Any

import rclpy
from builtin_interfaces.msg import Time
from lifecycle_msgs.msg import Transition
from lifecycle_msgs.srv import ChangeState
from rcl_interfaces.srv import GetParameters, SetParameters
from rclpy.action import ActionClient
from rclpy.node import Node
from rclpy.qos import QoSProfile
from sensor_msgs.msg import JointState
from std_msgs.msg import Header
from trajectory_msgs.msg import JointTrajectory

from softgrip_interfaces.action import Grasp, MoveTendon
from softgrip_interfaces.msg import CellState, EmulatorTruth, LeaseHeartbeat, SafetyState
from softgrip_interfaces.srv import AcquireLease, ListProducts, PlaceObject
from softgrip_nodekit import LATCHED, RELIABLE, SENSOR

#: Topics it listens to.
HEARD: dict[str, tuple[Any, QoSProfile]] = {
    "tendon/state": (JointState, SENSOR),
    "cell/state": (CellState, LATCHED),
    "emulator/truth": (EmulatorTruth, SENSOR),
}
#: Topics it publishes, and where a message has room for a mark. None of them orders anything, and it hears none itself:
#: its own words would take the place of a latched message in its queue.
SPOKEN: dict[str, tuple[Any, Callable[[str], Any]]] = {
    "tendon/trajectory": (JointTrajectory, lambda mark: JointTrajectory(header=Header(frame_id=mark))),
    "tendon/heartbeat": (LeaseHeartbeat, lambda mark: LeaseHeartbeat(header=Header(frame_id=mark))),
    "gripper/joint_commands": (JointState, lambda mark: JointState(header=Header(frame_id=mark))),
    "safety/state": (SafetyState, lambda mark: SafetyState(header=Header(frame_id=mark))),
}
#: Services it calls, each with a request that is answered and does nothing.
CALLED: dict[str, tuple[Any, Any]] = {
    "cell/list_products": (ListProducts, ListProducts.Request()),
    "camera/get_parameters": (GetParameters, GetParameters.Request()),
    "tendon/lease": (AcquireLease, AcquireLease.Request(owner="nobody", tendons=["none"], duration=1.0)),
    "camera/set_parameters": (SetParameters, SetParameters.Request()),
    "emulator/place_object": (PlaceObject, PlaceObject.Request(product="none of these")),
    # rclpy answers nothing at all to the number of a transition that there is not
    "tendon_driver/change_state": (ChangeState, ChangeState.Request(transition=Transition(label="none of these"))),
}
#: Actions it sends a goal to that is refused or ends by itself at once.
ORDERED: dict[str, tuple[Any, Any]] = {
    "tendon/move": (MoveTendon, MoveTendon.Goal(deadline=Time(sec=1))),
    "cell/grasp": (Grasp, Grasp.Goal(product="none of these")),
}


class Client:
    """All attempts of one client on one node."""

    def __init__(self, node: Node, mark: str) -> None:
        self._node = node
        self._mark = mark
        self.came: set[str] = set()
        self.refused: dict[str, str] = {}
        self._publishers: dict[str, Any] = {}
        self._clients: dict[str, Any] = {}
        self._actions: dict[str, Any] = {}
        self._waiting: dict[str, Any] = {}
        for topic, (kind, qos) in HEARD.items():
            what = f"hears {topic}"
            self._try(what, partial(self._listen, what, kind, topic, qos))
        for topic, (kind, _) in SPOKEN.items():
            qos = LATCHED if topic == "safety/state" else RELIABLE
            self._keep(self._publishers, f"publishes {topic}", topic, node.create_publisher, kind, topic, qos)
        for service, (kind, _) in CALLED.items():
            self._keep(self._clients, f"calls {service}", service, node.create_client, kind, service)
        for action, (kind, _) in ORDERED.items():
            self._keep(self._actions, f"orders {action}", action, ActionClient, node, kind, action)

    def _keep(self, place: dict[str, Any], what: str, name: str, make: Callable[..., Any], *arguments: Any) -> None:
        self._try(what, lambda: place.update({name: make(*arguments)}))

    def _try(self, what: str, make: Callable[[], Any]) -> None:
        """Make an endpoint; a middleware that refuses it does so here, each with an error of its own."""
        try:
            make()
        except Exception as error:  # noqa: BLE001  RCLError, RMWError, InvalidHandle: which, no document says
            self.refused[what] = str(error)[:200]

    def _listen(self, what: str, kind: Any, topic: str, qos: QoSProfile) -> None:
        self._node.create_subscription(kind, topic, lambda _: self.came.add(what), qos)

    def go_on(self) -> None:
        """Say everything once more, and ask what has not been answered."""
        for topic, publisher in self._publishers.items():
            publisher.publish(SPOKEN[topic][1](self._mark))
        for service, client in self._clients.items():
            if client.service_is_ready():
                self._ask(f"calls {service}", partial(client.call_async, CALLED[service][1]))
        for action, client in self._actions.items():
            if client.server_is_ready():
                self._ask(f"orders {action}", partial(client.send_goal_async, ORDERED[action][1]))

    def _ask(self, what: str, ask: Callable[[], Any]) -> None:
        asked = self._waiting.get(what)
        if asked is None:
            self._waiting[what] = ask()
        elif asked.done() and asked.exception() is None:
            self.came.add(what)


def attempt(mark: str, seconds: float, required: set[str]) -> dict[str, Any]:
    """Try everything until what is required has come, at most for a minute more than ``seconds`` [s]."""
    node = rclpy.create_node("_ros2cli_client")
    client = Client(node, mark)
    begin_s = time.monotonic()
    next_s = begin_s
    while (passed_s := time.monotonic() - begin_s) < seconds or (
        not required <= client.came and passed_s < seconds + 60
    ):
        rclpy.spin_once(node, timeout_sec=0.05)
        if time.monotonic() >= next_s:
            client.go_on()
            next_s = time.monotonic() + 0.5
    return {
        "came": sorted(client.came),
        "refused": client.refused,
        "nodes": sorted({name for name in node.get_node_names() if name != node.get_name()}),
        "topics": sorted(name for name, _ in node.get_topic_names_and_types()),
        "services": sorted(name for name, _ in node.get_service_names_and_types() if node.get_name() not in name),
    }


def hear(file: Path) -> None:
    """Append a line 'TOPIC MARK' for each mark that is heard on a topic of ``SPOKEN``."""
    node = rclpy.create_node("_ros2cli_listener")
    heard: set[str] = set()

    def note(topic: str, message: Any) -> None:
        line = f"{topic} {message.header.frame_id}"
        if line not in heard:
            heard.add(line)
            with file.open("a") as lines:
                lines.write(f"{line}\n")

    for topic, (kind, _) in SPOKEN.items():
        node.create_subscription(kind, topic, partial(note, topic), SENSOR)
    file.touch()
    rclpy.spin(node)


def main() -> int:
    rclpy.init()
    if sys.argv[1] == "--hear":
        hear(Path(sys.argv[2]))
    else:
        sys.stdout.write(f"{json.dumps(attempt(sys.argv[1], float(sys.argv[2]), set(sys.argv[3:])))}\n")
    rclpy.shutdown()
    return 0


if __name__ == "__main__":
    sys.exit(main())
