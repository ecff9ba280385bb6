# SPDX-License-Identifier: Apache-2.0
"""Parameters: names, types, values, and their messages."""

from __future__ import annotations

import array
from enum import Enum
from pathlib import Path
from typing import Any

from embedded_ros.arguments import matches
from embedded_ros.errors import ArgumentsError

PARAMETER_SEPARATOR_STRING = "."
_INT64 = 2**63
_ARRAY_CODES = {"BYTE_ARRAY": "B", "INTEGER_ARRAY": "q", "DOUBLE_ARRAY": "d"}


class Parameter:
    """A name with a typed value."""

    class Type(Enum):
        """Types of parameters; the numbers are rcl_interfaces/ParameterType's."""

        NOT_SET = 0
        BOOL = 1
        INTEGER = 2
        DOUBLE = 3
        STRING = 4
        BYTE_ARRAY = 5
        BOOL_ARRAY = 6
        INTEGER_ARRAY = 7
        DOUBLE_ARRAY = 8
        STRING_ARRAY = 9

        @classmethod
        def from_parameter_value(cls, parameter_value: Any) -> Parameter.Type:
            """Return the type of a Python value; TypeError when parameters have none for it."""
            if parameter_value is None:
                return cls.NOT_SET
            for kind, python in ((cls.BOOL, bool), (cls.INTEGER, int), (cls.DOUBLE, float), (cls.STRING, str)):
                if isinstance(parameter_value, python):
                    return kind
            if isinstance(parameter_value, list | tuple | array.array):
                for kind, item_type in (
                    (cls.BYTE_ARRAY, bytes),
                    (cls.BOOL_ARRAY, bool),
                    (cls.INTEGER_ARRAY, int),
                    (cls.DOUBLE_ARRAY, float),
                    (cls.STRING_ARRAY, str),
                ):
                    if all(isinstance(item, item_type) for item in parameter_value):
                        return kind
                raise TypeError("The given value is not a list of one of the allowed types")
            raise TypeError(f"The given value is not one of the allowed types '{parameter_value}'.")

        def check(self, parameter_value: Any) -> bool:
            """Whether a Python value has this type."""
            simple = {"BOOL": bool, "INTEGER": int, "DOUBLE": float, "STRING": str}
            if self.name == "NOT_SET":
                return parameter_value is None
            if self.name == "INTEGER":
                return isinstance(parameter_value, int) and not isinstance(parameter_value, bool)
            if self.name in simple:
                return isinstance(parameter_value, simple[self.name])
            if not isinstance(parameter_value, list | tuple | array.array):
                return False
            item = {"BYTE_ARRAY": bytes, "BOOL_ARRAY": bool, "INTEGER_ARRAY": int, "DOUBLE_ARRAY": float,
                    "STRING_ARRAY": str}[self.name]  # fmt: skip
            return all(isinstance(value, item) for value in parameter_value)

    def __init__(self, name: str, type_: Parameter.Type | None = None, value: Any = None) -> None:
        if type_ is None:
            type_ = Parameter.Type.from_parameter_value(value)
        if not isinstance(type_, Parameter.Type):
            raise TypeError("type must be an instance of `Parameter.Type`")
        if not type_.check(value):
            raise ValueError(f"Type '{type_}' and value '{value}' do not agree")
        self._type_ = type_
        self._name = name
        self._value = value

    @classmethod
    def from_parameter_msg(cls, param_msg: Any) -> Parameter:
        """Return the parameter that a rcl_interfaces/Parameter holds."""
        kind = Parameter.Type(param_msg.value.type)
        return cls(param_msg.name, kind, parameter_value_to_python(param_msg.value))

    @property
    def name(self) -> str:
        """The name."""
        return self._name

    @property
    def type_(self) -> Parameter.Type:
        """The type."""
        return self._type_

    @property
    def value(self) -> Any:
        """The value."""
        return self._value

    def __repr__(self) -> str:
        return f"Parameter({self._name!r}, {self._type_}, {self._value!r})"

    def __eq__(self, other: object) -> bool:
        if not isinstance(other, Parameter):
            return NotImplemented
        return (self._name, self._type_, self._value) == (other._name, other._type_, other._value)

    def __hash__(self) -> int:
        return hash((self._name, self._type_))

    def get_parameter_value(self) -> Any:
        """Return the value as rcl_interfaces/ParameterValue."""
        from rcl_interfaces.msg import ParameterValue  # noqa: PLC0415  classes are made on first use

        message = ParameterValue(type=self._type_.value)
        if self._type_ is not Parameter.Type.NOT_SET:
            field = f"{self._type_.name.lower()}_value"
            setattr(message, field, list(self._value) if self._type_.name.endswith("_ARRAY") else self._value)
        return message

    def to_parameter_msg(self) -> Any:
        """Return rcl_interfaces/Parameter."""
        from rcl_interfaces.msg import Parameter as Message  # noqa: PLC0415  classes are made on first use

        return Message(name=self._name, value=self.get_parameter_value())


