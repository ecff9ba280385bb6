# SPDX-License-Identifier: Apache-2.0
"""A context: one set of arguments, one domain, one Zenoh session, shared by its nodes."""

from __future__ import annotations

import contextlib
import itertools
import os
import sys
import threading
import weakref
from typing import TYPE_CHECKING, Any, Self

from rclpy._rclpy_pybind11 import RCLError, RCLInvalidROSArgsError, UnknownROSArgsError
from rclpy.impl import rcutils_logger

from embedded_ros import arguments, network
from embedded_ros.errors import ArgumentsError, UnknownArgumentsError, WireError
from embedded_ros.graph import Graph

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator, Sequence

    import zenoh

_MAX_DOMAIN = 232


def domain_from_environment() -> int:
    """Return ROS_DOMAIN_ID, 0 when it is not set."""
    text = os.environ.get("ROS_DOMAIN_ID", "") or "0"
    if not text.isdigit() or int(text) > _MAX_DOMAIN:
        raise RCLError(f"ROS_DOMAIN_ID: expected a number 0..{_MAX_DOMAIN}, found {text!r}")
    return int(text)


def parse_arguments(argv: list[str]) -> arguments.Arguments:
    """Read ROS arguments.

    Raises:
        RCLInvalidROSArgsError, UnknownROSArgsError: an argument or parameter file is wrong.
    """
    for item in argv:
        item.encode()
    try:
        return arguments.parse(argv)
    except UnknownArgumentsError as error:
        raise UnknownROSArgsError(f"Found unknown ROS arguments: {error}") from error
    except ArgumentsError as error:
        raise RCLInvalidROSArgsError(f"Failed to parse ROS arguments: {error}") from error


class Context:
    """Made by ``rclpy.init``; several may be used at once."""

    def __init__(self) -> None:
        self._lock = threading.RLock()
        self._callbacks: list[Any] = []
        self._initialized = False
        self._ok = False
        self._domain = 0
        self._arguments = arguments.Arguments()
        self._link: tuple[zenoh.Session, network.RouterKeeper | None] | None = None
        self._graph = Graph()
        self._ids = itertools.count()
        self._wakers: weakref.WeakSet[Any] = weakref.WeakSet()
        self._events: set[threading.Event] = set()
        self._hosts_router = True

    @property
    def handle(self) -> Context | None:
        """Itself once initialized; there is no C handle here."""
        return self if self._initialized else None

    def init(
        self,
        args: Sequence[str] | None = None,
        *,
        initialize_logging: bool = True,
        domain_id: int | None = None,
    ) -> None:
        """Read the arguments and take the domain. The session is opened by the first node.

        Raises:
            RCLInvalidROSArgsError: a ROS argument or parameter file is wrong.
        """
        with self._lock:
            if domain_id is not None and domain_id < 0:
                raise RuntimeError(f"Domain id ({domain_id}) should not be lower than zero.")
            if self._initialized:
                raise RuntimeError("Context.init() must only be called once")
            self._arguments = parse_arguments(list(args if args is not None else sys.argv))
            self._domain = domain_from_environment() if domain_id is None else domain_id
            self._initialized = self._ok = True
            if initialize_logging:
                for name, level in self._arguments.log_levels.items():
                    rcutils_logger.set_level(name, level)

    def _session(self) -> zenoh.Session:
        """Return the session, opening it when this is the first use."""
        with self._lock:
            if self._link is None:
                if not self._ok:
                    raise RCLError("the context is not initialized, or was shut down")
                try:
                    self._link = network.open_session(self._domain, host=self._hosts_router)
                except WireError as error:
                    raise RCLError(str(error)) from error
                self._graph.watch(self._link[0], self._domain)
            return self._link[0]

    def ok(self) -> bool:
        """Whether it is initialized and not shut down."""
        return self._ok

    def get_domain_id(self) -> int:
        """Return the domain."""
        if not self._initialized:
            raise RuntimeError("Context must be initialized before it can have a domain id")
        return self._domain

    def on_shutdown(self, callback: Callable[[], None]) -> None:
        """Call a function or method when this context is shut down."""
        if not callable(callback):
            raise TypeError(f"callback should be a callable, got {type(callback)}")
        if hasattr(callback, "__self__"):
            self._callbacks.append(weakref.WeakMethod(callback))
        else:
            self._callbacks.append(lambda: callback)

    def _shutdown_by_signal(self, _name: str) -> None:
        """Mark as shut down and wake whoever waits; the session stays for ``shutdown`` to close."""
        if self._ok:
            self._mark_down()

    def _mark_down(self) -> None:
        self._ok = False
        callbacks, self._callbacks = self._callbacks, []
        for make in callbacks:
            callback = make()
            if callback is not None:
                callback()
        for waker in list(self._wakers):
            waker.wake()
        for event in list(self._events):
            event.set()

    @contextlib.contextmanager
    def _waking(self, event: threading.Event) -> Iterator[None]:
        """Set an event when the context is shut down."""
        self._events.add(event)
        try:
            yield
        finally:
            self._events.discard(event)

    def shutdown(self) -> None:
        """Shut down: nodes of this context can no longer communicate."""
        if not self._initialized:
            raise RuntimeError("Context must be initialized before it can be shutdown")
        if not self._ok and self._link is None:
            raise RCLError("failed to shutdown: rcl_shutdown already called on the given context")
        self.try_shutdown()

    def try_shutdown(self) -> None:
        """Shut down unless that has happened."""
        if self._ok:
            self._mark_down()
        self._close()

    def _close(self) -> None:
        with self._lock:
            link, self._link = self._link, None
        if link is not None:
            session, keeper = link
            session.close()  # type: ignore[no-untyped-call]  # zenoh's stub
            if keeper is not None:
                keeper.close()

    def destroy(self) -> None:
        """Give everything back."""
        self.try_shutdown()

    def __enter__(self) -> Self:
        if not self._initialized:
            self.init()
        return self

    def __exit__(self, *_: object) -> None:
        self.try_shutdown()
