# SPDX-License-Identifier: Apache-2.0
"""The recorder as a process: killed at random moments, and asked by its services."""

from __future__ import annotations

import os
import random
import signal
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from pathlib import Path

import pytest
import rclpy
from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus
from rclpy.node import Node
from rclpy.qos import HistoryPolicy, QoSProfile
from rclpy.serialization import deserialize_message, serialize_message
from std_msgs.msg import Int32, String

from softgrip_bag.reader import attachments, facts, read
from softgrip_bag.repair import is_broken, repair
from softgrip_bag.writer import BagWriter, Topic
from softgrip_interfaces.srv import SnapshotRecording, SplitRecording, StartRecording, StopRecording
from softgrip_testing.free_domains import own_domain

pytestmark = pytest.mark.slow
LONGEST = 60.0  # [s] for anything that is waited for


@pytest.fixture
def talker(monkeypatch: pytest.MonkeyPatch) -> Iterator[Node]:
    monkeypatch.setenv("ROS_DOMAIN_ID", own_domain())
    rclpy.init()
    node = Node("talker")
    yield node
    node.destroy_node()
    rclpy.try_shutdown()


@pytest.fixture
def recorder(tmp_path: Path) -> Iterator[Callable[..., subprocess.Popen[bytes]]]:
    running: list[subprocess.Popen[bytes]] = []

    def start(bag: Path, *more: str) -> subprocess.Popen[bytes]:
        command = [sys.executable, "-m", "softgrip_bag.nodes.recorder", "--ros-args"]
        command += ["-p", f"root:={tmp_path}", "-p", f"path:={bag}", "-p", f"attachment_roots:={tmp_path}", *more]
        running.append(subprocess.Popen(command))
        return running[-1]

    yield start
    for process in running:
        process.kill()
        process.wait(LONGEST)


def wait_until(condition: Callable[[], bool], work: Callable[[], object], what: str) -> None:
    deadline = time.monotonic() + LONGEST
    while not condition():
        assert time.monotonic() < deadline, f"expected {what} within {LONGEST} s"
        work()


def texts(bag: Path) -> list[int]:
    """Return the numbers that were published, as far as they are on the disk."""
    if not list(bag.glob("*.mcap")):
        return []
    return [int(message.data[8:].rstrip(b"\0")) for message in read(bag, {"/count"})]


def call(node: Node, kind: type, name: str, request: object) -> object:
    client = node.create_client(kind, name)
    assert client.wait_for_service(LONGEST)
    future = client.call_async(request)
    rclpy.spin_until_future_complete(node, future, timeout_sec=LONGEST)
    assert future.done()
    return future.result()


def test_killed_at_random_moments_everything_that_was_on_the_disk_is_kept(
    talker: Node, recorder: Callable[[Path], subprocess.Popen[bytes]], tmp_path: Path
) -> None:
    output = talker.create_publisher(String, "count", 100)
    moments = random.Random(9)
    number = 0
    for attempt in range(3):
        bag = tmp_path / f"bag{attempt}"
        process = recorder(bag)
        requested = moments.randrange(5, 60)

        def say() -> None:
            nonlocal number
            number += 1
            output.publish(String(data=str(number)))
            rclpy.spin_once(talker, timeout_sec=0.005)

        wait_until(
            lambda bag=bag, requested=requested: len(texts(bag)) >= requested, say, f"{requested} messages in {bag}"
        )
        process.send_signal(signal.SIGKILL)
        process.wait(LONGEST)
        kept = texts(bag)
        assert len(kept) >= requested
        assert kept == sorted(set(kept))
        assert is_broken(bag)
        assert repair(bag).bad_chunks == 0
        assert texts(bag) == kept


@pytest.mark.parametrize(
    ("interrupted", "is_finished"),
    [("Recorder._start_at_once", True), ("Recorder._look", True), ("Pipeline.__init__", False)],
)
def test_a_signal_before_the_node_is_whole_ends_the_process(
    interrupted: str, is_finished: bool, tmp_path: Path
) -> None:
    owner, method = interrupted.split(".")
    program = (
        "import os, signal, sys\n"
        "from softgrip_bag.nodes.recorder import Pipeline, Recorder, main\n"
        f"go_on = {interrupted}\n"
        "def go_on_and_interrupt(*arguments):\n"
        "    go_on(*arguments)\n"
        "    os.kill(os.getpid(), signal.SIGINT)\n"
        f"setattr({owner}, {method!r}, go_on_and_interrupt)\n"
        "sys.exit(main())\n"
    )
    bag = tmp_path / "bag"
    command = [sys.executable, "-c", program, "--ros-args", "-p", f"root:={tmp_path}", "-p", f"path:={bag}"]
    ended = subprocess.run(command, timeout=LONGEST, check=False, capture_output=True, text=True)
    assert ended.returncode == 0, ended.stderr
    assert (bag / "metadata.yaml").is_file() == is_finished
    assert is_broken(bag) != is_finished


