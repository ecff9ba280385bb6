# SPDX-License-Identifier: Apache-2.0
"""Log-ins: random tokens in memory, that end; and a brake for whoever guesses passwords."""

from __future__ import annotations

import secrets
from collections.abc import Callable
from dataclasses import dataclass
from typing import Final

from softgrip_panel.errors import AccessError
from softgrip_panel.model.roles import Person, Role
from softgrip_panel.texts import say

#: A session without any request for so long is over, and so is one that is so old [s].
IDLE_S: Final = 8 * 3600.0
OLD_S: Final = 24 * 3600.0
MAX_SESSIONS: Final = 200
#: So many wrong log-ins are free; each further one doubles the wait, up to the longest [s].
FREE_TRIES: Final = 5
FIRST_WAIT_S: Final = 2.0
MAX_WAIT_S: Final = 300.0
MAX_KEYS: Final = 10_000


@dataclass
class _Session:
    person: Person
    began_s: float
    used_s: float


class Sessions:
    """Who is logged in.

    Args:
        now_s: monotonic clock [s].
        on_end: called with the name of a session that has ended.
    """

    def __init__(self, now_s: Callable[[], float], on_end: Callable[[str], None] = lambda _: None) -> None:
        self._now_s = now_s
        self._on_end = on_end
        self._by_token: dict[str, _Session] = {}

    def open_session(self, name: str, role: Role) -> str:
        """Begin a session and return its token, the only thing that proves it."""
        self._drop_old()
        while len(self._by_token) >= MAX_SESSIONS:
            self.end(min(self._by_token, key=lambda token: self._by_token[token].used_s))
        token, now_s = secrets.token_urlsafe(32), self._now_s()
        # the name of a session is shown and logged; its token is not
        person = Person(secrets.token_hex(6), name, role)
        self._by_token[token] = _Session(person, now_s, now_s)
        return token

    def find(self, token: str | None) -> Person | None:
        """Return whose token it is; None for a strange or an ended one."""
        session = self._by_token.get(token or "")
        if session is None:
            return None
        now_s = self._now_s()
        if now_s - session.used_s > IDLE_S or now_s - session.began_s > OLD_S:
            self.end(token or "")
            return None
        session.used_s = now_s
        return session.person

    def end(self, token: str) -> None:
        """End a session."""
        session = self._by_token.pop(token, None)
        if session is not None:
            self._on_end(session.person.session)

    def _drop_old(self) -> None:
        for token in list(self._by_token):
            session = self._by_token[token]
            if self._now_s() - session.used_s > IDLE_S or self._now_s() - session.began_s > OLD_S:
                self.end(token)


class LoginBrake:
    """Makes whoever gives wrong passwords wait: by name and by address.

    Args:
        now_s: monotonic clock [s].
    """

    def __init__(self, now_s: Callable[[], float]) -> None:
        self._now_s = now_s
        self._failures: dict[str, tuple[int, float]] = {}

    def check(self, *keys: str) -> None:
        """Let pass who need not wait.

        Raises:
            AccessError: with how long to wait.
        """
        wait_s = max((self._wait_s(key) for key in keys), default=0.0)
        if wait_s > 0.0:
            raise AccessError(say("error.brake", wait=wait_s))

    def fail(self, *keys: str) -> None:
        """Take a wrong log-in."""
        now_s = self._now_s()
        if len(self._failures) > MAX_KEYS:
            self._failures = {key: found for key, found in self._failures.items() if now_s - found[1] < MAX_WAIT_S}
        for key in keys:
            count, _ = self._failures.get(key, (0, 0.0))
            self._failures[key] = (count + 1, now_s)

    def succeed(self, *keys: str) -> None:
        """Take a right log-in."""
        for key in keys:
            self._failures.pop(key, None)

    def _wait_s(self, key: str) -> float:
        count, last_s = self._failures.get(key, (0, 0.0))
        if count < FREE_TRIES:
            return 0.0
        limit_s = min(MAX_WAIT_S, FIRST_WAIT_S * 2.0 ** min(count - FREE_TRIES, 20))
        return max(0.0, last_s + limit_s - self._now_s())
