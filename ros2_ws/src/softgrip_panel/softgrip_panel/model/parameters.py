# SPDX-License-Identifier: Apache-2.0
"""Parameters of the cell's nodes: value, meaning, bounds; and what a person types, as a value."""

from __future__ import annotations

import math
from collections.abc import Awaitable
from dataclasses import dataclass
from enum import IntEnum
from typing import Any, Final, Protocol

import yaml

from softgrip_panel.errors import PanelError
from softgrip_panel.texts import say

#: What is typed is no longer.
MAX_CHARS: Final = 2000


class ParameterKind(IntEnum):
    """Type of a value, numbered as in rcl_interfaces/msg/ParameterType."""

    NOT_SET = 0
    BOOL = 1
    INTEGER = 2
    DOUBLE = 3
    STRING = 4
    BYTES = 5
    BOOLS = 6
    INTEGERS = 7
    DOUBLES = 8
    STRINGS = 9

    @property
    def field(self) -> str:
        """Field of rcl_interfaces/msg/ParameterValue that holds it."""
        if self <= ParameterKind.STRING:
            return f"{self.name.lower()}_value"
        return {5: "byte_array_value"}.get(int(self), f"{self.name[:-1].lower()}_array_value")


@dataclass(frozen=True)
class ParameterView:
    """One parameter.

    Attributes:
        name, kind, value: as the node says.
        description: with the unit in brackets at its end.
        minimum, maximum: of a number, or of every element; infinite where there is none.
        constraint: what else is asked of it, in words.
        is_changeable: whether it may be set while the node runs; else in its file, and the node is started again.
    """

    name: str
    kind: ParameterKind
    value: object
    description: str = ""
    minimum: float = -math.inf
    maximum: float = math.inf
    constraint: str = ""
    is_changeable: bool = False

    @property
    def bounds(self) -> str:
        """What it may be, in words; empty = anything of its type."""
        low, high = ("" if math.isinf(one) else f"{one:g}" for one in (self.minimum, self.maximum))
        number = f"{low} .. {high}".strip() if low or high else ""
        return ", ".join(filter(None, (number, self.constraint)))

    @property
    def text(self) -> str:
        """The value as a person types it."""
        if self.kind is ParameterKind.STRING:
            return str(self.value)
        return yaml.safe_dump(self.value, default_flow_style=True, width=10_000).removesuffix("...\n").strip()

    def read(self, text: str) -> object:
        """Return what was typed as a value.

        Raises:
            PanelError: it is of another type, or out of bounds; the node checks it again.
        """
        if len(text) > MAX_CHARS:
            raise PanelError(say("error.parameter_long", name=self.name, limit=MAX_CHARS, found=len(text)))
        if self.kind is ParameterKind.STRING:
            return text
        try:
            typed = yaml.safe_load(text)
        except (yaml.YAMLError, ValueError) as error:
            raise PanelError(
                say("error.parameter", name=self.name, expected=self._expected(), found=text[:60])
            ) from error
        if self.kind >= ParameterKind.BOOLS:
            if not isinstance(typed, list) or not typed:
                raise PanelError(say("error.parameter_list", name=self.name, such=self.text, found=text[:60]))
            return [self._element(one) for one in typed]
        return self._element(typed)

    def _element(self, typed: Any) -> Any:
        kind = self.kind if self.kind < ParameterKind.BOOLS else ParameterKind(self.kind - 5)
        if kind is ParameterKind.DOUBLE and type(typed) is int:
            typed = float(typed)
        types: dict[int, Any] = {1: bool, 2: int, 3: float, 4: str}
        if type(typed) is not types.get(int(kind)):
            raise PanelError(say("error.parameter", name=self.name, expected=self._expected(), found=str(typed)[:60]))
        is_number = kind in {ParameterKind.INTEGER, ParameterKind.DOUBLE}
        if is_number and not self.minimum <= typed <= self.maximum:
            raise PanelError(say("error.parameter_bounds", name=self.name, bounds=self.bounds, found=typed))
        return typed

    def _expected(self) -> str:
        kind = self.kind.name.lower()
        return f"{kind} {self.bounds}".strip()


class ParameterReader(Protocol):
    """The way to the parameters of other nodes."""

    def nodes(self) -> tuple[str, ...]:
        """Names of the cell's nodes that have parameters."""
        ...

    def read(self, node: str) -> Awaitable[tuple[ParameterView, ...]]:
        """Return all parameters of a node.

        Raises:
            PanelError: it does not answer.
        """
        ...
