# SPDX-License-Identifier: Apache-2.0
"""Three cells on one machine and in one domain: each has its own wires, files and bag; a name is taken once."""

from __future__ import annotations

import json
import os
import sys
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

from softgrip_bag.nodes.replay import NODES, check
from softgrip_testing.waiting import wait_until

pytest.importorskip("rosbags")
from rosbags.highlevel import AnyReader

ROOT = Path(__file__).resolve().parents[2]
CELL = ("ros2", "launch", "softgrip_bringup", "cell.launch.yaml")
#: Three cells are more than two processors carry beside a test run; `make faults` has the machine to itself.
NAMES = ("left", "middle", "right") if "SOFTGRIP_QUIET_MACHINE" in os.environ else ("left", "right")

#: Topics that all cells of a domain share -> who a message is from, by what it says itself.
SENDERS: dict[str, Callable[[Any], list[str]]] = {
    "/diagnostics": lambda message: [status.name for status in message.status],
    "/rosout": lambda message: [message.name.replace(".", "/")],
    "/parameter_events": lambda message: [message.node.strip("/")],
    "/tf": lambda message: [one.child_frame_id for one in message.transforms],
    "/tf_static": lambda message: [one.child_frame_id for one in message.transforms],
}

#: Some seconds of a cell; most of it are the camera's frames [byte].
RECORDED_BYTES = 1_500_000

pytestmark = [pytest.mark.ros, pytest.mark.slow]
Launch = Callable[..., Any]


def size_of(folder: Path) -> int:
    return sum(path.stat().st_size for path in folder.rglob("*") if path.is_file())


@pytest.mark.timeout(400)
def test_cells_share_a_domain_and_nothing_else(launch: Launch, tmp_path: Path) -> None:
    domain = None
    cells = {}
    for seed, name in enumerate(NAMES, start=1):
        cells[name] = launch(
            *CELL, f"cell:={name}", f"seed:={seed}", f"out:={tmp_path}/{name}", "camera_fps:=4.0", "speed:=0.5",
            "gripper:=false", f"wire_dir:={tmp_path}/wires/{name}", domain=domain,
        )  # fmt: skip
        domain = cells[name].domain
    for cell in cells.values():
        cell.wait_for("wires in", 90.0)
    for name in NAMES:
        wait_until(
            lambda bags=tmp_path / name / "bags": size_of(bags) > RECORDED_BYTES,
            f"a bag of {name} that grows",
            120.0,
            0.2,
        )
    for name in NAMES[1:]:
        cells[name].interrupt()
    for name in NAMES[1:]:
        cells[name].wait_for_end(60.0)
    second = launch(*CELL, "cell:=left", f"out:={tmp_path}/again", f"wire_dir:={tmp_path}/wires/again", domain=domain)
    second.wait_for_end(60.0)
    assert "expected one cell named 'left'" in second.output
    assert "cell:=..." in second.output
    cells["left"].interrupt()
    cells["left"].wait_for_end(60.0)
    for name in NAMES:
        (bag,) = (tmp_path / name / "bags").iterdir()
        assert_own(bag, name)
        result = check(bag, "marker_tracker")  # of all nodes the one that works where nothing is mounted
        assert result.divergence is None, (name, result.divergence)
        assert result.compared > 20


@pytest.mark.long
@pytest.mark.timeout(7200)
def test_three_shifts_at_once_in_one_domain_reach_their_ends(launch: Launch, tmp_path: Path) -> None:
    """Each bag replays bit by bit, with every node that can be replayed, and holds no message of another cell."""
    domain, shifts, bags, begun = None, {}, {}, time.monotonic()
    for seed, name in enumerate(("left", "middle", "right"), start=1):
        shifts[name] = launch(
            sys.executable, str(ROOT / "tools" / "demo.py"), f"{tmp_path}/{name}", "--seed", str(seed), f"cell:={name}",
            f"wire_dir:={tmp_path}/wires/{name}", "panel:=false", domain=domain,
        )  # fmt: skip
        domain = shifts[name].domain
    for name, shift in shifts.items():
        assert shift.wait_for_end(4200.0) == 0, shift.output[-6000:]
        summary = json.loads((tmp_path / name / "summary.json").read_text())
        assert len({grasp["product"] for grasp in summary["grasps"]}) == 15
        assert shift.survivors() == []
        bags[name] = Path(summary["bag"]["path"])
        minutes = (time.monotonic() - begun) / 60.0
        print(f"{name}: {len(summary['grasps'])} grasps, ended within {minutes:.1f} minutes")  # noqa: T201  a measurement
    for name, bag in bags.items():
        messages = assert_own(bag, name)
        compared = {}
        for node in NODES:
            result = check(bag, node)
            assert result.divergence is None, (name, node, result.divergence)
            assert result.compared > 0, (name, node)
            compared[node] = result.compared
        print(f"{name}: {messages} messages, all its own; compared in replays: {compared}")  # noqa: T201  a measurement


def assert_own(bag: Path, name: str) -> int:
    """Check that every message of a bag is one of the cell's own; return how many there are."""
    seen: set[str] = set()
    messages = 0
    with AnyReader([bag]) as reader:
        for connection, _, data in reader.messages():
            messages += 1
            topic = connection.topic
            if topic.startswith(f"/{name}/"):
                seen.add(topic)
                continue
            message = reader.deserialize(data, connection.msgtype)
            assert topic in SENDERS, f"{bag}: expected topics of /{name}, found {topic}"
            senders = SENDERS[topic](message)
            assert all(sender.startswith(f"{name}/") for sender in senders), (topic, senders)
            seen.add(topic)
    assert {f"/{name}/tendon/state", f"/{name}/finger/measured", "/diagnostics", "/rosout", "/tf_static"} <= seen
    return messages
