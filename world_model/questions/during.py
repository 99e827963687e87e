"""What was at a place at any time of a span, for how long, when last, and what has left it."""

from __future__ import annotations

from collections.abc import Iterable

from world_model.questions.answers import (
    Answer,
    clean,
    clock,
    duration,
    iso,
    listed,
    objects_at,
    ranked,
    stated,
)
from world_model.questions.moments import Span
from world_model.questions.naming import described, one_named, place_named, plain, spoken, things_named
from world_model.questions.past import Change, When, changes_of, moves_at, since_when, told_change
from world_model.questions.recall import Recall, Timeline, Trust
from world_model.questions.where import evidence_of, within
from world_model.state import DAY

FOUND, NOT_FOUND = 0.96, Trust.NOT_SEEN
"""That something was where it was seen at some time; that it was nowhere else between the looks."""
AT_FIRST = 4.0 * DAY  # s: of the end of a span, in which it is looked for first when something left a place


def shares_at(world: Recall, place: str, span: Span, ids: Iterable[str] | None = None) -> dict[str, float]:
    """Share of a span that each object was at a place, of those that were; of all things where `ids` is None."""
    names = world.things() if ids is None else ids
    found = {}
    for name in names:
        seconds = world.inside(place, world.window(name, span.start, span.end).spent(span.start, span.end))
        if seconds > 0.0:
            found[name] = seconds / max(span.end - span.start, 1.0)
    return found


def what_was_at(world: Recall, place: str, when: Span) -> Answer:
    """What was at a place at any time of a span. value : ids, what was longest there first.

    Raises NothingKnownError, AmbiguousError.
    """
    where, span = place_named(world, place), within(world, when)
    shares = shares_at(world, where, span)
    there = ranked(shares)
    named = [described(world, name) + _part(shares[name]) for name in there]
    verb = "was" if len(there) == 1 else "were"
    probability = Trust.SEEN * Trust.EACH ** len(there) if there else NOT_FOUND
    told_of = f"{listed(named, 20)} {verb}" if there else "Nothing that I know of was"
    sentence = f"{told_of} {spoken(world, where)} {span.between}"
    options = objects_at(where, {name: shares[name] for name in there}, "share")
    return stated(sentence, "what_is_at", probability, span.start, there, (), options)


def _part(share: float) -> str:
    return "" if share >= 0.95 else f" ({max(100 * share, 1):.0f} % of the time)"


def was_at(world: Recall, what: str, place: str, when: Span) -> Answer:
    """Whether an object, or one of a class, was at a place at any time of a span. value : bool.

    Raises NothingKnownError, AmbiguousError.
    """
    where, span = place_named(world, place), within(world, when)
    meant = things_named(world, what, past=True)
    shares = shares_at(world, where, span, meant.ids)
    if shares:
        names = [
            f"{described(world, name)} was {spoken(world, where)}{_part(shares[name])}"
            for name in ranked(shares)
        ]
        sentence = f"Yes, {listed(names)} {span.between}"
    else:
        sentence = f"No, I know of no {clean(plain(what))} that was {spoken(world, where)} {span.between}"
    best = max(shares, key=shares.__getitem__, default=meant.ids[0])
    evidence = evidence_of(world, world.window(best, span.start, span.end), span.start, span.end)
    return stated(sentence, "is_at", FOUND if shares else NOT_FOUND, span.start, bool(shares), evidence)


def how_long_at(world: Recall, what: str, place: str, when: Span) -> Answer:
    """How long of a span an object was at a place, or anywhere. value : s.

    Raises NothingKnownError, AmbiguousError.
    """
    name, span = one_named(world, what), within(world, when)
    where = place_named(world, place) if place else ""
    line = world.window(name, span.start, span.end)
    by_place = line.spent(span.start, span.end)
    if where:
        long = world.inside(where, by_place) + 0.0
        said = f"{described(world, name)} was {spoken(world, where)} for {duration(long)}"
    else:
        long = sum(by_place.values())
        parts = [f"{spoken(world, each)} for {duration(seconds)}" for each, seconds in by_place.items()]
        said = f"{described(world, name)} was {listed(parts) or 'not seen'}"
    evidence = evidence_of(world, line, span.start, span.end)
    return stated(f"{said} {span.between}", "how_long_there", Trust.NOT_SEEN, span.start, long, evidence)


