# SPDX-License-Identifier: Apache-2.0
"""The right to command the tendons (tendon/lease): taken before work, kept by heartbeats, handed over on request."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Final

from softgrip_interfaces.msg import LeaseHeartbeat, TendonOwners
from softgrip_interfaces.srv import AcquireLease, ReleaseLease
from softgrip_nodekit import NodeIo, to_time_message

#: A driver that has not answered for so long does not answer [s].
ANSWER_S: Final = 2.0
#: A lease that an earlier run of the same owner left is waited for so much longer than it lasts [s].
OWN_LEASE_GRACE_S: Final = 0.5
#: After a hand-over the tendons are left alone for so long, so that whoever asked gets them [s].
HAND_OVER_S: Final = 5.0

#: tendon/owners may say so long after the grant what was true before it [s].
SETTLED_S: Final = 2.0

#: Called with "" when the tendons are ours, else with why not.
Answered = Callable[[str], None]


@dataclass
class _Request:
    """An acquisition on its way."""

    answered: Answered
    until_s: float
    is_asked: bool = False
    refusal: str = ""  # of the last answer


class TendonLease:
    """One owner's lease of some tendons.

    Args:
        node_io: the node's way to others.
        publish: sends a heartbeat (tendon/heartbeat).
        owner: who, in words.
        tendons: names.
        duration_s: without heartbeats for so long the driver ends the lease [s].
        lost: called with why, when the lease ended without us.
        ask_for_hand_over: ask an owner who only holds something to release the tendons to us.
    """

    def __init__(
        self,
        node_io: NodeIo,
        publish: Callable[[LeaseHeartbeat], None],
        owner: str,
        tendons: Sequence[str],
        duration_s: float,
        lost: Callable[[str], None],
        *,
        ask_for_hand_over: bool = False,
    ) -> None:
        self._node_io = node_io
        self._publish = publish
        self._owner = owner
        self._tendons = tuple(tendons)
        self._duration_s = duration_s
        self._lost = lost
        self._ask_for_hand_over = ask_for_hand_over
        self._acquire = node_io.create_client(AcquireLease, "tendon/lease")
        self._release = node_io.create_client(ReleaseLease, "tendon/lease_release")
        self._owners: dict[str, tuple[str, str]] = {}
        self._request: _Request | None = None
        self._releasing: list[tuple[float, Callable[[], None]]] = []
        self._is_seen = False  # tendon/owners has shown us as owner since we asked
        self._granted_s = 0.0
        self._left_until_s = 0.0
        #: Goes with every order; empty while the tendons are not ours.
        self.token = ""

    @property
    def is_requested(self) -> bool:
        """Whether somebody asks for the tendons."""
        return bool(self.token) and any(self._owners.get(name, ("", ""))[1] for name in self._tendons)

    @property
    def is_left(self) -> bool:
        """Whether the tendons were handed over a moment ago."""
        return self._node_io.monotonic_s() < self._left_until_s

    def missing(self) -> list[str]:
        """Return the services that nobody serves."""
        servers = {
            "service tendon/lease": self._acquire.service_is_ready(),
            "service tendon/lease_release": self._release.service_is_ready(),
        }
        return [name for name, ready in servers.items() if not ready]

    def acquire(self, answered: Answered) -> None:
        """Become the owner; at once where it is so already. One acquisition at a time: a new one replaces another."""
        if self.token:
            answered("")
            return
        if not self._acquire.service_is_ready():
            answered("expected service tendon/lease, found none; start or check tendon_driver")
            return
        self._request = _Request(
            answered, self._node_io.monotonic_s() + self._duration_s + OWN_LEASE_GRACE_S + ANSWER_S
        )
        self._ask(self._request)

    def release(self, released: Callable[[], None] = lambda: None) -> None:
        """Give the tendons back; what moves stops and holds. ``released`` is called in any case."""
        token, self.token = self.token, ""
        if not token or not self._release.service_is_ready():
            released()
            return
        entry = (self._node_io.monotonic_s() + ANSWER_S, released)
        self._releasing.append(entry)
        answer = self._release.call_async(ReleaseLease.Request(token=token))
        answer.add_done_callback(lambda _response: self._released(entry))

    def hand_over(self) -> None:
        """Give the tendons to whoever asked for them, and leave them alone for a while."""
        self._left_until_s = self._node_io.monotonic_s() + HAND_OVER_S
        self.release()

    def observe_owners(self, message: TendonOwners) -> None:
        """Take tendon/owners: another owner means that the lease was lost."""
        self._owners = {entry.tendon: (entry.owner, entry.requested_by) for entry in message.owners}
        self._is_seen = self._is_seen or not self._others()
        self._check_ownership()

    def _others(self) -> list[str]:
        """Return who else owns some of the tendons, as tendon/owners said last."""
        return sorted({self._owners.get(name, ("", ""))[0] or "nobody" for name in self._tendons} - {self._owner})

    def _check_ownership(self) -> None:
        """Find out that the lease was lost; what tendon/owners said before it was granted does not count."""
        others = self._others()
        is_settled = self._is_seen or self._node_io.monotonic_s() - self._granted_s > SETTLED_S
        if self.token and others and is_settled:
            self.token = ""
            self._lost(
                f"lost the tendons: expected '{self._owner}' to own them (tendon/owners), found {_named(others)}"
            )

    def send_heartbeat(self) -> None:
        """Publish that the owner is alive, and give up what is not answered; each call is a heartbeat."""
        now_s = self._node_io.monotonic_s()
        if self.token:
            message = LeaseHeartbeat(token=self.token)
            message.header.stamp = to_time_message(self._node_io.now_ns())
            self._publish(message)
        self._check_ownership()
        for entry in [entry for entry in self._releasing if now_s > entry[0]]:
            self._released(entry)
        request = self._request
        if request is None:
            return
        if now_s > request.until_s:
            late = f"tendon/lease did not answer or grant within {ANSWER_S:g} s; check tendon_driver"
            self._finish(request, f"tendon/lease: {request.refusal}" if request.refusal else late)
        elif not request.is_asked:
            self._ask(request)

    def _ask(self, request: _Request) -> None:
        request.is_asked, self._is_seen = True, False
        goal = AcquireLease.Request(
            owner=self._owner,
            tendons=list(self._tendons),
            duration=self._duration_s,
            hand_over=self._ask_for_hand_over,
        )
        answer = self._acquire.call_async(goal)
        answer.add_done_callback(lambda future: self._on_answer(request, future.result()))

    def _on_answer(self, request: _Request, response: AcquireLease.Response | None) -> None:
        if request is not self._request:
            if response is not None and response.success:  # nobody waits for it any more
                self._release.call_async(ReleaseLease.Request(token=response.token))
            return
        if response is None:
            self._finish(request, "tendon_driver went away before it answered tendon/lease")
        elif response.success:
            self.token, self._granted_s = response.token, self._node_io.monotonic_s()
            self._finish(request, "")
        elif self._is_ours_from_before():
            request.is_asked = False  # ends by itself: its owner died and sends no heartbeats
        elif self._ask_for_hand_over:
            request.is_asked = False  # the owner has been asked; it decides until the request runs out
            request.refusal = response.message
        else:
            self._finish(request, f"tendon/lease: {response.message}")

    def _is_ours_from_before(self) -> bool:
        owners = {self._owners.get(name, ("", ""))[0] for name in self._tendons}
        return owners <= {self._owner, ""} and self._owner in owners

    def _finish(self, request: _Request, why_not: str) -> None:
        self._request = None
        request.answered(why_not)

    def _released(self, entry: tuple[float, Callable[[], None]]) -> None:
        if entry in self._releasing:
            self._releasing.remove(entry)
            entry[1]()


def _named(owners: Sequence[str]) -> str:
    return ", ".join(f"'{owner}'" if owner != "nobody" else owner for owner in owners)
