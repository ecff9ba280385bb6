# SPDX-License-Identifier: Apache-2.0
"""What the recorder answers, counts and says, with a talker in the same process."""

from __future__ import annotations

import errno
import os
from collections import Counter
from collections.abc import Callable, Iterator
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest
import rclpy
from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus
from rcl_interfaces.msg import Log
from rclpy.executors import SingleThreadedExecutor
from rclpy.node import Node
from rclpy.qos import DurabilityPolicy, QoSProfile
from rclpy.serialization import deserialize_message, serialize_message
from std_msgs.msg import String

from softgrip_bag.errors import BagError
from softgrip_bag.mcap_file import Attachment
from softgrip_bag.nodes import recorder as recorder_module
from softgrip_bag.nodes.recorder import Recorder
from softgrip_bag.reader import attachments, facts, read
from softgrip_bag.repair import is_broken
from softgrip_bag.writer import BagWriter, FileLimits
from softgrip_interfaces.srv import SnapshotRecording, SplitRecording, StartRecording, StopRecording
from softgrip_nodekit import Health, StartupError
from softgrip_testing.free_domains import own_domain
from softgrip_testing.waiting import TEST_TIMEOUT_S, wait_until

pytestmark = pytest.mark.ros
LATCHED = QoSProfile(depth=1, durability=DurabilityPolicy.TRANSIENT_LOCAL)


class Desk:
    """A recorder and a talker, spun by whoever waits."""

    def __init__(self) -> None:
        self.recorder = Recorder()
        self.talker = Node("talker")
        self._executor = SingleThreadedExecutor()
        self._executor.add_node(self.recorder)
        self._executor.add_node(self.talker)
        self.said: dict[str, tuple[Health, str]] = {}
        self.recorder._diagnostics.set = self._hear  # type: ignore[method-assign]

    def _hear(self, component: str, health: Health, message: str, _values: object = None) -> None:
        self.said[component] = (health, message)

    def until(self, condition: Callable[[], object], expected: str) -> None:
        def spun() -> object:
            self._executor.spin_once(timeout_sec=0.01)
            return condition()

        wait_until(spun, expected, period_s=0.0)

    def call(self, kind: Any, name: str, **fields: Any) -> Any:
        client = self.talker.create_client(kind, f"recorder/{name}")
        self.until(client.service_is_ready, name)
        future = client.call_async(kind.Request(**fields))
        self.until(future.done, f"an answer of {name}")
        return future.result()

    def start(self, path: str = "bag") -> Path:
        answer = self.call(StartRecording, "start", path=path)
        assert answer.success, answer.message
        return Path(answer.path)

    def stop(self) -> Any:
        return self.call(StopRecording, "stop")

    def publish_heard(self, topic: str, qos: QoSProfile | int = 10) -> Any:
        """Return a publisher that the recorder listens to."""
        publisher = self.talker.create_publisher(String, topic, qos)
        self.until(lambda: publisher.get_subscription_count() > 0, "a listening recorder")
        return publisher

    def close(self) -> None:
        self.recorder.close()
        self._executor.shutdown()
        self.recorder.destroy_node()
        self.talker.destroy_node()


