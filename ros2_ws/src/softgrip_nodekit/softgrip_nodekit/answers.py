# SPDX-License-Identifier: Apache-2.0
"""Answers of services that say whether, and why not: those with ``success`` and ``message``."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, TypeVar

Response = TypeVar("Response", bound=Any)


def answer(response: Response, act: Callable[[], str], *refusals: type[Exception]) -> Response:
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