def when_last_at(world: Recall, what: str, place: str) -> Answer:
    """When an object was at a place last. value : ISO 8601, None where never. Raises NothingKnownError."""
    name, where = one_named(world, what), place_named(world, place)
    line = world.latest(name)
    if line.cut and not any(world.contains(where, stay.place) for stay in line.stays):
        line = world.timeline(name)
    stays = [stay for stay in line.stays if world.contains(where, stay.place)]
    if not stays:
        first = clock(line.stays[0].since) if line.stays else "the beginning"
        sentence = f"{described(world, name)} was never {spoken(world, where)} since {first}"
        return stated(sentence, "when_last_seen", NOT_FOUND, world.now, None)
    last = stays[-1]
    is_there = last is line.stays[-1] and not line.lost
    until = f"is {spoken(world, where)} since" if is_there else f"was {spoken(world, where)} last until"
    stamp = last.since if is_there else last.until
    seen = iso(world.now if is_there else stamp)
    evidence = evidence_of(world, line, last.since, last.until)
    sentence = f"{described(world, name)} {until} {clock(stamp)}"
    return stated(sentence, "when_last_seen", FOUND, stamp, seen, evidence)


def what_moved(world: Recall, since: When = None, place: str = "") -> Answer:
    """Every move within a span, or of the last day, also of what is back where it was; to or from a place.

    value : [[object, from, to, stamp], ...], None for nowhere. Raises NothingKnownError, AmbiguousError, InputError.
    """
    where = place_named(world, place) if place else ""
    span = since_when(world, since, DAY)
    moves = sorted(moves_at(world, where, span), key=lambda change: change.end)
    at = f" {spoken(world, where)}" if where else ""
    before = f"{len(moves) - 12} moves before; " if len(moves) > 12 else ""
    parts = "; ".join(told_change(world, move) for move in moves[-12:])
    told_of = f"Moved{at} {span.between}: {before}{parts}"
    if not moves:
        told_of = f"Nothing that I know of was moved{at} {span.between}"
    value = [[move.object, move.before, move.after, iso(move.end)] for move in moves]
    return stated(told_of, "what_moved", Trust.SEEN * Trust.EACH ** len(moves), span.start, value)


def what_left(world: Recall, place: str, since: When = None) -> Answer:
    """What was at a place at the beginning of a span, or at any time of the last day, and is no longer there.

    value : {id: place where it is, None where nobody knows}. Raises NothingKnownError, AmbiguousError.
    """
    where = place_named(world, place)
    span = since_when(world, since, DAY)
    parts, value = [], {}
    for name in world.heads(world.active(span.start, span.end)):
        line, last = _last_leaving(world, name, where, span)
        stay = line.stays[-1] if line.stays else None
        here = stay is not None and not line.lost and world.contains(where, stay.place)
        if last is not None and not here:
            value[name] = None if line.lost or stay is None else stay.place
            parts.append(told_change(world, last))
    period = f"since {clock(span.start)}"
    probability = Trust.SEEN * Trust.EACH ** len(parts)
    sentence = (
        f"No longer {spoken(world, where)}, {period}: {listed(parts)}"
        if parts
        else f"Nothing that I know of has left the place {spoken(world, where)} {period}"
    )
    return stated(sentence, "what_left", probability, span.start, value)


def _last_leaving(world: Recall, name: str, where: str, span: Span) -> tuple[Timeline, Change | None]:
    """The last time within a span that an object left a place, and its timeline from before that on.

    It is looked for from the end: of a year most often only days are read.
    """
    long = AT_FIRST
    while True:
        start = max(span.start, span.end - long)
        line = world.since(name, start)
        left = [
            change
            for change in changes_of(line, start, span.end)
            if change.before is not None and world.contains(where, change.before)
            and (change.after is None or not world.contains(where, change.after))
        ]  # fmt: skip
        if left or start <= max(span.start, 0.0):
            return line, left[-1] if left else None
        long *= 8.0
