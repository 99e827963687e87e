"""Library settings as ROS parameters: the dataclass that a library documents is the one definition."""

from __future__ import annotations

from dataclasses import MISSING, fields
from typing import Any, Literal, get_type_hints

from whereabouts.parameters.parameter_base import setting


def settings_of(config_type: type) -> dict[str, tuple[Any, Any]]:
    """Fields of a configuration dataclass as fields of a pydantic model, for `pydantic.create_model`.

    Metadata `description`, `unit`, `low`, `high` and `choices` are taken over; all are read at the start only. Fields
    without a description are left out: ROS cannot express them.
    """
    hints = get_type_hints(config_type)
    made: dict[str, tuple[Any, Any]] = {}
    for item in fields(config_type):
        if "description" not in item.metadata:
            continue
        if item.default is MISSING:
            raise TypeError(f"{config_type.__name__}.{item.name} has no plain default")
        about = item.metadata
        kind = Literal[tuple(about["choices"])] if "choices" in about else hints[item.name]
        described = setting(
            item.default,
            about["description"],
            unit=about.get("unit", ""),
            ge=about.get("low"),
            le=about.get("high"),
            fixed=True,
        )
        made[item.name] = (kind, described)
    return made
