"""The questions that can be asked in words; each is one call of a function.

A question is made of fixed words (see `CAN_BE_ASKED`), of what it is about, a place, and a time that may stand anywhere
in it. Whatever no pattern takes is not understood, and answered with what can be asked.
"""

from __future__ import annotations

import re
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

from estimation.errors import InputError
from estimation.geometry.places import Places
from world_model.memory.store import Store
from world_model.questions.answers import (
    AmbiguousError,
    Answer,
    NothingKnownError,
    NotUnderstoodError,
    clean,
    iso,
    listed,
)
from world_model.questions.company import (
    what_was_carried,
    where_was_person,
    who_is_here,
    who_moved,
    who_was_here,
)
from world_model.questions.during import how_long_at, was_at, what_left, what_moved, what_was_at, when_last_at
from world_model.questions.moments import Span, ahead, extract
from world_model.questions.naming import PREPOSITIONS, is_person, phrases
from world_model.questions.past import (
    history,
    how_long_there,
    how_often,
    what_changed,
    what_is_missing,
    when_moved,
)
from world_model.questions.recall import Recall, recall
from world_model.questions.spelling import respelled
from world_model.questions.usual import (
    is_at_usual_place,
    what_is_needed_next,
    what_is_usually_here,
    where_will_be,
)
from world_model.questions.where import (
    how_many,
    is_at,
    what_is_at,
    when_last_seen,
    where_is,
    where_usually,
    where_was,
    which_room,
)
from world_model.questions.wording import plainly
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
Call = Callable[[Recall, dict[str, str], "Span | None", str], Answer]


def _what(said: dict[str, str]) -> str:
    return said.get("what") or ""


def _is_past(world: Recall, span: Span | None) -> bool:
    return span is not None and span.start < world.now - 1.0


def _is_long(span: Span | None) -> bool:
    return span is not None and span.end - span.start >= 1.0


def _where(world: Recall, said: dict[str, str], span: Span | None, word: str) -> Answer:
    past = said.get("verb", "is") in ("was", "were", "had been", "did", "has been", "have been")
    if _is_past(world, span):
        then = _when(span, word)
        if then is not None and is_person(world, _what(said)):
            return where_was_person(world, _what(said), then)
        return where_was(world, _what(said), then)
    return where_was(world, _what(said)) if past and span is None else where_is(world, _what(said))


def _room(world: Recall, said: dict[str, str], span: Span | None, word: str) -> Answer:
    return which_room(world, _what(said), _when(span, word) if _is_past(world, span) else None)


def _when(span: Span | None, word: str) -> Span | None:
    """Until a moment is that moment."""
    if span is None:
        return None
    return Span(span.start, span.start, span.words) if word == "until" else span


def _since(world: Recall, span: Span | None, word: str) -> Span | None:
    """ "yesterday" is the whole day; a moment is since then."""
    if span is None:
        return None
    if word == "until":
        return Span(-float("inf"), span.start, span.words)
    if span.end - span.start < 1.0:
        return Span(span.start, world.now, span.words)
    return span


def _without_time(span: Span | None) -> None:
    """Raises NotUnderstoodError where a time is said that would not be looked at."""
    if span is not None:
        raise NotUnderstoodError(
            f'I can only tell what is usual at all hours, not "{clean(span.words)}"; ask without it, or what was so '
            "at a time that is past."
        )


def _usually(world: Recall, said: dict[str, str], span: Span | None, word: str) -> Answer:
    _without_time(span)
    return where_usually(world, _what(said))


def _at_home(world: Recall, said: dict[str, str], span: Span | None, word: str) -> Answer:
    _without_time(span)
    return is_at_usual_place(world, _what(said))


def _seen(world: Recall, said: dict[str, str], span: Span | None, word: str) -> Answer:
    return when_last_seen(world, _what(said), _since(world, span, word))


