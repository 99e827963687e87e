"""Messages that are unpacked when somebody looks at them.

Making Python objects of a large message takes longer than all that most nodes do with it, and of what comes several
times a second some need one a second.
"""

from __future__ import annotations

import struct
from dataclasses import dataclass
from typing import Any

from rclpy.serialization import deserialize_message

from whereabouts.nodes.stamps import NANOSECONDS

# Bytes of an encapsulated message before its first field; the second of them says in which order bytes follow.
PREFIX = 4


@dataclass(frozen=True)
class Packed:
    """A message as it came; its type begins with a header."""

    kind: type
    data: bytes

    @property
    def stamp(self) -> int:
        """Of its header, ns."""
        order = "<" if self.data[1] & 1 else ">"
        seconds, fraction = struct.unpack_from(f"{order}iI", self.data, PREFIX)
        return int(seconds) * NANOSECONDS + int(fraction)

    def unpack(self) -> Any:
        """The message."""
        return deserialize_message(self.data, self.kind)
