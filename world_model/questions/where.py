"""Where things are and were, what is at a place, how many there are."""

from __future__ import annotations

import math
import re
from collections.abc import Mapping, Sequence
from dataclasses import replace
from itertools import pairwise
from typing import Any, NamedTuple

import numpy as np

from estimation.checks import FloatArray
from world_model.memory.stays import ObjectStay, Timeline
from world_model.questions.answers import (
    Answer,
    NothingKnownError,
    NotUnderstoodError,
    clean,
    clock,
    duration,
    hedged,
    iso,
    listed,
    told,
)
from world_model.questions.elsewhere import WEEKS, elsewhere, weeks_of
from world_model.questions.moments import Span, When, moment, recurring
from world_model.questions.naming import (
    Meant,
    at_the,
    described,
    name_of,
    one_named,
    place_named,
    plain,
    position_of,
    spoken,
    things_named,
)
from world_model.questions.recall import Recall, Trust, ranked
from world_model.state import BELIEVED, DAY, PERSON, SURE, most_probable

HIDDEN = 0.89  # The most that is told of a place where something was not seen: it is never told as sure
LATELY = 6 * 3600.0  # s: what went from where it was no longer ago may be where it usually goes then


def where_is(world: Recall, what: str, every: bool = False) -> Answer:
    """Where an object is now. value : name of the place. Several that fit are all told of. Raises NothingKnownError.

    every : they are all meant, also where the words are no plural.
    """
    meant = things_named(world, what)
    alone = len(meant.ids) == 1
    each = [_where(world, name, world.now, "where_is", alone and meant.by_name) for name in meant.ids]
    known = [k for k, answer in enumerate(each) if alone or answer.value]
    if len(known) == 1 and (alone or not meant.plural):
        return _doubted(world, each[known[0]], meant.ids[known[0]], meant.kind)
    return _several(world, meant.ids, each, meant.plural or every)


def _doubted(world: Recall, answer: Answer, name: str, kind: str | None) -> Answer:
    """The answer about an object that was asked for as one of a class, where it rather is of another."""
    item = world.present.get(name)
    if item is None or kind in (None, item.most_probable("class")):
        return answer
    p = item.attributes.get("class", {}).get(kind, 0.0)
    sentence = f"{answer.sentence.rstrip('.')}; it is a {name_of(kind)} with {told(p)}."
    return replace(answer, sentence=sentence, probability=answer.probability * p)


def _several(world: Recall, ids: Sequence[str], each: list[Answer], plural: bool) -> Answer:
    """The answers about several objects: all are meant where `plural`, else it is asked which."""
    told_of = "; ".join(answer.sentence.rstrip(".") for answer in each[:8])
    question = "" if plural else f" Which one: {listed(map(clean, ids), 8, 'or')}?"
    return Answer(
        f"There are {len(ids)}: {told_of}.{question}",
        "where_is" if plural else "choices",
        math.prod(answer.probability for answer in each) if plural else each[0].probability,
        iso(world.now),
        list(ids) if plural else None,
        sum((answer.evidence for answer in each), ()),
        tuple(
            {"object": name, "place": answer.value, "probability": answer.probability}
            for name, answer in zip(ids, each, strict=True)
        ),
        () if plural else tuple(ids),
    )


def where_was(world: Recall, what: str, when: When = None) -> Answer:
    """Where an object was at a moment or during a span of time; without a time where it was seen last.

    value : name of the place, the one it was longest at during a span.
    Raises NothingKnownError, InputError for the time.
    """
    if when is None:
        return when_last_seen(world, what)
    meant, span = things_named(world, what, past=True), within(world, when)
    name = meant.ids[0]
    if len(meant.ids) > 1:
        known = [each for each in meant.ids if line_at(world, each, span.end).at(span.end)[1] is not None]
        if len(known) > 1:
            each = [_where(world, one, span.middle, "where_was", False) for one in known]
            return _several(world, known, each, meant.plural)
        name = known[0] if known else name
    if span.lasts:
        return _during(world, name, span)
    return _where(world, name, span.middle, "where_was", meant.by_name)


