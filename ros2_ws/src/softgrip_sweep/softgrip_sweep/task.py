# SPDX-License-Identifier: Apache-2.0
"""One piece of a sweep: a function's name and its arguments, so that any process can do it and anybody can read it."""

from __future__ import annotations

import hashlib
import importlib
import json
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any

_KEY_DIGITS = 16


@dataclass(frozen=True)
class SweepTask:
    """What one worker does in one go, a few seconds to a minute.

    Attributes:
        function: ``module:name`` of a function of plain values that returns plain values (JSON), and depends on nothing
            but its arguments and the files that they name.
        arguments: by name, plain values.
    """

    function: str
    arguments: Mapping[str, Any]

    @property
    def key(self) -> str:
        """Return a name for the result: the same for the same function and arguments, in every process."""
        text = json.dumps([self.function, self.arguments], sort_keys=True)
        return hashlib.sha256(text.encode()).hexdigest()[:_KEY_DIGITS]

    def __str__(self) -> str:
        given = ", ".join(f"{name}={value}" for name, value in self.arguments.items())
        return f"{self.function.rpartition(':')[2]}({given})"


def run_task(function: str, arguments: Mapping[str, Any]) -> Any:
    """Do a task in this process; returns its result as it comes back from JSON, so that stored and fresh are alike."""
    module, _, name = function.partition(":")
    work: Callable[..., Any] = getattr(importlib.import_module(module), name)
    return json.loads(json.dumps(work(**arguments)))