def test_services_and_what_the_bag_carries(
    talker: Node, recorder: Callable[[Path], subprocess.Popen[bytes]], tmp_path: Path
) -> None:
    calibration = tmp_path / "camera.yaml"
    calibration.write_text("a: 1\n")
    talker.declare_parameter("calibration_file", str(calibration))
    # what is kept in full is sent in full: with a depth, a middleware may drop of three thousand at once
    output = talker.create_publisher(String, "count", QoSProfile(history=HistoryPolicy.KEEP_ALL))
    beat = talker.create_publisher(String, "beat", 100)
    talker.create_timer(0.01, lambda: beat.publish(String(data="goes on")))
    bag = tmp_path / "bag"
    process = recorder(bag)
    number = 0

    def say() -> None:
        nonlocal number
        number += 1
        output.publish(String(data=str(number)))
        rclpy.spin_once(talker, timeout_sec=0.01)

    carried = "parameter_files/talker/calibration_file/camera.yaml"
    wait_until(lambda: bool(texts(bag)) and carried in {a.name for a in attachments(bag)}, say, f"{carried} in {bag}")
    assert next(a for a in attachments(bag) if a.name == carried).data == b"a: 1\n"
    split = call(talker, SplitRecording, "recorder/split", SplitRecording.Request())
    assert split.success, split.message
    assert texts(Path(split.path).parent)
    snapshot = call(talker, SnapshotRecording, "recorder/snapshot", SnapshotRecording.Request())
    assert snapshot.success, snapshot.message
    assert texts(Path(snapshot.path))
    for _ in range(3000):
        number += 1
        output.publish(String(data=str(number)))
    stopped = call(talker, StopRecording, "recorder/stop", StopRecording.Request())
    assert stopped.success, stopped.message
    answered = time.time_ns()
    # nothing that was sent after it, though it waited for half a second
    assert [m.published for m in read(bag, {"/beat"})][-1] < answered - 250_000_000
    assert texts(bag)[-3000:] == list(range(number - 2999, number + 1))  # all that was sent before the stop
    assert not is_broken(bag)
    assert stopped.messages == len(list(read(bag)))
    assert {"softgrip_machine", "softgrip_software", "softgrip_dropped"} <= facts(bag).keys()
    process.send_signal(signal.SIGINT)
    assert process.wait(LONGEST) == 0


def test_a_fault_while_nothing_is_recorded_keeps_what_led_to_it(
    talker: Node, recorder: Callable[..., subprocess.Popen[bytes]], tmp_path: Path
) -> None:
    output = talker.create_publisher(String, "count", 100)
    health = talker.create_publisher(DiagnosticArray, "/diagnostics", 10)
    level = DiagnosticStatus.OK
    recorder(tmp_path / "unused", "-p", "record_on_start:=false", "-p", "snapshot_after_s:=0.3")
    said = 0

    def say() -> None:
        nonlocal said
        said += 1
        output.publish(String(data=str(said)))
        health.publish(DiagnosticArray(status=[DiagnosticStatus(name="driver: index", level=level, message="gone")]))
        rclpy.spin_once(talker, timeout_sec=0.01)

    def snapshots() -> list[Path]:
        return [path.parent for path in tmp_path.glob("fault_*/metadata.yaml")]

    wait_until(lambda: output.get_subscription_count() > 0, say, "a listening recorder")
    heard_from = said
    wait_until(lambda: said > heard_from + 20, say, "twenty messages")
    assert snapshots() == []
    level, failed_at = DiagnosticStatus.ERROR, said
    wait_until(lambda: bool(snapshots()), say, "a snapshot of the fault")
    numbers = texts(snapshots()[0])
    assert min(numbers) <= failed_at < max(numbers)
    assert facts(snapshots()[0])["softgrip_fault"] == {"fault": "driver: index: gone"}
    assert not (tmp_path / "unused").exists()


class Health:
    """What a recorder says on /diagnostics: component -> (level, message)."""

    def __init__(self, node: Node) -> None:
        self.said: dict[str, tuple[int, str]] = {}
        self._subscription = node.create_subscription(DiagnosticArray, "/diagnostics", self._take, 10)

    def _take(self, message: DiagnosticArray) -> None:
        for status in message.status:
            self.said[status.name.removeprefix("recorder: ")] = (status.level[0], status.message)

    def has(self, component: str, level: bytes, text: str) -> bool:
        found = self.said.get(component, (-1, ""))
        return found[0] == level[0] and text in found[1]


