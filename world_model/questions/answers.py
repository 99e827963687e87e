"""What an answer is, and how moments, durations and probabilities are put into words."""

from __future__ import annotations

import re
from collections.abc import Iterable, Mapping
from dataclasses import asdict, dataclass
from datetime import datetime
from typing import Any

from estimation.errors import InputError
from world_model.describing import LIKELY
from world_model.state import SURE

_UNPRINTABLE = re.compile(r"[\x00-\x1f\x7f-\x9f\u2028\u2029\u202a-\u202e\u2066-\u2069]+")


class NotUnderstoodError(InputError):
    """The question is none of those that can be asked."""


class NothingKnownError(InputError):
    """The question is about something that nothing is known of; the message says what is known."""


class AmbiguousError(InputError):
    """The question fits several things. choices : their names."""

    def __init__(self, message: str, choices: Iterable[str]) -> None:
        super().__init__(message)
        self.choices = tuple(choices)


@dataclass(frozen=True)
class Answer:
    """One sentence and the record behind it.

    sentence : for people. kind : the function that answered ("where_is"), "not_understood", "unknown" or "choices".
    probability : that the answer is right, in [0, 1]. stamp : the moment that the answer is about, ISO 8601 with
    offset, "" where there is none. value : the answer for programs (a place, names, a number, an ISO 8601 moment),
    None where nothing is known. evidence : what was seen, {"object", "event", "place", "stamp"}. alternatives : other
    answers, {"object" and/or "place", "probability"}. choices : what an ambiguous question may mean.
    """

    sentence: str
    kind: str
    probability: float = 0.0
    stamp: str = ""
    value: Any = None
    evidence: tuple[Mapping[str, Any], ...] = ()
    alternatives: tuple[Mapping[str, Any], ...] = ()
    choices: tuple[str, ...] = ()

    @classmethod
    def stated(cls, sentence: str, kind: str, probability: float, stamp: float, *more: Any) -> Answer:
        """One whose sentence ends with its probability. stamp : s since 1970. more : the fields from `value` on."""
        return cls(f"{sentence}, {told(probability)}.", kind, probability, iso(stamp), *more)

    @property
    def understood(self) -> bool:
        """Whether the question is one that can be asked."""
        return self.kind != "not_understood"

    def to_dict(self) -> dict[str, Any]:
        """As JSON-able data."""
        return asdict(self)


def clean(text: str, longest: int = 80) -> str:
    """A name for a sentence: one line, nothing that a terminal obeys."""
    shown = _UNPRINTABLE.sub(" ", str(text)).strip()
    return shown if len(shown) <= longest else f"{shown[: longest - 1]}…"


def iso(stamp: float) -> str:
    """ISO 8601 with offset, local time, of s since 1970."""
    try:
        return datetime.fromtimestamp(stamp).astimezone().isoformat(timespec="seconds")
    except (ValueError, OverflowError, OSError):
        return ""


def clock(stamp: float) -> str:
    """ "2026-11-21 09:12", local time."""
    return iso(stamp)[:16].replace("T", " ")


def duration(seconds: float) -> str:
    """ "3 days 2 h", "2 h 10 min", "40 s"."""
    whole = max(round(seconds), 0)
    if whole < 120:
        return f"{whole} s"
    minutes = round(whole / 60)
    days, hours, minutes = minutes // 1440, minutes // 60 % 24, minutes % 60
    parts = [f"{days} day{'s' if days > 1 else ''}" if days else "", f"{hours} h" if hours else ""]
    parts += [f"{minutes} min" if minutes and not days else ""]
    return " ".join(part for part in parts if part)


def hedged(probability: float, verb: str = "is") -> str:
    """ "is", "is probably" or "may be"; of the past "was", "was probably", "may have been"."""
    if probability >= SURE:
        return verb
    if probability >= LIKELY:
        return f"{verb} probably"
    return "may have been" if verb in ("was", "were") else "may be"


def listed(parts: Iterable[str], most: int = 12, final: str = "and") -> str:
    """ "a, b and c"; of very many the first."""
    given = list(parts)
    if len(given) > most:
        given = [*given[:most], f"{len(given) - most} more"]
    return given[0] if len(given) == 1 else f"{', '.join(given[:-1])} {final} {given[-1]}" if given else ""


def told(probability: float) -> str:
    """ "p = 0.97"."""
    return f"p = {min(probability, 0.99):.2f}"
