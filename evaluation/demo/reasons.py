"""Why the robot looks somewhere, in plain words."""

from __future__ import annotations

import math
import re

ASKED = re.compile(r"^(?P<who>.+) asked for it\.$")
DRIVEN = re.compile(r"^Driving (?P<metres>[0-9.]+) m ")
NEAR = 0.5
"""m: what is that near is on the way."""


def plain(reason: str, name: str, unseen: float) -> str:
    """A reason of world_maintenance for people.

    name : of the thing. unseen : s since it was seen last, nan where that is not known.
    """
    asked = ASKED.match(reason)
    if asked is not None:
        who = asked["who"]
        return f"looked again at the {name}, asked for by {who}"
    parts = [f"not seen for {lasting(unseen)}"] if unseen >= 5.0 else []
    driven = DRIVEN.match(reason)
    if driven is not None:
        metres = float(driven["metres"])
        parts.append(
            "on the way" if metres <= NEAR else f"{metres:.0f} m away" if metres >= 1.0 else "near by"
        )
        if "on the way" in reason and metres > NEAR:
            parts.append("others on the way")
        if "this tour" in reason:
            parts.append("more on the same round")
    return f"looked again at the {name}: {', '.join(parts) or reason}"


def lasting(seconds: float) -> str:
    """ "40 s", "6 min", "3 h", "2 days"."""
    if not math.isfinite(seconds):
        return "long"
    for unit, length, most in (("s", 1.0, 90.0), ("min", 60.0, 5400.0), ("h", 3600.0, 172800.0)):
        if seconds < most:
            return f"{seconds / length:.0f} {unit}"
    return f"{seconds / 86400.0:.0f} days"
