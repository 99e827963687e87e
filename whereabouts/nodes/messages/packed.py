"""Messages that are unpacked when somebody looks at them.

Making Python objects of a large message takes longer than all that most nodes do with it, and of what comes several
times a second some need one a second.
"""

from __future__ import annotations

import struct
import time
from dataclasses import dataclass
from typing import Any

from rclpy.serialization import deserialize_message

from estimation.errors import InputError
from whereabouts.nodes.messages.envelopes import PAYLOAD, envelope
from whereabouts.nodes.messages.stamps import NANOSECONDS, nanoseconds

# Bytes of an encapsulated message before its first field; the second of them says in which order bytes follow.
PREFIX = 4
# Of a stamp and of the length of the frame's name that follows it.
STAMP, LENGTH = 8, 4


@dataclass(frozen=True)
class Packed:
    """A message as it came; its type begins with a header. Raises InputError where it cannot be one."""

    kind: type
    data: bytes

    def __post_init__(self) -> None:
        least = PREFIX + STAMP + LENGTH
        if not least <= len(self.data) <= PAYLOAD:
            raise InputError(f"{least} to {PAYLOAD} bytes expected, got {len(self.data)}")
        if self.data[0] != 0 or self.data[1] > 1:
            raise InputError(f"a plain encapsulation expected, got {self.data[:2].hex()}")

    @property
    def stamp(self) -> int:
        """Of its header, ns."""
        order = "<" if self.data[1] & 1 else ">"
        seconds, fraction = struct.unpack_from(f"{order}iI", self.data, PREFIX)
        return int(seconds) * NANOSECONDS + int(fraction)

    @property
    def frame(self) -> str:
        """Of its header; "" where it has none that can be read."""
        order, first = "<" if self.data[1] & 1 else ">", PREFIX + STAMP + LENGTH
        (length,) = struct.unpack_from(f"{order}I", self.data, PREFIX + STAMP)
        return self.data[first : first + max(length - 1, 0)].decode("utf-8", "replace")

    def unpack(self) -> Any:
        """The message. Raises InputError where the bytes are none, or its contents are outside of its envelope."""
        try:
            message = deserialize_message(self.data, self.kind)
        except Exception as error:  # whatever the middleware makes of such bytes
            raise InputError(
                f"{len(self.data)} bytes cannot be read as {self.kind.__name__}: {error}"
            ) from None
        envelope(self.kind).check(message)
        return message


class MessageOpener:
    """Looks at messages of one type, `kind`, as they come. packed : whether they stay as they are; see `Packed`.

    stamped : whether they have a header. envelope : what they must be inside of.
    """

    def __init__(self, kind: Any, packed: bool) -> None:
        self.kind, self.packed = kind, packed
        self.envelope = envelope(kind)
        self.stamped = "header" in kind.get_fields_and_field_types()

    def stamp_of(self, message: Any) -> int:
        """ns; now where it does not say."""
        if isinstance(message, Packed):
            return message.stamp
        return nanoseconds(message.header.stamp) if self.stamped and not self.packed else time.time_ns()

    def open(self, message: Any) -> Any:
        """A message that is inside of its envelope. Raises InputError for any other."""
        if self.packed:
            return Packed(self.kind, message)
        self.envelope.check(message)
        return message

    def size(self, message: Any) -> int:
        return len(message.data) if self.packed else self.envelope.size(message)
