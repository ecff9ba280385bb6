# SPDX-License-Identifier: Apache-2.0
"""Emergency stop, lock and leases at their edges: who is told, what a token is worth, what a file may say."""

from __future__ import annotations

import hashlib
import threading
import time
from functools import partial
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest
import yaml
from builtin_interfaces.msg import Duration
from std_srvs.srv import Trigger
from trajectory_msgs.msg import JointTrajectory, JointTrajectoryPoint

from softgrip_driver.nodes.tendon_driver import TendonDriver
from softgrip_driver.nodes.tendon_safety import Drives, SafetyServer
from softgrip_driver.tendon.blocking import block_of
from softgrip_driver.tendon.gripper import Policies, StopPolicy
from softgrip_driver.tendon.limits import TendonLimits
from softgrip_driver.tendon.ownership import Ownership
from softgrip_driver.tendon.safety import Safety, SafetyRefusal
from softgrip_driver.tendon.safety_store import SafetyRecord, SafetyStore, StopCause
from softgrip_interfaces.action import MoveTendon
from softgrip_interfaces.srv import ReleaseLock


@pytest.fixture
def reported() -> list[tuple[bool, bool]]:
    """What whoever follows safety/state was told: stopped, locked."""
    return []


@pytest.fixture
def safety(tmp_path: Path, reported: list[tuple[bool, bool]]) -> Safety:
    return Safety(
        SafetyStore(tmp_path / "safety.yaml"), lambda record: reported.append((record.is_stopped, record.is_locked))
    )


def test_every_change_is_reported_to_those_who_follow(safety: Safety, reported: list[tuple[bool, bool]]) -> None:
    safety.latch_stop("a person")
    safety.announce()
    token = safety.acquire_lock("manager", "hands in the palm")
    safety.reset_stop()
    safety.release_lock(token)
    assert reported == [(True, False), (True, True), (False, True), (False, False)]


class SlowDisk(SafetyStore):
    """A file whose writing takes until it is let go on."""

    def __init__(self, path: Path) -> None:
        super().__init__(path)
        self.is_writing, self.may_go_on = threading.Event(), threading.Event()

    def save(self, record: SafetyRecord) -> None:
        self.is_writing.set()
        assert self.may_go_on.wait(10.0)
        super().save(record)


@pytest.mark.parametrize("was_stopped", [True, False])
def test_a_stop_waits_for_no_disk_and_stands_when_a_reset_before_it_is_written(
    tmp_path: Path, *, was_stopped: bool
) -> None:
    disk = SlowDisk(tmp_path / "safety.yaml")
    safety = Safety(disk)
    if was_stopped:
        safety.latch_stop("the first")
    reset = threading.Thread(target=safety.reset_stop)
    reset.start()
    assert disk.is_writing.wait(10.0)
    stop = threading.Thread(target=safety.latch_stop, args=("the second",))
    stop.start()
    stop.join(10.0)
    assert not stop.is_alive()
    disk.may_go_on.set()
    reset.join(10.0)
    assert safety.record.cause is StopCause.REQUESTED
    assert safety.persist() == ""
    assert Safety(SafetyStore(tmp_path / "safety.yaml")).record.cause is StopCause.REQUESTED


def test_torque_is_off_before_middleware_and_disk_are_used() -> None:
    done: list[str] = []
    safety = SimpleNamespace(
        latch_stop=lambda _: done.append("latched"),
        announce=lambda: done.append("announced"),
        persist=lambda: done.append("on disk") or "",
    )
    server: Any = SimpleNamespace(
        safety=safety,
        _enforce=lambda: done.append("torque off") or "",
        _policies=Policies(),
        _node=SimpleNamespace(get_logger=lambda: SimpleNamespace(warning=lambda _: None)),
    )
    server._stop = partial(SafetyServer._stop, server)
    response = SafetyServer._on_stop(server, Trigger.Request(), Trigger.Response())
    assert response.success
    assert done == ["latched", "torque off", "announced", "on disk"]


# --- requests of before a standstill ---------------------------------------------------------------------------------


def old_requests(safety: Safety, done: list[str]) -> Any:
    """A server whose process has just stood still."""
    server: Any = SimpleNamespace(
        safety=safety,
        _drives=Drives(lambda: None, lambda: True, lambda: "the node stood still for 5.0 s"),
        _enforce=lambda: done.append("torque off") or "",
        _is_locked=False,
        _node=SimpleNamespace(get_logger=lambda: SimpleNamespace(error=done.append)),
    )
    server._stop = partial(SafetyServer._stop, server)
    return server


def test_a_reset_that_may_be_older_than_the_stop_does_not_end_it(safety: Safety) -> None:
    safety.latch_stop("a person")
    answer = SafetyServer._on_reset(old_requests(safety, []), Trigger.Request(), Trigger.Response())
    assert not answer.success
    assert "stood still" in answer.message
    assert safety.record.is_stopped


def test_an_unlock_that_may_be_older_than_the_hands_inside_does_not_end_the_lock(safety: Safety) -> None:
    token = safety.acquire_lock("manager", "hands in the palm")
    request = ReleaseLock.Request(token=token)
    answer = SafetyServer._on_unlock(old_requests(safety, []), request, ReleaseLock.Response())
    assert not answer.success
    assert "stood still" in answer.message
    assert safety.record.is_locked


