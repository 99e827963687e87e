"""ROS 1 messages as ROS 2 messages: the header loses its `seq`, standard types take ROS 2's fields."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

from rosbags.convert.converter import is_same_wireformat, migrate_bytes
from rosbags.interfaces import Nodetype
from rosbags.typesys import Stores, get_types_from_msg, get_typestore
from rosbags.typesys.msg import normalize_msgtype
from rosbags.typesys.store import Typestore

from whereabouts.logs.bags.ros_types import standard_types
from whereabouts.logs.bags.storage import LATCHED, Topic

RENAMED = {"tf/msg/tfMessage": "tf2_msgs/msg/TFMessage"}


def topic_of(name: bytes, connection: dict[bytes, bytes]) -> Topic:
    """The topic a ROS 1 connection is read as; one whose type cannot be converted has a `problem`."""
    topic = name.decode(errors="replace")
    recorded = connection.get(b"type", b"").decode(errors="replace")
    try:
        source_type = normalize_msgtype(recorded)
        definition = connection[b"message_definition"].decode(errors="replace")
        source = get_typestore(Stores.EMPTY)
        source.register(get_types_from_msg(definition, source_type))
        target_type = RENAMED.get(source_type, source_type)
        target = _target_types(source, source_type, target_type)
        text = target.generate_msgdef(target_type, ros_version=2)[0]
        type_hash = target.hash_rihs01(target_type)
        convert = _converter(source, target, source_type, target_type)
    except Exception as error:  # the parser raises whatever a wrong text makes it stumble over
        return Topic(topic, recorded, problem=f"its ROS 1 definition cannot be used ({error!r})")
    qos = (LATCHED,) if connection.get(b"latching") == b"1" else ()
    return Topic(topic, target_type, text, "ros2msg", type_hash, qos, convert)


def _target_types(source: Typestore, source_type: str, target_type: str) -> Typestore:
    """Jazzy's types where it has them; a type of its own keeps its fields, over Jazzy's for what it uses."""
    standard = standard_types()
    if target_type in standard.fielddefs:
        return standard
    store = get_typestore(Stores.EMPTY)
    used: dict[str, Any] = {}
    waiting = list(source.fielddefs)
    while waiting:
        name = waiting.pop()
        if name not in used:
            known = standard.fielddefs if name in standard.fielddefs else source.fielddefs
            used[name] = known[name]
            waiting += [found for _, field in known[name][1] for found in _names_in(field)]
    store.register(used)
    return store


def _names_in(field: Any) -> list[str]:
    """Type names a field description refers to: the field itself, or the elements of its array."""
    kind, detail = field
    if kind in (Nodetype.ARRAY, Nodetype.SEQUENCE):
        kind, detail = detail[0]
    return [detail] if kind == Nodetype.NAME else []


def _converter(
    source: Typestore, target: Typestore, source_type: str, target_type: str
) -> Callable[[bytes], bytes]:
    if is_same_wireformat(source, target, source_type, target_type):
        return lambda data: bytes(target.ros1_to_cdr(data, target_type))
    cache: dict[str, object] = {}

    def migrate(data: bytes) -> bytes:
        migrated = migrate_bytes(
            source, target, source_type, target_type, cache, data, src_is2=False, dst_is2=True
        )
        return bytes(migrated)

    return migrate
