"""The questions that can be asked in words; each is one call of a function.

A question is made of fixed words (see `CAN_BE_ASKED`), of what it is about, a place, and a time that may stand anywhere
in it. Whatever no pattern takes is not understood, and answered with what can be asked.
"""

from __future__ import annotations

import math
import re
from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

from estimation.errors import InputError
from estimation.geometry.places import Places
from world_model.memory.store import Store
from world_model.questions import company, nearby, past, traits, usual, where
from world_model.questions.answers import (
    AmbiguousError,
    Answer,
    NothingKnownError,
    NotUnderstoodError,
    clean,
    iso,
    listed,
)
from world_model.questions.moments import Span, ahead, extract, moment
from world_model.questions.naming import PREPOSITIONS, is_person, name_words, phrases, things_named
from world_model.questions.recall import Recall, Trust, recall
from world_model.questions.wording import plainly, respelled, simply
from world_model.symbols import Symbols

LONGEST = 500  # Characters of a question
CAN_BE_ASKED = (
    "where is the red cup", "where was cup-3 yesterday at nine", "where are the cups", "where is the cup usually",
    "when was the cup last seen", "when was the cup moved", "how often was the cup moved since monday",
    "how often was the cup on the kitchen table this week", "how long has the cup been there",
    "what has changed since breakfast", "what is missing", "what is on the kitchen table",
    "what was in the kitchen at 14:30", "what is usually on the desk", "how many cups are in the kitchen",
    "is the cup on the desk", "who was in the kitchen yesterday morning", "what will be needed next",
    "what happened to the cup", "which room is the cup in", "who moved the cup", "what has left the desk since noon",
    "where will the cup be tomorrow at eight", "what came to the desk today", "what is out of place",
    "what is next to the laptop", "how far is the cup from the book", "which cups are not in the kitchen",
    "what color is cup-3", "what was missing at noon", "what have you not seen today", "which places do you know",
    "when was anyone last in the kitchen", "where is the cup usually in the morning", "who has the cup",
    "is the cup in the kitchen or on the desk", "will the cup be on the desk tomorrow at eight",
)  # fmt: skip
_AT = rf"(?P<place>(?:{PREPOSITIONS}) .+)"
_BY = r"(?:right |just |directly )?(?:next to|close to|closest to|nearest to|nearest|near|beside|by|around)"
_TO = r"(?P<to>to|onto|into|on|in|at|from|out of) (?P<place>.+)"
_HERE = r"(?:here|there|around|home|at home|in the house|in the home)"
_BE = r"(?P<verb>is|was)"
_SOON = r"(?: (?:in|within|during|over) the next (?P<ahead>.+))?"
_PLACED = (
    r"(?:(?:in |at |on )?(?:its|their|the) (?:usual |normal |right |proper )?(?:place|spot)"
    r"|where (?:it|they) should be)"
)
_ASKS = r"(?:usually|where|when|who|what|which|how|is|was|did|can|could|will|would|should|list|tell|why)\b"
_UNREAD = re.compile(
    r"\b(?:where|when|who|what|how|did|not|it|they|before|after|since|while|if|than|i|you)\b"
)
"""Words that no name has: what has one was not read to its end."""
_I = r"(?:you|i|we|one)"
_WHO = r"(?P<who>(?!it\b|that\b|this\b|the\b|my\b|there\b|any|anyone\b|not\b)[\w-]+(?: [\w-]+)?)"
_W = r"(?P<what>.+?)"
_WHAT = r"(?:what|which(?: things| objects| items)?|what things|what objects)(?: else| all)?"


