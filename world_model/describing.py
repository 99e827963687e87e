"""Objects in people's words: the small green bowl (book-1), how sure that is, and how long ago it was seen.

A symbol is a stable name and says nothing about what a thing is: it was given when little was known. What people read
is the class, as it is believed now, with the symbol in brackets.
"""

from __future__ import annotations

import math
from collections.abc import Iterable

from world_model.state import SURE, WorldObject

LIKELY = 0.5  # up to it no class and no colour is said: another is as likely
COLOR = "color"


def named(item: WorldObject, adjectives: Iterable[str] = ()) -> str:
    """ "the green bowl (book-1)", "the bowl, 0.74 (book-1)" where its class is in doubt, "book-1" where it is unknown.

    adjectives : further symbols that hold of it, such as "small".
    """
    classes = item.attributes.get("class", {})
    kind = item.most_probable("class")
    share = float(classes.get(kind, 0.0))
    if not kind or share <= LIKELY:
        return item.id
    color = item.most_probable(COLOR)
    words = [word for word in adjectives if word not in (kind, color)]
    if color and item.attributes[COLOR][color] > LIKELY:
        words.append(color)
    what = " ".join(word.replace("_", " ") for word in (*words, kind))
    if what == item.id:
        return f"the {what}"
    return f"the {what} ({item.id})" if share >= SURE else f"the {what}, {share:.2f} ({item.id})"


def ago(seconds: float) -> str:
    """ "3 min ago"; "now" for less than 5 s, "long ago" for what was never measured."""
    if not math.isfinite(seconds):
        return "long ago"
    return "now" if seconds < 5.0 else f"{spoken_time(seconds)} ago"


def spoken_time(seconds: float) -> str:
    """ "40 s", "20 min", "3 h", "4 days"."""
    for unit, length, most in (("s", 1, 90), ("min", 60, 120), ("h", 3600, 48)):
        if seconds < most * length:
            return f"{seconds / length:.0f} {unit}"
    return f"{seconds / 86400:.0f} days"