def line_at(world: Recall, name: str, stamp: float) -> Timeline:
    """As much of a timeline as a moment needs."""
    return world.latest(name) if stamp >= world.now else world.line(name, stamp, stamp)


def within(world: Recall, when: When) -> Span:
    """A time, now where none is said, as a span that ends now at the latest.

    Raises NothingKnownError for the future, InputError for no time.
    """
    if when is None:
        return Span(world.now, world.now)
    span = when if isinstance(when, Span) else moment(when, world.now)
    if span.start > world.now:
        raise NothingKnownError(
            f"{clock(span.start)} is in the future: the newest moment I know is {clock(world.now)}."
        )
    return Span(span.start, min(span.end, world.now), span.words)


def _during(world: Recall, name: str, span: Span) -> Answer:
    """Where it was longest, and where else."""
    line = world.line(name, span.start, span.end)
    shares = line.shares(span.start, span.end)
    if not shares:
        return _where(world, name, span.middle, "where_was", True)
    order = ranked(shares)
    best = order[0]
    probability = min(Trust.SEEN, 0.5 + 0.5 * shares[best]) if len(order) > 1 else Trust.SEEN
    others = [f"{spoken(world, place)} ({100 * shares[place]:.0f} % of the time)" for place in order[1:]]
    sentence = f"{described(world, name)} was {spoken(world, best)} {span.between}"
    sentence += f" most of the time; also {listed(others)}" if others else ""
    evidence = evidence_of(line, span.start, span.end)
    options = places_of(name, shares, order[1:])
    return Answer.stated(sentence, "where_was", probability, span.start, best, evidence, options)


def _where(world: Recall, name: str, stamp: float, kind: str, by_name: bool) -> Answer:
    if by_name and world.has_changed(name):
        return _exchanged(world, name, stamp, kind)
    line = line_at(world, name, stamp)
    chances, stay = line.at(stamp)
    if stay is None:
        first = f"; it was first seen at {clock(line.stays[0].since)}" if line.stays else ""
        return Answer(
            f"Nothing is known of {clean(name)} at {clock(stamp)}{first}.", kind, Trust.NOT_SEEN, iso(stamp)
        )
    if kind == "where_is" and (line.lost or not chances):
        return _missing(world, name, line, stay, stamp)
    place = most_probable(chances)
    certain = chances.get(place, 0.0)
    item = world.present.get(line.id)
    if kind == "where_is" and item is not None:
        certain *= item.existence * max(world.place_probability(item, place), 0.05)
    twins = world.alike(line.id) if by_name else []
    if twins:
        certain *= _identity(world, line, twins)
    if by_name:
        certain *= world.individual(name)[1]
    if certain < 0.25 and kind == "where_was":
        return _unknown(world, name, line, stay, stamp)
    verb = hedged(certain, "is" if kind == "where_is" else "was")
    where = spoken(world, place or stay)
    seen = f"seen there last at {clock(stay.until)}" if kind == "where_is" else f"at {clock(stamp)}"
    doubt = f"; it cannot be told from {listed(map(clean, twins))}" if twins else ""
    also = f", now called {clean(line.id)}," if line.id != name else ""
    sentence = f"{described(world, name)}{also} {verb} {where}, {told(certain)}, {seen}{doubt}."
    others = [other for other, p in chances.items() if other != place and p > Trust.NAMED]
    options = list(places_of(name, chances, others))
    options += [
        {"object": twin, "place": place, "probability": (1.0 - certain) / len(twins)} for twin in twins
    ]
    evidence = evidence_of(line, stay.since, stay.until)
    return Answer(sentence, kind, certain, iso(stamp), place or position_of(stay), evidence, tuple(options))


