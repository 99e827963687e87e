"""Message classes and definitions by type name."""

from __future__ import annotations

import importlib
import os
import sys
from functools import cache
from pathlib import Path
from typing import Any

from estimation.errors import WhereaboutsError

SEPARATOR = "=" * 80
PRIMITIVES = frozenset(
    "bool byte char float32 float64 int8 uint8 int16 uint16 int32 uint32 int64 uint64 string wstring".split()  # noqa: SIM905
)


class UnknownTypeError(WhereaboutsError):
    """A message type of which no Python module is installed."""


@cache
def message_class(type_name: str) -> Any:
    """Class of a type such as "sensor_msgs/msg/LaserScan".

    Raises
    ------
    UnknownTypeError : its package is not installed here.
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
        waiting += _used_types(current, parts[current])
    first, *others = parts.items()
    texts = [first[1]]
    for name, text in others:
        texts.append(f"{SEPARATOR}\nMSG: {name.replace('/msg/', '/')}\n{text}")
    return "\n".join(texts)


def _definition_file(type_name: str) -> Path | None:
    package, _, name = type_name.partition("/msg/")
    prefixes = [sys.prefix, *os.environ.get("AMENT_PREFIX_PATH", "").split(os.pathsep)]
    for prefix in filter(None, prefixes):
        path = Path(prefix) / "share" / package / "msg" / f"{name}.msg"
        if path.exists():
            return path
    return None


def _used_types(type_name: str, text: str) -> list[str]:
    """Types of the fields of a definition that are messages themselves."""
    package = type_name.partition("/")[0]
    used = []
    for line in text.splitlines():
        words = line.partition("#")[0].split()
        if len(words) < 2 or "=" in words[1]:
            continue
        base = words[0].partition("[")[0].partition("<")[0]
        if base in PRIMITIVES:
            continue
        owner, slash, name = base.partition("/")
        used.append(f"{owner}/msg/{name.removeprefix('msg/')}" if slash else f"{package}/msg/{base}")
    return used
