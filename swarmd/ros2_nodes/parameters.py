"""The parameters of a node, as `rclpy.parameter` and the methods of a Node have them."""

from __future__ import annotations

import array
from collections.abc import Callable, Iterable, Mapping
from enum import IntEnum
from typing import Any

import numpy as np


class ParameterException(Exception):
    """The base of the errors of parameters, as in `rclpy.exceptions`."""


class ParameterNotDeclaredException(ParameterException):
    """A parameter that was not declared is read or set."""


class ParameterAlreadyDeclaredException(ParameterException):
    """A parameter is declared twice."""


class ParameterUninitializedException(ParameterException):
    """A parameter that has no value yet is read."""


class InvalidParameterTypeException(ParameterException):
    """A parameter gets a value of another type."""


class InvalidParameterValueException(ParameterException):
    """A parameter gets a value that its descriptor or a callback refuses."""


class ParameterImmutableException(ParameterException):
    """A parameter that is read-only is set."""


class ParameterType(IntEnum):
    """The types of parameters, as `rcl_interfaces/msg/ParameterType`."""

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
    def from_parameter_value(cls, value: Any) -> ParameterType:
        """The type of a value; TypeError for one that no parameter has."""
        return type_of(value)


_ITEMS = (
    (bool, ParameterType.BOOL_ARRAY),
    (int, ParameterType.INTEGER_ARRAY),
    (float, ParameterType.DOUBLE_ARRAY),
    (str, ParameterType.STRING_ARRAY),
)
_ONES = (
    (bool, ParameterType.BOOL),
    (int, ParameterType.INTEGER),
    (float, ParameterType.DOUBLE),
    (str, ParameterType.STRING),
)
_FIELDS: Mapping[ParameterType, tuple[str, Any]] = {
    ParameterType.BOOL: ("bool_value", False),
    ParameterType.INTEGER: ("integer_value", 0),
    ParameterType.DOUBLE: ("double_value", 0.0),
    ParameterType.STRING: ("string_value", ""),
    ParameterType.BYTE_ARRAY: ("byte_array_value", []),
    ParameterType.BOOL_ARRAY: ("bool_array_value", []),
    ParameterType.INTEGER_ARRAY: ("integer_array_value", []),
    ParameterType.DOUBLE_ARRAY: ("double_array_value", []),
    ParameterType.STRING_ARRAY: ("string_array_value", []),
}


def type_of(value: Any) -> ParameterType:
    """The type of a parameter with this value; TypeError for a value that no parameter has."""
    if value is None:
        return ParameterType.NOT_SET
    for kind, type_ in _ONES:
        if isinstance(value, kind):
            return type_
    if isinstance(value, np.ndarray | array.array):
        value = value.tolist()
    if isinstance(value, list | tuple):
        if not value or all(isinstance(one, bytes) for one in value):
            return ParameterType.BYTE_ARRAY
        for kind, type_ in _ITEMS:
            if all(isinstance(one, kind) for one in value):
                return type_
    raise TypeError(f"The given value is not one of the allowed types {value!r}.")


class ParameterValue:
    """The value of a parameter, as `rcl_interfaces/msg/ParameterValue`."""

    def __init__(self, value: Any, type_: ParameterType) -> None:
        self.type = int(type_)
        for kind, (field, default) in _FIELDS.items():
            setattr(self, field, value if kind is type_ else default)

    def __repr__(self) -> str:
        fields = ", ".join(f"{name}={getattr(self, name)!r}" for name, _ in _FIELDS.values())
        return f"rcl_interfaces.msg.ParameterValue(type={self.type}, {fields})"


def python_value(parameter_value: ParameterValue) -> Any:
    """The value in a `ParameterValue`; None if it is not set."""
    field = _FIELDS.get(ParameterType(parameter_value.type))
    return None if field is None else getattr(parameter_value, field[0])


class Parameter:
    """A parameter with its type and value, as `rclpy.parameter.Parameter`."""

    Type = ParameterType

    def __init__(self, name: str, type_: ParameterType | None = None, value: Any = None) -> None:
        self.name = name
        self.type_ = type_of(value) if type_ is None else type_
        self.value = value
        if type_ is not None and value is not None and not _fits(value, type_):
            raise ValueError(f"Type '{type_}' and value '{value}' do not agree")

    def get_parameter_value(self) -> ParameterValue:
        """The value as a message."""
        return ParameterValue(self.value, self.type_)

    def to_parameter_msg(self) -> Parameter:
        """Itself: `name` and `value` are those of a message."""
        return self

    def __repr__(self) -> str:
        return f"Parameter(name={self.name!r}, type_={self.type_!r}, value={self.value!r})"


def _fits(value: Any, type_: ParameterType) -> bool:
    if isinstance(value, list | tuple) and not value:
        return type_ >= ParameterType.BYTE_ARRAY
    return type_of(value) is type_