def _last_at(world: Recall, said: dict[str, str], span: Span | None, word: str) -> Answer:
    if span is not None:
        return was_at(world, _what(said), said["place"], _since(world, span, word) or span)
    return when_last_at(world, _what(said), said["place"])


def _moved(world: Recall, said: dict[str, str], span: Span | None, word: str) -> Answer:
    return when_moved(world, _what(said), _since(world, span, word))


def _often(world: Recall, said: dict[str, str], span: Span | None, word: str) -> Answer:
    return how_often(world, _what(said), said.get("place") or "", _since(world, span, word))


def _long(world: Recall, said: dict[str, str], span: Span | None, word: str) -> Answer:
    if span is not None and _is_past(world, span):
        return how_long_at(world, _what(said), said.get("place") or "", _since(world, span, word) or span)
    return how_long_there(world, _what(said), said.get("place") or "")


def _changed(world: Recall, said: dict[str, str], span: Span | None, word: str) -> Answer:
    return what_changed(world, _since(world, span, word), said.get("place") or "")


def _all_moved(world: Recall, said: dict[str, str], span: Span | None, word: str) -> Answer:
    return what_moved(world, _since(world, span, word), said.get("place") or "")


def _missing(world: Recall, said: dict[str, str], span: Span | None, word: str) -> Answer:
    return what_is_missing(world, _since(world, span, word))


def _left(world: Recall, said: dict[str, str], span: Span | None, word: str) -> Answer:
    return what_left(world, said["place"], _since(world, span, word))


def _usually_here(world: Recall, said: dict[str, str], span: Span | None, word: str) -> Answer:
    _without_time(span)
    return what_is_usually_here(world, said["place"])


def _who(world: Recall, said: dict[str, str], span: Span | None, word: str) -> Answer:
    if said.get("verb") in ("is", "are") and not _is_past(world, span):
        return who_is_here(world, said.get("place") or "")
    return who_was_here(world, said.get("place") or "", _since(world, span, word), said.get("who") or "")


def _who_moved(world: Recall, said: dict[str, str], span: Span | None, word: str) -> Answer:
    return who_moved(world, _what(said), _since(world, span, word), said.get("who") or "")


def _carried(world: Recall, said: dict[str, str], span: Span | None, word: str) -> Answer:
    return what_was_carried(world, said["who"], _since(world, span, word))


def _next(world: Recall, said: dict[str, str], span: Span | None, word: str) -> Answer:
    _without_time(span)
    return what_is_needed_next(world, _ahead(said.get("ahead") or ""))


def _ahead(words: str) -> Span | None:
    if not words:
        return None
    _, span, _ = extract(f"in the last {words}", 0.0)
    return span


def _what_at(world: Recall, said: dict[str, str], span: Span | None, word: str) -> Answer:
    if span is not None and _is_past(world, span) and _is_long(span) and word != "until":
        return what_was_at(world, said["place"], span)
    past = said.get("verb") in ("was", "were", "lay", "stood") or _is_past(world, span)
    return what_is_at(world, said["place"], _when(span, word) if past else None)


def _many(world: Recall, said: dict[str, str], span: Span | None, word: str) -> Answer:
    return how_many(world, _what(said), said.get("place") or "", _when(span, word))


def _is_at(world: Recall, said: dict[str, str], span: Span | None, word: str) -> Answer:
    if span is not None and _is_past(world, span) and _is_long(span) and word != "until":
        return was_at(world, _what(said), said["place"], span)
    return is_at(world, _what(said), said["place"], _when(span, word) if _is_past(world, span) else None)


def _listed(world: Recall, said: dict[str, str], span: Span | None, word: str) -> Answer:
    """ "cups are on the desk", "red things in the kitchen"."""
    what = re.sub(rf" (?:is|are|was|were)(?: there)? (?=(?:{PREPOSITIONS}) )", " ", _what(said))
    if _is_past(world, span):
        if said.get("place"):
            return _is_at(
                world, {"what": what.removesuffix(said["place"]).strip(), "place": said["place"]}, span, word
            )
        return where_was(world, what, _when(span, word))
    return where_is(world, what)


