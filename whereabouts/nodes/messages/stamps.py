"""Message stamps as integers: nanoseconds compare and subtract without rounding."""

from __future__ import annotations

from builtin_interfaces.msg import Duration, Time

NANOSECONDS = 1_000_000_000


def nanoseconds(stamp: Time | Duration) -> int:
    """A message stamp in nanoseconds."""
    return int(stamp.sec) * NANOSECONDS + int(stamp.nanosec)


def seconds(stamp: Time | Duration) -> float:
    """A message stamp in seconds."""
    return nanoseconds(stamp) / NANOSECONDS


def time_message(total: int) -> Time:
    """Nanoseconds as a message stamp."""
    return Time(sec=total // NANOSECONDS, nanosec=total % NANOSECONDS)


def duration_message(seconds: float) -> Duration:
    """Seconds as a message."""
    total = round(seconds * NANOSECONDS)
    return Duration(sec=total // NANOSECONDS, nanosec=total % NANOSECONDS)