@dataclass(frozen=True)
class ParsedQuestion:
    """What a pattern found in a question. span, word : the time in it, and how it was put; then the words by group.
    said : the question as it was put."""

    world: Recall
    span: Span | None
    word: str
    what: str = ""
    place: str = ""
    who: str = ""
    verb: str = ""
    ahead: str = ""
    empty: str = ""
    to: str = ""
    left: str = ""
    other: str = ""
    said: str = ""

    @property
    def way(self) -> str:
        """Whether a move is meant "from" a place or "to" it."""
        return "from" if self.left or self.to in ("from", "out of") else "to" if self.to else ""

    @property
    def past(self) -> bool:
        return self.span is not None and not self.world.is_now(self.span.start)

    @property
    def then(self) -> Span | None:
        """The time of a question about the past; until a moment is that moment."""
        if self.span is None or not self.past:
            return None
        return Span(self.span.start, self.span.start, self.span.words) if self.word == "until" else self.span

    @property
    def since(self) -> Span | None:
        """ "yesterday" is the whole day; a moment is since then."""
        span = self.span
        if span is None:
            return None
        if self.word == "until":
            return Span(-float("inf"), span.start, span.words)
        return span if span.lasts else Span(span.start, self.world.now, span.words)

    @property
    def around(self) -> Span | None:
        """As `since`, but a moment without that word is the minutes around it: "who was here at nine"."""
        span = self.then
        if span is None or span.lasts or self.word in ("since", "until"):
            return self.since
        return Span(span.start - company.NOW, min(span.start + company.NOW, self.world.now), span.words)

    @property
    def daily(self) -> Span | None:
        """The time of what is usual then; "since" that time it is not one that comes again."""
        word = "" if self.word == "between" else self.word
        return self.span and replace(self.span, words=f"{word} {self.span.words}".strip())

    @property
    def always(self) -> Recall:
        """The world. Raises NotUnderstoodError where a time is said that would not be looked at."""
        if self.span is not None:
            raise NotUnderstoodError(
                f'I can only tell what is usual at all hours, not "{clean(self.span.words)}"; ask without it, or what '
                "was so at a time that is past."
            )
        return self.world


Call = Callable[[ParsedQuestion], Answer]


def _where(q: ParsedQuestion) -> Answer:
    if q.span is not None and q.span.start > q.world.now + 1.0:
        then = where.within(q.world, q.span) if q.verb == "was" else q.span
        return usual.where_will_be(q.world, q.what, then)
    if q.then is not None:
        call = company.where_was_person if is_person(q.world, q.what) else where.where_was
        return call(q.world, q.what, q.then)
    return (where.where_was if q.verb == "was" and q.span is None else where.where_is)(q.world, q.what)


def _named(q: ParsedQuestion) -> Answer:
    """Where something is, of which no more than the name was said. Raises NotUnderstoodError where it is no name."""
    try:
        return _where(q)
    except NothingKnownError:
        raise NotUnderstoodError(_not_understood(q.said)) from None


def _last_at(q: ParsedQuestion) -> Answer:
    if q.since is not None:
        return where.is_at(q.world, q.what, q.place, q.since)
    return past.when_last_at(q.world, q.what, q.place)


def _who(q: ParsedQuestion) -> Answer:
    if q.verb == "is" and not q.past:
        return company.who_is_here(q.world, q.place)
    return company.who_was_here(q.world, q.place, q.around, q.who)


def _next(q: ParsedQuestion) -> Answer:
    span = extract(f"in the last {q.ahead}", 0.0)[1] if q.ahead else None
    return usual.what_is_needed_next(q.always, max(span.end - span.start, 600.0) if span else usual.AHEAD)


def _is_at(q: ParsedQuestion) -> Answer:
    each = re.sub(r"^(?:all|both|every|each)\b(?: of)? ", "", q.what)
    if each != q.what:
        many, known = where.how_many(q.world, each, q.place, q.then), len(things_named(q.world, each).ids)
        all_there = many.value == known
        said = f"{'Yes' if all_there else 'No'}, {many.value} of {known}. {many.sentence}"
        return replace(many, kind="is_at", value=all_there, sentence=said)
    if q.span is not None and q.span.words.startswith("for "):
        long = past.how_long_there(q.world, q.what, q.place)
        there = (long.value or 0.0) >= q.span.end - q.span.start
        said = f"{'Yes' if there else 'No'}: {long.sentence}"
        return replace(long, kind="is_at", value=there, sentence=said)
    if q.verb == "was" and q.span is None:
        last = past.when_last_at(q.world, q.what, q.place)
        return replace(last, kind="is_at", value=last.value is not None)
    return where.is_at(q.world, q.what, q.place, q.then)


