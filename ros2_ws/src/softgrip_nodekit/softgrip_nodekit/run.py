# SPDX-License-Identifier: Apache-2.0
"""Start and stop of a node process: one way for all."""

from __future__ import annotations

import faulthandler
import gc
import os
import sys
import time
import traceback
from collections.abc import Callable, Sequence
from pathlib import Path

import rclpy
from rclpy.executors import Executor, ExternalShutdownException
from rclpy.lifecycle import TransitionCallbackReturn
from rclpy.node import Node
from rclpy.signals import SignalHandlerOptions

from softgrip_nodekit.callback_errors import CallbackErrors, callback_errors
from softgrip_nodekit.cell_time import CellFollower, await_cell, join_cell_time
from softgrip_nodekit.ending import Ending
from softgrip_nodekit.errors import FatalError, StartupError
from softgrip_nodekit.executor import destroy_node, end_context, make_executor
from softgrip_nodekit.guards import guard_parameter_services, serve_ping, settle_time
from softgrip_nodekit.node import CellNode, HardwareNode
from softgrip_nodekit.priority import REALTIME_PRIORITY, claim_processor, own_threads

#: Exit code of a process that could not start.
CANNOT_START = 2
#: [s] how long device files may take to appear at start, and between looks.
DEVICE_WAIT = 6.0
DEVICE_POLL = 0.02
#: [s] for the middleware to take leave of the others, on a busy computer too; launch kills after ten.
SHUTDOWN_TIMEOUT_S = 7.0
#: [s] that making hardware safe may take before stderr shows what it waits for.
CLOSING_S = 10.0
STDERR = 2
#: [s] for which a thread may keep Python to itself while others want it; Python's own is five times as long.
SWITCH_INTERVAL = 0.001
#: DDS says of what a key does not permit that it failed "for unknown reasons".
_SECURE_HINT = (
    "the cell is secure: what its keys do not permit can not be made. Compare them with the access policy by "
    "`ros2 run softgrip_security keys FOLDER --check`; `make keys` writes the rules again"
)
#: Marks an error that has been counted.
_COUNTED = "softgrip_is_counted"
#: Begin the names of values that are none of the node's parameters: what a publisher or subscription declares when it
#: is made, maybe later; what a launch file could hand on and was not given (cell.launch.yaml).
_NOT_PARAMETERS = ("qos_overrides.", "not_given_")


def run(factory: Callable[[], CellNode], args: Sequence[str] | None = None, *, threads: int = 1) -> int:
    """Run a node until it is told to stop, and leave cleanly.

    A node with a `realtime_parameter` gets its threads scheduled by it, and the log says whether the system allowed it.
    A lifecycle node whose parameter ``autostart`` is true is configured and activated first; where that fails the
    process ends with code 2, so that a launch file can bring the cell down; so it does over anything else that happens
    before the node runs, such as a key that the middleware refuses. The node's ``close()`` is called on every exit
    path.

    What a callback raises does not end the node: it is logged, counted and shown on /diagnostics (`callback_errors`).
    A callback that must end it raises FatalError. The node also answers ``~/ping`` (`softgrip_nodekit.health`), and
    refuses another ``use_sim_time`` while it runs. With the parameter ``lockstep`` the time of an emulated cell waits
    for its executor (`softgrip_nodekit.cell_time`).

    Args:
        factory: makes the node; raises StartupError when that cannot be done.
        args: command line; None = sys.argv.
        threads: of the executor; 1 = single-threaded.

    Returns:
        the process's exit code.
    """
    try:
        rclpy.init(args=list(args) if args is not None else None, signal_handler_options=SignalHandlerOptions.NO)
    except Exception as error:  # noqa: BLE001  rcl's words for arguments and parameter files, in several classes
        return _cannot_start(getattr(factory, "__name__", "node"), error)
    # A large message that one thread reads must not hold up a loop, or an emergency stop, of another.
    sys.setswitchinterval(SWITCH_INTERVAL)
    node: CellNode | None = None
    follower: CellFollower | None = None
    executor: Executor | None = None
    ending = Ending()
    code, is_started = 0, False
    try:
        ending.take_signals()
        node = factory()
        follower = join_cell_time(node)
        _refuse_unknown_parameters(node)
        settle_time(node)
        guard_parameter_services(node)
        serve_ping(node)
        _claim_processor(node)
        executor = make_executor(node, threads)
        executor.add_node(node)
        if isinstance(node, HardwareNode) and _autostart(node):
            _bring_up(node)
        # What the start made stays. A collection that walks through all of it stops the node for tens of milliseconds.
        gc.collect()
        gc.freeze()
        is_started = True
        _spin(executor, ending, callback_errors(node))
    except (KeyboardInterrupt, ExternalShutdownException):
        pass
    except StartupError as error:
        code = _cannot_start(_name_of(node, factory), error)
    except FatalError as error:
        code = 1
        print(f"[{node.get_name() if node else ''}] ends: {error}", file=sys.stderr, flush=True)  # noqa: T201  as above
    except Exception as error:
        if is_started:
            raise
        traceback.print_exc()
        code = _cannot_start(_name_of(node, factory), error)
    finally:
        ending.leave()
        if follower is not None:
            follower.leave()
        _leave(node, executor)
    return code


