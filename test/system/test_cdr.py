"""Messages read by `whereabouts.messages.cdr` beside rclpy's own reading, of random content."""

from __future__ import annotations

import re
from typing import Any

import numpy as np
import pytest
from rclpy.serialization import serialize_message

from whereabouts.console.heard import TOPICS
from whereabouts.messages.cdr import UnreadableTypeError, reader
from whereabouts.nodes.messages.message_types import definition, message_class

WORDS = ("", "a", "cup", "réd", "living room", "x" * 37)


def filled(type_name: str, rng: np.random.Generator) -> Any:
    """A message of random content; every array may be empty."""
    message = message_class(type_name)()
    for name, kind in message.get_fields_and_field_types().items():
        found = re.fullmatch(r"sequence<(.+?)(?:, \d+)?>|(.+)\[(\d+)\]", kind)
        if found is None:
            setattr(message, name, value(kind, rng))
        else:
            count = int(found[3]) if found[2] else int(rng.integers(0, 4))
            setattr(message, name, [value(found[1] or found[2], rng) for _ in range(count)])
    return message


def value(kind: str, rng: np.random.Generator) -> Any:
    if "/" in kind:
        return filled(kind.replace("/", "/msg/"), rng)
    if kind == "string":
        return str(rng.choice(WORDS))
    if kind == "boolean":
        return bool(rng.integers(2))
    if kind in ("double", "float"):
        return float(np.float32(rng.normal()))
    if kind == "octet":
        return bytes([int(rng.integers(256))])
    return int(rng.integers(0, 100))


def plain(message: Any) -> Any:
    """As lists, texts and numbers."""
    if isinstance(message, (str, bool, int, float)):
        return message
    if isinstance(message, bytes):
        return message[0]
    if isinstance(message, np.generic):
        return message.item()
    if hasattr(message, "get_fields_and_field_types"):
        return {name: plain(getattr(message, name)) for name in message.get_fields_and_field_types()}
    if hasattr(message, "__dict__"):
        return {name: plain(each) for name, each in vars(message).items()}
    return [plain(each) for each in message]


@pytest.mark.parametrize("type_name", sorted(set(TOPICS.values())))
def test_every_message_is_read_as_rclpy_reads_it(type_name: str) -> None:
    read = reader(type_name, definition(type_name))
    rng = np.random.default_rng(7)
    for _ in range(30):
        message = filled(type_name, rng)
        data = serialize_message(message)
        assert plain(read(data)) == plain(message)
        with pytest.raises(ValueError, match=r"."):
            read(data[: len(data) // 2])


def test_what_cannot_be_read_is_refused() -> None:
    read = reader("std_msgs/msg/String", "string data")
    assert read(bytes([0, 1, 0, 0, 3, 0, 0, 0]) + b"ab\0").data == "ab"
    for data in (b"", b"\0\0\0\0\0\0\0\3ab\0", bytes([0, 1, 0, 0]) + b"\xff" * 4):
        with pytest.raises(ValueError, match=r"."):
            read(data)
    for wrong in ("", "wstring data", "no definition"):
        with pytest.raises(UnreadableTypeError):
            reader("std_msgs/msg/Wide", wrong)
