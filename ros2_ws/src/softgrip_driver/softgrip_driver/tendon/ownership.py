# SPDX-License-Identifier: Apache-2.0
"""Who may command which tendon: one owner each, for as long as it shows that it is alive.

Pure: the time comes in as `now` [s] of a monotonic clock, tokens from a function. A lease covers the tendons it was
granted for; another owner may take some of them by force, and the rest stays.
"""

from __future__ import annotations

import hmac
import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass


class LeaseRefusal(Exception):  # noqa: N818  an answer, not a failure
    """A lease that is not granted; says who owns what and what to do."""


@dataclass
class Lease:
    """One owner's right to command tendons.

    Attributes:
        owner: node or person, in words.
        token: goes with every order.
        duration_s: without a heartbeat until it ends.
        renewed_at: [s] of the last heartbeat.
    """

    owner: str
    token: str
    duration_s: float
    renewed_at: float

    def has_lapsed(self, now: float) -> bool:
        """Whether its owner has been silent for too long."""
        return now - self.renewed_at > self.duration_s


@dataclass(frozen=True)
class OwnerRow:
    """One tendon's owner as TendonOwner tells it; empty owner = nobody."""

    tendon: str
    owner: str
    duration_s: float
    requested_by: str


class Ownership:
    """Leases of all tendons of a driver.

    Args:
        tendons: names, in order.
        max_duration_s: the longest lease.
        new_token: gives a token that nobody can guess.
    """

    def __init__(self, tendons: Sequence[str], max_duration_s: float, new_token: Callable[[], str]) -> None:
        self._max_duration_s = max_duration_s
        self._new_token = new_token
        self._leases: dict[str, Lease | None] = dict.fromkeys(tendons)
        self._requested_by: dict[str, str] = dict.fromkeys(tendons, "")

    def acquire(
        self,
        owner: str,
        tendons: Sequence[str],
        duration_s: float,
        now: float,
        *,
        hand_over: bool = False,
        force: bool = False,
        reason: str = "",
    ) -> tuple[Lease, tuple[str, ...]]:
        """Grant a lease.

        Args:
            owner: node or person, in words.
            tendons: names; none = all.
            duration_s: without a heartbeat until it ends.
            now: [s]
            hand_over: where somebody else owns one, note who asks for it.
            force: take what somebody else owns; needs a reason.
            reason: in words.

        Returns:
            the lease, and the tendons that were taken from another owner: what they do has to stop.

        Raises:
            LeaseRefusal: an unknown tendon, no owner, a duration out of range, or another owner.
        """
        names = list(tendons) or list(self._leases)
        self._check_request(owner, names, duration_s, force=force, reason=reason)
        taken = tuple(name for name in names if self._owner_of(name, now))
        if taken and not force:
            if hand_over:
                for name in taken:
                    self._requested_by[name] = owner
            owners = ", ".join(f"'{name}' by {self._owner_of(name, now)}" for name in taken)
            how = "asked its owner to hand it over" if hand_over else "ask with hand_over, or wait"
            raise LeaseRefusal(f"owned: tendon {owners}; {how}")
        lease = Lease(owner, self._new_token(), duration_s, now)
        for name in names:
            self._leases[name] = lease
            self._requested_by[name] = ""
        return lease, taken

    def _check_request(self, owner: str, names: Sequence[str], duration_s: float, *, force: bool, reason: str) -> None:
        unknown = [name for name in names if name not in self._leases]
        if unknown:
            raise LeaseRefusal(f"expected tendons out of {list(self._leases)}, found {unknown}")
        if not owner.strip():
            raise LeaseRefusal("expected an owner, found none; say who commands the tendons")
        if not (math.isfinite(duration_s) and 0.0 < duration_s <= self._max_duration_s):
            raise LeaseRefusal(
                f"expected a duration above 0 and up to {self._max_duration_s:g} s, found {duration_s:g} s"
            )
        if force and not reason.strip():
            raise LeaseRefusal("expected a reason with force, found none; say who takes over and why")

    def renew(self, token: str, now: float) -> tuple[str, ...]:
        """Take a heartbeat; return the tendons that it keeps, none for a token that is not (any more) in force."""
        kept = tuple(name for name in self._leases if self._is_owned_with(name, token, now))
        for name in kept:
            lease = self._leases[name]
            assert lease is not None
            lease.renewed_at = now
        return kept

    def is_known(self, token: str) -> bool:
        """Whether a lease has this token, lapsed or not."""
        return any(_is_token(lease, token) for lease in list(self._leases.values()))

    def release(self, token: str, now: float) -> tuple[str, ...]:
        """End a lease; return its tendons, none for a token that is not in force."""
        ended = tuple(name for name in self._leases if self._is_owned_with(name, token, now))
        for name in ended:
            self._leases[name] = None
        return ended

    def end_lapsed(self, now: float) -> dict[str, str]:
        """End the leases whose owner fell silent; return tendon -> owner of those."""
        lapsed = {
            name: lease.owner for name, lease in self._leases.items() if lease is not None and lease.has_lapsed(now)
        }
        for name in lapsed:
            self._leases[name] = None
        return lapsed

    def refusal(self, token: str, tendons: Sequence[str], now: float) -> str:
        """Return why an order with this token may not command tendons, empty when it may."""
        for name in tendons:
            owner = self._owner_of(name, now)
            if owner and not self._is_owned_with(name, token, now):
                found = "without a token" if not token else "with another token"
                return (
                    f"tendon '{name}' is owned by {owner}, the order came {found}; see tendon/owners and tendon/lease"
                )
            if token and not owner:
                return f"the lease on tendon '{name}' has ended; acquire it again (tendon/lease)"
        return ""

    def owner_of(self, tendon: str, now: float) -> str:
        """Return who owns a tendon, empty for nobody."""
        return self._owner_of(tendon, now)

    def last_heartbeat(self, tendon: str) -> float:
        """Return when [s] a tendon's owner last showed that it is alive; -inf without an owner."""
        lease = self._leases[tendon]
        return -math.inf if lease is None else lease.renewed_at

    def rows(self) -> tuple[OwnerRow, ...]:
        """Return every tendon's owner."""
        return tuple(
            OwnerRow(name, lease.owner if lease else "", lease.duration_s if lease else 0.0, self._requested_by[name])
            for name, lease in self._leases.items()
        )

    def _owner_of(self, tendon: str, now: float) -> str:
        lease = self._leases[tendon]
        return "" if lease is None or lease.has_lapsed(now) else lease.owner

    def _is_owned_with(self, tendon: str, token: str, now: float) -> bool:
        lease = self._leases[tendon]
        return lease is not None and not lease.has_lapsed(now) and _is_token(lease, token)


def _is_token(lease: Lease | None, token: str) -> bool:
    return lease is not None and hmac.compare_digest(lease.token.encode(), token.encode())
