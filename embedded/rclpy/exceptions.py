# SPDX-License-Identifier: Apache-2.0
"""The exceptions of rclpy."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from rclpy.parameter import Parameter


class NotInitializedException(Exception):  # noqa: N818  rclpy's name, as all below
    """``rclpy.init()`` has not been called, or was undone."""

    def __init__(self, *args: object) -> None:
        super().__init__("rclpy.init() has not been called", *args)


class NoTypeSupportImportedException(Exception):  # noqa: N818
    """The class given is no message, service or action type."""

    def __init__(self, *args: object) -> None:
        super().__init__("no type_support imported", *args)


class NameValidationException(Exception):  # noqa: N818
    """A name breaks a rule."""

    def __init__(self, name_type: str, name: str, error_msg: str, invalid_index: int, *args: object) -> None:
        caret = " " * (len(name_type) + 2 + invalid_index + 1) + "^"
        super().__init__(
            f"Invalid {name_type}: {error_msg}:\n  '{name}'\n{caret}", name, error_msg, invalid_index, *args
        )
        self.name_type = name_type
        self.name = name
        self.error_msg = error_msg
        self.invalid_index = invalid_index

    def __str__(self) -> str:
        return str(self.args[0])


class InvalidNamespaceException(NameValidationException):
    """A namespace breaks a rule."""

    def __init__(self, name: str, error_msg: str, invalid_index: int, *args: object) -> None:
        super().__init__("namespace", name, error_msg, invalid_index, *args)


class InvalidNodeNameException(NameValidationException):
    """A node name breaks a rule."""

    def __init__(self, name: str, error_msg: str, invalid_index: int, *args: object) -> None:
        super().__init__("node name", name, error_msg, invalid_index, *args)


class InvalidTopicNameException(NameValidationException):
    """A topic name breaks a rule."""

    def __init__(self, name: str, error_msg: str, invalid_index: int, *args: object) -> None:
        super().__init__("topic name", name, error_msg, invalid_index, *args)


class InvalidServiceNameException(NameValidationException):
    """A service name breaks a rule."""

    def __init__(self, name: str, error_msg: str, invalid_index: int, *args: object) -> None:
        super().__init__("service name", name, error_msg, invalid_index, *args)


class InvalidHandle(Exception):  # noqa: N818
    """The entity was destroyed."""


class ParameterException(Exception):  # noqa: N818
    """Base of exceptions about parameters."""

    def __init__(self, error_msg: str, parameters: Any) -> None:
        super().__init__(f"{error_msg}: {parameters}")


class ParameterNotDeclaredException(ParameterException):
    """The parameter was not declared."""

    def __init__(self, parameters: Any) -> None:
        super().__init__("Invalid access to undeclared parameter(s)", parameters)


class ParameterAlreadyDeclaredException(ParameterException):
    """The parameter is declared already."""

    def __init__(self, parameters: Any) -> None:
        super().__init__("Parameter(s) already declared", parameters)


class InvalidParameterException(ParameterException):
    """A parameter name breaks a rule."""

    def __init__(self, parameter: Any) -> None:
        super().__init__("Invalid parameter name", parameter)


class InvalidParameterTypeException(ParameterException):
    """The value has a type that the parameter may not take."""

    def __init__(self, desired_parameter: Parameter, expected_type: str) -> None:
        super().__init__(
            f"Trying to set parameter '{desired_parameter._name}' to '{desired_parameter._value}' of type "
            f"'{desired_parameter._type_.name}', expecting type '{expected_type}'",
            desired_parameter.name,
        )
        self.param_name = desired_parameter.name


class InvalidParameterValueException(ParameterException):
    """A value was refused by its descriptor or by a callback."""

    def __init__(self, parameter: Any, value: object, reason: str | None = None) -> None:
        super().__init__(f"Invalid parameter value ({value}) for parameter. Reason: {reason}", parameter)


class ParameterUninitializedException(ParameterException):
    """The parameter is declared with a type but has no value yet."""

    def __init__(self, parameter_name: str) -> None:
        super().__init__(f"The parameter '{parameter_name}' is not initialized", parameter_name)


class ParameterImmutableException(ParameterException):
    """The parameter is read-only."""

    def __init__(self, parameter: Any) -> None:
        super().__init__("Attempted to modify read-only parameter", parameter)


class ROSInterruptException(Exception):  # noqa: N818
    """Shut down while waiting."""

    def __init__(self) -> None:
        super().__init__("rclpy.shutdown() has been called")
