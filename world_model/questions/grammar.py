"""The questions that can be asked in words; each is one call of a function.

A question is made of fixed words (see `CAN_BE_ASKED`), of what it is about, a place, and a time that may stand anywhere
in it. Whatever no pattern takes is not understood, and answered with what can be asked.
"""

from __future__ import annotations

import re
from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path

from estimation.errors import InputError
from estimation.geometry.places import Places
from world_model.memory.store import Store
from world_model.questions import company, past, usual, where
from world_model.questions.answers import (
    AmbiguousError,
    Answer,
    NothingKnownError,
    NotUnderstoodError,
    clean,
    iso,
    listed,
)
from world_model.questions.moments import Span, ahead, extract
from world_model.questions.naming import PREPOSITIONS, is_person, phrases
from world_model.questions.recall import Recall, Trust, recall
from world_model.questions.wording import plainly, respelled
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
    "where will the cup be tomorrow at eight",
)  # fmt: skip
_AT = rf"(?P<place>(?:{PREPOSITIONS}) .+)"
_HERE = r"(?:here|there|around|home|at home|in the house|in the home)"
_BE = r"(?P<verb>is|are|was|were|has been|have been|had been)"
_ANY = r"(?:you|i|we|one|anyone|anybody|somebody|someone)"
_WHO = r"(?P<who>(?!it\b|that\b|this\b|the\b|my\b|there\b|any)[\w-]+(?: [\w-]+)?)"
_PLACE = r"(?P<place>.+)"
_WHAT = r"(?:what|which) (?:has |have |is |was |were |been |things? |objects |else )*"
_ANYTHING = r"(?:has|have|did|was|were) (?:anything|something|any things?) (?:been |else )?"
_HANDLED = r"(?:moved?|took|taken?|carr(?:y|ied)|had|held|used?|touch(?:ed)?|brought|bring|removed?)"
_USUALLY = r"(?:usually|normally|mostly|often|generally|most of the time)"


@dataclass(frozen=True)
class ParsedQuestion:
    """What a pattern found in a question. span, word : the time in it, and how it was put; then the words by group."""

    world: Recall
    span: Span | None
    word: str
    what: str = ""
    place: str = ""
    who: str = ""
    verb: str = ""
    ahead: str = ""

    @property
    def past(self) -> bool:
        return self.span is not None and self.span.start < self.world.now - 1.0

    @property
    def during(self) -> Span | None:
        """A time in the past that lasts, and is not the end of one."""
        long = self.span is not None and self.span.end - self.span.start >= 1.0
        return self.span if self.past and long and self.word != "until" else None

    @property
    def when(self) -> Span | None:
        """Until a moment is that moment."""
        span = self.span
        return Span(span.start, span.start, span.words) if span is not None and self.word == "until" else span

    @property
    def then(self) -> Span | None:
        """The time of a question about the past."""
        return self.when if self.past else None

    @property
    def since(self) -> Span | None:
        """ "yesterday" is the whole day; a moment is since then."""
        span = self.span
        if span is None:
            return None
        if self.word == "until":
            return Span(-float("inf"), span.start, span.words)
        return Span(span.start, self.world.now, span.words) if span.end - span.start < 1.0 else span

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
    if q.past:
        assert q.when is not None
        if is_person(q.world, q.what):
            return company.where_was_person(q.world, q.what, q.when)
        return where.where_was(q.world, q.what, q.when)
    was = q.verb in ("was", "were", "had been", "did", "has been", "have been")
    return (where.where_was if was and q.span is None else where.where_is)(q.world, q.what)


def _last_at(q: ParsedQuestion) -> Answer:
    if q.since is not None:
        return past.was_at(q.world, q.what, q.place, q.since)
    return past.when_last_at(q.world, q.what, q.place)


def _long(q: ParsedQuestion) -> Answer:
    if q.past and q.since is not None:
        return past.how_long_at(q.world, q.what, q.place, q.since)
    return past.how_long_there(q.world, q.what, q.place)


def _who(q: ParsedQuestion) -> Answer:
    if q.verb in ("is", "are") and not q.past:
        return company.who_is_here(q.world, q.place)
    return company.who_was_here(q.world, q.place, q.since, q.who)


def _next(q: ParsedQuestion) -> Answer:
    return usual.what_is_needed_next(q.always, extract(f"in the last {q.ahead}", 0.0)[1] if q.ahead else None)


def _what_at(q: ParsedQuestion) -> Answer:
    if q.during is not None:
        return past.what_was_at(q.world, q.place, q.during)
    was = q.verb in ("was", "were", "lay", "stood") or q.past
    return where.what_is_at(q.world, q.place, q.when if was else None)


