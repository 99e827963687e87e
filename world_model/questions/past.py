"""How often and how long, what changed, moved, left or is missing, what happened to an object, what was where."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, replace
from itertools import pairwise, takewhile, zip_longest

from world_model.memory.stays import AWAY, ObjectStay, Timeline
from world_model.questions.answers import Answer, NothingKnownError, clean, clock, duration, iso, listed, told
from world_model.questions.elsewhere import elsewhere
from world_model.questions.moments import Span, When, moment
from world_model.questions.naming import (
    at_the,
    described,
    name_of,
    one_named,
    place_named,
    spoken,
)
from world_model.questions.recall import LATELY, WEEK, Recall, Trust
from world_model.questions.where import evidence_of, within
from world_model.state import BELIEVED, DAY, PERSON

MANY = 100  # Stays, of which no more are read where no time is given
CONFIRMED = 60.0  # s: what was seen for less may have been a false detection; of less a sentence says nothing


@dataclass(frozen=True)
class Change:
    """An object came, went, or went from one place to another, between two moments. left, came : its stays before and
    after, None where it was not in the world. left_by : when it was found to be gone, if it was nowhere for a while."""

    object: str
    left: ObjectStay | None
    came: ObjectStay | None
    start: float
    end: float
    left_by: float | None = None

    @property
    def before(self) -> str | None:
        """The place it left."""
        return None if self.left is None else self.left.place

    @property
    def after(self) -> str | None:
        """The place it came to."""
        return None if self.came is None else self.came.place

    @property
    def back(self) -> bool:
        """Whether it is where it was."""
        return self.left is not None and self.came is not None and self.left.is_where(self.came)

    @property
    def was_away(self) -> bool:
        """Whether it was nowhere for longer than a look at every place takes."""
        return self.left_by is not None and self.end - self.left_by > AWAY


def since_when(world: Recall, when: When, usual: float = math.inf) -> Span:
    """The span that "since" or a time stands for; the last `usual` s where there is none."""
    if when is None:
        return Span(world.now - usual, world.now)
    if isinstance(when, Span) and when.start == -math.inf:  # "before noon"
        return Span(when.end - usual, when.end, when.words)
    return when if isinstance(when, Span) else Span(moment(when, world.now).start, world.now)


def period_of(world: Recall, span: Span) -> str:
    """ "since 2026-11-21 09:12" of a span that ends now, else when it began and ended."""
    return f"since {clock(span.start)}" if world.is_now(span.end) else span.between


def changes_of(line: Timeline, start: float, end: float) -> list[Change]:
    """What happened to an object within a span."""
    stays = line.stays
    first = stays[:1] if line.begun else ()
    found = [Change(line.id, None, each, each.since, each.since) for each in first]
    found += [
        Change(line.id, before, stay, before.until, stay.since, before.left_by)
        for before, stay in pairwise(stays)
    ]
    if stays and stays[-1].left_by is not None:
        found.append(Change(line.id, stays[-1], None, stays[-1].until, stays[-1].left_by))
    return [change for change in found if start < change.end <= end]


def is_about(world: Recall, change: Change, place: str, way: str = "") -> bool:
    """Whether an object left a place, or came to it: way : only "from" or only "to" it; "" is every place."""
    first, second = (change.after, change.before) if way == "to" else (change.before, change.after)
    if not way:
        return any(end is not None and world.contains(place, end) for end in (first, second))
    away = second is None or second == first or not world.contains(place, second)
    return first is not None and world.contains(place, first) and away


def moves_at(world: Recall, place: str, span: Span, way: str = "") -> list[Change]:
    """What left, or went from one place to another, within a span; from or to a place, where one is said.

    way : as of `is_about`; "to" also what is new, or back, there.
    """
    return [
        change
        for name in world.heads(world.active(span.start, span.end))
        for change in changes_of(world.line(name, span.start, span.end), span.start, span.end)
        if is_about(world, change, place, way)
        and (way == "to" or (change.left is not None and not change.back))
    ]


def how_often(world: Recall, what: str, place: str = "", since: When = None) -> Answer:
    """How often an object was moved, or came to a place. value : number. Raises NothingKnownError, AmbiguousError."""
    name, where, span = one_named(world, what), place_named(world, place), since_when(world, since)
    line, until_now, certain = _line(world, name, span), world.is_now(span.end), 1.0
    gone = line.stays[-1].left_by if line.lost and line.stays else None
    if where:
        count = len(_visits(world, line, where, span))
        said = f"was {spoken(world, where)} {_times(count)}" if count else f"was never {spoken(world, where)}"
    else:
        changes = changes_of(line, span.start, span.end)
        count = sum(None not in (each.left, each.came) and not each.back for each in changes)
        away = sum(each.back and each.was_away for each in changes)
        if gone and until_now:
            # It has gone from where it was, to where nobody has looked yet, or out of the house.
            out = elsewhere(world, line).out
            count, certain = count + (out < 0.5), max(out, 1.0 - out)
        said = f"was moved {_times(count)}" if count else "was not moved"
        said += f", but was away {_times(away)} and came back," if away else ""
    begin = max(span.start, line.stays[0].since if line.stays else world.now)
    until = "" if until_now else f" until {clock(span.end)}"
    there = max(line.at(world.now)[0].values(), default=1.0) if until_now else 1.0
    probability = Trust.SEEN * Trust.EACH**count * there * certain
    missing = f"; it is missing since {clock(gone)}" if gone and begin < gone <= span.end else ""
    sentence = f"{described(world, name)} {said} since {clock(begin)}{until}, {told(probability)}{missing}."
    evidence = evidence_of(line, span.start, span.end)
    options = ({"value": count + 1, "probability": (1.0 - probability) / 2},)
    return Answer(sentence, "how_often", probability, iso(begin), count, evidence, options)


def _line(world: Recall, name: str, span: Span) -> Timeline:
    """As much of a timeline as a span needs; of one without a beginning as much as can be told at once."""
    if math.isfinite(span.start):
        return world.line(name, span.start)
    for line in world.back(name):
        if len(line.stays) > MANY:
            break
    return line


def _visits(world: Recall, line: Timeline, where: str, span: Span) -> list[ObjectStay]:
    """Stays at a place, those that follow each other in one room being one."""
    stays = line.within(span.start, span.end)
    return [
        stay
        for before, stay in zip([None, *stays], stays, strict=False)
        if world.contains(where, stay.place)
        and not (before and not before.gone and world.contains(where, before.place))
    ]


def _times(count: int) -> str:
    return {1: "once", 2: "twice"}.get(count, f"{count} times")


def how_long_there(
    world: Recall, what: str, place: str = "", when: Span | None = None, gone: bool = False
) -> Answer:
    """How long an object has been where it is, or missing; when : how long of that span it was at a place, or
    anywhere; gone : or nowhere. value : s.

    Raises NothingKnownError, AmbiguousError.
    """
    name = one_named(world, what)
    if when is None:
        return _how_long(world, name, place)
    where, span = place_named(world, place), within(world, when)
    line = world.line(name, span.start, span.end)
    by_place = line.spent(span.start, span.end)
    long = world.inside(where, by_place) + 0.0
    if where:
        said = f"was {spoken(world, where)} for {duration(long)}"
    elif gone:
        first = line.stays[0].since if line.stays else span.end
        long = max(span.end - max(span.start, first) - long, 0.0)
        said = f"was away for {duration(long)}"
    else:
        parts = [f"{spoken(world, each)} for {duration(seconds)}" for each, seconds in by_place.items()]
        said = f"was {listed(parts) or 'not seen'}"
    evidence = evidence_of(line, span.start, span.end)
    sentence = f"{described(world, name)} {said} {span.between}"
    return Answer.stated(sentence, "how_long_there", Trust.NOT_SEEN, span.start, long, evidence)


how_long_at = how_long_there


def _how_long(world: Recall, name: str, place: str) -> Answer:
    line = world.latest(name)
    if not line.stays:
        raise NothingKnownError(f"{clean(name)} was never seen for certain.")
    last, now = line.stays[-1], world.now

    def long(said: str, p: float, stamp: float, seconds: float | None, start: float, end: float) -> Answer:
        evidence = evidence_of(line, start, end)
        return Answer(f"{described(world, name)} {said}.", "how_long_there", p, iso(stamp), seconds, evidence)

    if line.lost:
        gone = last.left_by or now
        said = (
            f"has been missing for {duration(now - gone)}, since {clock(gone)} at the latest; before that it was "
            f"{spoken(world, last)} for {duration(last.until - last.since)}"
        )
        return long(said, Trust.NOT_SEEN, gone, now - gone, last.since, gone)
    where = place_named(world, place) if place else last.place

    def is_there(stay: ObjectStay) -> bool:
        return world.contains(where, stay.place) if where else stay.is_where(last)

    for line in world.back(name):
        there = takewhile(lambda stay: not stay.gone and is_there(stay), line.stays[::-1])
        stays = list(there)
        if len(stays) < len(line.stays):
            break
    if not stays:
        said = f"is not {spoken(world, where)}, but {spoken(world, last)}"
        return long(said, Trust.SEEN, now, None, last.since, now)
    came, earliest = stays[-1].since, stays[-1].came_after
    probability = Trust.SEEN * line.at(now)[0].get(last.place, 0.5)
    unsure = math.isfinite(earliest) and came - earliest > CONFIRMED
    more = f" (at most {duration(came - earliest)} longer)" if unsure else ""
    has = "has been" if probability >= Trust.NOT_SEEN else "has probably been"
    since = f"{duration(now - came)}{more}, since {clock(came)}, {told(probability)}"
    found = long(
        f"{has} {spoken(world, where or last)} for {since}", probability, came, now - came, came, now
    )
    return replace(found, alternatives=({"stamp": iso(earliest), "probability": 0.0},)) if unsure else found


def when_moved(
    world: Recall, what: str, during: Span | None = None, place: str = "", way: str = ""
) -> Answer:
    """When an object was moved last, from where to where; during : in that span. value : ISO 8601, None where never.

    place, way : from or to this one, as of `is_about`. Raises NothingKnownError.
    """
    name = one_named(world, what)
    where = place_named(world, place)
    span = during or Span(-math.inf, world.now)
    line, moves = moves_of(world, name, span, where, way)
    if not moves:
        first = line.stays[0].since if line.stays else span.end
        then = during.between if during else f"since it was first seen at {clock(first)}"
        at = f" {way or 'from or to'} {_end(world, where)}" if where else ""
        sentence = f"{described(world, name)} was not moved{at} {then}"
        return Answer.stated(sentence, "when_moved", Trust.NOT_SEEN, span.end, None)
    moves = moves[-8:] if during else moves[-1:]
    parts = "; ".join(told_change(world, each) for each in moves)
    last = moves[-1]
    evidence = evidence_of(line, last.start, last.end)
    return Answer.stated(parts, "when_moved", Trust.SEEN, last.end, iso(last.end), evidence)


def moves_of(
    world: Recall, name: str, span: Span, place: str = "", way: str = "", back: bool = True
) -> tuple[Timeline, list[Change]]:
    """When an object left where it was, within a span; from or to a place, as of `is_about`. Its timeline, too.

    Of a span without a beginning the last ones. back : also when it came back to where it had been.
    """

    def fits(change: Change) -> bool:
        return change.left is not None and (back or not change.back) and is_about(world, change, place, way)

    if math.isinf(span.start):
        return last_changes(world, name, span, fits)
    line = world.line(name, span.start, span.end)
    return line, list(filter(fits, changes_of(line, span.start, span.end)))


def last_changes(
    world: Recall, name: str, span: Span, fits: Callable[[Change], bool]
) -> tuple[Timeline, list[Change]]:
    """Changes in the end of a span, as much of it as is needed to have one that fits, and the timeline there."""
    for line in world.back(name, span.start, span.end):
        changes = list(filter(fits, changes_of(line, span.start, span.end)))
        if changes:
            break
    return line, changes


def told_change(world: Recall, change: Change) -> str:
    name = described(world, change.object)
    if change.left is None:
        return f"{name} is new {spoken(world, change.came or '')}, seen there first at {clock(change.end)}"
    if change.came is None:
        return f"{name} is no longer {spoken(world, change.left)}; it went by {clock(change.end)}"
    between = f"at {clock(change.end)}"
    if change.end - change.start >= CONFIRMED:
        between = Span(change.start, change.end).between
    if change.left_by is not None and change.was_away:
        left = f"{name} left {_end(world, change.left)} by {clock(change.left_by)}"
        return f"{left} and was found {spoken(world, change.came)} at {clock(change.end)}"
    return f"{name} went from {_end(world, change.left)} to {_end(world, change.came)} {between}"


def _end(world: Recall, where: str | ObjectStay) -> str:
    """ "the kitchen table"."""
    place = where if isinstance(where, str) else where.place
    return f"the {name_of(place)}" if place in world.places else spoken(world, where).removeprefix("at ")


def what_changed(world: Recall, since: When = None, place: str = "") -> Answer:
    """What is elsewhere, new or gone since a moment. value : {id: [place before, place after]}. Raises InputError."""
    span = since_when(world, since, DAY)
    where = place_named(world, place)
    found, certain = _net_changes(world, span)
    found = [change for change in found if is_about(world, change, where)]
    at = at_the(world, where)
    probability = Trust.SEEN * Trust.EACH ** len(found) * certain
    parts, period = "; ".join(told_change(world, each) for each in found[:12]), period_of(world, span)
    nothing = f"Nothing that I know of has changed{at} {period}"
    sentence = f"Changed{at} {period}: {parts}" if found else nothing
    value = {change.object: [change.before, change.after] for change in found}
    lines = [world.latest(change.object, span.start, span.end) for change in found[:8]]
    evidence = sum((evidence_of(line, c.start, c.end) for line, c in zip(lines, found, strict=False)), ())
    return Answer.stated(sentence, "what_changed", probability, span.start, value, evidence)


def _net_changes(world: Recall, span: Span) -> tuple[list[Change], float]:
    """One for each object that is not where it was at the beginning of a span, and how probably these are all."""
    found, certain = [], 1.0
    for name in world.heads(world.active(span.start, span.end)):
        line = world.latest(name, span.start, span.end)
        begun = world.line(name, span.start, span.start) if span.end - span.start > LATELY else line
        before, after = begun.found_by(span.start), line.found_by(span.end)
        if _is_false(world, line) or _as_it_was(before, after):
            continue
        if after is None and line.lost and world.is_now(span.end):
            # It may still be there: one look that did not find it is no proof.
            there = elsewhere(world, line).places.get(line.stays[-1].place, 0.0)
            certain *= max(there, 1.0 - there)
            after = line.stays[-1] if there > 0.5 else None
        if before is None:
            line, _ = last_changes(world, name, span, lambda change: True)
        changes, gone = changes_of(line, span.start, span.end), line.last(span.end)
        start, end = span.start, min(line.stays[0].since, span.end)
        if after is None and gone is not None:
            start, end = gone.until, gone.left_by or span.end
        elif changes:
            start, end = changes[-1].start, changes[-1].end
        if not _as_it_was(before, after):
            found.append(Change(name, before, after, start, end))
    return sorted(found, key=lambda change: change.end), certain


def _as_it_was(before: ObjectStay | None, after: ObjectStay | None) -> bool:
    """Whether an object is, or is not, where it was."""
    return before is after if before is None or after is None else before.is_where(after)


def _is_false(world: Recall, line: Timeline) -> bool:
    """Whether all that was seen of it may be a false detection, or was a person after all."""
    if line.lost and world.likely_kind(line.id) == PERSON:
        return True
    return not line.stays or (line.lost and sum(stay.until - stay.since for stay in line.stays) < CONFIRMED)


def what_is_missing(world: Recall, since: When = None) -> Answer:
    """What was there and is no longer, of the last week, or what went in a span of time. value : ids."""
    span = since_when(world, since, WEEK)
    begin = span.start - WEEK if since is None else span.start
    missing: list[tuple[float, str, ObjectStay]] = []
    certain = 1.0
    candidates = [name for name, item in world.present.items() if item.lost or item.existence < 0.5]
    candidates += world.active(span.start, span.end)
    for name in world.heads(candidates):
        line = world.latest(name)
        if (
            line.lost
            and not _is_false(world, line)
            and begin <= (line.stays[-1].left_by or world.now) <= span.end
        ):
            out = elsewhere(world, line).out
            certain *= max(out, 1.0 - out)
            if out >= 0.5:
                missing.append((line.stays[-1].left_by or line.stays[-1].until, name, line.stays[-1]))
    missing.sort(reverse=True)
    parts = [
        f"{described(world, name)}, seen last {spoken(world, stay)} at {clock(stay.until)}"
        for _, name, stay in missing
    ]
    then = "" if since is None else f" {period_of(world, span)}"
    sentence = f"Missing{then} {'is' if len(missing) == 1 else 'are'} {listed(parts)}"
    if not missing:
        sentence = f"Nothing that I know of is missing{then}"
    looks = (evidence_of(world.latest(name), stay.since, world.now) for _, name, stay in missing[:8])
    evidence = sum(looks, ())
    value = [name for _, name, _ in missing]
    return Answer.stated(sentence, "what_is_missing", Trust.SEEN * certain, world.now, value, evidence)


def what_was_missing(world: Recall, stamp: float) -> Answer:
    """What was known, and nowhere, at a moment of the past, s. value : ids. Raises NothingKnownError, InputError."""
    span = within(world, Span(stamp, stamp))
    missing = []
    for name in world.things():
        line = world.line(name, span.start, span.start)
        chances, stay = line.at(span.start)
        if stay is not None and not _is_false(world, line) and sum(chances.values()) < BELIEVED:
            missing.append(name)
    named = listed(described(world, name) for name in missing)
    sentence = f"{named or 'Nothing that I know of'} {'were' if len(missing) > 1 else 'was'} missing at {clock(stamp)}"
    p = Trust.SEEN * Trust.EACH ** len(missing)
    return Answer.stated(sentence, "what_was_missing", p, stamp, missing)


def history(world: Recall, what: str, since: When = None) -> Answer:
    """Where an object was, and since when. value : [[place, since, until], ...].

    Raises NothingKnownError, AmbiguousError.
    """
    name = one_named(world, what)
    span = since_when(world, since)
    line = _line(world, name, span)
    stays = line.within(span.start, span.end)
    if not stays:
        raise NothingKnownError(f"{clean(name)} was not seen in that time.")
    parts = [_told_stay(world, stay, after) for stay, after in zip_longest(stays, stays[1:])][-10:]
    more = " at least" if line.cut and math.isinf(span.start) else ""
    before = f"{len(stays) - 10} places{more} before; " if len(stays) > 10 else ""
    end = f", missing since {clock(stays[-1].left_by or stays[-1].until)}" if line.lost else ""
    sentence = f"{described(world, name)} was {before}{', then '.join(parts)}{end}."
    value = [[stay.place, iso(stay.since), iso(stay.until)] for stay in stays]
    first = iso(stays[0].since)
    return Answer(sentence, "history", Trust.SEEN, first, value, evidence_of(line, span.start, span.end))


def _told_stay(world: Recall, stay: ObjectStay, after: ObjectStay | None) -> str:
    """ "on the sofa from 2026-11-21 09:12", and since when it was nowhere before the next."""
    away = stay.left_by if after is not None and after.since - (stay.left_by or math.inf) > AWAY else None
    then = f", then away from {clock(away)}" if away is not None else ""
    return f"{spoken(world, stay)} from {clock(stay.since)}{then}"


def when_last_at(world: Recall, what: str, place: str) -> Answer:
    """When an object was at a place last. value : ISO 8601, None where never. Raises NothingKnownError."""
    name, where = one_named(world, what), place_named(world, place)
    for line in world.back(name):
        stays = [stay for stay in line.stays if world.contains(where, stay.place)]
        if stays:
            break
    else:
        first = clock(line.stays[0].since) if line.stays else "the beginning"
        sentence = f"{described(world, name)} was never {spoken(world, where)} since {first}"
        return Answer.stated(sentence, "when_last_seen", Trust.NOT_SEEN, world.now, None)
    last = stays[-1]
    is_there = last is line.stays[-1] and not line.lost
    until = f"is {spoken(world, where)} since" if is_there else f"was {spoken(world, where)} last until"
    stamp = last.since if is_there else last.until
    seen = iso(world.now if is_there else stamp)
    evidence = evidence_of(line, last.since, last.until)
    sentence = f"{described(world, name)} {until} {clock(stamp)}"
    return Answer.stated(sentence, "when_last_seen", Trust.SEEN, stamp, seen, evidence)


def what_moved(world: Recall, since: When = None, place: str = "", way: str = "") -> Answer:
    """Every move within a span, or of the last day, also of what is back where it was; to or from a place.

    way : as of `moves_at`. value : [[object, from, to, stamp], ...], None for nowhere. Raises NothingKnownError,
    AmbiguousError, InputError.
    """
    where = place_named(world, place)
    span = since_when(world, since, DAY)
    moves = sorted(moves_at(world, where, span, way), key=lambda change: change.end)
    at = at_the(world, where)
    before = f"{len(moves) - 12} moves before; " if len(moves) > 12 else ""
    parts = "; ".join(told_change(world, move) for move in moves[-12:])
    told_of = f"{'Came to be' if way == 'to' else 'Moved'}{at} {span.between}: {before}{parts}"
    if not moves:
        told_of = f"Nothing that I know of {'came to be' if way == 'to' else 'was moved'}{at} {span.between}"
    value = [[move.object, move.before, move.after, iso(move.end)] for move in moves]
    return Answer.stated(told_of, "what_moved", Trust.SEEN * Trust.EACH ** len(moves), span.start, value)


def what_left(world: Recall, place: str, since: When = None) -> Answer:
    """What was at a place at the beginning of a span, or at any time of the last day, and is no longer there.

    value : {id: place where it is, None where nobody knows}. Raises NothingKnownError, AmbiguousError.
    """
    where = place_named(world, place)
    span = since_when(world, since, DAY)
    parts, value = [], {}

    def fits(change: Change) -> bool:
        return is_about(world, change, where, "from") and not change.back

    for name in world.heads(world.active(span.start, span.end)):
        line, moves = last_changes(world, name, span, fits)
        stay = line.stays[-1] if line.stays else None
        here = stay is not None and not line.lost and world.contains(where, stay.place)
        if moves and not here:
            value[name] = None if line.lost or stay is None else stay.place
            parts.append(told_change(world, moves[-1]))
    at, since_then = spoken(world, where), f"since {clock(span.start)}"
    sentence = f"No longer {at}, {since_then}: {listed(parts)}"
    if not parts:
        sentence = f"Nothing that I know of has left the place {at} {since_then}"
    probability = Trust.SEEN * Trust.EACH ** len(parts)
    return Answer.stated(sentence, "what_left", probability, span.start, value)
