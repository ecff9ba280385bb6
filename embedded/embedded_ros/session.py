# SPDX-License-Identifier: Apache-2.0
"""Declares what rmw_zenoh declares, on a session: publishers, subscriptions, queryables, queriers, tokens."""

from __future__ import annotations

import contextlib
import ctypes
import logging
import threading
from typing import TYPE_CHECKING, Any

import zenoh
import zenoh.ext

from embedded_ros.later import Callback
from embedded_ros.throttle import Throttle

if TYPE_CHECKING:
    from collections.abc import Callable

    from embedded_ros.wire import WireQos

_HEARTBEAT_S = 0.5
_FOREVER_S = 10.0 * 365 * 24 * 3600


_known_threads: set[int] = set()
_LOG = logging.getLogger(__name__)
_throttle = Throttle()


def _direct(function: Callable[[Any], None], at_end: Callable[[], None] | None = None) -> Any:
    """Call on Zenoh's own thread: its default thread would keep the process from exiting after an exception."""

    def called(item: Any) -> None:
        if threading.get_ident() not in _known_threads:
            _stay_known()
        try:
            with Callback():
                function(item)
        except Exception as error:  # noqa: BLE001  what comes from outside ends no thread and no process
            if _throttle.admit(type(error)) is not None:
                _LOG.exception("could not take in what arrived")

    return zenoh.handlers.Callback(called, at_end, indirect=False)


def _stay_known() -> None:
    """Make Python keep what it knows of a thread that is not its own.

    Otherwise it makes that for each call and takes it down after, stack included: as much work as the call itself.
    """
    _known_threads.add(threading.get_ident())
    ctypes.pythonapi.PyGILState_Ensure()


class Link:
    """A session, as endpoints use it."""

    def __init__(self, session: zenoh.Session) -> None:
        self._session = session

    @property
    def zid(self) -> str:
        """The session's id as it stands in tokens."""
        return str(self._session.info.zid())

    def token(self, key: str) -> zenoh.LivelinessToken:
        """Announce an entity."""
        return self._session.liveliness().declare_token(key)

    @staticmethod
    def withdraw(declared: Any) -> None:
        """Undeclare something; a session that is closed already has done so."""
        with contextlib.suppress(zenoh.ZError):
            declared.undeclare()

    def publisher(self, key: str, qos: WireQos) -> Any:
        """Declare a publisher; transient local keeps the last ``depth`` samples for late subscriptions.

        Let go of it to undeclare it. Its ``undeclare`` takes a cache down with Python's lock in hand, and waits for
        Zenoh's threads, which wait for that lock (eclipse-zenoh 1.10).
        """
        reliable = qos.reliability == 1
        options: dict[str, Any] = {
            "express": True,  # no waiting for more to send: latency before throughput
            "reliability": zenoh.Reliability.RELIABLE if reliable else zenoh.Reliability.BEST_EFFORT,
            "congestion_control": zenoh.CongestionControl.BLOCK
            if reliable and qos.history == 2
            else zenoh.CongestionControl.DROP,
        }
        if qos.durability != 1:
            return self._session.declare_publisher(key, **options)
        if reliable:
            options["sample_miss_detection"] = zenoh.ext.MissDetectionConfig(
                heartbeat=None, sporadic_heartbeat=_HEARTBEAT_S
            )
        return zenoh.ext.declare_advanced_publisher(
            self._session, key, cache=zenoh.ext.CacheConfig(qos.depth), publisher_detection=True, **options
        )

    def subscription(self, key: str, qos: WireQos, on_sample: Callable[[zenoh.Sample], None]) -> Any:
        """Declare a subscription; transient local asks publishers, also late ones, for what they keep.

        Let go of it to undeclare it, as with publishers.
        """
        if qos.durability != 1:
            return self._session.declare_subscriber(key, _direct(on_sample))
        options: dict[str, Any] = {}
        if qos.reliability == 1:
            options["recovery"] = zenoh.ext.RecoveryConfig(periodic_queries=None, heartbeat=True)
        return zenoh.ext.declare_advanced_subscriber(
            self._session,
            key,
            _direct(on_sample),
            history=zenoh.ext.HistoryConfig(detect_late_publishers=True, max_samples=qos.depth),
            subscriber_detection=True,
            **options,
        )

    def queryable(self, key: str, on_query: Callable[[zenoh.Query], None]) -> Any:
        """Declare the server side of a service."""
        return self._session.declare_queryable(key, _direct(on_query), complete=True)

    def querier(self, key: str) -> Any:
        """Declare the client side of a service; results of actions are waited for without limit."""
        options: dict[str, Any] = {}
        if "/_action/get_result/" in key:
            options["timeout"] = _FOREVER_S
        return self._session.declare_querier(
            key,
            target=zenoh.QueryTarget.ALL_COMPLETE,
            consolidation=zenoh.ConsolidationMode.NONE,
            express=True,
            **options,
        )

    @staticmethod
    def ask(
        querier: Any,
        payload: bytearray,
        attachment: bytes,
        on_reply: Callable[[zenoh.Reply], None],
        at_end: Callable[[], None] | None = None,
    ) -> None:
        """Send a request; `at_end` is called when no more replies come: all are there, or the way there is cut."""
        querier.get(_direct(on_reply, at_end), payload=payload, attachment=attachment)
