# SPDX-License-Identifier: Apache-2.0
"""Parameters of a node: declared, checked, set, announced."""

from __future__ import annotations

import warnings
from typing import TYPE_CHECKING, Any

from rclpy._rclpy_pybind11 import RCLInvalidROSArgsError
from rclpy.exceptions import (
    InvalidParameterTypeException,
    InvalidParameterValueException,
    ParameterAlreadyDeclaredException,
    ParameterImmutableException,
    ParameterNotDeclaredException,
    ParameterUninitializedException,
)
from rclpy.parameter import PARAMETER_SEPARATOR_STRING, Parameter
from rclpy.parameter_checks import REL_TOL, is_listed, make_descriptor, make_result, problem
from rclpy.validate_parameter_name import validate_parameter_name

if TYPE_CHECKING:
    from collections.abc import Callable, Sequence

    from rclpy.clock import Clock

    from embedded_ros.arguments import Arguments


class NodeParameters:
    """Parameter methods; mixed into Node."""

    PARAM_REL_TOL = REL_TOL

    _rcl_arguments: list[Arguments]
    _parameter_event_publisher: Any
    _clock: Clock

    def get_fully_qualified_name(self) -> str:
        """Return ``/namespace/name``."""
        raise NotImplementedError

    def _rcl_init_parameters(self, overrides: list[Parameter] | None, allow_undeclared: bool) -> None:
        self._parameters: dict[str, Parameter] = {}
        self._descriptors: dict[str, Any] = {}
        self._pre_set_parameters_callbacks: list[Callable[[list[Parameter]], list[Parameter]]] = []
        self._on_set_parameters_callbacks: list[Callable[[list[Parameter]], Any]] = []
        self._post_set_parameters_callbacks: list[Callable[[list[Parameter]], None]] = []
        self._allow_undeclared_parameters = allow_undeclared
        self._parameter_overrides: dict[str, Parameter] = {}
        for given in reversed(self._rcl_arguments):
            for name, (value, source) in given.parameters_of(self.get_fully_qualified_name()).items():
                try:
                    self._parameter_overrides[name] = Parameter(name, value=value)
                except TypeError as error:
                    raise RCLInvalidROSArgsError(f"{source}: {name}: {error}") from error
        for parameter in overrides or []:
            self._parameter_overrides[parameter.name] = parameter

    def _rcl_declare_overrides(self) -> None:
        from rcl_interfaces.msg import ParameterDescriptor  # noqa: PLC0415  classes are made on first use

        self.declare_parameters(
            "",
            [
                (name, parameter.value, ParameterDescriptor(dynamic_typing=True))
                for name, parameter in self._parameter_overrides.items()
                if name not in self._parameters
            ],
            ignore_override=True,
        )

    # -- declaring --------------------------------------------------------------------------------------------

    def declare_parameter(
        self,
        name: str,
        value: Any = None,
        descriptor: Any = None,
        ignore_override: bool = False,
    ) -> Parameter:
        """Declare a parameter; overrides from the command line and files replace the value.

        Raises:
            ParameterAlreadyDeclaredException, InvalidParameterException, InvalidParameterTypeException,
            InvalidParameterValueException: it cannot be declared like this.
        """
        given = (name,) if value is None and descriptor is None else (name, value, descriptor or make_descriptor())
        return self.declare_parameters("", [given], ignore_override)[0]

    def declare_parameters(
        self,
        namespace: str,
        parameters: Sequence[tuple[Any, ...]],
        ignore_override: bool = False,
    ) -> list[Parameter]:
        """Declare parameters given as (name), (name, value or type) or (name, value or type, descriptor)."""
        found: list[Parameter] = []
        descriptors: dict[str, Any] = {}
        for index, given in enumerate(parameters):
            name, value, descriptor = self._rcl_declaration(namespace, index, given)
            if not ignore_override and name in self._parameter_overrides:
                value = self._parameter_overrides[name].value
            found.append(Parameter(name, value=value))
            descriptors[name] = descriptor
        already = [parameter.name for parameter in found if parameter.name in self._parameters]
        if already:
            raise ParameterAlreadyDeclaredException(already)
        for parameter in found:
            self._rcl_declare(parameter, descriptors)
        return [self._parameters[parameter.name] for parameter in found]

    @staticmethod
    def _rcl_declaration(namespace: str, index: int, given: tuple[Any, ...]) -> tuple[str, Any, Any]:
        if not 1 <= len(given) <= 3:
            raise TypeError(f"parameter {index}: expected (name[, value[, descriptor]]), found {given!r}")
        name = given[0]
        if not isinstance(name, str):
            raise TypeError(f"First element {name} at index {index} in parameters list is not a str.")
        name = f"{namespace}.{name}" if namespace else name
        validate_parameter_name(name)
        second = given[1] if len(given) > 1 else None
        descriptor = given[2] if len(given) > 2 else make_descriptor()
        if not isinstance(descriptor, type(make_descriptor())):
            raise TypeError(
                f"Third element {descriptor} at index {index} in parameters list is not a ParameterDescriptor."
            )
        if len(given) == 1:
            warnings.warn(
                f"when declaring parameter named '{name}', declaring a parameter only by its name is deprecated. "
                "Pass a default value, a parameter type, or a descriptor with dynamic_typing=True",
                stacklevel=4,
            )
            descriptor.dynamic_typing = True
        if isinstance(second, Parameter.Type):
            if second is Parameter.Type.NOT_SET:
                raise ValueError(f"Cannot declare parameter {{{name}}} as statically typed of type NOT_SET")
            if descriptor.dynamic_typing:
                raise ValueError(f"parameter {{{name}}}: dynamic_typing=True is not allowed when the type is given")
            descriptor.type = second.value
            return name, None, descriptor
        if not descriptor.dynamic_typing:
            definition = getattr(type(second), "DEFINITION", None)
            if (
                second is not None
                and definition is not None
                and definition.text.name == "rcl_interfaces/msg/ParameterValue"
            ):
                descriptor.type = second.type
            else:
                descriptor.type = Parameter.Type.from_parameter_value(second).value
            if descriptor.type == 0:
                raise ValueError(
                    "Cannot declare a statically typed parameter with default value of type PARAMETER_NOT_SET"
                )
        return name, second, descriptor

    def _rcl_declare(self, parameter: Parameter, descriptors: dict[str, Any]) -> None:
        result = self._set_parameters_atomically_common([parameter], descriptors, allow_not_set_type=True)
        if not result.successful:
            if result.reason.startswith("Wrong parameter type"):
                expected = Parameter.Type(descriptors[parameter.name].type)
                raise InvalidParameterTypeException(parameter, expected.name)
            raise InvalidParameterValueException(parameter.name, parameter.value, result.reason)

    def undeclare_parameter(self, name: str) -> None:
        """Remove a parameter."""
        if self.has_parameter(name):
            if self._descriptors[name].read_only:
                raise ParameterImmutableException(name)
            del self._parameters[name]
            del self._descriptors[name]
        else:
            raise ParameterNotDeclaredException(name)

    def has_parameter(self, name: str) -> bool:
        """Whether a parameter is declared."""
        return name in self._parameters

    # -- reading ----------------------------------------------------------------------------------------------

    def get_parameter(self, name: str) -> Parameter:
        """Return a parameter.

        Raises:
            ParameterNotDeclaredException: it is not declared (and undeclared ones are not allowed).
            ParameterUninitializedException: it has a type but no value.
        """
        if self.has_parameter(name):
            parameter = self._parameters[name]
            if parameter.type_ is not Parameter.Type.NOT_SET or self._descriptors[name].dynamic_typing:
                return parameter
            raise ParameterUninitializedException(name)
        if self._allow_undeclared_parameters:
            return Parameter(name, Parameter.Type.NOT_SET, None)
        raise ParameterNotDeclaredException(name)

    def get_parameters(self, names: list[str]) -> list[Parameter]:
        """Return several parameters."""
        if not all(isinstance(name, str) for name in names):
            raise TypeError("All names must be instances of type str")
        return [self.get_parameter(name) for name in names]

    def get_parameter_or(self, name: str, alternative_value: Parameter | None = None) -> Parameter:
        """Return a parameter, or the alternative when it is not declared or has no value."""
        if alternative_value is None:
            alternative_value = Parameter(name, Parameter.Type.NOT_SET)
        parameter = self._parameters.get(name, alternative_value)
        return alternative_value if parameter.type_ is Parameter.Type.NOT_SET else parameter

    def get_parameter_types(self, names: list[str]) -> list[Parameter.Type]:
        """Return the types of several parameters."""
        if not all(isinstance(name, str) for name in names):
            raise TypeError("All names must be instances of type str")
        return [self.get_parameter_type(name) for name in names]

    def get_parameter_type(self, name: str) -> Parameter.Type:
        """Return the type of a parameter."""
        if self.has_parameter(name):
            return self._parameters[name].type_
        if self._allow_undeclared_parameters:
            return Parameter.Type.NOT_SET
        raise ParameterNotDeclaredException(name)

    def get_parameters_by_prefix(self, prefix: str) -> dict[str, Parameter]:
        """Return the parameters under a prefix, by what follows it."""
        head = prefix + PARAMETER_SEPARATOR_STRING if prefix else ""
        return {name[len(head) :]: value for name, value in self._parameters.items() if name.startswith(head)}

    def list_parameters(self, prefixes: list[str], depth: int) -> Any:
        """Return names (and prefixes) of parameters down to a depth; 0 is any depth."""
        from rcl_interfaces.msg import ListParametersResult  # noqa: PLC0415  classes are made on first use

        if not isinstance(prefixes, list):
            raise TypeError("The prefixes argument must be a list")
        if not all(isinstance(prefix, str) for prefix in prefixes):
            raise TypeError("All prefixes must be instances of type str")
        if not isinstance(depth, int):
            raise TypeError("The depth must be instance of type int")
        if depth < 0:
            raise ValueError("The depth must be greater than or equal to zero")
        result = ListParametersResult()
        for name in self._parameters:
            if is_listed(name, prefixes, depth):
                result.names.append(name)
                prefix = name.rpartition(PARAMETER_SEPARATOR_STRING)[0]
                if prefix and prefix not in result.prefixes:
                    result.prefixes.append(prefix)
        return result

    # -- setting ----------------------------------------------------------------------------------------------

    def set_parameters(self, parameter_list: list[Parameter]) -> list[Any]:
        """Set parameters one by one; return a result for each."""
        return [self.set_parameters_atomically([parameter]) for parameter in parameter_list]

    def set_parameters_atomically(self, parameter_list: list[Parameter]) -> Any:
        """Set all or none."""
        wrong = [item for item in parameter_list if not isinstance(item, Parameter)]
        if wrong:
            raise TypeError(f"expected rclpy.parameter.Parameter, found {wrong[0]!r}")
        for callback in self._pre_set_parameters_callbacks:
            parameter_list = callback(parameter_list)
        if self._pre_set_parameters_callbacks and not parameter_list:
            return make_result(
                "parameter list cannot be empty, this might be due to pre_set_parameters_callback modifying the "
                "original parameters list."
            )
        if not self._allow_undeclared_parameters:
            unknown = [parameter.name for parameter in parameter_list if not self.has_parameter(parameter.name)]
            if unknown:
                raise ParameterNotDeclaredException(unknown)
        return self._set_parameters_atomically_common(parameter_list)

    def _set_parameters_atomically_common(
        self,
        parameter_list: list[Parameter],
        descriptors: dict[str, Any] | None = None,
        *,
        allow_not_set_type: bool = False,
    ) -> Any:
        for parameter in parameter_list:
            known = descriptors if descriptors is not None else self._descriptors
            if parameter.name in known:
                reason = problem(
                    parameter,
                    known[parameter.name],
                    declared=self.has_parameter(parameter.name),
                    check_read_only=descriptors is None,
                )
                if reason:
                    return make_result(reason)
        for callback in self._on_set_parameters_callbacks:
            result = callback(parameter_list)
            if not hasattr(result, "successful"):
                warnings.warn("Callback returned an invalid type, it should return SetParameterResult.", stacklevel=3)
                return make_result("Callback returned an invalid type")
            if not result.successful:
                return result
        self._rcl_store(parameter_list, descriptors, allow_not_set_type=allow_not_set_type)
        for post in self._post_set_parameters_callbacks:
            post(parameter_list)
        return make_result()

    def _rcl_store(
        self, parameter_list: list[Parameter], descriptors: dict[str, Any] | None, *, allow_not_set_type: bool
    ) -> None:
        from rcl_interfaces.msg import ParameterEvent  # noqa: PLC0415  classes are made on first use

        event = ParameterEvent(node=self.get_fully_qualified_name())
        for parameter in parameter_list:
            name = parameter.name
            if parameter.type_ is Parameter.Type.NOT_SET and not allow_not_set_type:
                event.deleted_parameters.append(parameter.to_parameter_msg())
                self._parameters.pop(name, None)
                self._descriptors.pop(name, None)
                continue
            if descriptors is not None:
                self._descriptors[name] = descriptors[name]
            elif name not in self._descriptors:
                self._descriptors[name] = make_descriptor(dynamic_typing=True)
            new = self.get_parameter_or(name).type_ is Parameter.Type.NOT_SET
            (event.new_parameters if new else event.changed_parameters).append(parameter.to_parameter_msg())
            self._parameters[name] = parameter
        event.stamp = self._clock.now().to_msg()
        self._parameter_event_publisher.publish(event)

    def describe_parameter(self, name: str) -> Any:
        """Return the descriptor of a parameter."""
        if name in self._descriptors:
            return self._descriptors[name]
        if self._allow_undeclared_parameters:
            return make_descriptor()
        raise ParameterNotDeclaredException(name)

    def describe_parameters(self, names: list[str]) -> list[Any]:
        """Return the descriptors of several parameters."""
        return [self.describe_parameter(name) for name in names]

    def set_descriptor(self, name: str, descriptor: Any, alternative_value: Any = None) -> Any:
        """Give a parameter a new descriptor; the alternative replaces a value that does not suit it."""
        from rcl_interfaces.msg import Parameter as Message  # noqa: PLC0415  classes are made on first use

        if not self.has_parameter(name):
            if not self._allow_undeclared_parameters:
                raise ParameterNotDeclaredException(name)
            return self.get_parameter(name).get_parameter_value()
        if self.describe_parameter(name).read_only:
            raise ParameterImmutableException(name)
        current = self.get_parameter(name)
        if problem(current, descriptor, declared=True, check_read_only=False):
            if alternative_value is not None:
                current = Parameter.from_parameter_msg(Message(name=name, value=alternative_value))
            reason = problem(current, descriptor, declared=True, check_read_only=False)
            if reason:
                raise InvalidParameterValueException(name, current.value, reason)
        self._parameters[name] = current
        self._descriptors[name] = descriptor
        return current.get_parameter_value()

    # -- callbacks --------------------------------------------------------------------------------------------

    def add_pre_set_parameters_callback(self, callback: Callable[[list[Parameter]], list[Parameter]]) -> None:
        """Call before anything is checked; the callback may change the list."""
        self._pre_set_parameters_callbacks.insert(0, callback)

    def add_on_set_parameters_callback(self, callback: Callable[[list[Parameter]], Any]) -> None:
        """Call to accept or refuse; the last one added is asked first."""
        self._on_set_parameters_callbacks.insert(0, callback)

    def add_post_set_parameters_callback(self, callback: Callable[[list[Parameter]], None]) -> None:
        """Call when parameters have been set."""
        self._post_set_parameters_callbacks.insert(0, callback)

    def remove_pre_set_parameters_callback(self, callback: Callable[[list[Parameter]], list[Parameter]]) -> None:
        """Stop calling."""
        self._pre_set_parameters_callbacks.remove(callback)

    def remove_on_set_parameters_callback(self, callback: Callable[[list[Parameter]], Any]) -> None:
        """Stop calling."""
        self._on_set_parameters_callbacks.remove(callback)

    def remove_post_set_parameters_callback(self, callback: Callable[[list[Parameter]], None]) -> None:
        """Stop calling."""
        self._post_set_parameters_callbacks.remove(callback)
