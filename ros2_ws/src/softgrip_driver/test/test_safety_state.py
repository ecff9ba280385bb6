# SPDX-License-Identifier: Apache-2.0
"""Emergency stop and lock: what a new process finds on disk, and what nobody can end by mistake."""

import os
from pathlib import Path

import pytest

from softgrip_description.cell_file import ChainServo, ServoChain
from softgrip_driver.commands import calibrate_tension, stage
from softgrip_driver.tendon.blocking import block_of, keeps_torque
from softgrip_driver.tendon.gripper import Policies, StopPolicy
from softgrip_driver.tendon.safety import Safety, SafetyRefusal
from softgrip_driver.tendon.safety_store import (
    SafetyStore,
    SafetyStoreError,
    StopCause,
    check_port_is_free_to_move,
    port_file,
)
from softgrip_driver.wizard.chain import chain_backend

LET_GO, HOLD = StopPolicy.LET_GO, StopPolicy.HOLD


@pytest.fixture
def path(tmp_path):
    return tmp_path / "cell" / "safety.yaml"


def process(path) -> Safety:
    """The state as a process that starts now has it."""
    return Safety(SafetyStore(path))


def test_a_cell_that_never_ran_is_neither_stopped_nor_locked(path):
    assert process(path).refusal == ""
    assert not path.exists()


def test_a_stop_is_found_by_every_later_process_until_the_reset(path):
    safety = process(path)
    safety.latch_stop("a person")
    assert safety.persist() == ""
    for _ in range(3):
        later = process(path)
        assert "a person" in later.refusal
        assert later.record.cause is StopCause.REQUESTED
    process(path).reset_stop()
    assert process(path).refusal == ""


def test_a_stop_holds_in_memory_before_it_is_on_disk_and_when_it_cannot_be_written(path, monkeypatch):
    safety = process(path)
    safety.latch_stop("a person")
    assert "estop_reset" in safety.refusal
    monkeypatch.setattr(os, "fsync", lambda _: (_ for _ in ()).throw(OSError(28, "No space left on device")))
    assert "No space left" in safety.persist()
    assert "estop_reset" in safety.refusal
    monkeypatch.undo()
    assert safety.persist() == ""
    assert process(path).record.is_stopped


def test_a_reset_that_cannot_be_written_does_not_happen(path, monkeypatch):
    safety = process(path)
    safety.latch_stop("a person")
    safety.persist()
    monkeypatch.setattr(os, "fsync", lambda _: (_ for _ in ()).throw(OSError(30, "Read-only file system")))
    with pytest.raises(SafetyStoreError, match="Read-only"):
        safety.reset_stop()
    assert safety.record.is_stopped


def test_what_was_sent_before_a_stop_or_a_lock_ended_moves_nothing(path):
    now = [5_000_000_000]
    safety = Safety(SafetyStore(path), epoch_ns=lambda: now[0])
    assert safety.refusal_of_sent(1) == "", "nothing was forbidden since this process runs"
    safety.set_armed(armed=True)
    assert safety.refusal_of_sent(4_999_999_999) == "", "taking hold ends neither a stop nor a lock"
    token = safety.acquire_lock("a person", "hands inside")
    safety.latch_stop("another")
    now[0] = 6_000_000_000
    safety.reset_stop()
    assert safety.refusal_of_sent(5_500_000_000) == "", "the lock still stands, and refuses for itself"
    now[0] = 7_000_000_000
    safety.release_lock(token)
    refusal = safety.refusal_of_sent(6_750_000_000)
    assert "sent 0.250 s before the emergency stop or the lock ended" in refusal
    assert "synchronise" in refusal
    assert safety.refusal_of_sent(7_000_000_000) == ""
    assert safety.refusal_of_sent(0) == "", "a middleware that does not say when"


def test_a_stop_that_comes_while_another_is_reset_frees_nothing(path, monkeypatch):
    safety = Safety(SafetyStore(path), epoch_ns=lambda: 9)
    safety.latch_stop("first")
    save = SafetyStore.save
    monkeypatch.setattr(SafetyStore, "save", lambda store, record: (save(store, record), safety.latch_stop("second")))
    safety.reset_stop()
    assert safety.record.is_stopped
    assert safety.refusal_of_sent(8) == ""


def test_file_and_folder_are_synchronised_before_a_write_counts(path, monkeypatch):
    """The order of system calls that a power cut must not be able to cut short: data, rename, folder."""
    calls = []
    fsync, replace = os.fsync, type(path).replace

    def record_fsync(handle):
        calls.append("folder" if Path(f"/proc/self/fd/{handle}").is_dir() else "file")
        fsync(handle)

    def record_replace(self, target):
        calls.append("rename")
        return replace(self, target)

    monkeypatch.setattr(os, "fsync", record_fsync)
    monkeypatch.setattr(type(path), "replace", record_replace)
    process(path).set_armed(armed=True)
    assert calls[-3:] == ["file", "rename", "folder"]