def _came(q: ParsedQuestion) -> Answer:
    if q.span is None:
        return past.when_last_at(q.world, q.what, q.place)
    return past.when_moved(q.world, q.what, q.around, q.place or q.left, q.way)


def _listed(q: ParsedQuestion) -> Answer:
    """ "which cups are on the desk", "list the red things in the kitchen"."""
    if q.past and q.place:
        return _is_at(q)
    what = f"{q.what} {q.place}".strip()
    return where.where_was(q.world, what, q.then) if q.past else where.where_is(q.world, what, every=True)


def _will_be(q: ParsedQuestion) -> Answer:
    if q.span is None:
        raise NotUnderstoodError('When? Say "tomorrow at eight", "in two hours" or "this evening".')
    if q.place:
        return usual.will_be_at(q.world, q.what, q.place, q.span)
    return usual.where_will_be(q.world, q.what, q.span)


def _gone(q: ParsedQuestion) -> Answer:
    return past.how_long_there(q.world, q.what, "", q.since, gone=True) if q.past else _where(q)


def _missing(q: ParsedQuestion) -> Answer:
    if q.then is not None and not q.then.lasts and q.word != "since":
        return past.what_was_missing(q.world, q.then.start)
    return past.what_is_missing(q.world, q.since)


def _valued(q: ParsedQuestion) -> Answer:
    """Raises NotUnderstoodError about the past: what things looked like then is not kept."""
    if q.past:
        raise NotUnderstoodError("I can only tell what things look like now, not what they looked like then.")
    if q.verb:
        return traits.is_so(q.world, q.what, q.other)
    return traits.what_it_is(q.world, q.what, q.other or "class")


_CALLS: dict[str, Call] = {
    "where": _where,
    "last_at": _last_at,
    "long": lambda q: past.how_long_there(q.world, q.what, q.place, q.since if q.past else None),
    "who": _who,
    "next": _next,
    "what_at": lambda q: where.what_is_at(q.world, q.place or f"in {q.empty}", q.then),
    "is_at": _is_at,
    "came": _came,
    "listed": _listed,
    "will_be": _will_be,
    "room": lambda q: where.which_room(q.world, q.what, q.then),
    "usually": lambda q: where.where_usually(q.world, q.what, q.daily),
    "at_home": lambda q: usual.is_at_usual_place(q.always, q.what),
    "seen": lambda q: where.when_last_seen(q.world, q.what, q.since),
    "moved": lambda q: past.when_moved(q.world, q.what, q.around, q.place or q.left, q.way),
    "often": lambda q: past.how_often(q.world, q.what, q.place, q.since),
    "who_last": lambda q: company.who_was_last(q.world, q.place, q.since),
    "long_gone": lambda q: past.how_long_there(q.world, q.what, "", q.since if q.past else None, gone=True),
    "strays": lambda q: usual.what_is_out_of_place(q.always),
    "arrived": lambda q: past.what_moved(q.world, q.around, q.place, "to"),
    "everything": lambda q: where.what_is_at(q.world, "", q.then),
    "changed": lambda q: past.what_changed(q.world, q.since, q.place),
    "all_moved": lambda q: past.what_moved(q.world, q.around, q.place),
    "missing": _missing,
    "gone": _gone,
    "valued": _valued,
    "help": lambda q: Answer(f"You can ask: {'; '.join(CAN_BE_ASKED)}.", "help", 1.0, choices=CAN_BE_ASKED),
    "unseen": lambda q: where.what_was_not_seen(q.world, q.since),
    "places": lambda q: traits.which_places(q.world, q.what.replace("rooms", "room")),
    "near": lambda q: nearby.what_is_near(q.world, q.what, q.then, q.other),
    "far": lambda q: nearby.how_far(q.world, q.what, q.other, q.then),
    "left": lambda q: past.what_left(q.world, q.place, q.since),
    "usually_at": lambda q: usual.is_usually_at(q.world, q.what, q.place, q.daily),
    "usually_here": lambda q: usual.what_is_usually_here(q.world, q.place, q.daily),
    "who_moved": lambda q: company.who_moved(q.world, q.what, q.around, q.who, q.place, q.way),
    "who_has": lambda q: company.who_has(q.world, q.what),
    "carried": lambda q: company.what_was_carried(q.world, q.who, q.around),
    "many": lambda q: where.how_many(q.world, q.what, q.place, q.then),
    "history": lambda q: past.history(q.world, q.what, q.since),
}


