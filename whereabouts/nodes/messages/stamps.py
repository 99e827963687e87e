"""Message stamps as integers: nanoseconds compare and subtract without rounding."""

from __future__ import annotations

from builtin_interfaces.msg import Duration, Time

from whereabouts.messages.decode import nanoseconds, seconds
from whereabouts.system.clocks import NANOSECONDS

__all__ = ["NANOSECONDS", "duration_message", "nanoseconds", "seconds", "time_message"]


def time_message(total: int) -> Time:
    return Time(sec=total // NANOSECONDS, nanosec=total % NANOSECONDS)


def duration_message(seconds: float) -> Duration:
    total = round(seconds * NANOSECONDS)
    return Duration(sec=total // NANOSECONDS, nanosec=total % NANOSECONDS)
