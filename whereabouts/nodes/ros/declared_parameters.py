"""Declares a pydantic model as ROS parameters and keeps both the same while a node runs."""

from __future__ import annotations

import difflib
from typing import Any, Generic, TypeVar

from pydantic import ValidationError
from pydantic.fields import FieldInfo
from rcl_interfaces.msg import FloatingPointRange, IntegerRange, ParameterDescriptor, SetParametersResult
from rclpy.node import Node
from rclpy.parameter import Parameter

from estimation.errors import InputError
from whereabouts.parameters.parameter_base import (
    NodeParameters,
    allowed,
    bounds,
    explain,
    extra,
    is_parameter_of_any,
)

Model = TypeVar("Model", bound=NodeParameters)
# Read once, before the node is configured for the first time.
AT_THE_START = ("autostart", "report_processed", "diagnostics_period")


class ParameterError(InputError):
    """A parameter has a wrong type or value; the message names it, the value and what is allowed."""


class ParameterSet(Generic[Model]):
    """The parameters of a running node.

    values : the validated model, replaced whenever a parameter is set.
    Raises ParameterError: a value given at the start is not allowed.
    """

    def __init__(self, node: Node, model: type[Model]) -> None:
        self._model = model
        self._configured = False
        given = {name: override.value for name, override in node._parameter_overrides.items()}
        self._warn_unknown(node, given)
        self.values = self._validated({name: given[name] for name in model.model_fields if name in given})
        for name, field in model.model_fields.items():
            # Dynamic, so that `range: 10` in a YAML file serves where 10.0 was meant; the model still checks.
            descriptor = describe(name, field)
            node.declare_parameter(name, getattr(self.values, name), descriptor, ignore_override=True)
        node.add_on_set_parameters_callback(self._on_set)

    def freeze(self, configured: bool) -> None:
        """Whether the node is configured: what is read then cannot be changed until it is cleaned up."""
        self._configured = configured

    def _warn_unknown(self, node: Node, given: dict[str, Any]) -> None:
        known = [*self._model.model_fields, "use_sim_time"]
        for name in given:
            if name in known or name.startswith("qos_overrides."):
                continue
            if is_parameter_of_any(name):
                continue  # of a section for all nodes, `/**`
            close = difflib.get_close_matches(name, known, n=1)
            hint = f"; did you mean '{close[0]}'?" if close else ""
            node.get_logger().warning(f"parameter '{name}' is unknown and has no effect{hint}")

    def _validated(self, changes: dict[str, Any]) -> Model:
        current = self.values.model_dump() if hasattr(self, "values") else {}
        try:
            return self._model.model_validate({**current, **changes})
        except ValidationError as error:
            raise ParameterError(
                "; ".join(explain(self._model, problem) for problem in error.errors())
            ) from None

    def _on_set(self, parameters: list[Parameter]) -> SetParametersResult:
        changes = {p.name: p.value for p in parameters if p.name in self._model.model_fields}
        if not changes:
            return SetParametersResult(successful=True)
        fixed = [
            name for name in changes if self._configured and extra(self._model.model_fields[name], "fixed")
        ]
        if fixed:
            reason = f"{fixed[0]} can only be set while the node is unconfigured: clean it up first"
            return SetParametersResult(successful=False, reason=reason)
        try:
            values = self._validated(changes)
        except Exception as error:  # a ParameterError, or what a validator has not thought of
            return SetParametersResult(successful=False, reason=str(error))
        self.values = values
        return SetParametersResult(successful=True)


def describe(name: str, field: FieldInfo) -> ParameterDescriptor:
    """ROS descriptor of a field: description, range, whether it is read only."""
    unit = extra(field, "unit")
    descriptor = ParameterDescriptor(
        description=f"{field.description}{f' [{unit}]' if unit else ''}",
        additional_constraints=allowed(field),
        read_only=name in AT_THE_START,
        dynamic_typing=field.annotation is float,
    )
    lower, upper = bounds(field)
    if lower is not None and upper is not None:
        if field.annotation is int:
            descriptor.integer_range = [IntegerRange(from_value=int(lower), to_value=int(upper), step=1)]
        else:
            descriptor.floating_point_range = [
                FloatingPointRange(from_value=float(lower), to_value=float(upper))
            ]
    return descriptor