def _spin(executor: Executor, ending: Ending, errors: CallbackErrors) -> None:
    """Run callbacks until the node's end; executors let out what a callback raised, and can be run again."""
    while True:
        try:
            ending.spin(executor)
        except (ExternalShutdownException, FatalError, StartupError):
            raise
        except Exception as error:  # noqa: BLE001  no message from outside may end a node
            if ending.is_asked or not rclpy.ok():
                return
            if not _is_known(error):
                errors.report(error)
        else:
            return


def _is_known(error: Exception) -> bool:
    """Whether this very error was here before: rclpy's executor of several threads may let one out twice."""
    marks = vars(error)  # not setattr, which a class of errors may forbid
    known = _COUNTED in marks
    marks[_COUNTED] = True
    return known


def _name_of(node: Node | None, factory: Callable[[], Node]) -> str:
    return str(node.get_name()) if node is not None else getattr(factory, "__name__", "node")


def _cannot_start(name: str, error: Exception) -> int:
    print(f"[{name}] cannot start: {error}", file=sys.stderr, flush=True)  # noqa: T201  the log may be down
    if os.environ.get("ROS_SECURITY_ENABLE") == "true" and not isinstance(error, StartupError):
        print(f"[{name}] {_SECURE_HINT}", file=sys.stderr, flush=True)  # noqa: T201
    return CANNOT_START


def _refuse_unknown_parameters(node: CellNode) -> None:
    """Refuse values for parameters that the node does not have: ROS 2 passes over a misspelt one in silence."""
    given = node._parameter_overrides  # noqa: SLF001  rclpy has no public way to ask
    unknown = [
        name
        for name in given
        if not node.has_parameter(name) and not name.startswith(_NOT_PARAMETERS) and name not in node.former_parameters
    ]
    if unknown:
        known = ", ".join(sorted(node.list_parameters([], 0).names))
        raise StartupError(f"unknown parameter {', '.join(map(repr, unknown))}; {node.get_name()} has {known}")


def _claim_processor(node: Node) -> None:
    if node.has_parameter(REALTIME_PRIORITY):
        node.get_logger().info(claim_processor(int(node.get_parameter(REALTIME_PRIORITY).value), own_threads()))


def _autostart(node: Node) -> bool:
    return node.has_parameter("autostart") and bool(node.get_parameter("autostart").value)


def _bring_up(node: HardwareNode) -> None:
    await_cell(node)
    _await_devices([Path(path) for path in node.device_paths])
    for transition in (node.trigger_configure, node.trigger_activate):
        result = transition()
        if result != TransitionCallbackReturn.SUCCESS:
            reason = node.startup_problem or "see the log above"
            raise StartupError(f"{transition.__name__.removeprefix('trigger_')} failed: {reason}")


def _await_devices(paths: Sequence[Path]) -> None:
    """Wait for device files; what is still missing afterwards is for ``configure`` to name."""
    deadline = time.monotonic() + DEVICE_WAIT
    while time.monotonic() < deadline and not all(path.exists() for path in paths):
        time.sleep(DEVICE_POLL)


def _leave(node: CellNode | None, executor: Executor | None) -> None:
    faulthandler.dump_traceback_later(CLOSING_S, file=STDERR)
    try:
        if node is not None:
            node.close()
    finally:
        if executor is not None:
            executor.shutdown(timeout_sec=2.0)
        # All is safe and written. A middleware that does not let go, with Python's lock in its hands, would hold up the
        # whole cell: this ends the process all the same (code 1), with what it was waiting for on stderr.
        faulthandler.dump_traceback_later(SHUTDOWN_TIMEOUT_S, exit=True, file=STDERR)
        if node is not None:
            destroy_node(node)
        end_context()
        # What Python keeps until the process has ended the middleware keeps as well (`destroy_node` says what follows).
        gc.unfreeze()
        faulthandler.cancel_dump_traceback_later()