def _will_be(world: Recall, said: dict[str, str], span: Span | None, word: str) -> Answer:
    if span is None:
        raise NotUnderstoodError('When? Say "tomorrow at eight", "in two hours" or "this evening".')
    return where_will_be(world, _what(said), span)


def _history(world: Recall, said: dict[str, str], span: Span | None, word: str) -> Answer:
    return history(world, _what(said), _since(world, span, word))


_W = r"(?P<what>.+?)"
_PATTERNS: tuple[tuple[str, Call], ...] = tuple(
    (rf"(?:{pattern})", call)
    for pattern, call in (
        (rf"where (?:is|are|was|were|does|do) {_W} {_USUALLY}(?: (?:be|belong|kept|go|lie|stand))?", _usually),
        (rf"where (?:is|are|do you|do i|does one|can i|would i) {_USUALLY} (?:find |keep |see |put )?{_W}", _usually),
        (rf"where (?:does|do) {_W} (?:{_USUALLY} )?(?:belong|go|live|lie|stand)", _usually),
        (rf"where (?:should|ought|is supposed to|are supposed to) {_W} (?:to )?(?:be|go|stand|lie)", _usually),
        (rf"where (?:is|are) {_W} supposed to be", _usually),
        (
            rf"(?:is|are) {_W} (?:in|at|on) (?:its|their|the) (?:usual|normal|right|proper) (?:place|spot)",
            _at_home,
        ),
        (rf"(?:is|are) {_W} where (?:it|they) (?:belongs?|should be|{_USUALLY} (?:is|are))", _at_home),
        (
            rf"(?:in |on |at )?(?:which|what) (?:room|place|spot|part of here) (?P<verb>is|are|was|were) {_W}"
            r"(?: (?:in|on|at))?",
            _room,
        ),
        (rf"when (?:was|were|did|is) (?:(?:you|i|anyone|somebody) )?(?:last )?(?:see|seen) {_W}(?: last)?", _seen),
        (rf"when (?:was|were|is) {_W} (?:last )?(?:seen|there|{_HERE})(?: last)?", _seen),
        (rf"when (?:was|were|is) {_W} (?:last )?{_AT}?(?: last)", _last_at),
        (rf"when (?:was|were|is) {_W} last {_AT}", _last_at),
        (
            rf"when (?:did|was|were) {_W} (?:come|get|arrive|put|placed|moved) (?:to|onto|into|on|in|at) {_PLACE}",
            _last_at,
        ),
        (rf"how long ago (?:was|were|did) (?:{_ANY} (?:last )?see )?{_W}(?: (?:last )?seen)?(?: last)?", _seen),
        (rf"how long (?:has it been|is it) since {_ANY} (?:last )?saw {_W}", _seen),
        (rf"how long (?:has it been|is it) since {_W} (?:was|were) (?:last )?seen", _seen),
        (rf"when (?:was|were) the last time (?:you|i|anyone|somebody) (?:saw|had seen) {_W}", _seen),
        (rf"(?:last seen|last sight of) {_W}", _seen),
        (rf"when (?:was|were) the last time {_ANY} (?:moved|took|used) {_W}", _moved),
        (rf"when (?:did|has) {_ANY} (?:last )?(?:moved?|take|taken|used?|touch|touched) {_W}(?: last)?", _moved),
        (
            rf"when (?:was|were|did|has|have) {_W} (?:been )?(?:last )?(?:moved?|taken|carried|go|leave|left|"
            rf"disappear(?:ed)?|vanish(?:ed)?)(?: away| last| missing)*",
            _moved,
        ),
        (
            rf"(?:how often|how many times) (?:was|were|has|have|did|is) {_W} (?:been )?"
            rf"(?:moved?|carried|used|taken)(?: around)?",
            _often,
        ),
        (rf"(?:how often|how many times) (?:was|were|has|have|is) {_W} (?:been )?{_AT}", _often),
        (
            rf"(?:how long|since when) (?:has|have|is|are|was|were) {_W} (?:been )?(?:{_HERE}|where "
            rf"(?:it is|they are)|missing|gone|lost|away)",
            _long,
        ),
        (rf"(?:how long|since when) (?:has|have|is|are|was|were) {_W} (?:been )?{_AT}", _long),
        (rf"(?:how long|since when) (?:has|have) {_W} been", _long),
        (rf"{_WHAT}(?:changed|different|new)(?: {_HERE})?(?: {_AT})?", _changed),
        (rf"{_ANYTHING}(?:changed?|different|new)(?: {_HERE})?(?: {_AT})?", _changed),
        (rf"{_WHAT}(?:moved|happened)(?: around| about)?(?: {_HERE})?(?: {_AT})?", _all_moved),
        (rf"{_ANYTHING}(?:moved?|happen(?:ed)?)(?: around| about)?(?: {_HERE})?(?: {_AT})?", _all_moved),
        (
            rf"(?:what|which things) (?:is|are|was|has|have) (?:no longer|not .+ any ?more|missing|gone|disappeared|"
            rf"vanished|been taken|been removed|taken|removed) {_AT}",
            _left,
        ),
        (rf"(?:what|which things) (?:has|have) left {_PLACE}", _left),
        (rf"(?:is|was|has) (?:anything|something) (?:missing|gone|been taken|been removed|taken|removed) {_AT}", _left),
        (
            r"(?:what|which) (?:is|are|was|has|have|things are|objects are|things have|things|objects) (?:gone |been )?"
            r"(?:missing|gone|lost|not where it was|disappeared|vanished)(?: now)?",
            _missing,
        ),
        (r"(?:is|are) (?:anything|something|any things?|there anything) (?:missing|gone|lost)", _missing),
        (rf"what (?:is|are|lies|stands|do you|can i)(?: there)? {_USUALLY} (?:find |see |kept )?{_AT}", _usually_here),
        (rf"what (?:is|are) {_AT} {_USUALLY}", _usually_here),
        (rf"what (?:belongs|usually is|usually lies|is usually kept) {_AT}", _usually_here),
        (rf"(?:who|which people|what people|who all) {_BE} {_HERE}(?:,? and with what)?", _who),
        (rf"(?:who|which people|what people) {_BE} (?:seen )?{_AT}?(?:,? and with what)?", _who),
        (rf"(?:was|were|has|have) {_WHO} (?:been )?(?:{_HERE}|seen)", _who),
        (
            rf"who (?:has |have |had )?(?:last )?{_HANDLED} {_W}(?: last)?(?: {_AT})?",
            _who_moved,
        ),
        (rf"(?:has|have|did|was|were) (?!{_ANY} ){_W} (?:been )?(?:moved?|carried|used)(?: around| away)?", _often),
        (rf"(?:did|has|have) (?:{_ANY}|{_WHO}) {_HANDLED} {_W}", _who_moved),
        (rf"when (?:was|were|did) {_WHO} (?:come|arrive|visit)(?: {_HERE})?", _who),
        (
            rf"what (?:did|has|have) {_WHO} (?:{_HANDLED}|done?|put|pick(?:ed)? up|put down)(?: with| around| away)?",
            _carried,
        ),
        (rf"what was {_WHO} (?:carrying|holding|moving|doing)", _carried),
        (rf"(?:who|which people) (?:came|visited|used|went to|entered) ?(?:{_AT})?", _who),
        (
            rf"(?P<verb>was|were|has|have|is|are) (?:there )?(?:anybody|anyone|somebody|someone|people|any people) "
            rf"(?:been )?(?:{_HERE}|{_AT})",
            _who,
        ),
        (
            r"what (?:will be|will i|will we|is|do i|might be|will) (?:be )?"
            r"(?:needed|need|moved?|used|move|happen)(?: next| soon)*(?: "
            r"(?:in|within|during|over) the next (?P<ahead>.+))?",
            _next,
        ),
        (
            r"what (?:is|comes|happens|moves) (?:next|going to (?:be needed|be moved|move|happen))(?: next)?"
            r"(?: (?:in|within) the next (?P<ahead>.+))?",
            _next,
        ),
        (rf"how many (?:people|persons) {_BE} (?:seen )?(?:{_HERE}|{_AT})", _who),
        (rf"how many (?!times\b){_W} (?:are|is|were|was|lie|stand)(?: there)?(?: {_HERE})?(?: {_AT})?", _many),
        (
            rf"how many (?!times\b){_W} (?:do|can|did|have) (?:you|i|we) (?:know|see|seen|have|got|own)"
            rf"(?: {_HERE})?(?: {_AT})?",
            _many,
        ),
        (rf"how many (?!times\b){_W}(?: {_AT})?", _many),
        (rf"(?:is|are|was|were) there {_W}(?: left)? {_HERE}", _many),
        (rf"(?:do|have) (?:you|i|we) (?:have|got) {_W}(?: {_HERE})?", _many),
        (
            rf"what(?: all| else)? (?P<verb>is|are|was|were|lies|lay|stands|stood|"
            rf"(?:do|can) (?:you|we|i) (?:see|have))"
            rf"(?: there| lying| standing| kept)? {_AT}",
            _what_at,
        ),
        (rf"(?:what|which) (?:things|objects|items) (?P<verb>are|were|lie|lay)(?: there)? {_AT}", _what_at),
        (rf"(?:is there|are there|is|are) (?:anything|something|any things|things) {_AT}", _what_at),
        (rf"(?:what|which) (?P<what>.+ (?P<verb>are|were) {_AT})", _listed),
        (rf"(?:list|show|show me|give me|name)(?: me)? (?:all |all of )?{_W}", _listed),
        (rf"what (?:happened|was done|is the history|do you know) (?:to|with|of|about) {_W}", _history),
        (rf"(?:tell me |show me |give me )?(?:about|the history of|history of|history) {_W}", _history),
        (rf"tell me (?:about|of) {_W}", _history),
        (rf"(?:is|are|was|were) (?:there )?{_W} (?:still )?{_AT}", _is_at),
        (rf"(?:is|are) {_W} (?:still )?{_HERE}", _where),
        (rf"(?:is|are|was|were) there {_W}(?: left)?", _many),
        (rf"where (?:could|might|may|can) {_W} be", _where),
        (rf"(?:what|which) {_W} (?:are|is) {_HERE}", _where),
        (rf"(?:has|have) {_W} been {_AT}", _is_at),
        (rf"where will {_W} be", _will_be),
        (rf"where (?:has|have|did) {_W} (?:gone|go|ended up|end up|got to|get to|disappeared to)", _where),
        (rf"where (?:is|are) {_W} (?:now|at the moment|kept|lying)", _where),
        (rf"where (?:can|could|do|would|might|should) (?:i|we|you|one) (?:find|look for|see|get) {_W}", _where),
        (rf"where did (?:i|we|you|one) (?:last |usually )?(?:put|leave|see|find|lose) {_W}(?: last)?", _where),
        (rf"(?:where|whereabouts) (?P<verb>is|are|was|were|has|have) {_W}(?: been| seen| be| now)?", _where),
        (rf"(?:find|locate|look for|search for|show me) {_W}", _where),
        (rf"(?:do you know |can you tell me |tell me )where {_W} (?P<verb>is|are|was|were)", _where),
    )
)  # fmt: skip
_COMPILED = tuple((re.compile(pattern), call) for pattern, call in _PATTERNS)


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
        return Answer(str(error), "unknown", 0.9, iso(world.now))
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
                said = {name: value for name, value in found.groupdict().items() if value is not None}
                try:
                    return call(world, said, then, word if then is not None else "")
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
