# SPDX-License-Identifier: Apache-2.0
"""Whether other nodes answer: pinged like components of F' (Svc::Health), from a thread that nothing here can block."""

from __future__ import annotations

import functools
import threading
import time
from collections.abc import Callable, Sequence
from typing import TYPE_CHECKING, NamedTuple

from rclpy.node import Node
from std_srvs.srv import Trigger

from softgrip_nodekit.callback_errors import callback_errors
from softgrip_nodekit.cell_time import steady_timer
from softgrip_nodekit.isolated import IsolatedNode

if TYPE_CHECKING:
    from rclpy.callback_groups import CallbackGroup
    from rclpy.client import Client
    from rclpy.task import Future

#: [s] between two pings of a node.
PING_PERIOD_S = 0.25
#: [s] without an answer after which a node counts as silent.
SILENCE_LIMIT_S = 1.0


class HealthChange(NamedTuple):
    """Names that have fallen silent, and names that answer again, since the last look."""

    silent: list[str]
    back: list[str]


class HealthWatch:
    """Find which of some nodes do not answer. A node is watched from its first answer on.

    Args:
        names: of the nodes.
        limit_s: [s] without an answer.
        max_gap_s: [s] between two looks. After a longer one the watcher itself stood still: all get their time again.
    """

    def __init__(self, names: Sequence[str], limit_s: float = SILENCE_LIMIT_S, max_gap_s: float = 0.75) -> None:
        self.names = list(names)
        self._limit = limit_s
        self._max_gap = max_gap_s
        self._answered: dict[str, float] = {}
        self._silent: set[str] = set()
        self._looked: float | None = None

    def take_answer(self, name: str, now: float) -> None:
        """Take a node's answer at a steady time [s]."""
        self._answered[name] = now

    def find_changes(self, now: float) -> HealthChange:
        """Return who has fallen silent and who is back at a steady time [s]."""
        if self._looked is not None and now - self._looked > self._max_gap:
            for name in self._answered.keys() - self._silent:
                self._answered[name] = now
        self._looked = now
        silent = {name for name, answered in self._answered.items() if now - answered > self._limit}
        change = HealthChange(sorted(silent - self._silent), sorted(self._silent - silent))
        self._silent = silent
        return change

    @property
    def silent(self) -> list[str]:
        """Who did not answer at the last look."""
        return sorted(self._silent)


class Pings:
    """Ask nodes for a sign of life at their ``~/ping`` (`run` makes it), one ping at a time.

    Args:
        node: that asks; its executor takes the answers.
        names: of the nodes, as services are named beside ``resolved_by``.
        period: [s] between two looks.
        limit: [s] without an answer.
        now_s: monotonic clock of the limit [s]; in an emulated cell its time, which waits for a node that is only late.
        resolved_by: whose namespace and remappings hold for the names; None = ``node``.
        callback_group: that takes the answers; None = the node's default one.
    """

    def __init__(
        self,
        node: Node,
        names: Sequence[str],
        period: float = PING_PERIOD_S,
        limit: float = SILENCE_LIMIT_S,
        *,
        now_s: Callable[[], float] = time.monotonic,
        resolved_by: Node | None = None,
        callback_group: CallbackGroup | None = None,
    ) -> None:
        self._now_s = now_s
        self._limit = limit
        self._lock = threading.Lock()
        self._watch = HealthWatch(names, limit, max_gap_s=3.0 * period)
        self._pings: dict[str, tuple[Future[Trigger.Response], float]] = {}
        resolve = (resolved_by or node).resolve_service_name
        self._clients = {
            name: node.create_client(Trigger, resolve(f"{name}/ping"), callback_group=callback_group) for name in names
        }

    @property
    def silent(self) -> list[str]:
        """Names of the nodes that do not answer now."""
        with self._lock:
            return self._watch.silent

    def find_changes(self) -> HealthChange:
        """Ping who is not being asked already; return who has fallen silent and who is back."""
        now = self._now_s()
        for name, client in self._clients.items():
            self._ping(name, client, now)
        with self._lock:
            return self._watch.find_changes(now)

    def _ping(self, name: str, client: Client[Trigger.Request, Trigger.Response], now: float) -> None:
        sent = self._pings.get(name)
        if sent is not None:
            if now - sent[1] < self._limit:
                return  # one at a time: a node that stands still does not find hundreds when it goes on
            client.remove_pending_request(self._pings.pop(name)[0])
        if client.service_is_ready():
            future = client.call_async(Trigger.Request())
            self._pings[name] = future, now
            future.add_done_callback(functools.partial(self._take_answer, name))

    def _take_answer(self, name: str, future: Future[Trigger.Response]) -> None:
        self._pings.pop(name, None)
        if future.exception() is None:
            with self._lock:
                self._watch.take_answer(name, self._now_s())


class HealthMonitor:
    """Ping nodes and say who falls silent, from a node and thread of its own.

    Args:
        node: that watches; its name with "_health" is that of the node that pings.
        names: of the nodes, relative to the node's namespace or absolute.
        period, limit, now_s: as for `Pings`.
        on_silent: called with the name of a node that has not answered for ``limit``, on the monitor's thread.
        on_back: called with its name when it answers again.
    """

    def __init__(
        self,
        node: Node,
        names: Sequence[str],
        period: float = PING_PERIOD_S,
        limit: float = SILENCE_LIMIT_S,
        *,
        on_silent: Callable[[str], None],
        on_back: Callable[[str], None],
        now_s: Callable[[], float] = time.monotonic,
    ) -> None:
        self._on_silent = on_silent
        self._on_back = on_back
        self._isolated = IsolatedNode(node, "health", callback_errors(node).report)
        watching = self._isolated.node
        self._asked = Pings(watching, names, period, limit, now_s=now_s, resolved_by=node)
        steady_timer(watching, period, self._tick)
        self._isolated.start()

    @property
    def silent(self) -> list[str]:
        """Names of the nodes that do not answer now."""
        return self._asked.silent

    def _tick(self) -> None:
        change = self._asked.find_changes()
        for name in change.silent:
            self._on_silent(name)
        for name in change.back:
            self._on_back(name)

    def close(self) -> None:
        """Stop watching."""
        self._isolated.close()