@pytest.fixture
def desk(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[Callable[..., Desk]]:
    monkeypatch.setenv("ROS_DOMAIN_ID", own_domain())
    made: list[Desk] = []

    def make(*settings: str, namespace: str = "/") -> Desk:
        given = [f"root:={tmp_path}", "reserve_mb:=0", "record_on_start:=false", *settings]
        words = [word for setting in given for word in ("-p", setting)]
        rclpy.init(args=["--ros-args", "-r", f"__ns:={namespace}", *words])
        made.append(Desk())
        return made[-1]

    yield make
    for one in made:
        one.close()
    rclpy.try_shutdown()


def texts(bag: Path, topic: str) -> list[str]:
    """What was said: a middleware may fill the last bytes of a message up."""
    return [deserialize_message(message.data, String).data for message in read(bag, {topic})]


def test_a_running_recording_is_not_replaced_by_another_one(desk: Callable[..., Desk], tmp_path: Path) -> None:
    one = desk()
    publisher = one.publish_heard("count")
    bag = one.start()
    refused = one.call(StartRecording, "start", path="second")
    assert not refused.success
    assert f"found {bag}; stop it first" in refused.message
    publisher.publish(String(data="after the refusal"))
    stopped = one.stop()
    assert stopped.success
    assert Path(stopped.path) == bag
    assert [m.topic for m in read(bag, {"/count"})] == ["/count"]
    assert not (tmp_path / "second").exists()
    assert "found none" in one.stop().message
    assert not one.call(SplitRecording, "split").success
    assert one.start("second") == tmp_path / "second", "and then the next one begins"


def test_what_was_said_once_before_the_start_is_in_the_bag(desk: Callable[..., Desk]) -> None:
    one = desk()
    mode = one.publish_heard("mode", LATCHED)
    mode.publish(String(data="power"))
    one.until(one.recorder._ring.latched, "the mode")
    bag = one.start()
    assert one.stop().success
    assert texts(bag, "/mode") == ["power"]


def test_what_was_sent_before_the_stop_is_in_the_bag_though_the_stop_is_heard_first(desk: Callable[..., Desk]) -> None:
    """Between two requests an executor takes one message of a topic: hundreds wait when the stop is asked for."""
    one = desk()
    publisher = one.publish_heard("count", 1000)
    bag = one.start()
    for number in range(300):
        publisher.publish(String(data=str(number)))
    stopped = one.stop()
    assert stopped.success
    assert texts(bag, "/count") == [str(number) for number in range(300)]


def test_what_was_deleted_with_the_oldest_files_is_not_counted_as_in_the_bag(desk: Callable[..., Desk]) -> None:
    one = desk()
    one.recorder._limits = FileLimits(kept_files=1)
    publisher = one.publish_heard("count")
    bag = one.start()
    for number in range(3):
        before = one.recorder._bag.accepted  # type: ignore[union-attr]
        publisher.publish(String(data=str(number)))
        one.until(lambda before=before: one.recorder._bag.accepted > before, "the message")  # type: ignore[union-attr]
        assert one.call(SplitRecording, "split").success
    stopped = one.stop()
    assert stopped.success
    assert stopped.messages == len(list(read(bag)))
    assert [m.topic for m in read(bag, {"/count"})] != ["/count"] * 3


def test_a_recording_that_failed_is_no_success_and_is_an_error_on_diagnostics(
    desk: Callable[..., Desk], monkeypatch: pytest.MonkeyPatch
) -> None:
    one = desk()
    publisher = one.publish_heard("count")
    one.start()
    one.recorder._report()
    assert one.said["bag"][0] is Health.OK

    def full(*_: object) -> None:
        raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))

    monkeypatch.setattr(BagWriter, "write", full)
    publisher.publish(String(data="no room"))
    one.until(lambda: one.recorder._bag.error is not None, "the error")  # type: ignore[union-attr]
    split = one.call(SplitRecording, "split")
    assert not split.success
    assert "cannot be split" in split.message
    one.recorder._report()
    assert one.said["bag"][0] is Health.ERROR
    assert "No space left" in one.said["bag"][1]
    stopped = one.stop()
    assert not stopped.success
    assert "No space left" in stopped.message
    assert stopped.dropped >= 1
    one.recorder._report()
    assert one.said["bag"] == (Health.WARN, "not recording; call recorder/start")


def test_lost_messages_are_a_warning_that_names_their_topic(desk: Callable[..., Desk]) -> None:
    one = desk()
    one.recorder._losses.lost["/before"] += 5  # not of this recording
    one.start()
    one.recorder._report()
    assert one.said["bag"][0] is Health.OK
    one.recorder._losses.lost["/count"] += 7
    one.recorder._report()
    assert one.said["bag"] == (Health.WARN, "7 messages dropped: /count 7")
    assert one.stop().dropped == 7


def test_attachments_are_bounded_together_and_one_may_be_replaced(
    desk: Callable[..., Desk], monkeypatch: pytest.MonkeyPatch
) -> None:
    one = desk()
    taken = sum(len(carried.data) for carried in one.recorder._carried.values())
    monkeypatch.setattr(recorder_module, "_MAX_CARRIED", taken + 100)
    bag = one.start()
    one.recorder._attach(Attachment("a", "text/plain", bytes(60)))
    with pytest.raises(BagError, match="attachments"):
        one.recorder._attach(Attachment("b", "text/plain", bytes(60)))
    one.recorder._attach(Attachment("a", "text/plain", bytes(100)))
    assert one.stop().success
    carried = {carried.name: len(carried.data) for carried in attachments(bag)}
    assert carried["a"] == 100
    assert "b" not in carried


def test_what_another_cell_says_and_what_nobody_can_read_is_not_recorded(desk: Callable[..., Desk]) -> None:
    one = desk(namespace="/cell_1")
    taken: list[bytes] = []
    callback = one.recorder._own_only("/rosout", "rcl_interfaces/msg/Log", Log, lambda data, _: taken.append(data))
    own, other = (serialize_message(Log(name=name)) for name in ("cell_1.tendon_driver", "cell_2.tendon_driver"))
    for data in (own, other, b"\0\1\0\0\xff\xff\xff\xff\xff\xff\xff\xff"):
        callback(data, {})
    assert taken == [own]
    assert one.recorder._malformed == {"/rosout": 1}
    one.recorder._watch_faults("/diagnostics", lambda _: {"driver": "gone"}, b"\0\1\0\0\xff", DiagnosticArray)
    assert one.recorder._malformed["/diagnostics"] == 1
    one.recorder._report()
    assert one.said["topics"][0] is Health.WARN
    assert "messages not of its type" in one.said["topics"][1]