def _exchanged(world: Recall, name: str, stamp: float, kind: str) -> Answer:
    """Of an object that looks otherwise than before: it is where something looks as it did."""
    other = world.took_over(name)
    own = _where(world, name, stamp, kind, False)
    if not other:
        doubt = "; it looked otherwise before, so another one may be in its place."
        return replace(own, sentence=own.sentence.rstrip(".") + doubt, probability=0.5 * own.probability)
    there = _where(world, other, stamp, kind, False)
    sentence = (
        f"What was called {clean(name)} has probably changed places with {clean(other)}: {there.sentence}"
    )
    options = ({"object": name, "place": own.value, "probability": 1.0 - Trust.PROBABLY}, *there.alternatives)
    return replace(
        there, sentence=sentence, probability=Trust.PROBABLY * there.probability, alternatives=options
    )


def _identity(world: Recall, line: Timeline, twins: list[str]) -> float:
    """That an object is the one it is taken for, beside some that look like it."""
    lines = [line, *(world.latest(twin) for twin in twins)]
    if any(each.cut for each in lines):
        return 0.5  # in all the time that was not read they may have been
    mine, *others = map(_gaps, lines)
    both = any(((mine[:, :1] < gaps[:, 1]) & (gaps[:, 0] < mine[:, 1:])).any() for gaps in others)
    return 0.5 if both else Trust.TWIN


def _gaps(line: Timeline) -> FloatArray:
    """When (N, 2), s, it moved and nobody saw how."""
    return np.array([(stay.until, after.since) for stay, after in pairwise(line.stays)]).reshape(-1, 2)


def _unknown(world: Recall, name: str, line: Timeline, stay: ObjectStay, stamp: float) -> Answer:
    before = [each for each in line.stays if each.until <= stamp]
    known = before[-1] if before else stay
    sentence = (
        f"Nobody knows where {described(world, name)} was at {clock(stamp)}: it was seen last before that "
        f"{spoken(world, known)}, at {clock(known.until)}."
    )
    return Answer(
        sentence, "where_was", Trust.PROBABLY, iso(stamp), None, evidence_of(line, known.since, known.until)
    )


def _missing(world: Recall, name: str, line: Timeline, stay: ObjectStay, stamp: float) -> Answer:
    """It is not where it was: where it probably went, or what looks like it and came since."""
    if world.kind(name) == PERSON:
        seen = f"was seen last {spoken(world, stay)} at {clock(stay.until)}"
        sentence = f"{described(world, name)} {seen}, {duration(stamp - stay.until)} ago."
        evidence = evidence_of(line, stay.since, stamp)
        return Answer(sentence, "where_is", Trust.NOT_SEEN, iso(stay.until), None, evidence)
    back = [
        other
        for other in world.alike(name)
        if world.line(other, stay.until, stay.until).at(stay.until)[1] is None
    ]
    may = elsewhere(world, line)
    last = f"it was seen last {spoken(world, stay)} at {clock(stay.until)}, and is no longer there"
    order = [place for place in ranked(may.places) if may.places[place] > Trust.NAMED]
    options = list(places_of(name, may.places, order))
    evidence = evidence_of(line, stay.since, stamp)
    if may.best and not back:
        p = min(may.places[may.best], HIDDEN)
        sentence = (
            f"{described(world, name)} {hedged(p)} {spoken(world, may.best)}, {told(p)}: {last}, "
            "and was not found again yet."
        )
        return Answer(sentence, "where_is", p, iso(stamp), may.best, evidence, tuple(options[1:]))
    sentence = f"{described(world, name)} is missing: {last}"
    if back:
        where = world.latest(back[0]).stays[-1].place
        sentence += f"; {clean(back[0])}, which looks like it, came {spoken(world, where)} since"
        options.insert(0, {"object": back[0], "place": where, "probability": Trust.PROBABLY})
    else:
        usual = usual_places(world, name)
        usual.pop(stay.place, None)
        guess = most_probable(usual)
        sentence += f"; it is often {spoken(world, guess)}" if guess else ""
    probability = Trust.PROBABLY if back else may.out
    return Answer(f"{sentence}.", "where_is", probability, iso(stamp), None, evidence, tuple(options))


