# SPDX-License-Identifier: Apache-2.0
"""Who is there: the entities whose liveliness tokens are up, kept by each context."""

from __future__ import annotations

import logging
import threading
import time
from typing import TYPE_CHECKING

import zenoh

from embedded_ros import wire
from embedded_ros.throttle import Throttle
from embedded_ros.wire import Entity, EntityKind

if TYPE_CHECKING:
    from collections.abc import Callable, Iterable

_LOG = logging.getLogger(__name__)
_QUERY_TIMEOUT_S = 5.0
#: A cell has some hundreds. Whoever announces more than this costs no more memory.
_MAX_ENTITIES = 20_000


class Graph:
    """The entities of a domain. Changes arrive on Zenoh's thread; readers take a snapshot."""

    def __init__(self) -> None:
        #: counts changes: who has looked at one version need not look again
        self.version = 0
        self._entities: dict[str, Entity] = {}
        self._by_kind: dict[EntityKind, dict[str, Entity]] = {kind: {} for kind in EntityKind}
        self._by_name: dict[str, dict[str, Entity]] = {}
        self._by_gid: dict[bytes, Entity] = {}
        self._lock = threading.RLock()
        self._changed = threading.Condition(self._lock)
        self._listeners: list[Callable[[Entity, bool], None]] = []
        self._subscriber: object = None
        self._throttle = Throttle()

    def watch(self, session: zenoh.Session, domain: int) -> None:
        """Fill from the tokens that are up, then follow changes."""
        prefix = wire.liveliness_prefix(domain)
        handler = zenoh.handlers.Callback(self._on_token, indirect=False)
        self._subscriber = session.liveliness().declare_subscriber(prefix, handler, history=True)
        # The default channel has room for 256 replies, and tokens that the session knows already are put into it
        # before anybody can take one out (zenoh 1.10.2): a larger cell would stand still here for ever.
        replies: list[zenoh.Reply] = []
        done = threading.Event()
        collect = zenoh.handlers.Callback(replies.append, done.set, indirect=False)
        session.liveliness().get(prefix, collect, timeout=_QUERY_TIMEOUT_S)
        done.wait(2.0 * _QUERY_TIMEOUT_S)
        for reply in replies:
            if reply.ok is not None:
                self.add(str(reply.ok.key_expr))

    def _on_token(self, sample: zenoh.Sample) -> None:
        key = str(sample.key_expr)
        if sample.kind == zenoh.SampleKind.PUT:
            self.add(key)
        else:
            self.remove(key)

    def add(self, token: str) -> None:
        """Take a token in; one that is no ROS 2 token is ignored."""
        try:
            entity = wire.decode_token(token)
        except ValueError as error:
            _LOG.debug("ignored liveliness token: %s", error)
            return
        with self._lock:
            if token in self._entities:
                return
            if len(self._entities) >= _MAX_ENTITIES:
                if self._throttle.admit("full") is not None:
                    _LOG.error("more than %d nodes and endpoints: ignored %s", _MAX_ENTITIES, token)
                return
            self._entities[token] = entity
            self._by_kind[entity.kind][token] = entity
            self._by_name.setdefault(entity.name, {})[token] = entity
            self._by_gid[wire.gid_of(token)] = entity
            self.version += 1
            self._changed.notify_all()
            listeners = list(self._listeners)
        self._tell(listeners, entity, appeared=True)

    def remove(self, token: str) -> None:
        """Drop a token that is gone."""
        with self._lock:
            entity = self._entities.pop(token, None)
            if entity is None:
                return
            del self._by_kind[entity.kind][token]
            named = self._by_name[entity.name]
            del named[token]
            if not named:
                del self._by_name[entity.name]
            self._by_gid.pop(wire.gid_of(token), None)
            self.version += 1
            self._changed.notify_all()
            listeners = list(self._listeners)
        self._tell(listeners, entity, appeared=False)

    def _tell(self, listeners: list[Callable[[Entity, bool], None]], entity: Entity, *, appeared: bool) -> None:
        for listener in listeners:
            try:
                listener(entity, appeared)
            except Exception:  # noqa: BLE001  a listener of someone else must not stop the others
                if self._throttle.admit("listener") is not None:
                    _LOG.exception("a listener failed over %s", entity)

    def listen(self, listener: Callable[[Entity, bool], None]) -> None:
        """Call ``listener(entity, appeared)`` on each change, on the thread that brought it."""
        with self._lock:
            self._listeners.append(listener)

    def unlisten(self, listener: Callable[[Entity, bool], None]) -> None:
        """Stop calling a listener."""
        with self._lock:
            if listener in self._listeners:
                self._listeners.remove(listener)

    def wait(self, condition: Callable[[], bool], timeout_s: float | None) -> bool:
        """Wait until a condition on the graph holds; return whether it does."""
        with self._changed:
            return self._changed.wait_for(condition, timeout_s)

    def settle(self, quiet_s: float, limit_s: float = 3.0) -> None:
        """Wait until nothing changes for a while: a fresh session meets its peers one after the other."""
        end = time.monotonic() + limit_s
        with self._changed:
            while time.monotonic() < end and self._changed.wait(quiet_s):
                pass

    def snapshot(self, *kinds: EntityKind) -> list[Entity]:
        """Return the entities of the given kinds, or all."""
        with self._lock:
            return [entity for kind in kinds or EntityKind for entity in self._by_kind[kind].values()]

    def endpoints(self, name: str, *kinds: EntityKind) -> list[Entity]:
        """Return the endpoints on a fully qualified name."""
        with self._lock:
            return [entity for entity in self._by_name.get(name, {}).values() if entity.kind in kinds]

    def by_gid(self, gid: bytes) -> Entity | None:
        """Return the endpoint with this gid, when its token has been seen."""
        return self._by_gid.get(gid)


def names_and_types(entities: Iterable[Entity]) -> list[tuple[str, list[str]]]:
    """Return sorted (name, sorted types) of endpoints."""
    found: dict[str, set[str]] = {}
    for entity in entities:
        found.setdefault(entity.name, set()).add(entity.ros_type)
    return [(name, sorted(types)) for name, types in sorted(found.items())]


def incompatible_policy(offered: wire.WireQos, requested: wire.WireQos) -> str | None:
    """Return the first policy for which DDS would not match a publisher with a subscription (OMG DDS 1.4, 2.2.3)."""
    if offered.durability == 2 and requested.durability == 1:
        return "DURABILITY_QOS_POLICY"
    if offered.deadline_ns > requested.deadline_ns:
        return "DEADLINE_QOS_POLICY"
    if offered.liveliness == 1 and requested.liveliness == 3:
        return "LIVELINESS_QOS_POLICY"
    if offered.lease_ns > requested.lease_ns:
        return "LIVELINESS_QOS_POLICY"
    if offered.reliability == 2 and requested.reliability == 1:
        return "RELIABILITY_QOS_POLICY"
    return None
