# SPDX-License-Identifier: Apache-2.0
"""Parameters of nodes in a bag: every node is asked once, and the files that parameters name come along.

Files are read on a thread of its own: a file may be slow, and a recording must not wait. Secrets stay out of what nodes
answer, and of /parameter_events, where each publishes what its parameters are set to.
"""

from __future__ import annotations

import re
import threading
import time
from collections.abc import Callable, Sequence
from pathlib import Path
from queue import Empty, SimpleQueue
from typing import TYPE_CHECKING, Any

from rcl_interfaces.msg import Parameter, ParameterEvent
from rcl_interfaces.srv import GetParameters, ListParameters
from rclpy.node import Node
from rclpy.parameter import parameter_value_to_python
from rclpy.serialization import deserialize_message, serialize_message

from softgrip_bag.cell_namespace import is_below
from softgrip_bag.context import FILE_PARAMETERS, parameter_attachment, parameter_files
from softgrip_bag.errors import BagError
from softgrip_bag.mcap_file import Attachment
from softgrip_bag.redaction import redact, redact_value

if TYPE_CHECKING:
    from rclpy.client import Client
    from rclpy.task import Future

    _ListClient = Client[ListParameters.Request, ListParameters.Response]
    _GetClient = Client[GetParameters.Request, GetParameters.Response]

PARAMETER_EVENT = "rcl_interfaces/msg/ParameterEvent"
#: [s] a node that has not answered until then is asked again.
ANSWER_TIMEOUT_S = 5.0
#: [s] between two tries to read a file that is not there.
RETRY_S = 0.5
#: As many refusals are kept: they come from anybody.
MAX_REFUSED = 100
#: A fully qualified name, as ROS 2 allows it (design.ros2.org, "Topic and Service name mapping").
_NAME = re.compile(r"(/[A-Za-z_][A-Za-z0-9_]*)+")


class FileReader:
    """Reads files one after the other.

    Args:
        roots: folders that files may be below, or files that they may be.
        found: called with each file, on the reader's thread.
    """

    def __init__(self, roots: Sequence[Path], found: Callable[[Attachment], None]) -> None:
        self._roots = roots
        self._found = found
        self._asked: SimpleQueue[tuple[str, str, str] | None] = SimpleQueue()
        self._results: SimpleQueue[tuple[tuple[str, str, str], str, bool]] = SimpleQueue()
        self._pending: set[tuple[str, str, str]] = set()
        # a daemon: a file system that never answers must not keep the process from ending
        self._thread = threading.Thread(target=self._run, name="file reader", daemon=True)
        self._thread.start()

    def request(self, node: str, parameter: str, path: str) -> None:
        """Read a file or a folder's YAML files in the thread; one that is asked for already is not asked for twice."""
        if (node, parameter, path) not in self._pending:
            self._pending.add((node, parameter, path))
            self._asked.put((node, parameter, path))

    def results(self) -> list[tuple[tuple[str, str, str], str, bool]]:
        """Return what has been done since: (node, parameter, path), what is wrong or empty, whether to try again."""
        done = []
        while True:
            try:
                done.append(self._results.get_nowait())
            except Empty:
                break
            self._pending.discard(done[-1][0])
        return done

    def close(self) -> None:
        """End the thread after what it reads now."""
        self._asked.put(None)

    def _run(self) -> None:
        while (asked := self._asked.get()) is not None:
            node, parameter, path = asked
            problem, is_temporary = "", False
            try:
                for file in parameter_files(self._roots, node, parameter, Path(path)):
                    self._found(file)
            except OSError as error:
                problem, is_temporary = error.strerror or str(error), True
            except BagError as error:
                problem = str(error)
            except Exception as error:  # noqa: BLE001  whatever a file causes is reported and the next one is read
                problem = repr(error)
            self._results.put((asked, problem, is_temporary))


