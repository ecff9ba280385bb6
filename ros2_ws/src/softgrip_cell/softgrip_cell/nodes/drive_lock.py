# SPDX-License-Identifier: Apache-2.0
"""The lock of the drives (tendon/lock, tendon/unlock) as its owner calls it: torque off while hands are in the cell."""

from __future__ import annotations

from collections.abc import Callable
from typing import TypeVar

from softgrip_interfaces.srv import AcquireLock, ReleaseLock
from softgrip_nodekit import NodeIo, PendingResult, ServiceClient

Request = TypeVar("Request")
Response = TypeVar("Response")

#: Called with whether it was done (None: nobody answered, it may or may not have been), and the token or the words.
Answered = Callable[[bool | None, str], None]


class DriveLock:
    """Asks the driver to lock and to unlock.

    Args:
        node_io: the node's way to others.
        owner: who, in words.
    """

    def __init__(self, node_io: NodeIo, owner: str) -> None:
        self._owner = owner
        self._acquire = node_io.create_client(AcquireLock, "tendon/lock")
        self._release = node_io.create_client(ReleaseLock, "tendon/unlock")

    def ready(self) -> bool:
        """Whether the driver serves locks."""
        return bool(self._acquire.service_is_ready() and self._release.service_is_ready())

    def lock(self, reason: str, answered: Answered) -> None:
        """Switch the torque off and have every motion refused; answers with the token that ends it."""
        request = AcquireLock.Request(owner=f"{self._owner}: {reason}", reason=reason)

        def responded(response: AcquireLock.Response) -> None:
            if response.token and not response.success:  # locked, but some torque could not be switched off
                self._release.call_async(ReleaseLock.Request(token=response.token, reason="not safe"))
            answered(bool(response.success), str(response.token if response.success else response.message))

        self._call(self._acquire, request, responded, answered)

    def unlock(self, token: str, reason: str, answered: Answered) -> None:
        """End the lock; nothing moves and nothing is powered by it."""
        request = ReleaseLock.Request(token=token, reason=reason)
        self._call(self._release, request, lambda r: answered(bool(r.success), str(r.message)), answered)

    def ask(self, token: str, answered: Answered) -> None:
        """Ask whether a lock still stands."""
        request = AcquireLock.Request(owner=self._owner, reason="does it still stand?", token=token)
        self._call(self._acquire, request, lambda r: answered(bool(r.success), str(r.message)), answered)

    @staticmethod
    def _call(
        client: ServiceClient[Request, Response],
        request: Request,
        responded: Callable[[Response], None],
        answered: Answered,
    ) -> None:
        def on_response(future: PendingResult[Response | None]) -> None:
            response = future.result()
            if response is None:
                answered(None, "the driver went away before it answered")
            else:
                responded(response)

        client.call_async(request).add_done_callback(on_response)
