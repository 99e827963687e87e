"""Who was at a place, from when to when, and what was moved meanwhile."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from estimation.checks import FloatArray
from estimation.places import Place
from world_model.questions.answers import Answer, clean, clock, iso, listed, told
from world_model.questions.moments import Span
from world_model.questions.naming import place_named, spoken
from world_model.questions.past import Change, changes_of, since_when, told_change
from world_model.questions.recall import PERSON, Recall

BESIDE = 1.0
"""m: who is that close to a piece of furniture is at it."""
PAUSE = 900.0
"""s: who is back within it has not been away."""


@dataclass(frozen=True)
class Visit:
    """One person at a place from `start` to `end`, s."""

    person: str
    start: float
    end: float


def who_was_here(world: Recall, place: str = "", since: str | float | Span | None = None) -> Answer:
    """Who was at a place, or anywhere, since a moment (default: of the last day), and what was moved meanwhile.

    value : [[person, from, until, [objects]], ...]. Raises NothingKnownError, AmbiguousError, InputError.
    """
    span = since_when(world, since if since is not None else Span(world.now - 86400.0, world.now))
    where = place_named(world, place) if place and place != "here" else ""
    visits = visits_of(world, where, span)
    changes = _changes(world, where, span)
    value: list[list[Any]] = []
    parts, evidence = [], []
    for visit in visits:
        during = [change for change in changes if change.start <= visit.end and change.end >= visit.start]
        value.append([visit.person, iso(visit.start), iso(visit.end), [change.object for change in during]])
        with_what = f" ({listed(told_change(world, change) for change in during)})" if during else ""
        parts.append(f"{clean(visit.person)} from {clock(visit.start)} to {clock(visit.end)[11:]}{with_what}")
        evidence.append({"object": visit.person, "event": "seen", "place": where, "stamp": iso(visit.start)})
    at = spoken(world, where) if where else "here"
    period = (
        f"since {clock(span.start)}"
        if span.end >= world.now - 1.0
        else f"between {clock(span.start)} and {clock(span.end)}"
    )
    probability = 0.97 if visits else 0.95
    if visits:
        sentence = f"{_people(visits)} {at} {period}: {'; '.join(parts[-8:])}, {told(probability)}."
    else:
        sentence = f"I have seen nobody {at} {period}, {told(probability)}."
    return Answer(sentence, "who_was_here", probability, iso(span.start), value, tuple(evidence[-8:]))


def _people(visits: list[Visit]) -> str:
    count = len({visit.person for visit in visits})
    return f"{count} {'person was' if count == 1 else 'people were'}"


def visits_of(world: Recall, place: str, span: Span) -> list[Visit]:
    """Visits of people within a span, in order of time."""
    found: list[Visit] = []
    for name in _persons(world, span):
        stamps, positions = _track(world, name, span)
        inside = stamps[_at(world.places[place], positions)] if place else stamps
        found += _joined(name, inside)
    return sorted(found, key=lambda visit: visit.start)


def _persons(world: Recall, span: Span) -> list[str]:
    return [name for name in world.active(span.start, span.end) if world.kind(name) == PERSON]


def _track(world: Recall, name: str, span: Span) -> tuple[FloatArray, FloatArray]:
    """Stamps (N,) and positions (N, 3) at which a person was seen."""
    found: dict[float, FloatArray] = {}
    if world.store is not None:
        for _, event, numbers, existence, lost, seen, _ in world.store.sights(
            name, world.epochs.get(name, world.epoch), span.start
        ):
            if event != "gone" and not lost and existence >= 0.5:
                found[seen] = np.frombuffer(numbers, "<f8")
    item = world.present.get(name)
    if item is not None and not item.lost:
        found[item.last_seen] = item.position
    kept = sorted(stamp for stamp in found if span.start <= stamp <= span.end)
    return np.array(kept), np.array([found[stamp] for stamp in kept]).reshape(-1, 3)


def _at(place: Place, positions: FloatArray) -> Any:
    """Whether people stand in a room, or in or beside a piece of furniture."""
    inside = place.contains(positions[:, :2])
    if place.kind == "room" or not len(positions):
        return inside
    corners = place.polygon
    along = np.roll(corners, -1, axis=0) - corners
    offset = positions[:, None, :2] - corners
    share = np.clip((offset * along).sum(-1) / np.maximum((along**2).sum(-1), 1e-12), 0.0, 1.0)
    apart = np.linalg.norm(offset - share[..., None] * along, axis=-1).min(1)
    return inside | (apart <= BESIDE)


def _joined(name: str, stamps: FloatArray) -> list[Visit]:
    visits: list[Visit] = []
    for stamp in stamps.tolist():
        if visits and stamp - visits[-1].end <= PAUSE:
            visits[-1] = Visit(name, visits[-1].start, stamp)
        else:
            visits.append(Visit(name, stamp, stamp))
    return visits


def _changes(world: Recall, where: str, span: Span) -> list[Change]:
    """What was moved at a place within a span."""
    found = []
    for name in world.heads(world.active(span.start, span.end)):
        for change in changes_of(world.since(name, span.start), span.start, span.end):
            ends = [place for place in (change.before, change.after) if place is not None]
            if change.before not in (None, change.after) and (
                not where or any(world.contains(where, place) for place in ends)
            ):
                found.append(change)
    return found
