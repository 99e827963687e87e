"""Parameters in words, for ROS descriptors, error messages and the README."""

from __future__ import annotations

from typing import Any, get_args

from pydantic.fields import FieldInfo

from whereabouts.parameters.parameter_base import NodeParameters


def extra(field: FieldInfo, name: str) -> Any:
    """`unit` or `fixed` of a field."""
    given = field.json_schema_extra
    return given.get(name) if isinstance(given, dict) else None


def bounds(field: FieldInfo) -> tuple[float | None, float | None]:
    """Inclusive lower and upper bound of a field, None where it has none."""
    lower = next((m.ge for m in field.metadata if hasattr(m, "ge")), None)
    upper = next((m.le for m in field.metadata if hasattr(m, "le")), None)
    return lower, upper


def allowed(field: FieldInfo) -> str:
    """What values a field takes, in words."""
    lower, upper = bounds(field)
    kind = getattr(field.annotation, "__name__", str(field.annotation)).replace("typing.", "")
    if options := get_args(field.annotation):
        listed = ", ".join(getattr(option, "__name__", str(option)) for option in options)
        kind = f"one of {listed}" if kind == "Literal" else f"{kind} of {listed}"
    unit = extra(field, "unit")
    span = "" if lower is None or upper is None else f" from {lower:g} to {upper:g}"
    return f"{kind}{span}{f' {unit}' if unit else ''}"


def explain(model: type[NodeParameters], problem: Any) -> str:
    """One validation problem as a sentence: name, value, allowed values."""
    name = str(problem["loc"][0]) if problem["loc"] else "parameters"
    field = model.model_fields.get(name)
    expected = f"{allowed(field)} expected" if field else problem["msg"]
    if problem["type"] == "value_error":
        expected = problem["msg"].removeprefix("Value error, ")
        if not problem["loc"]:
            return f"parameters: {expected}"
    return f"parameter {name}: {expected}, got {problem['input']!r}"
