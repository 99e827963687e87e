"""What a reader left out or kept with a remark: counted by reason, with the place of the first example."""

from __future__ import annotations

import re
from copy import deepcopy
from dataclasses import dataclass, field

# Of two reasons that differ by no more than their numbers the first stands for both; names of topics stay apart.
NUMBER = re.compile(r"(?<![\w/.])-?\d[\d.]*(?:e[+-]?\d+)?(?![\w/])")


@dataclass
class Remark:
    """One reason: how often it applied and where it did first (`line 12`, `byte 4096`)."""

    count: int = 0
    first: str = ""


@dataclass
class Summary:
    """Account of one pass over a log.

    records : number of records handed out, by topic.
    skipped : what was not handed out, by reason; numbers in it are those of the first example.
    notes : what was handed out although something about it is unusual (stamps that go backwards), or what is
        to be known about the whole file (it ends in the middle of a chunk).
    """

    records: dict[str, int] = field(default_factory=dict)
    skipped: dict[str, Remark] = field(default_factory=dict)
    notes: dict[str, Remark] = field(default_factory=dict)

    def count(self, topic: str) -> None:
        self.records[topic] = self.records.get(topic, 0) + 1

    def skip(self, reason: str, where: str, count: int = 1) -> None:
        """Count something left out because of `reason`, at `where`."""
        _add(self.skipped, reason, where, count)

    def note(self, reason: str, where: str, count: int = 1) -> None:
        """Count something kept although `reason`, at `where`."""
        _add(self.notes, reason, where, count)

    def clear(self) -> None:
        self.records.clear()
        self.skipped.clear()
        self.notes.clear()

    def update(self, other: Summary) -> None:
        """Add the skips and notes of another account."""
        for reason, remark in other.skipped.items():
            self.skip(reason, remark.first, remark.count)
        for reason, remark in other.notes.items():
            self.note(reason, remark.first, remark.count)

    def copy(self) -> Summary:
        return deepcopy(self)

    @property
    def skipped_count(self) -> int:
        return sum(remark.count for remark in self.skipped.values())

    def lines(self) -> list[str]:
        """One sentence per reason, skips first; empty when there is nothing to say."""
        return [
            *(f"skipped {_sentence(reason, remark)}" for reason, remark in self.skipped.items()),
            *(f"note: {_sentence(reason, remark)}" for reason, remark in self.notes.items()),
        ]


def _sentence(reason: str, remark: Remark) -> str:
    return f"{remark.count} × {reason} (first at {remark.first})"


def _add(where_to: dict[str, Remark], reason: str, where: str, count: int) -> None:
    if reason not in where_to:
        kind = NUMBER.sub("", reason)
        reason = next((known for known in where_to if NUMBER.sub("", known) == kind), reason)
    remark = where_to.setdefault(reason, Remark(first=where))
    remark.count += count