def _is_at(q: ParsedQuestion) -> Answer:
    if q.during is not None:
        return past.was_at(q.world, q.what, q.place, q.during)
    return where.is_at(q.world, q.what, q.place, q.then)


def _listed(q: ParsedQuestion) -> Answer:
    """ "cups are on the desk", "red things in the kitchen"."""
    what = re.sub(rf" (?:is|are|was|were)(?: there)? (?=(?:{PREPOSITIONS}) )", " ", q.what)
    if not q.past:
        return where.where_is(q.world, what)
    if q.place:
        return _is_at(replace(q, what=what.removesuffix(q.place).strip()))
    return where.where_was(q.world, what, q.when)


def _will_be(q: ParsedQuestion) -> Answer:
    if q.span is None:
        raise NotUnderstoodError('When? Say "tomorrow at eight", "in two hours" or "this evening".')
    return usual.where_will_be(q.world, q.what, q.span)


_CALLS: dict[str, Call] = {
    "where": _where,
    "last_at": _last_at,
    "long": _long,
    "who": _who,
    "next": _next,
    "what_at": _what_at,
    "is_at": _is_at,
    "listed": _listed,
    "will_be": _will_be,
    "room": lambda q: where.which_room(q.world, q.what, q.then),
    "usually": lambda q: where.where_usually(q.always, q.what),
    "at_home": lambda q: usual.is_at_usual_place(q.always, q.what),
    "seen": lambda q: where.when_last_seen(q.world, q.what, q.since),
    "moved": lambda q: past.when_moved(q.world, q.what, q.since),
    "often": lambda q: past.how_often(q.world, q.what, q.place, q.since),
    "changed": lambda q: past.what_changed(q.world, q.since, q.place),
    "all_moved": lambda q: past.what_moved(q.world, q.since, q.place),
    "missing": lambda q: past.what_is_missing(q.world, q.since),
    "left": lambda q: past.what_left(q.world, q.place, q.since),
    "usually_here": lambda q: usual.what_is_usually_here(q.always, q.place),
    "who_moved": lambda q: company.who_moved(q.world, q.what, q.since, q.who),
    "carried": lambda q: company.what_was_carried(q.world, q.who, q.since),
    "many": lambda q: where.how_many(q.world, q.what, q.place, q.when),
    "history": lambda q: past.history(q.world, q.what, q.since),
}


