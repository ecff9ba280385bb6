# SPDX-License-Identifier: Apache-2.0
"""The right to command the tendons and the lock around hands, as their owner keeps them; the driver answers by hand."""

from __future__ import annotations

from collections.abc import Callable
from concurrent.futures import Future
from typing import Any

import pytest

from softgrip_cell.nodes.drive_lock import DriveLock
from softgrip_cell.nodes.tendon_lease import ANSWER_S, HAND_OVER_S, OWN_LEASE_GRACE_S, SETTLED_S, TendonLease
from softgrip_interfaces.msg import TendonOwner, TendonOwners
from softgrip_interfaces.srv import AcquireLease, AcquireLock, ReleaseLease, ReleaseLock
from softgrip_nodekit import nanoseconds

pytestmark = pytest.mark.ros
DURATION_S = 3.0
NOW_NS = 1_700_000_000_123_456_789
#: The next float is later than this, whatever was added up before.
MOMENT_S = 1e-6


class GivenClient:
    """A service whose answers the test gives, when it likes."""

    def __init__(self) -> None:
        self.is_ready = True
        self.requests: list[Any] = []
        self._answers: list[Future[Any]] = []

    def service_is_ready(self) -> bool:
        return self.is_ready

    def call_async(self, request: Any) -> Future[Any]:
        self.requests.append(request)
        self._answers.append(Future())
        return self._answers[-1]

    def answer(self, response: Any, call: int = -1) -> None:
        self._answers[call].set_result(response)


class GivenIo:
    """Clocks that stand, and clients that the test answers."""

    def __init__(self) -> None:
        self.time_s = 100.0
        self.clients: dict[str, GivenClient] = {}

    def now_ns(self) -> int:
        return NOW_NS

    def monotonic_s(self) -> float:
        return self.time_s

    def create_client(self, _kind: Any, name: str) -> GivenClient:
        return self.clients.setdefault(name, GivenClient())


class Bench:
    """A lease of two tendons before a driver that answers by hand."""

    def __init__(self, *, ask_for_hand_over: bool = False) -> None:
        self.node_io = GivenIo()
        self.beats: list[Any] = []
        self.lost: list[str] = []
        self.answers: list[str] = []
        self.lease = TendonLease(
            self.node_io,  # type: ignore[arg-type]
            self.beats.append,
            "manager",
            ("index", "thumb"),
            DURATION_S,
            self.lost.append,
            ask_for_hand_over=ask_for_hand_over,
        )
        self.acquire = self.node_io.clients["tendon/lease"]
        self.release = self.node_io.clients["tendon/lease_release"]

    def grant(self, token: str = "t1", call: int = -1) -> None:
        self.acquire.answer(AcquireLease.Response(success=True, token=token), call)

    def refuse(self, message: str = "the tendons are owned by 'Ada'") -> None:
        self.acquire.answer(AcquireLease.Response(message=message))

    def own(self) -> None:
        """Have the lease, and see it on tendon/owners."""
        self.lease.acquire(self.answers.append)
        self.grant()
        self.see("manager", "manager")

    def see(self, index: str, thumb: str, requested_by: str = "") -> None:
        """Hear tendon/owners."""
        owners = [
            TendonOwner(tendon=tendon, owner=owner, requested_by=requested_by)
            for tendon, owner in (("index", index), ("thumb", thumb))
        ]
        self.lease.observe_owners(TendonOwners(owners=owners))

    def beat_after(self, duration_s: float) -> None:
        self.node_io.time_s += duration_s
        self.lease.send_heartbeat()


@pytest.fixture
def bench() -> Bench:
    return Bench()


def test_what_is_granted_is_kept_by_heartbeats_with_its_token_and_asked_for_once(bench: Bench) -> None:
    bench.lease.send_heartbeat()
    bench.lease.acquire(bench.answers.append)
    bench.lease.send_heartbeat()
    assert (bench.lease.token, bench.answers, bench.beats) == ("", [], [])
    (request,) = bench.acquire.requests
    assert (request.owner, list(request.tendons), request.duration) == ("manager", ["index", "thumb"], DURATION_S)
    assert not request.hand_over
    bench.grant("t1")
    bench.lease.send_heartbeat()
    assert (bench.lease.token, bench.answers) == ("t1", [""])
    assert [(beat.token, nanoseconds(beat.header.stamp)) for beat in bench.beats] == [("t1", NOW_NS)]
    bench.lease.acquire(bench.answers.append)
    assert bench.answers == ["", ""]
    assert len(bench.acquire.requests) == 1