_PATTERNS = rf"""
usually      usually where (?:is|was|did|can|would|should)(?: {_I})? (?:(?:find|keep|seen|moved|gone|left) )?{_W}
>(?: (?:be|kept|gone|is|moved|hang|stored))*
usually      where should (?!{_I}\b){_W} (?:be|gone|is)
strays       (?:what|which things) is (?:out of (?:its )?place|in the wrong place|misplaced|not {_PLACED})
strays       is (?:everything|all|anything) (?:not |out of )?{_PLACED}
strays       usually (?:what|which things|is everything|is anything) (?:is )?(?:not )?where (?:it|they)(?: is)?
at_home      is {_W} {_PLACED}
at_home      usually is {_W} where (?:it|they)(?: is)?
usually_at   usually {_BE} {_W} {_AT}
usually_here usually {_WHAT}(?: is| did {_I}| can {_I})?(?: there)? (?:(?:find|seen|kept|moved) )?{_AT}
room         (?:in |on |at )?(?:which|what) (?:room|place|spot|part of here) {_BE} {_W}(?: (?:in|on|at))?
room         (?:in |on |at )?(?:which|what) (?:room|place|spot) {_W} {_BE}(?: (?:in|on|at))?
who_last     who {_BE} anyone (?:{_HERE}|{_AT})
who_last     (?:when|how long ago) (?:is|was) anyone(?: seen)?(?: {_HERE}| {_AT})
seen         (?:when|how long ago) (?:is|was|did)(?: {_I}| anyone)? seen {_W}
seen         (?:when|how long ago|how long (?:was it|is it) since) (?:(?:is|was|did) )?{_W} (?:was )?(?:seen|{_HERE})
seen         (?:how long (?:was it|is it) since {_I} seen|seen|sight of) {_W}
last_at      when (?:is|was) {_W} {_AT}
came         when (?:did|was) {_W} (?:came|moved|gone) {_TO}
moved        when (?:did|was)(?: {_I}| anyone) moved {_W}
all_moved    (?:when|how long ago) (?:did|was) anything moved
moved        (?:when|how long ago) (?:did|was) {_W} (?:moved|gone|left|came)(?: {_HERE})?(?: {_TO})?
moved        when (?:did|was) {_W} left (?P<left>.+)
moved        where (?:was|did) {_W} (?:be )?before(?: that| (?:it|they) (?:was )?moved)?
often        how often (?:did|was|is) {_W} (?:moved|gone)(?: around)?
often        how often (?:did|was|is) {_W} {_AT}
long_gone    how long (?:did|was) {_W} (?:gone|stay gone|out)
long         (?:how long|since when|for how long) (?:did|is|was) {_W} (?:{_HERE}|where (?:it|they) is|gone)
long         (?:how long|since when|for how long|how much time) (?:did|is|was) {_W} (?:(?:stay|spend|left|be) )?{_AT}
long         (?:how long|since when|for how long) (?:did|was) {_W}
changed      {_WHAT} (?:(?:is|was|did) )?(?:changed|different|new)(?: {_HERE})?(?: {_AT})?
changed      (?:(?:is|was|did)(?: there)? )?anything (?:changed?|different|new)(?: {_HERE})?(?: {_AT})?
arrived      {_WHAT} (?:(?:is|was|did) )?(?:came|moved) (?:to|onto|into) (?P<place>.+)
arrived      (?:is|was|did) anything (?:came|moved) (?:to|onto|into) (?P<place>.+)
arrived      {_WHAT} (?:was|did) put {_AT}
all_moved    {_WHAT} (?:(?:is|was|did) )?(?:moved|happened)(?: around| about)?(?: {_HERE})?(?: {_AT})?
all_moved    (?:is|was|did) anything (?:moved|happen(?:ed)?)(?: around| about)?(?: {_HERE})?(?: {_AT})?
left         {_WHAT} (?:is|was|did) (?:no longer|not .+ any ?more|gone) {_AT}
left         {_WHAT} (?:did )?left (?P<place>.+)
left         (?:is|was|did) anything (?:gone|moved) {_AT}
missing      {_WHAT} (?:(?:is|was|did) )?(?:gone|not where it was)
missing      (?:is|was|did)(?: there)? anything gone
missing      (?:did|was) {_I} gone anything
unseen       {_WHAT} (?:did|was) (?:{_I} not|not {_I}) seen
places       (?:what|which|list|show me|name)(?: all)?(?: the)? (?:(?P<what>rooms|furniture)|places)
>(?: (?:is there|did {_I} know(?: of| about)?))?
help         help|what can {_I} ask(?: {_I})?|(?:what|which) questions .+|what can {_I} did
who          who {_BE} (?:seen )?(?:{_HERE}|{_AT})?(?:,? and with what)?
who          where (?P<verb>is) (?:everyone|everybody|anyone|all)
who          (?:was|did) {_WHO} (?:seen|{_HERE})
who_moved    who (?:did )?moved {_W}(?: {_TO})?
who          who (?:did )?came(?: {_HERE})?(?: (?:to )?(?P<place>.+))?
often        (?:did|was) (?!{_I} |anyone |anything ){_W} moved(?: around)?
moved        (?:did|was) (?!{_I} |anyone |anything ){_W} (?:moved|gone|came) {_TO}
moved        (?:did|was) (?!{_I} |anyone |anything ){_W} left (?P<left>.+)
who_moved    (?:did|was) (?:{_I}|anyone|{_WHO}) moved {_W}
carried      what (?:did|was) {_WHO} (?:moved|done?|doing)(?: with| around)?
who          {_BE} (?:there )?anyone(?: seen)? (?:{_HERE}|{_AT})
who          did anyone (?:was|came)(?: {_HERE})?(?: {_TO})?
who          did anyone came (?P<place>.+)
who          who did {_I} seen(?: {_HERE}| {_AT})?
who          (?P<verb>is|was) (?:the |our )?(?:house|home|flat|apartment) empty
who_has      who (?:did|(?:(?:did|is) )?came) (?!left\b){_W}
who_has      did anyone (?:did|came) {_W}
next         what did {_I} need
next         what (?:will be|will {_I}|will|is|might be) (?:be )?(?:needed|need|moved|happen)
>(?: next| soon)*{_SOON}
next         what (?:is|came|happens|moved) (?:next|going to (?:be )?(?:needed|moved|happen))(?: next)?{_SOON}
who          how many anyone {_BE} (?:seen )?(?:{_HERE}|{_AT})
many         how many {_W} (?:is|was)(?: there)?(?: left)?(?: {_HERE})?(?: {_AT})?
many         how many {_W} (?:did|can) {_I} (?:know|seen|did|came|own)(?: {_HERE})?(?: {_AT})?
many         (?:how many|number of) {_W}(?: {_AT})?
many         (?:is|was) there {_W}(?: left)? {_HERE}
many         did {_I} did {_W}(?: {_HERE})?
everything   {_WHAT} (?:did|was) {_I} (?:seen|know|know about|know of)(?: {_HERE})?
near         {_WHAT} {_BE}(?: there| left| kept)* {_BY} {_W}
near         {_BE}(?: there)? anything {_BY} {_W}
near         (?:what|which) (?P<other>.+) {_BE} {_BY} {_W}
far          how far (?:away )?{_BE} {_W} (?:away )?from (?P<other>.+)
far          (?:how far apart|what is the distance between) (?:{_BE} )?{_W} and (?P<other>.+)
far          {_BE} {_W} {_BY} (?P<other>.+)
what_at      {_WHAT} (?:{_BE}|(?:did|can) {_I} (?:seen|did|came))(?: there| left| kept)* {_AT}
what_at      {_BE}(?: there)? anything(?: left)? {_AT}
what_at      {_BE} (?P<empty>.+) (?:empty|clear|free)
listed       (?:what|which) (?P<what>.+) {_BE} (?P<place>(?:not )?(?:{PREPOSITIONS}) .+)
listed       (?:list|show|give me|name)(?: me)? (?:all |all of )?{_W}
history      what (?:happened|was done|is the history|did {_I} know|did {_I} did|did {_I} do) (?:to|with|of|about) {_W}
history      (?:tell me |show me |give me )?(?:about|describe|the history of|history of|history) {_W}
is_at        {_BE} (?:there )?{_W} {_AT}
will_be      will {_W} be {_AT}
is_at        did {_I} (?:left|moved|forget) {_W} {_AT}
where        is {_W} {_HERE}
gone         (?:{_BE}|did) {_W} gone
where        (?:did|is) {_W} (?:came)(?: {_HERE})?
many         (?:is|was) there {_W}(?: left)?
where        where (?:could|might|may|can) {_W} be
where        (?:what|which) {_W} is {_HERE}
will_be      where will {_W} be
where        where (?:is|was|did) {_W} (?:gone|ended up|end up|came|came to|disappeared to)
where        where (?:can|could|did|would|might|should) {_I} (?:find|look for|seen|came) {_W}
where        where (?:is|did|was|can|could|might)?(?: ?{_I}) (?:did )?(?:moved|left|seen|find|lose|gone|keep|forget)
> {_W}
where        where {_BE} {_W}(?: seen| be| now| kept| moved)?
where        where did {_W} (?:be|is|left)
valued       what (?:kind|sort) of (?:thing|object) is {_W}
valued       (?:what|which) (?:kind of )?(?P<other>[\w-]+) is {_W}
valued       {_BE} {_W} (?:an? )?(?P<other>[\w-]+(?: or (?:an? )?[\w-]+)*)
where        (?:whereabouts (?:is|was)|find|locate|look for|search for|show me|location of|the location of) {_W}
"""
"""A word of `_CALLS` and what its question looks like; behind ">" it goes on. The first that fits is taken."""
_COMPILED = tuple(
    (re.compile(f"(?:{pattern.lstrip()})"), _CALLS[word])
    for word, _, pattern in (
        line.partition(" ") for line in _PATTERNS.strip().replace("\n>", "").splitlines()
    )
)