def usual_spans(world: Recall, when: When = None) -> tuple[list[tuple[float, float]], str]:
    """The last weeks, or a time of day or a weekday in them, from and to in s; and how a sentence says it.

    Raises NotUnderstoodError for a time that comes once, InputError for no time.
    """
    if when is None:
        return [(world.now - WEEKS, world.now)], ""
    span = when if isinstance(when, Span) else moment(when, world.now)
    spans = recurring(span, world.now, WEEKS)
    if not spans:
        raise NotUnderstoodError(
            f'I can tell what is usual at all hours, at a time of day or on a weekday, not "{clean(span.words)}"; ask '
            "what was so at that time."
        )
    at = "" if span.lasts else f" ({clock(span.start)[11:]})"
    return spans, f" {clean(span.words)}{at}"


def usual_places(world: Recall, name: str, when: When = None) -> dict[str, float]:
    """Share of the time of the last weeks by place, as of `usual_spans`."""
    return weeks_of(world, name).shares_of(usual_spans(world, when)[0])


def where_usually(world: Recall, what: str, when: When = None) -> Answer:
    """Where an object usually is, at all hours or at a time of day or a weekday. value : name of the place.

    Raises NothingKnownError or AmbiguousError, and as `usual_spans`.
    """
    name, then = one_named(world, what), usual_spans(world, when)[1]
    shares = usual_places(world, name, when)
    if not shares:
        raise NothingKnownError(f"{clean(name)} was not seen{then} in the last four weeks.")
    order = ranked(shares)
    likely = [
        f"{spoken(world, place)} ({100 * shares[place]:.0f} %)" for place in order[:4] if shares[place] > 0.05
    ]
    whole = "that time in the last four weeks" if then else "the last four weeks"
    first = f"{spoken(world, order[0])}{then} ({100 * shares[order[0]]:.0f} % of {whole})"
    rest = f"; else {listed(likely[1:])}" if likely[1:] else ""
    second = shares[order[1]] if len(order) > 1 else 0.0
    probability = min(Trust.SEEN, 0.5 + 2.0 * (shares[order[0]] - second))
    sentence = f"{described(world, name)} is usually {first}{rest}."
    options = places_of(name, shares, order[1:])
    return Answer(sentence, "where_usually", probability, iso(world.now), order[0], (), options)


def which_room(world: Recall, what: str, when: When = None) -> Answer:
    """In which room an object is or was. value : name of the room, or of the place where that is in none.

    Raises NothingKnownError.
    """
    found = where_is(world, what) if when is None else where_was(world, what, when)
    rooms = world.rooms_of(found.value) if isinstance(found.value, str) else []
    if len(rooms) != 1 or rooms[0] == found.value:
        return found
    verb = "is" if found.kind == "where_is" else "was"
    return replace(found, value=rooms[0], sentence=f"{found.sentence} That {verb} {spoken(world, rooms[0])}.")