def test_a_refusal_names_the_owner_and_a_driver_that_is_not_there_is_named(bench: Bench) -> None:
    bench.lease.acquire(bench.answers.append)
    bench.refuse()
    assert bench.answers == ["tendon/lease: the tendons are owned by 'Ada'"]
    bench.lease.acquire(bench.answers.append)
    bench.acquire.answer(None)
    assert "went away before it answered" in bench.answers[-1]
    assert bench.lease.missing() == []
    bench.acquire.is_ready = False
    assert bench.lease.missing() == ["service tendon/lease"]
    bench.lease.acquire(bench.answers.append)
    assert "found none; start or check tendon_driver" in bench.answers[-1]
    assert len(bench.acquire.requests) == 2
    bench.beat_after(60.0)
    assert len(bench.answers) == 3
    assert (bench.lease.token, bench.beats) == ("", [])


def test_a_driver_that_does_not_answer_is_given_up_and_what_it_grants_later_is_given_back(bench: Bench) -> None:
    bench.lease.acquire(bench.answers.append)
    bench.beat_after(DURATION_S + OWN_LEASE_GRACE_S + ANSWER_S - MOMENT_S)
    assert bench.answers == []
    bench.beat_after(2.0 * MOMENT_S)
    assert len(bench.answers) == 1
    assert "did not answer or grant within" in bench.answers[0]
    bench.grant("late")
    assert (bench.lease.token, len(bench.answers)) == ("", 1)
    assert [request.token for request in bench.release.requests] == ["late"]


def test_a_new_acquisition_takes_the_place_of_another_whose_grant_is_given_back(bench: Bench) -> None:
    second: list[str] = []
    bench.lease.acquire(bench.answers.append)
    bench.lease.acquire(second.append)
    bench.grant("t1", call=0)
    assert (bench.lease.token, bench.answers, second) == ("", [], [])
    assert [request.token for request in bench.release.requests] == ["t1"]
    bench.grant("t2", call=1)
    assert (bench.lease.token, bench.answers, second) == ("t2", [], [""])


def test_what_an_earlier_run_left_is_waited_for_and_what_somebody_else_has_too_is_not(bench: Bench) -> None:
    bench.see("manager", "")
    bench.lease.acquire(bench.answers.append)
    bench.refuse("the tendons are owned by 'manager'")
    assert bench.answers == []
    bench.beat_after(0.1)
    assert len(bench.acquire.requests) == 2
    bench.beat_after(0.1)
    assert len(bench.acquire.requests) == 2, "asked again while it is being asked"
    bench.see("manager", "Ada")
    bench.refuse("the tendons are owned by 'Ada'")
    assert bench.answers == ["tendon/lease: the tendons are owned by 'Ada'"]


def test_who_may_ask_for_a_hand_over_asks_until_the_time_is_up_and_then_says_why() -> None:
    bench = Bench(ask_for_hand_over=True)
    bench.lease.acquire(bench.answers.append)
    assert bench.acquire.requests[0].hand_over
    bench.refuse()
    bench.beat_after(0.1)
    assert (len(bench.acquire.requests), bench.answers) == (2, [])
    bench.refuse()
    bench.beat_after(DURATION_S + OWN_LEASE_GRACE_S + ANSWER_S)
    assert bench.answers == ["tendon/lease: the tendons are owned by 'Ada'"]


def test_another_owner_ends_orders_at_once_and_is_named(bench: Bench) -> None:
    bench.own()
    bench.see("manager", "manager")
    assert bench.lost == []
    bench.see("manager", "Ada")
    assert bench.lease.token == ""
    assert bench.lost == ["lost the tendons: expected 'manager' to own them (tendon/owners), found 'Ada'"]
    bench.beat_after(0.1)
    assert bench.beats == []
    assert len(bench.lost) == 1


def test_what_was_true_before_the_grant_is_no_loss_and_what_stays_true_is_one(bench: Bench) -> None:
    bench.see("", "")
    bench.own()
    bench.lease.release()
    bench.release.answer(ReleaseLease.Response(success=True))
    bench.see("", "")  # and this is what tendon/owners says for a while after the next grant
    bench.lease.acquire(bench.answers.append)
    bench.grant("t2")
    bench.see("", "")
    bench.beat_after(SETTLED_S - MOMENT_S)
    assert (bench.lease.token, bench.lost) == ("t2", [])
    bench.beat_after(2.0 * MOMENT_S)
    assert bench.lease.token == ""
    assert bench.lost == ["lost the tendons: expected 'manager' to own them (tendon/owners), found nobody"]


def test_what_is_given_back_is_not_used_from_then_on(bench: Bench) -> None:
    released: list[str] = []
    bench.own()
    bench.lease.release(lambda: released.append("answered"))
    assert (bench.lease.token, released) == ("", [])
    assert [request.token for request in bench.release.requests] == ["t1"]
    bench.beat_after(0.1)
    assert bench.beats == []
    bench.release.answer(ReleaseLease.Response(success=True))
    bench.beat_after(2.0 * ANSWER_S)
    assert released == ["answered"]
    bench.lease.release(lambda: released.append("nothing to give"))
    assert released == ["answered", "nothing to give"]
    assert len(bench.release.requests) == 1