def ask(
    source: object, question: str, places: Places | None = None, symbols: Symbols | None = None
) -> Answer:
    """Answer a question in plain words.

    source : a `Store`, the path of its file, or a `WorldModel`. places, symbols : instead of those that it knows.
    A question that is not understood is answered with what can be asked, an ambiguous one with the choices, one about
    something unknown with what is known; see `Answer.kind`. Raises StoreError where the file is no store.
    """
    if isinstance(source, (str, Path)):
        with Store(source, read_only=True) as store:
            return ask(store, question, places, symbols)
    return answered(recall(source, places, symbols), lambda world: _call(world, question))


def answered(world: Recall, call: Callable[[Recall], Answer]) -> Answer:
    """The answer of a call; what it raises about the question is an answer, too. One from a damaged store says so."""
    try:
        answer = call(world)
    except AmbiguousError as error:
        answer = Answer(str(error), "choices", 1.0, iso(world.now), choices=error.choices)
    except NothingKnownError as error:
        answer = Answer(str(error), "unknown", Trust.NOT_SEEN, iso(world.now))
    except InputError as error:
        answer = Answer(clean(str(error), 400), "not_understood", choices=CAN_BE_ASKED)
    damage = f" ({clean(world.damage, 400)})" if world.damage else ""
    return replace(answer, sentence=f"{answer.sentence}{damage}")


