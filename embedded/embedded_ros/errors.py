# SPDX-License-Identifier: Apache-2.0
"""The errors of the engine; each message says what was expected, what was found and what to do."""


class EmbeddedError(Exception):
    """Base of everything the engine raises on purpose."""


class InterfaceError(EmbeddedError):
    """An interface definition that cannot be read; names file and line."""


class UnknownInterfaceError(EmbeddedError, ImportError):
    """A message, service or action that neither the workspace nor the shipped set defines."""


class WorkspaceError(EmbeddedError):
    """A package, executable or file that the workspace does not have."""


class ArgumentsError(EmbeddedError):
    """A ``--ros-args`` argument or parameter file that is wrong; names argument or file and key."""


class UnknownArgumentsError(ArgumentsError):
    """``--ros-args`` holds arguments that nobody knows."""


class WireError(EmbeddedError):
    """The network cannot be used: port taken by something else, bad configuration."""


class LaunchError(EmbeddedError):
    """A launch file that cannot be run; names file and line."""


class CdrError(EmbeddedError, ValueError):
    """Received bytes that are no message of the expected type."""


class RequestRefusedError(EmbeddedError):
    """A server answered a request with an error: too many are waiting, it is malformed, or its callback failed."""


def needs_ros2(feature: str) -> NotImplementedError:
    """Return the refusal of a feature outside the scope of the stand-in."""
    return NotImplementedError(f"{feature} is not part of embedded/; it needs ROS 2 (source a Jazzy installation)")
