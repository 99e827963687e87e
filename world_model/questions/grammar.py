"""The questions that can be asked in words; each is one call of a function.

A question is made of fixed words (see `CAN_BE_ASKED`), of what it is about, a place, and a time that may stand anywhere
in it. Whatever no pattern takes is not understood, and answered with what can be asked.
"""

from __future__ import annotations

import re
from collections.abc import Callable
from pathlib import Path

from estimation.errors import InputError
from estimation.places import Places
from world_model.questions.answers import (
    AmbiguousError,
    Answer,
    NothingKnownError,
    NotUnderstoodError,
    clean,
    iso,
)
from world_model.questions.company import who_was_here
from world_model.questions.moments import Span, extract
from world_model.questions.naming import PREPOSITIONS
from world_model.questions.past import (
    history,
    how_long_there,
    how_often,
    what_changed,
    what_is_missing,
    when_moved,
)
from world_model.questions.recall import Recall, recall
from world_model.questions.usual import what_is_needed_next, what_is_usually_here
from world_model.questions.where import (
    how_many,
    is_at,
    what_is_at,
    when_last_seen,
    where_is,
    where_usually,
    where_was,
)
from world_model.store import Store
from world_model.symbols import Symbols

LONGEST = 500
"""Characters of a question."""
CAN_BE_ASKED = (
    "where is the red cup", "where was cup-3 yesterday at nine", "where are the cups", "where is the cup usually",
    "when was the cup last seen", "when was the cup moved", "how often was the cup moved since monday",
    "how often was the cup on the kitchen table this week", "how long has the cup been there",
    "what has changed since breakfast", "what is missing", "what is on the kitchen table",
    "what was in the kitchen at 14:30", "what is usually on the desk", "how many cups are in the kitchen",
    "is the cup on the desk", "who was in the kitchen yesterday morning", "what will be needed next",
    "what happened to the cup",
)  # fmt: skip
_AT = rf"(?P<place>(?:{PREPOSITIONS}) .+)"
_HERE = r"(?:here|there|around|home|at home|in the house|in the home)"
_BE = r"(?:is|are|was|were|has been|have been|had been)"
_USUALLY = r"(?:usually|normally|mostly|often|generally|most of the time)"
Call = Callable[[Recall, dict[str, str], "Span | None", str], Answer]


def _what(said: dict[str, str]) -> str:
    return said.get("what") or ""


def _where(world: Recall, said: dict[str, str], span: Span | None, word: str) -> Answer:
    past = said.get("verb", "is") in ("was", "were", "had been", "did", "has been", "have been")
    if span is not None and span.start < world.now - 1.0:
        return where_was(world, _what(said), _when(span, word))
    return where_was(world, _what(said)) if past and span is None else where_is(world, _what(said))


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


def _usually(world: Recall, said: dict[str, str], span: Span | None, word: str) -> Answer:
    return where_usually(world, _what(said))


def _seen(world: Recall, said: dict[str, str], span: Span | None, word: str) -> Answer:
    return when_last_seen(world, _what(said))


def _moved(world: Recall, said: dict[str, str], span: Span | None, word: str) -> Answer:
    return when_moved(world, _what(said))


def _often(world: Recall, said: dict[str, str], span: Span | None, word: str) -> Answer:
    return how_often(world, _what(said), said.get("place") or "", _since(world, span, word))


def _long(world: Recall, said: dict[str, str], span: Span | None, word: str) -> Answer:
    return how_long_there(world, _what(said), said.get("place") or "")


def _changed(world: Recall, said: dict[str, str], span: Span | None, word: str) -> Answer:
    return what_changed(world, _since(world, span, word), said.get("place") or "")


def _missing(world: Recall, said: dict[str, str], span: Span | None, word: str) -> Answer:
    return what_is_missing(world, _since(world, span, word))


def _usually_here(world: Recall, said: dict[str, str], span: Span | None, word: str) -> Answer:
    return what_is_usually_here(world, said["place"])


def _who(world: Recall, said: dict[str, str], span: Span | None, word: str) -> Answer:
    return who_was_here(world, said.get("place") or "", _since(world, span, word))


def _next(world: Recall, said: dict[str, str], span: Span | None, word: str) -> Answer:
    return what_is_needed_next(world, _ahead(said.get("ahead") or ""))


def _ahead(words: str) -> Span | None:
    if not words:
        return None
    _, span, _ = extract(f"in the last {words}", 0.0)
    return span


def _what_at(world: Recall, said: dict[str, str], span: Span | None, word: str) -> Answer:
    past = said.get("verb") in ("was", "were") or span is not None
    return what_is_at(world, said["place"], _when(span, word) if past else None)


def _many(world: Recall, said: dict[str, str], span: Span | None, word: str) -> Answer:
    return how_many(world, _what(said), said.get("place") or "", _when(span, word))


def _is_at(world: Recall, said: dict[str, str], span: Span | None, word: str) -> Answer:
    return is_at(world, _what(said), said["place"], _when(span, word))


def _history(world: Recall, said: dict[str, str], span: Span | None, word: str) -> Answer:
    return history(world, _what(said), _since(world, span, word))


