"""What is usually at a place, and what will be needed next: counts of the history, and the routines it teaches."""

from __future__ import annotations

import math
from dataclasses import replace

from world_model.describing import LIKELY
from world_model.memory.routines import Routines
from world_model.memory.stays import Timeline, routines_of
from world_model.questions.answers import Answer, NothingKnownError, clean, clock, duration, iso, listed, told
from world_model.questions.elsewhere import WEEKS, weeks_of
from world_model.questions.moments import Span, When, moment
from world_model.questions.naming import described, one_named, place_named, spoken, where_words
from world_model.questions.recall import Recall, Trust, ranked, remembered
from world_model.questions.where import is_at, objects_at, places_of, usual_places, usual_spans, where_usually
from world_model.state import BELIEVED, DAY, SURE, most_probable

LEAST_DAYS = 2.0
AHEAD = 2 * 3600.0


def what_is_usually_here(world: Recall, place: str, when: When = None) -> Answer:
    """What is at a place for at least half of the time of the last four weeks. value : ids.

    when : at a time of day or on a weekday. Raises NothingKnownError, and as `usual_spans`.
    """
    where = place_named(world, place)
    spans, then = usual_spans(world, when)
    inside = {line.id: world.inside(where, line.shares_of(spans, absent=True)) for line in _all_weeks(world)}
    shares = {name: inside[name] for name in inside if inside[name] > Trust.NAMED}
    usual = [name for name in ranked(shares) if shares[name] >= BELIEVED]
    named = [f"{described(world, name)} ({100 * shares[name]:.0f} % of the time)" for name in usual]
    others = [name for name in ranked(shares) if shares[name] < BELIEVED]
    now_and_then = [f"{described(world, name)} ({100 * shares[name]:.0f} %)" for name in others[:4]]
    at = spoken(world, where) + then
    sentence = f"Usually {at}: {listed(named)}" if named else f"Nothing is usually {at}"
    if now_and_then:
        sentence += f"; now and then {listed(now_and_then)}"
    probability = Trust.SEEN * math.prod(_certain(share) for share in shares.values())
    options = objects_at(where, shares)
    return Answer.stated(sentence, "what_is_usually_here", probability, world.now, usual, (), options)


def is_usually_at(world: Recall, what: str, place: str, when: When = None) -> Answer:
    """Whether an object was at a place for at least half of the time of the last four weeks. value : bool.

    when : at a time of day or on a weekday. Raises as `where_usually`.
    """
    usual = where_usually(world, what, when)
    share = world.inside(place_named(world, place), usual_places(world, one_named(world, what), when))
    said, p = "Yes" if share >= BELIEVED else "No", Trust.SEEN * _certain(share)
    sentence = f"{said}, {100 * share:.0f} % of the time, {told(p)}: {usual.sentence}"
    return replace(usual, kind="is_usually_at", value=share >= BELIEVED, probability=p, sentence=sentence)


def _certain(share: float) -> float:
    """That a share found to be above or below one half is."""
    return 1.0 - 0.5 * math.exp(-40.0 * abs(share - BELIEVED))


def what_is_needed_next(world: Recall, ahead: float = AHEAD) -> Answer:
    """Which objects are expected to be moved within that many seconds, and where to. value : {id: place}.

    Raises NothingKnownError.
    """
    moves = learned(world).moves(world.now, ahead)
    order = sorted(moves, key=lambda name: -moves[name][1])
    parts = [
        f"{described(world, name)} {spoken(world, moves[name][0])} ({told(moves[name][1])})" for name in order
    ]
    until = f"until {clock(world.now + ahead)}, the next {duration(ahead)}"
    sentence = f"Needed next {until}: {listed(parts)}."
    if not order:
        sentence = f"Nothing is expected to be moved {until}."
    probability = moves[order[0]][1] if order else Trust.PROBABLY
    options = tuple({"object": n, "place": moves[n][0], "probability": moves[n][1]} for n in order)
    value = {name: moves[name][0] for name in order}
    return Answer(sentence, "what_is_needed_next", probability, iso(world.now), value, (), options)


