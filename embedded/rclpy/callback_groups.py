# SPDX-License-Identifier: Apache-2.0
"""Callback groups: which callbacks of a node may run at the same time."""

from __future__ import annotations

import threading
import weakref
from typing import Any


class CallbackGroup:
    """Base of the groups; tells the executor what may run."""

    def __init__(self) -> None:
        self.entities: set[weakref.ref[Any]] = set()

    def add_entity(self, entity: Any) -> None:
        """Put an entity into the group."""
        self.entities.add(weakref.ref(entity, self.entities.discard))

    def has_entity(self, entity: Any) -> bool:
        """Whether the group has an entity."""
        return weakref.ref(entity) in self.entities

    def can_execute(self, entity: Any) -> bool:
        """Whether an entity may run now."""
        raise NotImplementedError

    def beginning_execution(self, entity: Any) -> bool:
        """Mark that an entity is about to run; return False when it may not."""
        raise NotImplementedError

    def ending_execution(self, entity: Any) -> None:
        """Mark that an entity has run."""
        raise NotImplementedError


class ReentrantCallbackGroup(CallbackGroup):
    """All at the same time."""

    def can_execute(self, entity: Any) -> bool:  # noqa: ARG002
        """Return True."""
        return True

    def beginning_execution(self, entity: Any) -> bool:  # noqa: ARG002
        """Return True."""
        return True

    def ending_execution(self, entity: Any) -> None:
        """Do nothing."""


class MutuallyExclusiveCallbackGroup(CallbackGroup):
    """One at a time."""

    def __init__(self) -> None:
        super().__init__()
        self._active_entity: Any = None
        self._lock = threading.Lock()

    def can_execute(self, entity: Any) -> bool:  # noqa: ARG002
        """Whether nothing of the group is running."""
        return self._active_entity is None

    def beginning_execution(self, entity: Any) -> bool:
        """Take the group for an entity unless another has it."""
        with self._lock:
            if self._active_entity is None:
                self._active_entity = entity
                return True
        return False

    def ending_execution(self, entity: Any) -> None:
        """Free the group."""
        with self._lock:
            if self._active_entity is not entity:
                raise RuntimeError("the entity that ends is not the one that runs")
            self._active_entity = None
