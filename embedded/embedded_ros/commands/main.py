# SPDX-License-Identifier: Apache-2.0
"""``ros2``: picks the command and imports only that."""

from __future__ import annotations

import importlib
import signal
import sys

COMMANDS = {
    "action": "Send goals, list actions",
    "bag": "Record, inspect and play bags",
    "interface": "Show message, service and action definitions",
    "launch": "Run a YAML launch file",
    "lifecycle": "Get and set the state of lifecycle nodes",
    "node": "List nodes, show what a node has",
    "param": "List, get, set, describe and dump parameters",
    "pkg": "List packages, where they are, what they can run",
    "run": "Run an executable of a package",
    "service": "List, call, describe services",
    "topic": "List, echo, publish, measure topics",
}


def usage() -> str:
    """Return the overview."""
    lines = ["usage: ros2 <command> ...", "", "ros2 of embedded/: the same commands as ROS 2's, over Zenoh.", ""]
    lines += [f"  {name:<10} {text}" for name, text in COMMANDS.items()]
    return "\n".join([*lines, "", "Call `ros2 <command> -h` for more detailed usage.", ""])


def main(argv: list[str] | None = None) -> int:
    """Run a command; return its exit code. What a command returns as text is its error, as in ros2cli."""
    argv = sys.argv[1:] if argv is None else argv
    if not argv or argv[0] in {"-h", "--help"}:
        print(usage())
        return 0
    if argv[0] not in COMMANDS:
        print(usage(), file=sys.stderr)
        print(f"ros2: error: unknown command '{argv[0]}' (choose from {', '.join(COMMANDS)})", file=sys.stderr)
        return 2
    from embedded_ros.errors import EmbeddedError  # noqa: PLC0415  the overview is shown without it

    module = importlib.import_module(f"embedded_ros.commands.{argv[0]}")
    try:
        outcome = module.run(argv[1:])
    except KeyboardInterrupt:
        return signal.SIGINT
    except BrokenPipeError:
        return 0
    except EmbeddedError as error:
        outcome = f"ros2 {argv[0]}: {error}"
    if isinstance(outcome, str):
        print(outcome, file=sys.stderr)
        return 1
    return int(outcome or 0)


if __name__ == "__main__":
    sys.exit(main())