def test_a_driver_that_does_not_answer_a_release_holds_nobody_up(bench: Bench) -> None:
    released: list[str] = []
    bench.own()
    bench.lease.release(lambda: released.append("given up"))
    bench.beat_after(ANSWER_S - MOMENT_S)
    assert released == []
    bench.beat_after(2.0 * MOMENT_S)
    bench.release.answer(ReleaseLease.Response(success=True))
    assert released == ["given up"]
    bench.lease.acquire(bench.answers.append)
    bench.grant("t2")
    bench.release.is_ready = False
    assert bench.lease.missing() == ["service tendon/lease_release"]
    bench.lease.release(lambda: released.append("nobody there"))
    assert released == ["given up", "nobody there"]
    assert bench.lease.token == ""


def test_what_somebody_asks_for_is_handed_over_and_then_left_alone(bench: Bench) -> None:
    bench.see("Ada", "Ada", requested_by="Eve")
    assert not bench.lease.is_requested, "not ours to hand over"
    bench.own()
    assert not bench.lease.is_requested
    bench.see("manager", "manager", requested_by="Ada")
    assert bench.lease.is_requested
    assert not bench.lease.is_left
    bench.lease.hand_over()
    assert [request.token for request in bench.release.requests] == ["t1"]
    assert bench.lease.token == ""
    bench.node_io.time_s += HAND_OVER_S - MOMENT_S
    assert bench.lease.is_left
    bench.node_io.time_s += 2.0 * MOMENT_S
    assert not bench.lease.is_left


# --- the lock ---------------------------------------------------------------------------------------------------------

Said = list[tuple[bool | None, str]]


@pytest.fixture
def node_io() -> GivenIo:
    return GivenIo()


@pytest.fixture
def lock(node_io: GivenIo) -> DriveLock:
    return DriveLock(node_io, "manager")  # type: ignore[arg-type]


@pytest.fixture
def said() -> Said:
    return []


@pytest.fixture
def answered(said: Said) -> Callable[[bool | None, str], None]:
    return lambda success, text: said.append((success, text))


def test_hands_go_in_only_where_every_torque_is_off(
    lock: DriveLock, node_io: GivenIo, answered: Any, said: Said
) -> None:
    driver, undo = node_io.clients["tendon/lock"], node_io.clients["tendon/unlock"]
    lock.lock("a swap", answered)
    (request,) = driver.requests
    assert (request.owner, request.reason, request.token) == ("manager: a swap", "a swap", "")
    driver.answer(AcquireLock.Response(success=True, token="secret", message="locked"))
    assert (said, undo.requests) == ([(True, "secret")], [])
    lock.lock("a swap", answered)
    driver.answer(AcquireLock.Response(success=False, token="half", message="thumb: torque is on"))
    assert said[-1] == (False, "thumb: torque is on")
    assert [request.token for request in undo.requests] == ["half"], "a lock that protects nobody is not left behind"
    lock.lock("a swap", answered)
    driver.answer(AcquireLock.Response(success=False, message="locked by 'Ada'"))
    assert said[-1] == (False, "locked by 'Ada'")
    assert len(undo.requests) == 1, "another one's lock is left alone"


def test_who_gets_no_answer_does_not_know_whether_it_is_locked(
    lock: DriveLock, node_io: GivenIo, answered: Any, said: Said
) -> None:
    lock.lock("a swap", answered)
    node_io.clients["tendon/lock"].answer(None)
    lock.ask("secret", answered)
    node_io.clients["tendon/lock"].answer(None)
    lock.unlock("secret", "hands are out", answered)
    node_io.clients["tendon/unlock"].answer(None)
    assert said == [(None, "the driver went away before it answered")] * 3


@pytest.mark.parametrize("success", [True, False])
def test_unlocking_and_asking_go_by_the_token_and_hand_on_what_the_driver_says(
    lock: DriveLock, node_io: GivenIo, answered: Any, said: Said, success: bool
) -> None:
    driver, undo = node_io.clients["tendon/lock"], node_io.clients["tendon/unlock"]
    lock.ask("secret", answered)
    (asked,) = driver.requests
    assert asked.token == "secret", "without it this would be a new lock"
    driver.answer(AcquireLock.Response(success=success, message="about the lock"))
    lock.unlock("secret", "hands are out", answered)
    (released,) = undo.requests
    assert (released.token, released.reason, released.override_owner) == ("secret", "hands are out", False)
    undo.answer(ReleaseLock.Response(success=success, message="about its end"))
    assert said == [(success, "about the lock"), (success, "about its end")]


@pytest.mark.parametrize(("name", "expected"), [("", True), ("tendon/lock", False), ("tendon/unlock", False)])
def test_a_driver_is_ready_that_locks_and_unlocks(lock: DriveLock, node_io: GivenIo, name: str, expected: bool) -> None:
    if name:
        node_io.clients[name].is_ready = False
    assert lock.ready() is expected