def _call(world: Recall, question: str) -> Answer:
    if not isinstance(question, str) or not question.strip():
        raise NotUnderstoodError(_not_understood(""))
    if len(question) > LONGEST:
        raise NotUnderstoodError(f"A question has at most {LONGEST} characters, this one {len(question)}.")
    try:
        return _said(world, question)
    except NotUnderstoodError as error:
        # "Where is the cup? I need it now!"
        for part in re.split(r"(?<=[?!.]) +", question):
            try:
                return _said(world, part)
            except InputError:
                continue
        raise error


def _said(world: Recall, question: str) -> Answer:
    """The answer of a question in one sentence. Raises as `_matched`, and AmbiguousError."""
    text = plainly(question, LONGEST).lower()
    try:
        return _matched(world, text, question)
    except (NothingKnownError, NotUnderstoodError) as error:
        other, slips = respelled(text, phrases(world))
        if other == text:
            raise
        try:
            answer = _matched(world, other, question)
        except (NothingKnownError, NotUnderstoodError):
            raise error from None
    if not slips:
        return answer
    taken = listed(f'"{clean(said)}" for "{clean(meant)}"' for said, meant in slips)
    return replace(answer, sentence=f"I take {taken}. {answer.sentence}")


def _matched(world: Recall, text: str, question: str) -> Answer:
    """The answer of the first pattern that takes a question. Raises NothingKnownError, NotUnderstoodError."""
    will = re.match(r"(?:where )?will .+ be\b", text)
    bare, span, word = (*ahead(text, world.now), "") if will else extract(text, world.now)
    error: InputError | None = None
    # Time words may be part of a name: "the night lamp".
    for form, then in ((bare, span), (text, None))[: 2 if span is not None else 1]:
        for call, words in _fitting(simply(form, name_words(world))):
            q = ParsedQuestion(world, then, word if then is not None else "", said=question, **words)
            try:
                if then is not None and call not in (_where, _will_be):
                    where.within(world, then)  # of what is ahead nothing else is known
                return _each(call, q)
            except (NothingKnownError, NotUnderstoodError) as raised:
                if not _UNREAD.search(f"{q.what} {q.place.removeprefix('not ')} {q.who} {q.other}"):
                    error = error or raised
    raise error or NotUnderstoodError(_not_understood(question))


