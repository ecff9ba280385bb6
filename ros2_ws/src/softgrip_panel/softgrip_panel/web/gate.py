# SPDX-License-Identifier: Apache-2.0
"""What every request passes first: known host, own origin, a session; and the headers that keep a page to itself."""

from __future__ import annotations

import hashlib
from collections import deque
from collections.abc import Awaitable, Callable, MutableMapping
from http.cookies import CookieError, SimpleCookie
from typing import Any, Final

from softgrip_panel.access.origin import OriginRule
from softgrip_panel.access.sessions import Sessions
from softgrip_panel.errors import AccessError
from softgrip_panel.model.roles import Person
from softgrip_panel.texts import say

Scope = MutableMapping[str, Any]
Receive = Callable[[], Awaitable[MutableMapping[str, Any]]]
Send = Callable[[MutableMapping[str, Any]], Awaitable[None]]
App = Callable[[Scope, Receive, Send], Awaitable[None]]

COOKIE: Final = "softgrip_session"
#: Where a person comes from the gate's hands in a request's scope.
PERSON: Final = "softgrip_person"
TOKEN: Final = "softgrip_token"  # noqa: S105  a key, not a secret
#: What is served without a session.
PUBLIC: Final = frozenset({"/login", "/assets/panel.css"})
#: NiceGUI's own; it answers 400 to a page that it has given up, which then loads itself again.
SOCKETS: Final = "/_nicegui_ws/"
#: A request body is no larger [B]; order lists are the largest.
MAX_BODY: Final = 256 * 1024
#: So many strange sessions are remembered, as digests.
MAX_STRANGE: Final = 100
_READING: Final = frozenset({"GET", "HEAD"})

#: Nothing of a page comes from, or goes to, another machine. Vue compiles its templates in the browser ('unsafe-eval').
CONTENT_POLICY: Final = (
    "default-src 'self'; script-src 'self' 'unsafe-inline' 'unsafe-eval'; style-src 'self' 'unsafe-inline'; "
    "img-src 'self' data: blob:; font-src 'self' data:; connect-src 'self'; object-src 'none'; base-uri 'none'; "
    "form-action 'self'; frame-ancestors 'none'"
)
_HEADERS: Final = (
    (b"content-security-policy", CONTENT_POLICY.encode()),
    (b"x-content-type-options", b"nosniff"),
    (b"x-frame-options", b"DENY"),
    (b"referrer-policy", b"same-origin"),
    (b"cross-origin-opener-policy", b"same-origin"),
)


def header(scope: Scope, name: str) -> str | None:
    """Return a request's header, None where it is missing or stands there twice."""
    found = [value for key, value in scope.get("headers", []) if key.decode("latin-1").lower() == name]
    return found[0].decode("latin-1") if len(found) == 1 else None


def session_token(scope: Scope) -> str | None:
    """Return the token that a request's cookie carries."""
    try:
        cookies = SimpleCookie(header(scope, "cookie") or "")
    except CookieError:
        return None
    return cookies[COOKIE].value if COOKIE in cookies else None


class Gate:
    """ASGI: lets requests of known people on the panel's own pages pass to an application.

    Args:
        app: that they pass to.
        rule: host and origin.
        sessions: who is logged in.
        on_refusal: called with address, path and reason.
    """

    def __init__(
        self, app: App, rule: OriginRule, sessions: Sessions, on_refusal: Callable[[str, str, str], None]
    ) -> None:
        self._app = app
        self._rule = rule
        self._sessions = sessions
        self._on_refusal = on_refusal
        self._strange: deque[str] = deque(maxlen=MAX_STRANGE)

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        """Serve a request."""
        if scope["type"] not in ("http", "websocket"):
            await self._app(scope, receive, send)
            return
        is_reading = scope["type"] == "http" and scope["method"] in _READING
        try:
            self._rule.check(header(scope, "host"), header(scope, "origin"), needs_origin=not is_reading)
            _check_size(scope)
        except AccessError as error:
            self._on_refusal(_address(scope), scope["path"], str(error))
            await _refuse(scope, send, 403, str(error))
            return
        token = session_token(scope)
        person = self._sessions.find(token)
        if person is None and token:
            self._note_strange(scope, token)
        if person is None and scope["path"] not in PUBLIC:
            if is_reading and _wants_page(scope):
                await _answer(send, 303, b"", [(b"location", b"/login")])
            else:
                await _refuse(scope, send, 401, "expected a session, found none or one that has ended; log in")
            return
        scope[PERSON], scope[TOKEN] = person, token
        await self._app(scope, receive, self._watched(scope, send))

    def _note_strange(self, scope: Scope, token: str) -> None:
        """Write down a session that was forged or has ended, once: an old page goes on asking with it."""
        digest = hashlib.sha256(token.encode()).hexdigest()
        if digest not in self._strange:
            self._strange.append(digest)
            self._on_refusal(_address(scope), scope["path"], "expected a session, found a forged or an ended one")

    def _watched(self, scope: Scope, send: Send) -> Send:
        """Add the headers to what is sent, and write down what is refused or not there."""
        path = scope["path"]
        is_noted = path not in PUBLIC and not path.startswith(SOCKETS)

        async def sending(message: MutableMapping[str, Any]) -> None:
            if message["type"] == "http.response.start":
                message["headers"] = [*message.get("headers", []), *_HEADERS]
                if is_noted and 400 <= message["status"] < 500:
                    self._on_refusal(_address(scope), path, f"answered {message['status']}")
            await send(message)

        return sending


def person_of(scope: Scope) -> Person:
    """Return who asks; behind the gate there is always somebody, but on the public paths."""
    person = scope.get(PERSON)
    if not isinstance(person, Person):
        raise AccessError(say("error.no_session"))
    return person


def _check_size(scope: Scope) -> None:
    length = header(scope, "content-length") or "0"
    if not length.isdigit() or int(length) > MAX_BODY:
        raise AccessError(say("error.body_large", limit=MAX_BODY // 1024, found=length[:20]))
    if scope["type"] == "http" and header(scope, "transfer-encoding") is not None:
        raise AccessError(say("error.body_length"))


def _wants_page(scope: Scope) -> bool:
    return "text/html" in (header(scope, "accept") or "")


def _address(scope: Scope) -> str:
    client = scope.get("client")
    return str(client[0]) if client else "?"


async def _refuse(scope: Scope, send: Send, status: int, text: str) -> None:
    if scope["type"] == "websocket":
        await send({"type": "websocket.close", "code": 4000 + status, "reason": text[:100]})
    else:
        await _answer(send, status, f"{text}\n".encode(), [(b"content-type", b"text/plain; charset=utf-8")])


async def _answer(send: Send, status: int, body: bytes, headers: list[tuple[bytes, bytes]]) -> None:
    await send({"type": "http.response.start", "status": status, "headers": [*headers, *_HEADERS]})
    await send({"type": "http.response.body", "body": body})
