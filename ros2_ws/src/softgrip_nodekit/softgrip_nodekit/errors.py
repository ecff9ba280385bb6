# SPDX-License-Identifier: Apache-2.0
"""What keeps a node from starting, what ends one that runs, and what refuses a request: errors and their words."""

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import Protocol, TypeVar


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


class SuccessResponse(Protocol):
    """A response that says whether it was done, and in words what came of it."""

    success: bool
    message: str


SuccessResponseT = TypeVar("SuccessResponseT", bound=SuccessResponse)


def answer(response: SuccessResponseT, act: Callable[[], str], *refusals: type[Exception]) -> SuccessResponseT:
    """Act, and fill in what came of it.

    Args:
        response: gets ``success`` and ``message``.
        act: returns the message.
        refusals: errors whose text is the message of a refusal; any other goes on.
    """
    try:
        response.message, response.success = act(), True
    except refusals as error:
        response.message, response.success = str(error), False
    return response