def _each(call: Call, q: ParsedQuestion) -> Answer:
    """The answer; where "or" names several things or places that of each, the first that is not "no" counting."""
    name = next((name for name in ("what", "place", "other") if " or " in getattr(q, name)), "")
    parts = re.split(r",? or |, ", getattr(q, name)) if name else [""]
    if len(parts) < 2 or any(_UNREAD.search(part) for part in parts):
        return call(q)
    if any(_is_time(part, q.world.now) for part in parts[1:]):
        raise NotUnderstoodError("I can only tell of one time; ask for the other again.")
    answers, unknown = [], []
    for part in parts:
        try:
            alone: dict[str, Any] = {name: part}
            answers.append(_each(call, replace(q, **alone)))
        except NothingKnownError as error:
            unknown.append(error)
    if not answers:
        return call(q)
    best = next((answer for answer in answers if answer.value), answers[0])
    told_of = " ".join([*(answer.sentence for answer in answers), *map(str, unknown)])
    return replace(best, sentence=told_of, probability=math.prod(answer.probability for answer in answers))


def _is_time(words: str, now: float) -> bool:
    try:
        moment(words, now)
    except InputError:
        return False
    return True


def _fitting(text: str) -> Iterator[tuple[Call, dict[str, str]]]:
    """What a question may call, and its words by group, that of the first pattern first; a name alone asks where."""
    for pattern, call in _COMPILED:
        found = pattern.fullmatch(text)
        if found:
            yield call, found.groupdict("")
    if not re.match(_ASKS, text):
        yield _named, {"what": text}


def _not_understood(question: str) -> str:
    said = f'I do not understand "{clean(question)}"' if question else "That is no question"
    return f"{said}; ask for example: {'; '.join(CAN_BE_ASKED[:1] + CAN_BE_ASKED[6:7] + CAN_BE_ASKED[9:12])}."