def test_a_stranger_makes_it_neither_read_nor_write_elsewhere(
    talker: Node, recorder: Callable[..., subprocess.Popen[bytes]], tmp_path: Path
) -> None:
    inside = tmp_path / "inside"
    inside.mkdir()
    os.mkfifo(inside / "pipe.yaml")
    (tmp_path / "secret.yaml").write_text("not for bags\n")
    talker.declare_parameter("calibration_file", str(inside / "pipe.yaml"))
    talker.declare_parameter("profiles_directory", str(tmp_path / "secret.yaml"))
    talker.declare_parameter("broker", "mqtt://me:hunter2@host")
    talker.create_subscription(Int32, "count", lambda _: None, 10)  # a tool of another version
    output = talker.create_publisher(String, "count", 100)
    health = Health(talker)
    bag = inside / "bag"
    recorder(bag, "-p", f"root:={inside}", "-p", f"attachment_roots:={inside}")
    sent = 0

    def say() -> None:
        nonlocal sent
        sent += 1
        output.publish(String(data=str(sent)))
        rclpy.spin_once(talker, timeout_sec=0.01)

    def is_all_said() -> bool:
        refused = all(
            health.has("parameters", DiagnosticStatus.WARN, text)
            for text in ("is a pipe", "attachment_roots", "broker")
        )
        return bool(texts(bag)) and refused and health.has("topics", DiagnosticStatus.WARN, "std_msgs/msg/Int32")

    wait_until(is_all_said, say, "the refusals on /diagnostics")
    number = 0

    def set_a_secret() -> None:
        nonlocal number
        number += 1
        talker.declare_parameter(f"password_{number}", "hunter2")
        rclpy.spin_once(talker, timeout_sec=0.01)

    wait_until(
        lambda: any(b"***" in message.data for message in read(bag, {"/parameter_events"})),
        set_a_secret,
        "a parameter event in the bag",
    )
    ended = deserialize_message(serialize_message(String(data="a\0b")), String).data  # rclpy ends a text at its NUL
    for path in (str(tmp_path / "elsewhere"), "../elsewhere", ".", *([ended] if "\0" in ended else [])):
        for kind, name in ((StartRecording, "recorder/start"), (SnapshotRecording, "recorder/snapshot")):
            answer = call(talker, kind, name, kind.Request(path=path))
            assert not answer.success
            assert "expected" in answer.message
    for seconds in (float("nan"), -1.0):
        answer = call(talker, SnapshotRecording, "recorder/snapshot", SnapshotRecording.Request(seconds=seconds))
        assert not answer.success
        assert "expected 0" in answer.message
    assert sorted(path.name for path in tmp_path.iterdir()) == ["inside", "secret.yaml"]
    stopped = call(talker, StopRecording, "recorder/stop", StopRecording.Request())
    assert stopped.success, stopped.message
    assert stopped.messages == len(list(read(bag)))
    assert texts(bag)[-1] == sent
    carried = attachments(bag)
    assert not any(a.name.startswith("parameter_files/talker") for a in carried)
    assert not any(b"hunter2" in a.data for a in carried)
    assert not any(b"hunter2" in message.data for message in read(bag))


def test_a_full_disk_ends_no_recorder_and_a_broken_bag_is_repaired_meanwhile(
    talker: Node, recorder: Callable[..., subprocess.Popen[bytes]], mounted_disk: Path
) -> None:
    broken = mounted_disk / "broken"
    made = BagWriter(broken)
    made.add_topic(Topic("/a", "std_msgs/msg/String", "", "string data\n", ()))
    made.write("/a", 1, 1, b"\0\1\0\0\1\0\0\0\0")
    made.close()
    (broken / "metadata.yaml").unlink()
    filler = mounted_disk / "filler"
    filler.write_bytes(bytes(6_000_000))
    health = Health(talker)
    output = talker.create_publisher(String, "count", 100)
    process = recorder(Path(), "-p", "path:=''", "-p", f"root:={mounted_disk}", "-p", "reserve_mb:=4")

    def say() -> None:
        output.publish(String(data="1"))
        rclpy.spin_once(talker, timeout_sec=0.01)

    wait_until(lambda: health.has("bag", DiagnosticStatus.ERROR, "reserve_mb"), say, "an error on /diagnostics")
    wait_until(lambda: not is_broken(broken), say, "a repaired bag")
    refused = call(talker, StartRecording, "recorder/start", StartRecording.Request())
    assert not refused.success
    assert "reserve_mb" in refused.message
    filler.unlink()
    started = call(talker, StartRecording, "recorder/start", StartRecording.Request())
    assert started.success, started.message
    bag = Path(started.path)
    wait_until(lambda: len(texts(bag)) > 5, say, "messages in the bag")
    noise = random.Random(3)

    def shout() -> None:
        output.publish(String(data="1" + noise.randbytes(50_000).hex()))
        rclpy.spin_once(talker, timeout_sec=0.01)

    wait_until(lambda: health.has("bag", DiagnosticStatus.ERROR, "the bag is whole up to here"), shout, "the reserve")
    stopped = call(talker, StopRecording, "recorder/stop", StopRecording.Request())
    assert not stopped.success
    assert "reserve_mb" in stopped.message
    assert stopped.messages == len(list(read(bag)))
    assert stopped.dropped > 0
    assert not is_broken(bag)
    assert process.poll() is None
