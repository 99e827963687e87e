"""Message classes and definitions by type name."""

from __future__ import annotations

import importlib
import os
import re
import sys
from functools import cache
from pathlib import Path
from typing import Any

from estimation.errors import WhereaboutsError

SEPARATOR = "=" * 80
MESSAGE = re.compile(r"(\w+)/(\w+)")  # in the type of a field


class UnknownTypeError(WhereaboutsError):
    """A message type of which no Python module is installed."""


@cache
def message_class(type_name: str) -> Any:
    """Class of a type such as "sensor_msgs/msg/LaserScan".

    Raises UnknownTypeError: its package is not installed here.
    """
    package, _, name = type_name.partition("/msg/")
    try:
        return getattr(importlib.import_module(f"{package}.msg"), name)
    except (ImportError, AttributeError):
        raise UnknownTypeError(f"message type {type_name} is not installed") from None


@cache
def definition(type_name: str) -> str:
    """Text of a message definition followed by those of all types it uses, as bags store it; "" if not found."""
    parts: dict[str, str] = {}
    waiting = [type_name]
    while waiting:
        current = waiting.pop(0)
        if current in parts:
            continue
        path = _definition_file(current)
        if path is None:
            return ""
        parts[current] = path.read_text(encoding="utf-8")
        fields = message_class(current).get_fields_and_field_types()
        waiting += [f"{package}/msg/{name}" for package, name in MESSAGE.findall(" ".join(fields.values()))]
    first, *others = parts.items()
    texts = [f"{SEPARATOR}\nMSG: {name.replace('/msg/', '/')}\n{text}" for name, text in others]
    return "\n".join([first[1], *texts])


def _definition_file(type_name: str) -> Path | None:
    package, _, name = type_name.partition("/msg/")
    prefixes = [sys.prefix, *os.environ.get("AMENT_PREFIX_PATH", "").split(os.pathsep)]
    for prefix in filter(None, prefixes):
        path = Path(prefix) / "share" / package / "msg" / f"{name}.msg"
        if path.exists():
            return path
    return None