class ParameterSnapshot:
    """Call `ask_nodes` now and then: every node that has appeared is asked once.

    Args:
        node: whose clients are used.
        found: called with each attachment: a node's parameters, or a file that they name (on a thread of its own).
        roots: folders that these files may be below, or files that they may be.
    """

    def __init__(self, node: Node, found: Callable[[Attachment], None], roots: Sequence[Path]) -> None:
        self._node = node
        self._found = found
        self._files = FileReader(roots, found)
        self._asked: dict[str, float] = {}
        self._answered: set[str] = set()
        self._clients: dict[str, tuple[_ListClient, _GetClient]] = {}
        self._missing: dict[tuple[str, str, str], str] = {}
        self._refused: dict[str, str] = {}
        self._tried = 0.0

    @property
    def nodes(self) -> int:
        """How many nodes have answered."""
        return len(self._answered)

    @property
    def missing(self) -> list[str]:
        """Files that parameters name and that could not be read so far."""
        return [f"{node}: {parameter} = {path}: {why}" for (node, parameter, path), why in self._missing.items()]

    @property
    def refused(self) -> list[str]:
        """What is not carried and why; what was taken out of parameters."""
        return list(self._refused.values())

    def close(self) -> None:
        """End the thread that reads files."""
        self._files.close()

    def ask_nodes(self) -> None:
        """Ask nodes that have not answered; try again to read files that were not there."""
        for name, namespace in self._node.get_node_names_and_namespaces():
            full = f"{namespace.rstrip('/')}/{name}"
            if full in self._answered or full in self._refused or full == self._node.get_fully_qualified_name():
                continue
            if not is_below(full, self._node.get_namespace()):
                continue  # another cell's
            if name.startswith("_"):
                continue  # a tool's, here for a moment; in a secure cell nobody may ask it
            if _NAME.fullmatch(full):
                self._ask(full)
            else:
                self._refuse(full, f"expected a node's name, found {full!r:.100}; its parameters are not carried")
        self._look_at_files()

    def add_own(self, values: dict[str, object]) -> None:
        """Take this node's own parameters."""
        self._take(self._node.get_fully_qualified_name(), values)

    def _ask(self, full: str) -> None:
        now = time.monotonic()
        if now - self._asked.get(full, float("-inf")) < ANSWER_TIMEOUT_S:
            return
        if full not in self._clients and not self._make_clients(full):
            self._asked[full] = now
            return
        names, _ = self._clients[full]
        if names.service_is_ready():
            self._asked[full] = now
            names.call_async(ListParameters.Request()).add_done_callback(lambda done: self._on_names(full, done))

    def _make_clients(self, full: str) -> bool:
        """Make the clients of a node; DDS Security refuses those that access.yaml does not grant."""
        made = []
        try:
            for service, name in ((ListParameters, "list_parameters"), (GetParameters, "get_parameters")):
                made.append(self._node.create_client(service, f"{full}/{name}"))
        except RuntimeError as error:
            for client in made:
                self._node.destroy_client(client)
            self._refuse(full, f"{full}: its parameters are not carried, they may not be asked: {error}")
            return False
        self._clients[full] = (made[0], made[1])
        return True

    def _on_names(self, full: str, done: Future[ListParameters.Response]) -> None:
        if done.exception() is not None or full not in self._clients:
            return
        names = list(done.result().result.names)
        future = self._clients[full][1].call_async(GetParameters.Request(names=names))
        future.add_done_callback(lambda answer: self._on_values(full, names, answer))

    def _on_values(self, full: str, names: list[str], done: Future[GetParameters.Response]) -> None:
        if done.exception() is not None or full in self._answered:
            return
        values = [parameter_value_to_python(value) for value in done.result().values]
        self._take(full, dict(zip(names, values, strict=False)))
        for client in self._clients.pop(full, ()):
            self._node.destroy_client(client)

    def _take(self, full: str, values: dict[str, Any]) -> None:
        self._answered.add(full)
        plain = {name: list(v) if hasattr(v, "typecode") else v for name, v in values.items() if v is not None}
        clean, hidden = redact(plain)
        if hidden:
            self._refuse(
                f"{full} secrets", f"{full}: {', '.join(hidden)}: secrets taken out; keep them out of parameters"
            )
        try:
            self._found(parameter_attachment(full, clean))
        except BagError as error:
            self._refuse(full, f"{full}: {error}")
        for parameter in FILE_PARAMETERS & plain.keys():
            if plain[parameter]:
                self._files.request(full, parameter, str(plain[parameter]))

    def _look_at_files(self) -> None:
        for asked, problem, is_temporary in self._files.results():
            self._missing.pop(asked, None)
            if problem and is_temporary:
                self._missing[asked] = problem
            elif problem:
                node, parameter, _ = asked
                self._refuse(f"{node} {parameter}", f"{node}: {parameter}: {problem}")
        now = time.monotonic()
        if now - self._tried >= RETRY_S:
            self._tried = now
            for node, parameter, path in self._missing:
                self._files.request(node, parameter, path)

    def _refuse(self, key: str, why: str) -> None:
        if key not in self._refused and len(self._refused) < MAX_REFUSED:
            self._refused[key] = why
            self._node.get_logger().warning(why)


def without_secrets(data: bytes) -> bytes:
    """Return the event with secrets taken out; the same bytes when there are none.

    Bytes that are not such a message go into the bag as they are: nobody can read a secret from them as a parameter.
    """
    try:
        event = deserialize_message(data, ParameterEvent)
    except Exception:  # noqa: BLE001  each middleware has its own for bytes that are no such message
        return data
    parameters = (*event.new_parameters, *event.changed_parameters)
    hidden = [_redact(parameter) for parameter in parameters]
    return bytes(serialize_message(event)) if any(hidden) else data


def _redact(parameter: Parameter) -> bool:
    value = parameter.value
    text = redact_value(parameter.name, value.string_value)
    texts = redact_value(parameter.name, list(value.string_array_value))
    is_secret = text != value.string_value or texts != list(value.string_array_value)
    value.string_value, value.string_array_value = text, texts
    return bool(is_secret)
