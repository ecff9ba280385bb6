# SPDX-License-Identifier: Apache-2.0
"""ROS domains for tests, each held by one test at a time, whoever else tests on this machine."""

from __future__ import annotations

import fcntl
import itertools
import os
from collections.abc import Iterable
from pathlib import Path

#: DDS has ports for domains up to 101 where Linux gives no others away (docs.ros.org, The ROS_DOMAIN_ID).
TEST_DOMAINS = range(60, 100)
#: where locks lie: TMPDIR may be a test's own
_LOCKS = Path("/tmp")  # noqa: S108 - they are empty, and no link is followed


class FreeDomains:
    """Domains one after the other; each is held until it is released or this process ends.

    Args:
        start: how many domains to pass over, so that test processes begin at different ones.
        domains: the domains to take from.
    """

    def __init__(self, start: int = 0, domains: Iterable[int] = TEST_DOMAINS) -> None:
        self._all = list(domains)
        self._turns = itertools.islice(itertools.cycle(self._all), start % len(self._all), None)
        self._locks: dict[int, int] = {}

    def take_domain(self) -> int:
        """Return the next domain that nobody holds.

        Raises:
            RuntimeError: all are held.
        """
        for domain in itertools.islice(self._turns, len(self._all)):
            if domain not in self._locks and (lock := _locked(domain)) is not None:
                self._locks[domain] = lock
                return domain
        raise RuntimeError(f"expected a free ROS domain of {self._all[0]} to {self._all[-1]}, found all held by tests")

    def release(self, domain: int) -> None:
        """Let others take a domain; one that is not held stays as it is."""
        if (lock := self._locks.pop(domain, None)) is not None:
            os.close(lock)


def _locked(domain: int) -> int | None:
    path = _LOCKS / f"softgrip-test-domain-{domain}-{os.getuid()}.lock"
    lock = os.open(path, os.O_CREAT | os.O_RDWR | os.O_CLOEXEC | os.O_NOFOLLOW, 0o600)
    try:
        fcntl.flock(lock, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except OSError:
        os.close(lock)
        return None
    return lock


_OWN = FreeDomains(start=17 * os.getpid())  # processes that follow each other begin far apart
_LATEST = 4  # a module's own domain may still be in use when a test takes another
_taken: list[int] = []


def own_domain() -> str:
    """Return a ROS_DOMAIN_ID that no other test holds, with each call another one.

    DDS keeps a killed node in its graph for ten seconds: the next test must not ask it.
    """
    _taken.append(_OWN.take_domain())
    for domain in _taken[:-_LATEST]:
        _OWN.release(domain)
    del _taken[:-_LATEST]
    return str(_taken[-1])
