# SPDX-License-Identifier: Apache-2.0
"""What callbacks of a node raised: counted, said now and then, shown on /diagnostics. The node goes on."""

from __future__ import annotations

import threading
import time
import traceback
from collections import OrderedDict
from collections.abc import Callable
from weakref import WeakKeyDictionary

from rclpy.node import Node

#: [s] between two lines about errors of one kind from one place.
THROTTLE_S = 5.0
#: [s] for which an error makes the node's health a warning.
RECENT_S = 60.0
_MAX_KINDS = 64
_MAX_CHARS = 4000


class CallbackErrors:
    """Count and report what callbacks raised.

    Args:
        say: logs a line.
        clock: monotonic [s].
    """

    def __init__(self, say: Callable[[str], object], clock: Callable[[], float] = time.monotonic) -> None:
        self._say = say
        self._clock = clock
        self._lock = threading.Lock()
        self._said: OrderedDict[tuple[str, str], float] = OrderedDict()
        self._last_at: float | None = None
        self.count = 0
        self.last = ""

    def report(self, error: BaseException) -> None:
        """Count an error; its line, with the traceback, is throttled for each kind and place."""
        now = self._clock()
        with self._lock:
            self.count += 1
            self.last = f"{type(error).__name__}: {error}"[:_MAX_CHARS]
            self._last_at = now
            if not self._admits(_kind(error), now):
                return
            count = self.count
        text = "".join(traceback.format_exception(error))[-_MAX_CHARS:]
        self._say(f"a callback failed, the node goes on ({count} such errors so far): {self.last}\n{text}")

    def is_recent(self) -> bool:
        """Whether the last error is less than a minute old."""
        return self._last_at is not None and self._clock() - self._last_at < RECENT_S

    def _admits(self, kind: tuple[str, str], now: float) -> bool:
        said = self._said.get(kind)
        if said is not None and now - said < THROTTLE_S:
            return False
        self._said[kind] = now
        self._said.move_to_end(kind)
        if len(self._said) > _MAX_KINDS:
            self._said.popitem(last=False)
        return True


_of_nodes: WeakKeyDictionary[Node, CallbackErrors] = WeakKeyDictionary()
_lock = threading.Lock()


def callback_errors(node: Node) -> CallbackErrors:
    """Return the errors of a node's callbacks."""
    with _lock:
        known = _of_nodes.get(node)
        if known is None:
            known = _of_nodes[node] = CallbackErrors(node.get_logger().error)
        return known


def _kind(error: BaseException) -> tuple[str, str]:
    frames = traceback.extract_tb(error.__traceback__)
    place = f"{frames[-1].filename}:{frames[-1].lineno}" if frames else ""
    return type(error).__name__, place
