"""Message types from the definitions in a bag, decoded by rosbags without a ROS installation."""

from __future__ import annotations

from functools import lru_cache
from typing import Any
from weakref import WeakKeyDictionary

from rosbags.typesys import Stores, get_types_from_idl, get_types_from_msg, get_typestore
from rosbags.typesys.store import Typestore

from whereabouts.logs.bags.storage import Topic
from whereabouts.system.log_errors import UnreadableTypeError

_IDL_SEPARATOR = "=" * 80 + "\nIDL: "
# What `types_of` found for each topic that is still in use, or why there is nothing.
_FOUND: WeakKeyDictionary[Topic, Typestore | str] = WeakKeyDictionary()


@lru_cache(maxsize=1)
def standard_types() -> Typestore:
    """The types of ROS 2 Jazzy."""
    return get_typestore(Stores.ROS2_JAZZY)


def types_of(topic: Topic) -> Typestore:
    """A store that can decode the topic's messages: by the bag's definition, else by Jazzy's.

    Raises UnreadableTypeError: no definition, or one that cannot be parsed.
    """
    found = _FOUND.get(topic)
    if found is None:
        try:
            found = _FOUND[topic] = _parsed(topic)
        except UnreadableTypeError as error:
            found = _FOUND[topic] = f"{topic.type_name} cannot be read: {error}"
    if isinstance(found, str):
        raise UnreadableTypeError(found)
    return found


def _parsed(topic: Topic) -> Typestore:
    if topic.problem:
        raise UnreadableTypeError(topic.problem)
    if not topic.definition:
        if topic.type_name in standard_types().fielddefs:
            return standard_types()
        raise UnreadableTypeError("the bag has no definition of it")
    try:
        store = get_typestore(Stores.EMPTY)
        if topic.definition_format == "ros2idl":
            parts = topic.definition.split(_IDL_SEPARATOR)
            texts = [part.partition("\n")[2] for part in parts[1:]] or parts
            for text in texts:
                store.register(get_types_from_idl(text))
        else:
            store.register(get_types_from_msg(topic.definition, topic.type_name))
    except Exception as error:  # the parser raises whatever a wrong text makes it stumble over
        raise UnreadableTypeError(f"its definition cannot be parsed ({error})") from error
    if topic.type_name not in store.fielddefs:
        raise UnreadableTypeError("its definition is of another type")
    return store


def decoded(topic: Topic, cdr: bytes) -> Any:
    """A message of a topic, its fields as attributes.

    Raises UnreadableTypeError: as `types_of`, or the bytes do not fit the type.
    """
    store = types_of(topic)
    try:
        kind = store.get_msgdef(topic.type_name)
        read = {b"\0\0": kind.deserialize_cdr_be, b"\0\1": kind.deserialize_cdr_le}[bytes(cdr[:2])]
        message, end = read(cdr[4:], 0, kind.cls, store)
    except Exception as error:  # generated code on arbitrary bytes: any error means the same
        raise UnreadableTypeError(f"bytes do not fit {topic.type_name}") from error
    # More may follow: rclpy's serialize_message leaves as many bytes as it thought that it might need.
    if end > len(cdr) - 4:
        raise UnreadableTypeError(f"bytes do not fit {topic.type_name}: they end too early")
    return message