def where_will_be(world: Recall, what: str, when: str | float | Span) -> Answer:
    """Where an object is expected at a coming moment, by its routines. value : name of the place.

    Raises NothingKnownError, AmbiguousError.
    """
    name = one_named(world, what)
    stamp = (when if isinstance(when, Span) else moment(when, world.now)).middle
    if stamp < world.now:
        raise NothingKnownError(
            f"{clock(stamp)} is not in the future: the newest moment is {clock(world.now)}."
        )
    chances = learned(world).where(name, stamp)
    if not chances:
        raise NothingKnownError(f"I know no routines of {clean(name)}.")
    order = ranked(chances)
    best, p = order[0], chances[order[0]]
    verb = "will be" if p >= SURE else "will probably be" if p >= LIKELY else "may be"
    others = [
        f"{spoken(world, place)} ({told(chances[place])})" for place in order[1:3] if chances[place] > 0.1
    ]
    rest = f"; else {listed(others, final='or')}" if others else ""
    sentence = f"{described(world, name)} {verb} {spoken(world, best)} at {clock(stamp)}, {told(p)}{rest}."
    return Answer(sentence, "where_will_be", p, iso(stamp), best, (), places_of(name, chances, order[1:4]))


def will_be_at(world: Recall, what: str, place: str, when: Span) -> Answer:
    """Whether an object is expected at a place at a coming moment. value : bool. Raises as `where_will_be`."""
    answer, where = where_will_be(world, what, when), place_named(world, place)
    expected = {str(answer.value): answer.probability}
    expected |= {str(other["place"]): float(other["probability"]) for other in answer.alternatives}
    p = world.inside(where, expected)
    sentence = f"{'Yes' if p >= BELIEVED else 'No'}, {told(max(p, 1.0 - p))}: {answer.sentence}"
    return replace(
        answer, kind="will_be_at", value=p >= BELIEVED, probability=max(p, 1.0 - p), sentence=sentence
    )


def is_at_usual_place(world: Recall, what: str) -> Answer:
    """Whether an object is where it is most of the time. value : bool. Raises NothingKnownError, AmbiguousError."""
    usual = where_usually(world, what)
    answer = is_at(world, what, str(usual.value))
    return replace(answer, sentence=f"{answer.sentence} {usual.sentence}")


def what_is_out_of_place(world: Recall) -> Answer:
    """What is not where it was for most of the last four weeks. value : {id: usual place}."""
    start = world.now - WEEKS
    found = {}
    for line in _all_weeks(world):
        name = line.id
        shares, there = line.shares(start, world.now), world.latest(name).at(world.now)[0]
        usual = most_probable(shares)
        if usual and shares[usual] >= BELIEVED and there and world.inside(usual, there) < BELIEVED:
            found[name] = usual
    parts = [
        f"{described(world, name)} is {where_words(world, name).removeprefix('last ')}, usually {spoken(world, usual)}"
        for name, usual in found.items()
    ]
    said = f"Not where it usually is: {'; '.join(parts)}"
    if not parts:
        said = "All that I know of is where it usually is"
    probability = Trust.SEEN * Trust.EACH ** len(found)
    return Answer.stated(said, "what_is_out_of_place", probability, world.now, found)


@remembered
def learned(world: Recall) -> Routines:
    """Routines of the last weeks of history. Raises NothingKnownError where there are less than two days."""
    start, lines = world.now - WEEKS, _all_weeks(world)
    known = world.now - min((line.stays[0].since for line in lines if line.stays), default=world.now)
    if known < LEAST_DAYS * DAY:
        raise NothingKnownError(
            f"I know no routines yet: I remember {duration(known)}, two days at least are needed."
        )
    return routines_of(lines, start, world.now, round(WEEKS / DAY) + 1)


def _all_weeks(world: Recall) -> list[Timeline]:
    """Of all that is no person and was there in the last weeks."""
    names = world.heads([*world.present, *world.active(world.now - WEEKS, world.now)])
    return [weeks_of(world, name) for name in names]
