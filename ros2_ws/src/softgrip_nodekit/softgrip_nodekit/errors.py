# SPDX-License-Identifier: Apache-2.0
"""What keeps a node from starting, and what ends one that runs."""

from collections.abc import Iterator
from contextlib import contextmanager


class StartupError(Exception):
    """A node cannot start; the message says what was expected, what was found and what to do."""


class FatalError(Exception):
    """A node cannot go on: raised by a callback, it ends the process with exit code 1 (`run`); any other does not."""


@contextmanager
def startup_errors(*kinds: type[Exception]) -> Iterator[None]:
    """Turn errors of these kinds, which say what was expected, into `StartupError`; also a decorator."""
    try:
        yield
    except kinds as error:
        raise StartupError(str(error)) from error