def when_last_seen(world: Recall, what: str, during: Span | None = None) -> Answer:
    """When an object was seen last, and where; during : last within that span. value : ISO 8601.

    Raises NothingKnownError.
    """
    meant = things_named(world, what, past=True)
    if during is None:
        lines = [world.latest(name) for name in meant.ids]
    else:
        lines = [_cut(world.line(name, during.start, during.end), during) for name in meant.ids]
    lines = [line for line in lines if line.stays]
    if not lines and during is not None:
        sentence = f"{clean(what)} was not seen {during.between}."
        return Answer(sentence, "when_last_seen", Trust.NOT_SEEN, iso(during.start))
    if not lines:
        raise NothingKnownError(f'"{clean(what)}" was never seen for certain.')
    line = max(lines, key=lambda each: each.stays[-1].until)
    stay = line.stays[-1]
    missing = ", and is missing since" if line.lost and world.kind(line.id) != PERSON else ""
    others = sorted((each for each in lines if each is not line), key=lambda each: -each.stays[-1].until)
    also = "".join(f"; {described(world, each.id)} at {clock(each.stays[-1].until)}" for each in others[:3])
    sentence = (
        f"{described(world, line.id)} was seen last at {clock(stay.until)}, {duration(world.now - stay.until)} ago, "
        f"{spoken(world, stay)}{missing}{also}."
    )
    options = tuple(
        {
            "object": each.id,
            "place": each.stays[-1].place,
            "stamp": iso(each.stays[-1].until),
            "probability": 0.0,
        }
        for each in lines
        if each.id != line.id
    )
    probability = Trust.TWIN if meant.by_name and world.alike(line.id) else Trust.SEEN
    evidence = evidence_of(line, stay.since, stay.until)
    seen = iso(stay.until)
    return Answer(sentence, "when_last_seen", probability, seen, seen, evidence, options)


def what_was_not_seen(world: Recall, since: When = None) -> Answer:
    """What is known and was not seen since a moment, or in the last day where none is said, the longest first.

    value : ids. Raises InputError for the time.
    """
    start = within(world, since).start if since is not None else world.now - DAY
    items = [item for item in world.present.values() if item.last_seen < start]
    unseen = [
        item for item in sorted(items, key=lambda item: item.last_seen) if world.kind(item.id) != PERSON
    ]
    parts = [f"{described(world, item.id)}, seen last at {clock(item.last_seen)}" for item in unseen]
    sentence = f"Not seen since {clock(start)}: {'; '.join(parts[:20])}"
    if not unseen:
        sentence = f"All that I know of was seen since {clock(start)}"
    return Answer.stated(sentence, "what_was_not_seen", Trust.SEEN, start, [item.id for item in unseen])


def _cut(line: Timeline, span: Span) -> Timeline:
    """The part of a timeline within a span."""
    stays = (
        stay._replace(until=min(stay.until, span.end), left_by=None)
        for stay in line.within(span.start, span.end)
    )
    return replace(line, stays=tuple(stays), lost=False)


def evidence_of(line: Timeline, start: float, end: float) -> tuple[Mapping[str, Any], ...]:
    """First and last sight of each stay that overlaps a span, the newest eight."""
    found: list[dict[str, Any]] = []
    for stay in line.within(start, end):
        events = {
            "came": None if stay is line.stays[0] and not line.begun else stay.since,  # before what was read
            "seen": stay.until if stay.until > stay.since else None,
            "gone": stay.left_by,
        }
        found += [
            {"object": line.id, "event": event, "place": stay.place, "stamp": iso(stamp)}
            for event, stamp in events.items()
            if stamp is not None
        ]
    return tuple(found[-8:])


def objects_at(
    place: str, chances: Mapping[str, float], what: str = "probability"
) -> tuple[dict[str, Any], ...]:
    """Alternatives of an answer: objects that may be at a place."""
    return tuple({"object": name, "place": place, what: p} for name, p in chances.items())


def places_of(name: str, chances: Mapping[str, float], order: Sequence[str]) -> tuple[dict[str, Any], ...]:
    """Alternatives of an answer: places, in this order, at which an object may be."""
    return tuple({"object": name, "place": place, "probability": chances[place]} for place in order)


def _chances(world: Recall, line: Timeline, stamp: float) -> dict[str, float]:
    """Probability by place of an object at a moment; of one that has left where it was, of where it may be now."""
    if not line.lost or stamp < world.now:
        return line.at(stamp)[0]
    whole = line if line.stays else world.latest(line.id)
    return elsewhere(world, whole).places if whole.stays else {}