def parameter_value_to_python(parameter_value: Any) -> Any:
    """Return the Python value that a rcl_interfaces/ParameterValue holds."""
    try:
        kind = Parameter.Type(parameter_value.type)
    except ValueError:
        raise RuntimeError(f"unexpected parameter type {parameter_value.type}") from None
    if kind is Parameter.Type.NOT_SET:
        return None
    value = getattr(parameter_value, f"{kind.name.lower()}_value")
    return list(value) if kind.name.endswith("_ARRAY") else value


def get_parameter_value(string_value: str) -> Any:
    """Return the ParameterValue that YAML text such as ``1.5`` or ``[a, b]`` stands for; text when it is none."""
    from embedded_ros.parameter_files import load_yaml, parameter_value  # noqa: PLC0415  YAML costs start-up

    try:
        value = parameter_value(load_yaml(string_value, "value"), "value")
        if isinstance(value, int) and not isinstance(value, bool) and not -_INT64 <= value < _INT64:
            value = string_value
    except ArgumentsError:
        value = string_value
    if value == []:
        value = string_value
    return Parameter("value", value=value).get_parameter_value()


def parameter_dict_from_yaml_file(
    parameter_file: str,
    use_wildcard: bool = False,
    target_nodes: list[str] | None = None,
    namespace: str = "",
) -> dict[str, Any]:
    """Read a parameter file into {name: rcl_interfaces/Parameter}.

    Args:
        parameter_file: path of the YAML file.
        use_wildcard: whether ``/**`` applies.
        target_nodes: full names of the nodes wanted; all when None.
        namespace: put before each parameter's name.
    """
    from embedded_ros.parameter_files import load_parameter_file  # noqa: PLC0415  YAML costs start-up

    with Path(parameter_file).open(encoding="utf-8"):
        pass  # rclpy's callers expect FileNotFoundError, not an error about arguments
    entries = [("/" + name.lstrip("/"), values) for name, values, _ in load_parameter_file(Path(parameter_file))]
    requested = {"/" + node.lstrip("/") for node in target_nodes or [] if node}
    chosen = [(name, values) for name, values in entries if _applies(name, requested, use_wildcard=use_wildcard)]
    if not chosen or (requested and not any("*" not in name for name, _ in chosen) and not use_wildcard):
        known = ", ".join(name for name, _ in entries) or "none"
        raise RuntimeError(f"Param file does not contain selected parameters; it has some for: {known}")
    # Wildcards first, so that what is written for a node itself wins.
    chosen.sort(key=lambda item: "*" not in item[0])
    found: dict[str, Any] = {}
    for _, values in chosen:
        for name, value in values.items():
            full = namespace + name
            found[full] = Parameter(full, value=value).to_parameter_msg()
    return found


def _applies(name: str, requested: set[str], *, use_wildcard: bool) -> bool:
    if "*" not in name:
        return not requested or name in requested
    if not use_wildcard:
        return False
    return not requested or any(matches(name, node) for node in requested)