_W = r"(?P<what>.+?)"
_PATTERNS = rf"""
usually      where (?:is|are|was|were|does|do) {_W} {_USUALLY}(?: (?:be|belong|kept|go|lie|stand))?
usually      where (?:is|are|do you|do i|does one|can i|would i) {_USUALLY} (?:find |keep |see |put )?{_W}
usually      where (?:does|do) {_W} (?:{_USUALLY} )?(?:belong|go|live|lie|stand)
usually      where (?:should|ought|is supposed to|are supposed to) {_W} (?:to )?(?:be|go|stand|lie)
usually      where (?:is|are) {_W} supposed to be
at_home      (?:is|are) {_W} (?:in|at|on) (?:its|their|the) (?:usual|normal|right|proper) (?:place|spot)
at_home      (?:is|are) {_W} where (?:it|they) (?:belongs?|should be|{_USUALLY} (?:is|are))
room         (?:in |on |at )?(?:which|what) (?:room|place|spot|part of here) (?P<verb>is|are|was|were) {_W}(?: (?:in|
>on|at))?
seen         when (?:was|were|did|is) (?:(?:you|i|anyone|somebody) )?(?:last )?(?:see|seen) {_W}(?: last)?
seen         when (?:was|were|is) {_W} (?:last )?(?:seen|there|{_HERE})(?: last)?
last_at      when (?:was|were|is) {_W} (?:last )?{_AT}?(?: last)
last_at      when (?:was|were|is) {_W} last {_AT}
last_at      when (?:did|was|were) {_W} (?:come|get|arrive|put|placed|moved) (?:to|onto|into|on|in|at) {_PLACE}
seen         how long ago (?:was|were|did) (?:{_ANY} (?:last )?see )?{_W}(?: (?:last )?seen)?(?: last)?
seen         how long (?:has it been|is it) since {_ANY} (?:last )?saw {_W}
seen         how long (?:has it been|is it) since {_W} (?:was|were) (?:last )?seen
seen         when (?:was|were) the last time (?:you|i|anyone|somebody) (?:saw|had seen) {_W}
seen         (?:last seen|last sight of) {_W}
moved        when (?:was|were) the last time {_ANY} (?:moved|took|used) {_W}
moved        when (?:did|has) {_ANY} (?:last )?(?:moved?|take|taken|used?|touch|touched) {_W}(?: last)?
moved        when (?:was|were|did|has|have) {_W} (?:been )?(?:last )?(?:moved?|taken|carried|go|leave|left|disappear
>(?:ed)?|vanish(?:ed)?)(?: away| last| missing)*
often        (?:how often|how many times) (?:was|were|has|have|did|is) {_W} (?:been )?(?:moved?|carried|used|taken)
>(?: around)?
often        (?:how often|how many times) (?:was|were|has|have|is) {_W} (?:been )?{_AT}
long         (?:how long|since when) (?:has|have|is|are|was|were) {_W} (?:been )?(?:{_HERE}|where (?:it is|they are)|
>missing|gone|lost|away)
long         (?:how long|since when) (?:has|have|is|are|was|were) {_W} (?:been )?{_AT}
long         (?:how long|since when) (?:has|have) {_W} been
changed      {_WHAT}(?:changed|different|new)(?: {_HERE})?(?: {_AT})?
changed      {_ANYTHING}(?:changed?|different|new)(?: {_HERE})?(?: {_AT})?
all_moved    {_WHAT}(?:moved|happened)(?: around| about)?(?: {_HERE})?(?: {_AT})?
all_moved    {_ANYTHING}(?:moved?|happen(?:ed)?)(?: around| about)?(?: {_HERE})?(?: {_AT})?
left         (?:what|which things) (?:is|are|was|has|have) (?:no longer|not .+ any ?more|missing|gone|disappeared|
>vanished|been taken|been removed|taken|removed) {_AT}
left         (?:what|which things) (?:has|have) left {_PLACE}
left         (?:is|was|has) (?:anything|something) (?:missing|gone|been taken|been removed|taken|removed) {_AT}
missing      (?:what|which) (?:is|are|was|has|have|things are|objects are|things have|things|objects) (?:gone |
>been )?(?:missing|gone|lost|not where it was|disappeared|vanished)(?: now)?
missing      (?:is|are) (?:anything|something|any things?|there anything) (?:missing|gone|lost)
usually_here what (?:is|are|lies|stands|do you|can i)(?: there)? {_USUALLY} (?:find |see |kept )?{_AT}
usually_here what (?:is|are) {_AT} {_USUALLY}
usually_here what (?:belongs|usually is|usually lies|is usually kept) {_AT}
who          (?:who|which people|what people|who all) {_BE} {_HERE}(?:,? and with what)?
who          (?:who|which people|what people) {_BE} (?:seen )?{_AT}?(?:,? and with what)?
who          (?:was|were|has|have) {_WHO} (?:been )?(?:{_HERE}|seen)
who_moved    who (?:has |have |had )?(?:last )?{_HANDLED} {_W}(?: last)?(?: {_AT})?
often        (?:has|have|did|was|were) (?!{_ANY} ){_W} (?:been )?(?:moved?|carried|used)(?: around| away)?
who_moved    (?:did|has|have) (?:{_ANY}|{_WHO}) {_HANDLED} {_W}
who          when (?:was|were|did) {_WHO} (?:come|arrive|visit)(?: {_HERE})?
carried      what (?:did|has|have) {_WHO} (?:{_HANDLED}|done?|put|pick(?:ed)? up|put down)(?: with| around| away)?
carried      what was {_WHO} (?:carrying|holding|moving|doing)
who          (?:who|which people) (?:came|visited|used|went to|entered) ?(?:{_AT})?
who          (?P<verb>was|were|has|have|is|are) (?:there )?(?:anybody|anyone|somebody|someone|people|any people)
> (?:been )?(?:{_HERE}|{_AT})
next         what (?:will be|will i|will we|is|do i|might be|will) (?:be )?(?:needed|need|moved?|used|move|happen)
>(?: next| soon)*(?: (?:in|within|during|over) the next (?P<ahead>.+))?
next         what (?:is|comes|happens|moves) (?:next|going to (?:be needed|be moved|move|happen))(?: next)?(?: (?:in|
>within) the next (?P<ahead>.+))?
who          how many (?:people|persons) {_BE} (?:seen )?(?:{_HERE}|{_AT})
many         how many (?!times\b){_W} (?:are|is|were|was|lie|stand)(?: there)?(?: {_HERE})?(?: {_AT})?
many         how many (?!times\b){_W} (?:do|can|did|have) (?:you|i|we) (?:know|see|seen|have|got|own)(?: {_HERE})?
>(?: {_AT})?
many         how many (?!times\b){_W}(?: {_AT})?
many         (?:is|are|was|were) there {_W}(?: left)? {_HERE}
many         (?:do|have) (?:you|i|we) (?:have|got) {_W}(?: {_HERE})?
what_at      what(?: all| else)? (?P<verb>is|are|was|were|lies|lay|stands|stood|(?:do|can) (?:you|we|i) (?:see|
>have))(?: there| lying| standing| kept)? {_AT}
what_at      (?:what|which) (?:things|objects|items) (?P<verb>are|were|lie|lay)(?: there)? {_AT}
what_at      (?:is there|are there|is|are) (?:anything|something|any things|things) {_AT}
listed       (?:what|which) (?P<what>.+ (?P<verb>are|were) {_AT})
listed       (?:list|show|show me|give me|name)(?: me)? (?:all |all of )?{_W}
history      what (?:happened|was done|is the history|do you know) (?:to|with|of|about) {_W}
history      (?:tell me |show me |give me )?(?:about|the history of|history of|history) {_W}
history      tell me (?:about|of) {_W}
is_at        (?:is|are|was|were) (?:there )?{_W} (?:still )?{_AT}
where        (?:is|are) {_W} (?:still )?{_HERE}
many         (?:is|are|was|were) there {_W}(?: left)?
where        where (?:could|might|may|can) {_W} be
where        (?:what|which) {_W} (?:are|is) {_HERE}
is_at        (?:has|have) {_W} been {_AT}
will_be      where will {_W} be
where        where (?:has|have|did) {_W} (?:gone|go|ended up|end up|got to|get to|disappeared to)
where        where (?:is|are) {_W} (?:now|at the moment|kept|lying)
where        where (?:can|could|do|would|might|should) (?:i|we|you|one) (?:find|look for|see|get) {_W}
where        where did (?:i|we|you|one) (?:last |usually )?(?:put|leave|see|find|lose) {_W}(?: last)?
where        (?:where|whereabouts) (?P<verb>is|are|was|were|has|have) {_W}(?: been| seen| be| now)?
where        (?:find|locate|look for|search for|show me) {_W}
where        (?:do you know |can you tell me |tell me )where {_W} (?P<verb>is|are|was|were)
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
            return answered(recall(store, places, symbols), lambda world: _call(world, question))
    return answered(recall(source, places, symbols), lambda world: _call(world, question))


def answered(world: Recall, call: Callable[[Recall], Answer]) -> Answer:
    """The answer of a call; what it raises about the question is an answer, too."""
    try:
        return call(world)
    except AmbiguousError as error:
        return Answer(str(error), "choices", 1.0, iso(world.now), None, (), (), error.choices)
    except NothingKnownError as error:
        return Answer(str(error), "unknown", Trust.NOT_SEEN, iso(world.now))
    except NotUnderstoodError as error:
        return Answer(str(error), "not_understood", choices=CAN_BE_ASKED)
    except InputError as error:
        return Answer(f"{clean(str(error), 400)}", "not_understood", choices=CAN_BE_ASKED)


def _call(world: Recall, question: str) -> Answer:
    if not isinstance(question, str) or not question.strip():
        raise NotUnderstoodError(_not_understood(""))
    if len(question) > LONGEST:
        raise NotUnderstoodError(f"A question has at most {LONGEST} characters, this one {len(question)}.")
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
    will = re.match(r"where will .+ be\b", text)
    bare, span, word = (*ahead(text, world.now), "") if will else extract(text, world.now)
    tried: list[InputError] = []
    # Time words may be part of a name: "the night lamp".
    for form, then in ((bare, span), (text, None)):
        if form == bare or span is not None:
            for pattern, call in _COMPILED:
                found = pattern.fullmatch(form)
                if found is None:
                    continue
                try:
                    return call(
                        ParsedQuestion(world, then, word if then is not None else "", **found.groupdict(""))
                    )
                except (NothingKnownError, NotUnderstoodError) as error:
                    tried.append(error)
        if span is None:
            break
    if tried:
        raise tried[0]
    raise NotUnderstoodError(_not_understood(question))


def _not_understood(question: str) -> str:
    said = f'I do not understand "{clean(question)}"' if question else "That is no question"
    return f"{said}; ask for example: {'; '.join(CAN_BE_ASKED[:1] + CAN_BE_ASKED[6:7] + CAN_BE_ASKED[9:12])}."