class _Found(NamedTuple):
    """What is at a place. lasts : at any time of the span, with its share of it, else at the moment, with its
    probability. there : what is believed. then, verbs : the time as a sentence says it, and "is", "are" in it."""

    span: Span
    lasts: bool
    chances: dict[str, float]
    there: list[str]
    then: str
    verbs: tuple[str, str]

    def named(self, world: Recall) -> str:
        """What is there, with the share of the time, or the doubt."""
        return listed((described(world, name) + self._more(self.chances[name]) for name in self.there), 20)

    def _more(self, p: float) -> str:
        if self.lasts:
            return "" if p >= 0.95 else f" ({max(100 * p, 1):.0f} % of the time)"
        return "" if p >= SURE else f" (probably, {told(p)})"

    def probability(self, none: float) -> float:
        """That this is all; none : where there is nothing."""
        if self.lasts:
            return Trust.SEEN * Trust.EACH ** len(self.there) if self.there else none
        return math.prod(max(p, 1.0 - p) for p in self.chances.values()) * (
            Trust.SEEN if self.chances else none
        )

    def options(self, place: str) -> tuple[dict[str, Any], ...]:
        """Alternatives of an answer: objects that may be at the place."""
        what = "share" if self.lasts else "probability"
        return objects_at(place, self.chances, what)


def _found_at(world: Recall, place: str, when: When, ids: Sequence[str] | None = None) -> _Found:
    """What is or was at a place, of all things where `ids` is None; "" is anywhere. Raises InputError for the time."""
    span = within(world, when)
    now, chances = span.middle >= world.now, {}
    if ids is None and now and not span.lasts:
        ids = world.heads([*world.present, *world.departed(LATELY)])
    for name in world.things() if ids is None else ids:
        line, item = world.line(name, span.start, span.end), world.present.get(name)
        if span.lasts:
            p = world.inside(place, line.spent(span.start, span.end)) / (span.end - span.start)
        else:
            p = world.inside(place, _chances(world, line, span.middle))
            p *= item.existence if now and item is not None and not line.lost else 1.0
        if p > (0.0 if span.lasts else Trust.NAMED):
            chances[name] = p
    there = [name for name in ranked(chances) if span.lasts or chances[name] >= BELIEVED]
    then = f" {span.between}" if span.lasts else "" if when is None else f" at {clock(span.start)}"
    return _Found(span, span.lasts, chances, there, then, ("is", "are") if when is None else ("was", "were"))


def what_is_at(world: Recall, place: str, when: When = None) -> Answer:
    """What is, or was, at a place at a moment, or at any time of a span, the longest first; "" : anywhere. value : ids.

    Raises NothingKnownError, AmbiguousError.
    """
    where = place_named(world, place)
    found = _found_at(world, where, when)
    there, stamp = found.there, found.span.end
    told_of = f"Nothing that I know of {found.verbs[0]}"
    if there:
        told_of = f"{found.named(world)} {found.verbs[len(there) > 1]}"
    at = at_the(world, where) or (" seen" if found.lasts else " here")
    some = () if found.lasts else there[:4]
    evidence = sum((evidence_of(world.line(name, stamp, stamp), stamp, stamp) for name in some), ())
    sentence, p = f"{told_of}{at}{found.then}", found.probability(Trust.NOT_SEEN)
    return Answer.stated(sentence, "what_is_at", p, found.span.start, there, evidence, found.options(where))


what_was_at = what_is_at


