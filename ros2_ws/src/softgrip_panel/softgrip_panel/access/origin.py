# SPDX-License-Identifier: Apache-2.0
"""From where a browser may ask: the panel's own pages only, under a name that the panel has.

A page of another site that this browser has open could else order things (CSRF, websockets have no same-origin policy),
also under a name of its own that resolves to this machine (DNS rebinding).
"""

from __future__ import annotations

import ipaddress
from dataclasses import dataclass, field
from urllib.parse import urlsplit

from softgrip_panel.errors import AccessError
from softgrip_panel.texts import say

_LOOPBACK_NAMES = frozenset({"localhost", "127.0.0.1", "::1"})


def is_loopback(host: str) -> bool:
    """Whether a name or address to listen on is reached from this machine only."""
    if host in _LOOPBACK_NAMES:
        return True
    try:
        return ipaddress.ip_address(host).is_loopback
    except ValueError:
        return False


@dataclass(frozen=True)
class OriginRule:
    """The names under which the panel may be asked.

    Attributes:
        port: that it listens on.
        is_secure: by TLS.
        names: besides those of the loopback.
    """

    port: int
    is_secure: bool = False
    names: frozenset[str] = field(default_factory=frozenset)

    def check(self, host: str | None, origin: str | None, *, needs_origin: bool) -> None:
        """Let requests of the panel's own pages pass.

        Args:
            host: header Host.
            origin: header Origin.
            needs_origin: whether the request changes something or opens a websocket.

        Raises:
            AccessError: with what was expected.
        """
        if not self._is_known(host):
            raise AccessError(say("error.host", found=host))
        if origin is None:
            if needs_origin:
                raise AccessError(say("error.no_origin"))
            return
        scheme = "https" if self.is_secure else "http"
        if origin.rstrip("/").lower() != f"{scheme}://{(host or '').lower()}":
            raise AccessError(say("error.origin", found=origin))

    def _is_known(self, host: str | None) -> bool:
        try:
            parts = urlsplit(f"//{host or ''}")
            port = parts.port or (443 if self.is_secure else 80)
        except ValueError:
            return False
        return port == self.port and (parts.hostname or "") in (_LOOPBACK_NAMES | self.names)