class Parameters:
    """The declared parameters of one node.

    `overrides`: the values of files and launch, by name. `result(is_successful, reason)` makes the
    answer to a change.
    """

    def __init__(
        self, overrides: Mapping[str, Any], result: Callable[[bool, str], Any], *, open_: bool
    ) -> None:
        self.overrides = overrides
        self.callbacks: list[Callable[[list[Parameter]], Any]] = []
        self.after: list[Callable[[list[Parameter]], Any]] = []
        self._result = result
        self._declared: dict[str, Parameter] = {}
        self._descriptors: dict[str, Any] = {}
        self._is_open = open_  # values may be set that were not declared

    def declare(
        self, name: str, value: Any, descriptor: Any, *, ignore_override: bool
    ) -> Parameter:
        """Declare a parameter; its value is the override, else `value`, which may be a type."""
        if name in self._declared:
            raise ParameterAlreadyDeclaredException(f"Parameter(s) already declared: {name}")
        if isinstance(value, type):
            value = ParameterType[_TYPE_NAMES[value]] if value in _TYPE_NAMES else value
        is_type = isinstance(value, ParameterType)
        wanted = value if is_type else type_of(value)
        given = None if is_type else value
        if name in self.overrides and not ignore_override:
            given = self.overrides[name]
        is_dynamic = bool(getattr(descriptor, "dynamic_typing", False))
        is_free = is_dynamic or wanted is ParameterType.NOT_SET
        if given is not None and not is_free and not _fits(given, wanted):
            raise InvalidParameterTypeException(
                f"parameter {name!r} is {given!r} of type {type_of(given).name}; the node declares"
                f" {wanted.name}: write {_hint(wanted)} in its parameters"
            )
        parameter = Parameter(name, None if is_free or given is None else wanted, given)
        if given is None:
            parameter.type_ = ParameterType.NOT_SET
        if fault := _range_fault(parameter, descriptor):
            raise InvalidParameterValueException(fault)
        self._descriptors[name] = descriptor
        self._declared[name] = parameter
        self._ask([parameter])
        return parameter

    def undeclare(self, name: str) -> None:
        """Forget a parameter."""
        self._check(name)
        del self._declared[name]

    def has(self, name: str) -> bool:
        """Whether a parameter is declared."""
        return name in self._declared

    def get(self, name: str) -> Parameter:
        """A declared parameter; ParameterNotDeclaredException for another one."""
        if name not in self._declared and self._is_open:
            return Parameter(name)
        self._check(name)
        parameter = self._declared[name]
        return Parameter(name, parameter.type_, parameter.value)

    def names(self, prefix: str = "") -> list[str]:
        """The names of the declared parameters below a prefix."""
        start = f"{prefix}." if prefix else ""
        return [name for name in self._declared if name.startswith(start)]

    def descriptor(self, name: str) -> Any:
        """The descriptor with which a parameter was declared."""
        self._check(name)
        return self._descriptors.get(name)

    def set(self, parameters: Iterable[Parameter]) -> list[Any]:
        """Set parameters one after another; an answer for each."""
        return [self.set_together([parameter]) for parameter in parameters]

    def set_together(self, parameters: list[Parameter]) -> Any:
        """Set all parameters or none; the answer."""
        for parameter in parameters:
            if not self._is_open:
                self._check(parameter.name)
            descriptor = self._descriptors.get(parameter.name)
            if getattr(descriptor, "read_only", False):
                return self._result(
                    False, f"Trying to set a read-only parameter: {parameter.name}."
                )
            if fault := _range_fault(parameter, descriptor):
                return self._result(False, fault)
            before = self._declared.get(parameter.name)
            is_typed = before is not None and before.type_ is not ParameterType.NOT_SET
            is_free = bool(getattr(descriptor, "dynamic_typing", False))
            if before and is_typed and not is_free and not _fits(parameter.value, before.type_):
                wanted = before.type_.name
                return self._result(False, f"Wrong parameter type, expected {wanted}")
        for callback in self.callbacks:
            result = callback(parameters)
            if not result.successful:
                return result
        for parameter in parameters:
            self._declared[parameter.name] = parameter
        for callback in self.after:
            callback(parameters)
        return self._result(True, "")

    def _ask(self, parameters: list[Parameter]) -> None:
        for callback in self.callbacks:
            result = callback(parameters)
            if not result.successful:
                raise InvalidParameterValueException(result.reason)

    def _check(self, name: str) -> None:
        if name not in self._declared:
            raise ParameterNotDeclaredException(name)


_TYPE_NAMES: Mapping[type, str] = {
    bool: "BOOL",
    int: "INTEGER",
    float: "DOUBLE",
    str: "STRING",
}


def _hint(type_: ParameterType) -> str:
    hints = {ParameterType.DOUBLE: "1.0", ParameterType.INTEGER: "1", ParameterType.BOOL: "true"}
    return hints.get(type_, "a value of that type")


def _range_fault(parameter: Parameter, descriptor: Any) -> str:
    """Why a descriptor refuses a value; empty if it does not."""
    for name in ("floating_point_range", "integer_range"):
        for range_ in getattr(descriptor, name, ()) or ():
            value = parameter.value
            is_number = isinstance(value, int | float) and not isinstance(value, bool)
            if is_number and not range_.from_value <= value <= range_.to_value:
                return (
                    f"Parameter {parameter.name} doesn't comply with {name}:"
                    f" {value} is not in [{range_.from_value}, {range_.to_value}]"
                )
    return ""
