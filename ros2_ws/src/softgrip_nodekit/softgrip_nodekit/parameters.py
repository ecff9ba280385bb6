# SPDX-License-Identifier: Apache-2.0
"""A node's parameters as one table: default, unit, bounds, description; validated before they are applied."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

from rcl_interfaces.msg import FloatingPointRange, IntegerRange, ParameterDescriptor, SetParametersResult
from rclpy.exceptions import InvalidParameterTypeException
from rclpy.node import Node

from softgrip_nodekit.errors import StartupError
from softgrip_nodekit.node import CellNode

if TYPE_CHECKING:
    from rclpy.parameter import Parameter as RosParameter


@dataclass(frozen=True)
class Parameter:
    """One row of the table.

    Attributes:
        name: ROS name; carries the unit where it could be mistaken, e.g. ``tension_limit_n``.
        default: its type is the parameter's type; a list has elements of one type (never empty: ROS 2 cannot tell
            the type of an empty list from Python).
        description: what it does, for ``ros2 param describe``.
        unit: SI symbol, empty for counts, names and switches.
        minimum, maximum: bounds (inclusive) of a number, or of every element of a list of numbers.
        choices: the only values allowed, where there are few.
        changeable: may be set while the node runs.
        device: a path that need not exist yet when the node starts itself: `run` waits a while for it, because USB
            devices and emulated ones appear when they are ready.
        former: the name it had before; a value given under it at start is taken, with a warning. Files written for an
            earlier release and recorded bags stay usable.
        convert: from a value of the former parameter to one of this; None where only the name has changed.
    """

    name: str
    default: Any
    description: str
    unit: str = ""
    minimum: float | None = None
    maximum: float | None = None
    choices: tuple[Any, ...] = ()
    changeable: bool = False
    device: bool = False
    former: str = ""
    convert: Callable[[Any], Any] | None = None

    def problem(self, value: Any) -> str | None:
        """Return what is wrong with a value as expected / found, or None."""
        if isinstance(value, (list, tuple)) or hasattr(value, "typecode"):
            elements: Iterable[Any] = value
        else:
            elements = (value,)
        for element in elements:
            if self.choices and element not in self.choices:
                return f"parameter '{self.name}': expected one of {list(self.choices)}, found {element!r}"
            if isinstance(element, (int, float)) and not isinstance(element, bool) and not self._within(element):
                return f"parameter '{self.name}': expected {self._range_text()}, found {element}"
        return None

    def descriptor(self) -> ParameterDescriptor:
        """Return the ROS descriptor."""
        text = f"{self.description} [{self.unit}]" if self.unit else self.description
        descriptor = ParameterDescriptor(name=self.name, description=text, read_only=not self.changeable)
        if self.choices:
            descriptor.additional_constraints = f"one of {list(self.choices)}"
        if self.minimum is None and self.maximum is None:
            return descriptor
        low = -math.inf if self.minimum is None else self.minimum
        high = math.inf if self.maximum is None else self.maximum
        if isinstance(self.default, float):
            limit = 1.7976931348623157e308
            descriptor.floating_point_range = [
                FloatingPointRange(from_value=max(float(low), -limit), to_value=min(float(high), limit), step=0.0)
            ]
        elif isinstance(self.default, int) and not isinstance(self.default, bool):
            limit_int = 2**63 - 1
            descriptor.integer_range = [
                IntegerRange(
                    from_value=-limit_int if math.isinf(low) else int(low),
                    to_value=limit_int if math.isinf(high) else int(high),
                    step=0 if math.isinf(low) or math.isinf(high) else 1,
                )
            ]
        return descriptor

    def refusal(self, error: Exception) -> str:
        """Return why a value given at start was refused, from what rclpy says."""
        reason = str(error.args[0] if error.args else error)
        if isinstance(error, InvalidParameterTypeException) and isinstance(self.default, str):
            # YAML takes 0 for a number and yes for a truth
            return f"{reason}; text that looks like something else wants quotes: -p {self.name}:=\"'...'\""
        return reason

    def _within(self, number: float) -> bool:
        above = self.minimum is None or number >= self.minimum
        below = self.maximum is None or number <= self.maximum
        return above and below and not math.isnan(number)

    def _range_text(self) -> str:
        low = "-inf" if self.minimum is None else f"{self.minimum:g}"
        high = "inf" if self.maximum is None else f"{self.maximum:g}"
        return f"{low} .. {high} {self.unit}".rstrip()


class ParameterTable:
    """The table of one node, declared on it in one go.

    Usage::

        PARAMETERS = ParameterTable(Parameter("loop_rate", 100.0, "control loop rate", "Hz", 10.0, 500.0), ...)
        values = PARAMETERS.declare(node)          # {"loop_rate": 100.0, ...}
        PARAMETERS.on_change(node, self._apply)    # called with {"name": value} after validation
    """

    def __init__(self, *rows: Parameter) -> None:
        names = [row.name for row in rows]
        if len(set(names)) != len(names):
            raise ValueError(f"expected parameter names that differ, found {sorted(names)}")
        self.rows: Sequence[Parameter] = rows
        self._by_name = {row.name: row for row in rows}

    def declare(self, node: Node) -> dict[str, Any]:
        """Declare every row on the node and return the values, checked.

        Raises:
            StartupError: when a value given at start is out of its bounds or of another type.
        """
        for row in self.rows:
            try:
                node.declare_parameter(row.name, self._default(node, row), row.descriptor())
            except Exception as error:
                raise StartupError(f"parameter '{row.name}': {row.refusal(error)}") from error
        values = {row.name: self._plain(node.get_parameter(row.name).value) for row in self.rows}
        problems = [text for row in self.rows if (text := row.problem(values[row.name]))]
        if problems:
            raise StartupError("; ".join(problems))
        node.add_on_set_parameters_callback(self._validate)
        if isinstance(node, CellNode):
            node.device_paths = [values[row.name] for row in self.rows if row.device]
            node.former_parameters = [row.former for row in self.rows if row.former]
        return values

    def on_change(self, node: Node, apply: Callable[[dict[str, Any]], None]) -> None:
        """Call ``apply`` with the changed values after they were validated and set."""

        def post(parameters: Sequence[RosParameter]) -> None:
            changed = {p.name: self._plain(p.value) for p in parameters if p.name in self._by_name}
            if changed:
                apply(changed)

        node.add_post_set_parameters_callback(post)

    @staticmethod
    def _default(node: Node, row: Parameter) -> Any:
        """Return the row's default, or what was given under its former name."""
        if not row.former:
            return row.default
        given = node.declare_parameter(row.former, descriptor=ParameterDescriptor(dynamic_typing=True)).value
        node.undeclare_parameter(row.former)
        if given is None:
            return row.default
        value = given if row.convert is None else row.convert(given)
        said = "is called" if row.convert is None else f"= {given} is read as {value} for"
        node.get_logger().warning(f"parameter '{row.former}' {said} '{row.name}' now: use that name")
        return value

    def _validate(self, parameters: Sequence[RosParameter]) -> SetParametersResult:
        for parameter in parameters:
            row = self._by_name.get(parameter.name)
            problem = row.problem(self._plain(parameter.value)) if row else None
            if problem:
                return SetParametersResult(successful=False, reason=problem)
        return SetParametersResult(successful=True, reason="")

    @staticmethod
    def _plain(value: Any) -> Any:
        return list(value) if hasattr(value, "typecode") or isinstance(value, tuple) else value