@pytest.mark.parametrize(
    ("requested", "recording", "expected"),
    [
        ("never", False, False),
        ("unrecorded", False, True),
        ("unrecorded", True, False),
        ("always", True, True),
    ],
)
def test_a_fault_is_kept_where_that_was_asked_for(
    desk: Callable[..., Desk], tmp_path: Path, requested: str, recording: bool, expected: bool
) -> None:
    one = desk(f"snapshot_on_fault:={requested}", "snapshot_after_s:=0.0")
    if recording:
        one.start()
    message = DiagnosticArray(status=[DiagnosticStatus(name="driver", level=DiagnosticStatus.ERROR, message="gone")])
    faults = recorder_module._FAULTS["diagnostic_msgs/msg/DiagnosticArray"]
    one.recorder._watch_faults("/diagnostics", faults, serialize_message(message), DiagnosticArray)
    one.recorder._snapshot_of_fault()
    if one.recorder._snapshot_thread is not None:
        one.recorder._snapshot_thread.join(TEST_TIMEOUT_S)
    found = list(tmp_path.glob("fault_*"))
    assert len(found) == expected
    for bag in found:
        assert facts(bag)["softgrip_fault"] == {"fault": "driver: gone"}


def test_a_snapshot_that_has_no_room_says_so_and_one_that_fails_leaves_no_open_file(
    desk: Callable[..., Desk], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    one = desk()
    publisher = one.publish_heard("count")
    publisher.publish(String(data="1"))
    one.until(one.recorder._ring.last, "the message")
    one.recorder._values["reserve_mb"] = 1
    with monkeypatch.context() as patch:
        patch.setattr(recorder_module, "free_bytes", lambda _: 999_999)
        for kind, name in ((SnapshotRecording, "snapshot"), (StartRecording, "start")):
            refused = one.call(kind, name)
            assert not refused.success
            assert "reserve_mb" in refused.message
        patch.setattr(recorder_module, "free_bytes", lambda _: 1_000_000)
        refused = one.call(SnapshotRecording, "snapshot")
        assert "reserve_mb" in refused.message, "what is to be written needs room beside the reserve"
    abandoned: list[Path] = []
    monkeypatch.setattr(BagWriter, "abandon", lambda bag: abandoned.append(bag.folder))

    def fail(*_: object) -> None:
        raise OSError(errno.EIO, os.strerror(errno.EIO))

    with monkeypatch.context() as patch:
        patch.setattr(BagWriter, "write", fail)
        refused = one.call(SnapshotRecording, "snapshot", path="failed")
    assert not refused.success
    assert abandoned == [tmp_path / "failed"]
    answer = one.call(SnapshotRecording, "snapshot", path="whole")
    assert answer.success
    assert answer.messages == len(list(read(tmp_path / "whole"))) > 0
    assert not is_broken(tmp_path / "whole")


def test_a_bag_that_is_there_already_ends_the_start(desk: Callable[..., Desk], tmp_path: Path) -> None:
    (tmp_path / "there").mkdir()
    with pytest.raises(StartupError, match="exists"):
        desk("record_on_start:=true", f"path:={tmp_path / 'there'}")


def test_a_topic_of_two_types_is_a_warning_until_it_has_one(desk: Callable[..., Desk]) -> None:
    one = desk()
    one.publish_heard("count")
    one.recorder._look_at_types("/count", ["std_msgs/msg/Int32", "std_msgs/msg/String"], ["std_msgs/msg/String"])
    one.recorder._report()
    assert one.said["topics"][0] is Health.WARN
    assert "std_msgs/msg/Int32" in one.said["topics"][1]
    one.recorder._look_at_types("/count", ["std_msgs/msg/String"], ["std_msgs/msg/String"])
    one.recorder._report()
    assert one.said["topics"][0] is Health.OK


def test_a_topic_that_cannot_be_recorded_is_an_error(desk: Callable[..., Desk]) -> None:
    one = desk()
    publisher = SimpleNamespace(topic_type="nobody_msgs/msg/Nothing", topic_type_hash="", qos_profile=None)
    one.recorder._subscribe("/strange", "nobody_msgs/msg/Nothing", [publisher])  # type: ignore[list-item]
    one.recorder._report()
    assert one.said["topics"][0] is Health.ERROR
    assert "/strange: not recorded" in one.said["topics"][1]
    assert "/strange" not in one.recorder._topics
    assert one.recorder._lost() == Counter()
