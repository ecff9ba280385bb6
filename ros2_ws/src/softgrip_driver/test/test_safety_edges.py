# SPDX-License-Identifier: Apache-2.0
"""Emergency stop, lock and leases at their edges: who is told, what a token is worth, what a file may say."""

from __future__ import annotations

import hashlib
from pathlib import Path
from typing import Any

import pytest
import yaml

from softgrip_driver.tendon.blocking import block_of
from softgrip_driver.tendon.gripper import Policies, StopPolicy
from softgrip_driver.tendon.ownership import Ownership
from softgrip_driver.tendon.safety import Safety, SafetyRefusal
from softgrip_driver.tendon.safety_store import SafetyRecord, SafetyStore, StopCause


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
    token = safety.acquire_lock("manager", "hands in the palm")
    safety.reset_stop()
    safety.release_lock(token)
    assert reported == [(True, False), (True, True), (False, True), (False, False)]


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