_W = r"(?P<what>.+?)"
_PATTERNS: tuple[tuple[str, Call], ...] = tuple(
    (rf"(?:{pattern})", call)
    for pattern, call in (
        (rf"where (?:is|are|was|were|does|do) {_W} {_USUALLY}(?: (?:be|belong|kept|go|lie|stand))?", _usually),
        (rf"where (?:is|are|do you|do i|does one|can i|would i) {_USUALLY} (?:find |keep |see |put )?{_W}", _usually),
        (rf"where (?:does|do) {_W} (?:belong|go|live)", _usually),
        (rf"when (?:was|were|did|is) (?:(?:you|i|anyone|somebody) )?(?:last )?(?:see|seen) {_W}(?: last)?", _seen),
        (rf"when (?:was|were|is) {_W} (?:last )?(?:seen|there)(?: last)?", _seen),
        (rf"when (?:was|were) the last time (?:you|i|anyone|somebody) (?:saw|had seen) {_W}", _seen),
        (rf"(?:last seen|last sight of) {_W}", _seen),
        (
            rf"when (?:was|were|did|has|have) {_W} (?:been )?(?:last )?(?:moved?|taken|carried|go|leave|left)"
            rf"(?: away| last)*",
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
        (rf"(?:how long|since when) (?:has|have|is|are) {_W} (?:been )?{_AT}", _long),
        (rf"(?:how long|since when) (?:has|have) {_W} been", _long),
        (
            rf"what (?:has |have |is |was |things? |else )*(?:changed|moved|different|new|happened)(?: {_HERE})?"
            rf"(?: {_AT})?",
            _changed,
        ),
        (rf"(?:has|did) (?:anything|something) (?:changed?|moved?|happen(?:ed)?)(?: {_HERE})?(?: {_AT})?", _changed),
        (
            r"what (?:is|are|was|has|have|things are|objects are) (?:gone )?"
            r"(?:missing|gone|lost|not where it was|disappeared|vanished)(?: now)?",
            _missing,
        ),
        (r"(?:is|are) (?:anything|something|any things?|there anything) (?:missing|gone|lost)", _missing),
        (rf"what (?:is|are|lies|stands|do you|can i)(?: there)? {_USUALLY} (?:find |see |kept )?{_AT}", _usually_here),
        (rf"what (?:is|are) {_AT} {_USUALLY}", _usually_here),
        (rf"what (?:belongs|usually is|usually lies|is usually kept) {_AT}", _usually_here),
        (rf"(?:who|which people|what people|who all) {_BE} {_HERE}(?:,? and with what)?", _who),
        (rf"(?:who|which people|what people) {_BE} (?:seen )?{_AT}?(?:,? and with what)?", _who),
        (rf"(?:who|which people) (?:came|visited|used|went to|entered) ?(?:{_AT})?", _who),
        (
            rf"(?:was|were|has|have|is) (?:anybody|anyone|somebody|someone|people|there anybody|there anyone) "
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
        (rf"how many {_W} (?:are|is|were|was|lie|stand)(?: there)?(?: {_AT})?", _many),
        (rf"how many {_W} (?:do you|can you|did you) (?:know|see|have)(?: {_AT})?", _many),
        (rf"how many {_W}(?: {_AT})?", _many),
        (
            rf"what (?P<verb>is|are|was|were|lies|lay|stands|stood|do you see|can you see)"
            rf"(?: there| lying| standing| kept)? {_AT}",
            _what_at,
        ),
        (rf"(?:what|which) (?:things|objects|items) (?P<verb>are|were|lie) {_AT}", _what_at),
        (rf"what (?:happened|was done|is the history|do you know) (?:to|with|of|about) {_W}", _history),
        (rf"(?:tell me |show me |give me )?(?:about|the history of|history of|history) {_W}", _history),
        (rf"tell me (?:about|of) {_W}", _history),
        (rf"(?:is|are|was|were) (?:there )?{_W} (?:still )?{_AT}", _is_at),
        (rf"where (?:is|are) {_W} (?:now|at the moment|kept|lying)", _where),
        (rf"where (?:can|could|do|would|might|should) (?:i|we|you|one) (?:find|look for|see|get) {_W}", _where),
        (rf"where (?P<verb>did) (?:i|we|you|one) (?:put|leave|see|find|lose) {_W}", _where),
        (rf"(?:where|whereabouts) (?P<verb>is|are|was|were|has|have) {_W}(?: been| seen| be| now)?", _where),
        (rf"(?:find|locate|look for|search for|show me) {_W}", _where),
        (rf"(?:do you know |can you tell me |tell me )where {_W} (?P<verb>is|are|was|were)", _where),
    )
)  # fmt: skip
_COMPILED = tuple((re.compile(pattern), call) for pattern, call in _PATTERNS)
_SHORT = (
    (r"\b(where|what|who|when|how long|that|it)'s\b", r"\1 is"), (r"\b(where|what|who|when)'re\b", r"\1 are"),
    (r"\bhasn't\b", "has not"), (r"[?!.]+$", ""), (r"^(?:please|hey|hello|hi|ok|robot)[, ]+", ""), (r",? please$", ""),
    (r"^(?:can|could) you (?:please )?tell me ", ""), (r"^do you know ", ""),
    (r"^(?:where|whereabouts) (the .+|my .+) (is|are|was|were)$", r"where \2 \1"),
)  # fmt: skip


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


def plainly(question: str) -> str:
    """A question as the patterns want it. Raises NotUnderstoodError where it is no text, empty or too long."""
    if not isinstance(question, str) or not question.strip():
        raise NotUnderstoodError(_not_understood(""))
    if len(question) > LONGEST:
        raise NotUnderstoodError(f"A question has at most {LONGEST} characters, this one {len(question)}.")
    text = clean(question, LONGEST).replace("’", "'").replace("‘", "'").replace("“", '"').replace("”", '"')
    text = " ".join(text.split())
    for pattern, other in _SHORT:
        text = re.sub(pattern, other, text, flags=re.IGNORECASE)
    return text


def _call(world: Recall, question: str) -> Answer:
    text = plainly(question)
    bare, span, word = extract(text.lower(), world.now)
    tried: list[InputError] = []
    # Time words may be part of a name: "the night lamp".
    for form, then in ((bare, span), (text.lower(), None)):
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
