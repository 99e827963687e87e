"""Settings of a library as fields of a dataclass: each says its unit, its meaning and its allowed values.

ROS parameters, their files and pages are made from the same fields.
"""

from __future__ import annotations

import numbers
from collections.abc import Sequence
from dataclasses import field, fields
from typing import Any

from estimation.errors import InputError


def setting(
    default: Any,
    unit: str,
    text: str,
    low: float | None = None,
    high: float | None = None,
    choices: Sequence[str] = (),
) -> Any:
    """A field of a dataclass of settings: its unit, meaning and inclusive range, or the words it takes."""
    metadata: dict[str, Any] = {"unit": unit, "description": text}
    if low is not None:
        metadata |= {"low": low, "high": high}
    if choices:
        metadata["choices"] = tuple(choices)
    return field(default=default, metadata=metadata)


def check_settings(settings: Any) -> None:
    """Raises InputError naming the first setting that is out of its range or none of its choices."""
    for item in fields(settings):
        value, about = getattr(settings, item.name), item.metadata
        if isinstance(item.default, bool) and not isinstance(value, bool):
            raise InputError(f"{item.name}: true or false expected, got {value!r}")
        if "choices" in about and not (isinstance(value, str) and value in about["choices"]):
            raise InputError(f"{item.name}: one of {', '.join(about['choices'])} expected, got {value!r}")
        if "low" in about:
            number = isinstance(value, numbers.Real) and not isinstance(value, bool)
            if not number or not about["low"] <= value <= about["high"]:
                raise InputError(
                    f"{item.name}: {about['low']:g} to {about['high']:g} expected, got {value!r}"
                )