def test_a_process_that_follows_a_killed_one_starts_stopped(path):
    process(path).set_armed(armed=True)
    later = process(path)
    assert later.record.cause is StopCause.UNCLEAN_END
    assert "estop_reset" in later.refusal


def test_a_process_that_follows_an_orderly_one_does_not(path):
    safety = process(path)
    safety.set_armed(armed=True)
    safety.set_armed(armed=False)
    assert process(path).refusal == ""


def test_an_unclean_end_after_a_stop_stays_the_stop_that_was_asked_for(path):
    safety = process(path)
    safety.set_armed(armed=True)
    safety.latch_stop("a person")
    safety.persist()
    assert process(path).record.cause is StopCause.REQUESTED


def test_a_driver_that_stood_still_for_so_long_that_a_stop_may_be_lost_is_stopped(path):
    safety = process(path)
    assert safety.latch_standstill(1.99) == ""
    assert safety.refusal == ""
    assert "stood still for 2.5 s" in safety.latch_standstill(2.5)
    assert "may be lost" in safety.refusal
    assert safety.persist() == ""
    assert process(path).record.cause is StopCause.STANDSTILL


def test_a_standstill_does_not_hide_a_stop_that_was_asked_for(path):
    safety = process(path)
    safety.latch_stop("a person")
    safety.latch_standstill(5.0)
    assert safety.record.cause is StopCause.REQUESTED


def stop(safety):
    safety.latch_stop("a person")
    safety.persist()


@pytest.mark.parametrize(
    "leave",
    [stop, lambda safety: safety.acquire_lock("manager", "hands"), lambda safety: safety.set_armed(armed=True)],
    ids=["stopped", "locked", "killed"],
)
def test_another_name_of_the_port_does_not_end_a_stop(tmp_path, leave):
    """/dev/ttyUSB0 and /dev/serial/by-id/... are one adapter, and each name has a file of its own."""
    leave(process(tmp_path / "tendon_safety-dev-ttyUSB0.yaml"))
    later = process(tmp_path / "tendon_safety-dev-serial-by-id-usb-FTDI.yaml")
    assert "tendon_safety-dev-ttyUSB0.yaml" in later.refusal
    assert "another name" in later.refusal
    later.reset_stop()
    assert process(tmp_path / "tendon_safety-dev-serial-by-id-usb-FTDI.yaml").refusal == "", "once"


def test_a_new_port_beside_drivers_at_rest_is_free(tmp_path):
    other = process(tmp_path / "tendon_safety-dev-ttyUSB0.yaml")
    other.set_armed(armed=True)
    other.set_armed(armed=False)
    assert process(tmp_path / "tendon_safety-dev-ttyUSB1.yaml").refusal == ""


def test_an_emulated_port_is_nobody_elses(tmp_path):
    stop(process(tmp_path / "tendon_safety-dev-ttyUSB0.yaml"))
    assert process(tmp_path / "tendon_safety-tmp-wires-servos.yaml").refusal == ""


@pytest.mark.parametrize(
    "text", ["", "{", "schema: 1\n", "schema: 2\nsafety: {}\nsha256: x\n", "[1, 2]\n", "safety: \x00"]
)
def test_whatever_cannot_be_read_counts_as_stopped(path, text):
    path.parent.mkdir()
    path.write_text(text)
    safety = process(path)
    assert safety.record.cause is StopCause.UNREADABLE
    assert str(path) in safety.refusal


def test_an_edited_file_counts_as_stopped(path):
    safety = process(path)
    safety.latch_stop("a person")
    safety.persist()
    path.write_text(path.read_text().replace("cause: requested", "cause: ''"))
    assert process(path).record.is_stopped


def test_a_folder_in_place_of_the_file_counts_as_stopped(path):
    path.mkdir(parents=True)
    assert process(path).record.is_stopped


def test_the_sequence_grows_over_restarts(path):
    numbers = []
    for _ in range(3):
        safety = process(path)
        safety.latch_stop("a person")
        safety.persist()
        safety.reset_stop()
        numbers.append(safety.record.sequence)
    assert numbers == sorted(set(numbers))


# --- lock ----------------------------------------------------------------------------------------------------------


def test_only_the_owners_token_ends_a_lock_also_in_a_later_process(path):
    token = process(path).acquire_lock("manager", "hands in the palm")
    later = process(path)
    assert "manager" in later.refusal
    with pytest.raises(SafetyRefusal, match="another token; the cell is locked by manager"):
        later.release_lock("guess")
    assert later.release_lock(token) == "released the lock of manager"
    assert process(path).refusal == ""


def test_the_token_is_not_on_disk(path):
    token = process(path).acquire_lock("manager", "hands in the palm")
    assert token not in path.read_text()


def test_a_second_owner_is_told_who_has_the_lock(path):
    safety = process(path)
    token = safety.acquire_lock("manager", "hands in the palm")
    with pytest.raises(SafetyRefusal, match="already locked by manager"):
        safety.acquire_lock("stranger", "none")
    with pytest.raises(SafetyRefusal, match="another token"):
        safety.acquire_lock("stranger", "none", "guess")
    assert safety.acquire_lock("manager", "", token) == token


