# SPDX-License-Identifier: Apache-2.0
"""Things that can be destroyed, and are no longer usable then."""

from __future__ import annotations

from typing import Any, Self

from rclpy.exceptions import InvalidHandle


class Destroyable:
    """Base of nodes, endpoints and timers. ``with thing.handle:`` raises InvalidHandle once it is destroyed."""

    _destroyed = False

    @property
    def handle(self) -> Any:
        """Itself: there is no C handle here."""
        return self

    def _alive(self) -> None:
        if self._destroyed:
            raise InvalidHandle("cannot use Destroyable because destruction was requested")

    def destroy(self) -> None:
        """Make it unusable."""
        self._destroyed = True

    def __enter__(self) -> Self:
        self._alive()
        return self

    def __exit__(self, *_: object) -> None:
        """Leave it as it is."""