def is_at(world: Recall, what: str, place: str, when: When = None) -> Answer:
    """Whether an object, or one of a class, is or was at a place at a moment, or at any time of a span. value : bool.

    Raises NothingKnownError, AmbiguousError.
    """
    where = place_named(world, place)
    meant = things_named(world, what, when is not None)
    found = _found_at(world, where, when, meant.ids)
    span, lasts = found.span, found.lasts
    if meant.by_name and not lasts:
        twins = {name: p * (Trust.TWIN if world.alike(name) else 1.0) for name, p in found.chances.items()}
        found = found._replace(chances=twins)
    p = min(1.0 - math.prod(1.0 - each for each in found.chances.values()), Trust.EACH)
    if lasts:
        p = Trust.SEEN if found.there else 1.0 - Trust.NOT_SEEN
    if p >= 0.5:
        verb = hedged(Trust.SEEN if lasts else p, found.verbs[len(found.there) > 1])
        names = found.named(world) if lasts else listed(described(world, name) for name in found.there)
        sentence = f"Yes, {names or clean(what)} {verb} {spoken(world, where)}{found.then}"
    else:
        sentence = f"No, {_not_at(world, meant, where, found)}"
    name = found.there[0] if lasts and found.there else meant.ids[0]
    evidence = evidence_of(world.line(name, span.start, span.end), span.start, span.end)
    options = () if lasts else found.options(where)
    return Answer.stated(sentence, "is_at", max(p, 1.0 - p), span.start, p >= 0.5, evidence, options)


was_at = is_at


def _not_at(world: Recall, meant: Meant, where: str, found: _Found) -> str:
    """That an object is not there, and of a moment where it is."""
    one = clean(re.sub("^(any|some|every)thing$", "thing that I know of", plain(meant.words)))
    verbs = found.verbs
    said = f"there {verbs[meant.plural and one.endswith('s')]} no {one}"
    if len(meant.ids) == 1:
        said = f"{described(world, meant.ids[0])} {verbs[0]} not"
    said += f" {spoken(world, where)}{found.then}"
    if found.lasts or "thing" in one:
        return f"{said}, as far as I know" if found.lasts else said
    stamp = found.span.middle
    known = (
        f"{described(world, name)} {verbs[0]} {_elsewhere(world, name, stamp)}" for name in meant.ids[:3]
    )
    return f"{said}: {listed(known)}"


def _elsewhere(world: Recall, name: str, stamp: float) -> str:
    chances = _chances(world, line_at(world, name, stamp), stamp)
    if sum(chances.values()) < BELIEVED:
        return "at no place that I know"
    return spoken(world, most_probable(chances))


def how_many(world: Recall, what: str, place: str = "", when: When = None) -> Answer:
    """How many objects of a class there are, at a place or anywhere. value : number.

    Raises NothingKnownError, AmbiguousError.
    """
    where = place_named(world, place)
    everything = plain(what).rstrip("s") in ("thing", "object", "item")
    ids = tuple(world.things()) if everything else things_named(world, what, when is not None).ids
    found = _found_at(world, where, when, ids)
    count = len(found.there)
    shown = f": {found.named(world)}" if count else ""
    sentence = f"There {found.verbs[count != 1]} {count} of these{at_the(world, where)}{found.then}{shown}"
    p, options = found.probability(Trust.SEEN), found.options(where)
    return Answer.stated(sentence, "how_many", p, found.span.start, count, (), options)


def where_to_look(world: Recall, what: str) -> Answer:
    """Places in the order in which to look for an object: where it is, then where it usually is. value : names.

    Raises NothingKnownError, AmbiguousError.
    """
    name = one_named(world, what)
    line = world.latest(name)
    now = _chances(world, line, world.now)
    chances = {place: min(p, Trust.EACH) for place, p in now.items() if place}
    left = 1.0 - min(sum(chances.values()), 1.0)
    for place, share in usual_places(world, name).items():
        if place:
            chances[place] = chances.get(place, 0.0) + left * share
    if not chances:
        raise NothingKnownError(
            f"No place has a name that {clean(name)} may be at: world_model has them from its places_file. "
            f"{where_is(world, name).sentence}"
        )
    order = ranked(chances)
    parts = [
        f"{spoken(world, place)} ({told(chances[place])})"
        if chances[place] >= Trust.NAMED
        else spoken(world, place)
        for place in order[:6]
    ]
    options = places_of(name, chances, order)
    sentence = f"Look for {described(world, name)} {', then '.join(parts)}."
    return Answer(sentence, "where_to_look", chances[order[0]], iso(world.now), order, (), options)
