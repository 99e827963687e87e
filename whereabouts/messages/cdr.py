"""Messages as DDS sends them (CDR, little endian) read in a fraction of the time that rclpy takes for nested ones.

A function is made for each type from its definition. Fields become attributes, numbers in arrays numpy arrays.
"""

from __future__ import annotations

import struct
from collections.abc import Callable, Iterable
from types import SimpleNamespace
from typing import Any

import numpy as np
from rosbags.interfaces import Nodetype
from rosbags.typesys import get_types_from_msg

HEAD = 4
LITTLE = 1
FORMATS = {
    "bool": "?", "byte": "B", "char": "B", "int8": "b", "uint8": "B", "int16": "h", "uint16": "H", "int32": "i",
    "uint32": "I", "int64": "q", "uint64": "Q", "float32": "f", "float64": "d",
}  # fmt: skip
"""Of `struct` and numpy. Strings of wide characters are not read."""


class UnreadableTypeError(Exception):
    """Messages of a type cannot be read: no definition, or fields that cannot be read here; the message says which."""


def reader(type_name: str, definition: str) -> Callable[[bytes], Any]:
    """What makes a message of its bytes; that raises ValueError where they do not fit.

    type_name : such as "nav_msgs/msg/Odometry". definition : its text and those of all types it uses, as bags have it.
    Raises UnreadableTypeError.
    """
    if not definition.strip():
        raise UnreadableTypeError(f"{type_name}: its definition is not at hand")
    names: dict[str, Any] = {"new": SimpleNamespace, "array": np.frombuffer, "text": _text}
    names |= {f"read_{base}": struct.Struct(f"<{code}").unpack_from for base, code in FORMATS.items()}
    try:
        types = get_types_from_msg(definition, type_name)
    except Exception as error:  # the parser raises whatever a wrong text makes it stumble over
        raise UnreadableTypeError(f"{type_name}: its definition cannot be parsed ({error})") from error
    for name, (_, fields) in types.items():
        lacking = [kind for kind in map(_inner, (kind for _, kind in fields)) if kind and kind not in types]
        if lacking:
            raise UnreadableTypeError(f"{type_name}: {lacking[0]} is not in its definition")
        exec("\n".join(_function(name, fields)), names)
    first = names[_called(type_name)]

    def read(data: bytes) -> Any:
        if len(data) < HEAD or data[1] != LITTLE:
            raise ValueError("no message of this kind of machine")
        try:
            return first(memoryview(data)[HEAD:], 0)[0]
        except struct.error as error:
            raise ValueError(f"the message ends too early: {error}") from error

    return read


def _inner(kind: Any) -> str:
    """The type of a field that is a message, or has some; "" else."""
    node, what = kind
    if node in (Nodetype.ARRAY, Nodetype.SEQUENCE):
        return _inner(what[0])
    return str(what) if node == Nodetype.NAME else ""


def _text(data: memoryview, start: int, size: int) -> str:
    if start + size > len(data):
        raise ValueError("a text ends after the message")
    return str(data[start : start + max(size - 1, 0)], "utf-8")


def _called(type_name: str) -> str:
    return "of_" + type_name.replace("/", "_")


def _function(type_name: str, fields: Iterable[tuple[str, Any]]) -> list[str]:
    """Source of a function that reads one type: (bytes after the head, position) -> (message, position)."""
    lines, kept = [f"def {_called(type_name)}(d, p):"], []
    for number, (name, kind) in enumerate(fields):
        lines += [f"    {line}" for line in _field(f"v{number}", kind)]
        if name != "structure_needs_at_least_one_member":
            kept.append(f"{name}=v{number}")
    return [*lines, f"    return new({', '.join(kept)}), p"]


def _field(value: str, kind: Any) -> list[str]:
    node, what = kind
    if node == Nodetype.NAME:
        return [f"{value}, p = {_called(what)}(d, p)"]
    if node == Nodetype.BASE:
        return _text_field(value) if what[0] == "string" else _number(value, what[0])
    inner, count = what
    lines = [f"n = {count}"] if node == Nodetype.ARRAY else _number("n", "uint32")
    if inner[0] == Nodetype.BASE and inner[1][0] != "string":
        code = _code(inner[1][0])
        size = struct.calcsize(f"<{code}")
        # Of no numbers not even the first one is aligned.
        lines += [f"if n: p = p + {size - 1} & -{size}", f"{value} = array(d, '<{code}', n, p if n else 0)"]
        return [*lines, f"p += {size} * n"]
    item = f"{value}i"
    body = _field(item, inner)
    return [
        *lines,
        f"{value} = []",
        "for _ in range(n):",
        *(f"    {line}" for line in body),
        f"    {value}.append({item})",
    ]


def _number(value: str, base: str) -> list[str]:
    code = _code(base)
    size = struct.calcsize(f"<{code}")
    align = [f"p = p + {size - 1} & -{size}"] if size > 1 else []
    return [*align, f"{value}, = read_{base}(d, p)", f"p += {size}"]


def _text_field(value: str) -> list[str]:
    return [*_number("n", "uint32"), f"{value} = text(d, p, n)", "p += n"]


def _code(base: str) -> str:
    try:
        return FORMATS[base]
    except KeyError:
        raise UnreadableTypeError(f"a field of type {base} cannot be read") from None
