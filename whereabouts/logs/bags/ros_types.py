"""Message types from the definitions in a bag, decoded by rosbags without a ROS installation."""

from __future__ import annotations

from functools import lru_cache
from typing import Any

from rosbags.typesys import Stores, get_types_from_idl, get_types_from_msg, get_typestore
from rosbags.typesys.store import Typestore

from whereabouts.logs.bags.storage import Topic
from whereabouts.messages.cdr import UnreadableTypeError

_IDL_SEPARATOR = "=" * 80 + "\nIDL: "


@lru_cache(maxsize=1)
def standard_types() -> Typestore:
    """The types of ROS 2 Jazzy."""
    return get_typestore(Stores.ROS2_JAZZY)


def types_of(topic: Topic) -> Typestore:
    """A store that can decode the topic's messages: by the bag's definition, else by Jazzy's.

    Raises
    ------
    UnreadableTypeError : no definition, or one that cannot be parsed.
    """
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


class Decoder:
    """Decodes messages of one topic."""

    def __init__(self, topic: Topic) -> None:
        self._store = types_of(topic)
        self._type = topic.type_name
        self._to_cdr = topic.to_cdr

    def __call__(self, data: bytes) -> Any:
        """The message, its fields as attributes.

        Raises
        ------
        UnreadableTypeError : the bytes do not fit the type.
        """
        try:
            cdr = data if self._to_cdr is None else self._to_cdr(data)
            return self._store.deserialize_cdr(cdr, self._type)
        except Exception as error:  # generated code on arbitrary bytes: any error means the same
            raise UnreadableTypeError("bytes do not fit the type") from error
