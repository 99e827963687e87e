"""What a thing usually does, in one sentence."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from world_model.state import DAY, HOUR

Array = np.ndarray
FEWEST_DAYS = 3  # on which a thing left a place, before it usually does anything


def usual_move(name: str, place: int, ended: Array, slot: int, length: float, places: Sequence[str]) -> str:
    """Where a thing goes from `place`, when, and on how many of the days.

    ended : (M, 3) stays there: slots in which it came and had gone, and the place it went to, or -1. slot : of the
    question. length : of a slot, s. places : names.
    """
    here = places[place]
    ended = _at_this_time(ended[ended[:, 2] >= 0], slot, length)
    day = round(DAY / length)
    days = len(np.unique(ended[:, 1] // day))
    if days < FEWEST_DAYS:
        return (
            f"{name} has left {here} on {days} of the days remembered: too few to tell what it usually does."
        )
    to = int(np.bincount(ended[:, 2]).argmax())
    chosen = ended[ended[:, 2] == to]
    on = len(np.unique(chosen[:, 1] // day))
    return f"{name} usually goes from {here} to {places[to]} {_when(chosen, length)}; {on} of {days} days."


def _at_this_time(ended: Array, slot: int, length: float) -> Array:
    """Of stays (M, 3) those that lasted into the hour around this time of day; all where none did."""
    hour = round(HOUR / length)
    since = (slot + hour // 2 - ended[:, 0]) % round(DAY / length)
    chosen = ended[since <= ended[:, 1] - ended[:, 0] + hour]
    return chosen if len(chosen) else ended


def _when(chosen: Array, length: float) -> str:
    """After so long a stay, or at a time of day: whichever varies less. chosen : (M, 3) stays."""
    lasted = (chosen[:, 1] - chosen[:, 0]) * length
    middle = float(np.median(lasted))
    turn = np.exp(2j * np.pi * (chosen[:, 1] * length % DAY) / DAY)
    clock = float(np.angle(turn.mean())) / (2.0 * np.pi) * DAY % DAY
    off = (chosen[:, 1] * length - clock + DAY / 2.0) % DAY - DAY / 2.0
    if np.median(np.abs(lasted - middle)) <= np.median(np.abs(off)):
        return f"about {_duration(middle)} after it came"
    return f"at about {int(clock // HOUR):02d}:{int(clock % HOUR // 60):02d} UTC"


def _duration(seconds: float) -> str:
    """Minutes up to two hours, hours up to two days, then days."""
    for unit, length, most in (("min", 60, 2.0 * HOUR), ("h", HOUR, 2.0 * DAY)):
        if seconds < most:
            return f"{seconds / length:.0f} {unit}"
    return f"{seconds / DAY:.0f} days"