def test_a_standstill_in_which_a_stop_may_be_lost_stops_at_once_and_says_why(safety: Safety) -> None:
    done: list[str] = []
    server = old_requests(safety, done)
    SafetyServer._on_standstill(server, 1.5)
    assert not done
    assert not safety.record.is_stopped
    SafetyServer._on_standstill(server, 2.5)
    assert done[0] == "torque off"
    assert "stood still for 2.5 s" in done[1]
    assert Safety(SafetyStore(safety._store.path)).record.cause is StopCause.STANDSTILL


def test_no_order_that_may_be_old_reaches_the_bus() -> None:
    asked: list[Any] = []
    node: Any = SimpleNamespace(
        _loop=object(), _active=True, _order_guard=SimpleNamespace(refusal="the node stood still for 5.0 s")
    )
    assert TendonDriver._with_loop(node, asked.append) == (False, "the node stood still for 5.0 s")
    assert TendonDriver._ticket_or_refusal(node, MoveTendon.Goal()) == "the node stood still for 5.0 s"
    assert not asked


def test_a_stream_that_the_middleware_delivers_after_the_unlock_moves_nothing(safety: Safety) -> None:
    token = safety.acquire_lock("manager", "hands in the palm")
    sent_ns = time.time_ns()
    safety.release_lock(token)
    ordered: list[Any] = []
    said: list[str] = []
    logger = SimpleNamespace(warning=lambda text, **_: said.append(text))
    loop = SimpleNamespace(order=lambda *_, **__: ordered.append(1) or SimpleNamespace(refusal=""))
    node: Any = SimpleNamespace(
        _safety=safety,
        _active=True,
        _configuration=SimpleNamespace(limits={"index": TendonLimits()}),
        get_logger=lambda: logger,
    )
    node._with_loop = lambda action: action(loop)
    point = JointTrajectoryPoint(positions=[0.01], time_from_start=Duration(sec=1))
    stream = JointTrajectory(joint_names=["index"], points=[point])
    for sent, orders in ((sent_ns, 0), (time.time_ns(), 1)):
        TendonDriver._on_trajectory(node, stream, {"source_timestamp": sent})
        assert len(ordered) == orders
    assert len(said) == 1
    assert "before the emergency stop or the lock ended" in said[0]


# --- tokens and locks ----------------------------------------------------------------------------------------------


def test_a_token_has_16_bytes_that_nobody_can_guess_and_is_another_one_each_time(safety: Safety) -> None:
    """16 bytes are 22 letters of six bits."""
    tokens = set()
    for _ in range(50):
        token = safety.acquire_lock("manager", "hands in the palm")
        assert len(token) >= 22
        tokens.add(token)
        safety.release_lock(token)
    assert len(tokens) == 50


@pytest.mark.parametrize("token", ["", "guess"])
def test_without_the_token_a_stop_and_a_reason_release_nothing(safety: Safety, token: str) -> None:
    safety.acquire_lock("manager", "hands in the palm")
    safety.latch_stop("a person")
    with pytest.raises(SafetyRefusal, match="another token"):
        safety.release_lock(token, reason="I want to")
    assert safety.record.is_locked


def test_there_is_nothing_to_release_without_a_lock(safety: Safety) -> None:
    token = safety.acquire_lock("manager", "hands in the palm")
    safety.release_lock(token)
    with pytest.raises(SafetyRefusal, match="expected a lock, found none"):
        safety.release_lock(token)
    with pytest.raises(SafetyRefusal, match="the lock was released"):
        safety.acquire_lock("manager", "hands in the palm", token)


@pytest.mark.parametrize("policy", list(StopPolicy))
def test_a_lock_alone_blocks_and_lets_go(safety: Safety, policy: StopPolicy) -> None:
    policies = Policies(estop=policy, unclean_end=policy)
    assert block_of(safety, policies) is None
    safety.acquire_lock("manager", "hands in the palm")
    block = block_of(safety, policies)
    assert block is not None
    assert (block.is_stop, block.lets_go) == (False, True)
    assert "locked by manager (hands in the palm)" in block.text


@pytest.mark.parametrize(
    "changes",
    [
        {"lock_digest": 0},
        {"lock_digest": []},
        {"is_armed": 0},
        {"is_armed": "no"},
        {"sequence": "1"},
        {"cause": "tired"},
        {"extra": 1},
    ],
)
def test_a_file_of_a_right_checksum_that_says_something_else_counts_as_stopped(
    tmp_path: Path, changes: dict[str, Any]
) -> None:
    path = tmp_path / "safety.yaml"
    SafetyStore(path).save(SafetyRecord(sequence=1))
    body = {**yaml.safe_load(path.read_text())["safety"], **changes}
    digest = hashlib.sha256(yaml.safe_dump(body, sort_keys=True).encode()).hexdigest()
    path.write_text(yaml.safe_dump({"schema": 1, "safety": body, "sha256": digest}))
    assert SafetyStore(path).load().cause is StopCause.UNREADABLE


def test_a_lapsed_lease_is_reported_once_and_shown_as_nobody_s() -> None:
    ownership = Ownership(("index", "thumb"), 30.0, lambda: "token")
    ownership.acquire("manager", [], 1.0, 0.0)
    assert ownership.end_lapsed(1.1) == {"index": "manager", "thumb": "manager"}
    assert ownership.end_lapsed(1.2) == {}
    assert {row.owner for row in ownership.rows()} == {""}