def test_a_reset_does_not_end_a_lock(path):
    safety = process(path)
    safety.acquire_lock("manager", "hands in the palm")
    safety.latch_stop("a person")
    safety.persist()
    safety.reset_stop()
    assert "locked by manager" in safety.refusal


def test_a_lost_token_is_overridden_only_while_stopped_and_with_a_reason(path):
    safety = process(path)
    safety.acquire_lock("manager", "hands in the palm")
    with pytest.raises(SafetyRefusal, match="latched emergency stop"):
        safety.release_lock("", override_owner=True, reason="Ann: token lost, hands are out")
    safety.latch_stop("Ann")
    with pytest.raises(SafetyRefusal, match="reason"):
        safety.release_lock("", override_owner=True)
    assert "Ann" in safety.release_lock("", override_owner=True, reason="Ann: token lost, hands are out")
    assert not safety.record.is_locked


@pytest.mark.parametrize(("owner", "reason"), [("", "x"), ("x", ""), (" ", " ")])
def test_a_lock_needs_an_owner_and_a_reason(path, owner, reason):
    with pytest.raises(SafetyRefusal, match="owner and a reason"):
        process(path).acquire_lock(owner, reason)


def test_a_lock_that_cannot_be_written_is_none(path, monkeypatch):
    safety = process(path)
    monkeypatch.setattr(os, "fsync", lambda _: (_ for _ in ()).throw(OSError(28, "No space left on device")))
    with pytest.raises(SafetyStoreError):
        safety.acquire_lock("manager", "hands in the palm")
    assert not safety.record.is_locked


# --- what it means for the drives -----------------------------------------------------------------------------------


@pytest.mark.parametrize(("estop", "unclean"), [(LET_GO, HOLD), (HOLD, LET_GO)])
def test_torque_follows_the_policy_of_the_cause(path, estop, unclean):
    policies = Policies(estop=estop, unclean_end=unclean)
    safety = process(path)
    assert block_of(safety, policies) is None
    assert not keeps_torque(safety.record, policies)
    safety.set_armed(armed=True)
    later = process(path)
    assert block_of(later, policies).lets_go is (unclean is LET_GO)
    assert keeps_torque(later.record, policies) is (unclean is HOLD)
    later.latch_standstill(5.0)
    assert block_of(later, policies).lets_go is (unclean is LET_GO)
    assert keeps_torque(later.record, policies) is (unclean is HOLD)
    later.latch_stop("a person")
    assert block_of(later, policies).lets_go is (estop is LET_GO)
    assert keeps_torque(later.record, policies) is (estop is HOLD)


def test_a_lock_lets_go_whatever_the_policies(path):
    policies = Policies(estop=HOLD, unclean_end=HOLD)
    safety = process(path)
    safety.latch_stop("a person")
    safety.acquire_lock("manager", "hands in the palm")
    block = block_of(safety, policies)
    assert block.lets_go
    assert block.is_stop
    assert not keeps_torque(safety.record, policies)


# --- commands that move a port's drives without the driver -----------------------------------------------------------

PORT = "/tmp/wires/servos"


@pytest.fixture
def kept(tmp_path, monkeypatch) -> Path:
    """Where the port's stop and lock are kept."""
    monkeypatch.setenv("ROS_HOME", str(tmp_path))
    return port_file(PORT)


def locked(safety: Safety) -> None:
    safety.acquire_lock("manager", "hands in the palm")


def armed(safety: Safety) -> None:
    safety.set_armed(armed=True)


@pytest.mark.parametrize(
    ("happens", "found"),
    [
        (stop, r"an emergency stop \(a person"),
        (locked, r"hands in the cell \(hands in the palm"),
        (armed, r"torque on \(a driver that works, or ended without letting go"),
    ],
)
def test_who_moves_drives_without_the_driver_asks_what_it_kept(kept, happens, found):
    check_port_is_free_to_move(PORT)
    kept.parent.mkdir(exist_ok=True)
    happens(process(kept))
    with pytest.raises(SafetyStoreError, match=found):
        check_port_is_free_to_move(PORT)


@pytest.mark.parametrize("order", [("--jog", "5"), ("--start", "home")])
def test_a_stage_is_not_moved_while_it_is_stopped(kept, capsys, order):
    kept.parent.mkdir(exist_ok=True)
    stop(process(kept))
    assert stage.main(["--port", PORT, *order]) == 1
    assert "found an emergency stop (a person" in capsys.readouterr().err


def test_calibrate_tension_and_the_wizard_ask(kept, capsys):
    kept.parent.mkdir(exist_ok=True)
    stop(process(kept))
    assert calibrate_tension.main(["--port", PORT, "--gauge", "/tmp/wires/gauge"]) == 1
    assert "found an emergency stop (a person" in capsys.readouterr().err
    chain = ServoChain(port=PORT, chain=(ChainServo("index", 1, "XL330-M288"),))
    with pytest.raises(SafetyStoreError, match="an emergency stop"):
        chain_backend(chain, chain.chain, 0.04, print)
