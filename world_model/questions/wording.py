"""How people say the same thing: a question without politeness, contractions and fillers, in the order of a question.

What is done here is about English, not about what can be asked: "I can't find my mug" asks where it is.
"""

from __future__ import annotations

import re
import unicodedata
from collections.abc import Collection, Iterable

from world_model.questions.answers import clean

_ANYBODY = r"(?:you|we|i|anyone|anybody|somebody|someone|one)"
_ASKING = r"(?:where|whereabouts|what|who|when|how|which|whether|if|since when)"
_BEFORE_IT = (
    "can|could|would|will|do|does|did|have|has|you|we|i|anyone|anybody|somebody|someone|please|maybe|happen|still|"
    "know|remember|recall|tell|show|say|find out|check|help|remind|me|us|to|like|want|need|wish|wonder|forgot|"
    "forgotten|not|any|idea|let"
)
"""Of these are the polite words in front of a question."""
_NOUN = r"(?:all )?(?:the|my|our|your|his|her|their|any|a|an|that|this) .+?"
_LIES = r"(?:lying|laying|laid|sitting|standing|stored|located|situated|hidden|hiding|resting|kept)"
_HOME = r"(?:in|at|around|inside) (?:the|our|my|your|this) (?:whole |entire )?(?:house|home|flat|apartment)"
FUNCTION_WORDS = (  # noqa: SIM905
    "where what who when which how is are was were has have did does the my in on at of since there with from "
    "yesterday today morning evening night last usually missing changed moved seen between"
).split()
"""Words in which letters that changed places are put right."""
_SHORT = (
    (r"\b(where|what|who|when|how)['`]?s\b|\b(that|it|there)'s\b", r"\1\2 is"), (r"\b(\w+)'re\b", r"\1 are"),
    (r"^(?:at )?what time\b", "when"),
    (r"\b(where|what|who|when|how)'d\b", r"\1 did"), (r"\b(i|you|we)'d\b", r"\1 would"),
    (r"\b(\w+)'ve\b", r"\1 have"), (r"\bi'?m\b", "i am"), (r"\bca(?:n't|nt|nnot)\b", "can not"),
    (r"\b(is|are|was|were|has|have|do|does|did|could|would)n'?t\b", r"\1 not"),
)  # fmt: skip
_AROUND = (
    (r"[?!.\s]+$", ""),
    (r"^(?:hey|hello|hi|ok|okay|robot|so|and|well|sorry|excuse me|thanks|please)\b[, ]+", ""),
    (r"(?:,? (?:please|thanks|thank you|exactly|by any chance|for me|any ?more|robot|or not)|, then)$", ""),
    (r",? (?:and )?where (?:is|are) (?:it|they)$|,? (?:have you seen (?:it|them)|any ideas?)$", ""),
    (rf"^(?:(?:{_BEFORE_IT})\b,? )+(?={_ASKING}\b|(?:find|locate|show|list|look|search)\b)", ""),
)  # fmt: skip
_ORDER = (
    # What somebody looks for is asked for.
    (rf"^(?:have|has|had|did) {_ANYBODY} seen? (?=(?:anybody|anyone|somebody|someone|people)\b)", "was "),
    (rf"^(?:have|has|had|did|do|can|could) {_ANYBODY} (?:seen?|find|found|spotted?) (?=\w)", "where is "),
    (r"^(?:i|we) (?:can|could|do) not (?:seem to )?(?:find|see|locate) (.+?)$", r"where is \1"),
    (r"^(?:i am |we are )?(?:looking|searching|hunting) for (.+)$", r"where is \1"),
    (r"^(?:i|we) (?:have )?(?:lost|misplaced|mislaid) (.+)$", r"where is \1"),
    (r"^(?:i|we) (?:need|want|am missing|are missing) (?!to\b)(.+)$", r"where is \1"),
    (rf"^when (is|was|were) the last time ({_NOUN}) (?:is|was|were)\b", r"when \1 \2"),
    # The verb behind its subject, as after "do you know".
    (
        rf"^(where|whereabouts|when|how often|how many times|how long|since when) ({_NOUN}) "
        r"(is|are|was|were|has been|have been|has|have)\b(.*)$",
        r"\1 \3 \2\4",
    ),
    (
        rf"^(?:if|whether|(?:are you sure|how sure are you|is it true|"
        r"(?:how|is it) (?:likely|probable)(?: is it)?|what is the (?:probability|chance))(?: that)?) "
        rf"({_NOUN}|there|anybody|anyone|somebody|someone|anything|something) "
        r"(is|are|was|were|has|have)\b(.*)$",
        r"\2 \1\3",
    ),
    (rf"^(where|when) ({_NOUN}) (went|goes|came|moved|disappeared|left)$", r"\1 did \2 \3"),
    (rf"\b(is|are|was|were|been|be|there) {_LIES}\b", r"\1"),
    (rf"^(where (?:is|are|was|were) .+) {_LIES}$", r"\1"),
    (rf"\b{_HOME}\b", "here"),
    (r"\b(?:every|each) day\b", "usually"),
    (r"\b(?:every|each) (?=(?:morning|afternoon|evening|night)\b)", "usually in the "),
    (r"\b(?:every|each) (?=\w+day\b)", "usually on "),
    (r"\b(?:on )?((?:mon|tues|wednes|thurs|fri|satur|sun)day)s\b", r"usually on \1"),
    (r"\b(?:on |at )?(?:every weekend|(?:the )?weekends)\b", "usually at the weekend"),
    (r"\bin the (morning|afternoon|evening)s\b", r"usually in the \1"),
    (r"^who (is|was) (?:the )?last(?: one| to be)?\b(?! person)", r"who \1 the last person"),
    (r"^where here\b", "where"),
    (r"^where (?:does|do) (?!(?:you|we|i|one)\b)", "where usually did "),
    (r"\b(?:put|placed|laid) (?:on|onto|in|into)\b", "came to"),
)  # fmt: skip


_MEANT = {
    "was": "were|lay|stood|sat|sit",
    "is": "are|lies|lie|stands|stand|sits|being",
    "did": "does|do|has|had|have",
    "moved": "get moved|got moved|move|moves|moving|took|take|taken|taking|carry|carried|carrying|held|hold|holding|"
    "use|used|using|touch|touched|bring|brought|remove|removed|handled|shifted|put|puts|placed|pick up|picked up|"
    "put down|put away",
    "seen": "see|sees|saw|spot|spotted|notice|noticed",
    "gone": "go missing|gone missing|went missing|going missing|get lost|got lost|missing|lost|disappear|disappeared|"
    "vanish|vanished|away|go|went",
    "came": "come|comes|added|arrive|arrives|arrived|return|returns|returned|enter|entered|visit|visited|get|got",
    "left": "leave|leaves",
    "anyone": "the last person|any person|anybody|somebody|someone|any people|people|persons",
    "who": "who all|which people|what people",
    "anything": "something|any thing|any things|any objects|anything else",
    "usually": "normally|mostly|often|generally|typically|most of the time|belong|belongs|live|lives|supposed to be",
    "how often": "how often|how many times",
    "": "actually|really|exactly|ever|already|also|still|currently|just|possibly|probably|last|the last time|again|"
    "back|anywhere|yet|so far|lately|recently|been",
}
"""Each word of the patterns and what counts as it, "" for what tells nothing."""
_WORD_OF = {other: word for word, others in _MEANT.items() for other in others.split("|")}
_OTHERS = re.compile(rf"(?<![\w'-])(?:{'|'.join(sorted(_WORD_OF, key=len, reverse=True))})(?![\w'-])")


def simply(text: str, kept: Collection[str]) -> str:
    """A question in the few verbs of the patterns, "usually" in front. kept : words of names."""
    text = re.sub(r"\b(?:has|have|had)\b(?=.* been\b)", "was", text)
    said = _OTHERS.sub(lambda found: found[0] if found[0] in kept else _WORD_OF[found[0]], text)
    usual = re.sub(r"\busually\b", "", said)
    return " ".join((said if usual == said else f"usually {usual}").split())


def plainly(text: str, longest: int) -> str:
    """A question in the order and the words that the patterns want, case as it was."""
    said = clean(text, longest).replace("’", "'").replace("‘", "'").replace("“", '"').replace("”", '"')
    said = " ".join(said.split())
    said = _each(_SHORT, said)
    before = ""
    while before != said:  # "hey, can you please tell me"
        before, said = said, _each(_AROUND, said).strip(" ,")
    return said if re.search(r"['\"`]", said) else " ".join(_each(_ORDER, said).split())


def _each(rules: Iterable[tuple[str, str]], text: str) -> str:
    for pattern, other in rules:
        text = re.sub(pattern, other, text, flags=re.IGNORECASE)
    return text


SAME = (
    ("cup", "mug", "teacup", "coffee cup"), ("sofa", "couch", "settee"), ("tv", "television", "telly"),
    ("remote", "remote control", "tv remote"), ("laptop", "notebook computer", "macbook"),
    ("phone", "telephone", "cell phone", "mobile", "mobile phone", "cellphone", "smartphone"),
    ("bag", "handbag", "purse"),
    ("backpack", "rucksack"), ("glasses", "spectacles", "eyeglasses"), ("bin", "trash can", "garbage can"),
    ("fridge", "refrigerator"), ("bottle", "flask"), ("person", "human", "somebody"),
    ("living room", "lounge", "sitting room"), ("hall", "hallway", "corridor"), ("office", "study"),
    ("counter", "worktop", "countertop", "kitchen counter"), ("low table", "coffee table"), ("plant", "potted plant"),
    ("color", "colour"), ("clock", "alarm clock"), ("shoes", "shoe", "trainers", "sneakers"), ("bicycle", "bike"),
)  # fmt: skip
"""Words for the same; looked at only where nothing is called what was said."""
_GERMAN = str.maketrans({"ä": "ae", "ö": "oe", "ü": "ue", "ß": "ss", "ø": "oe", "å": "aa", "æ": "ae"})
LONG_ENOUGH = 5  # Letters from which on a letter too many or too few is a slip


def folded(text: str) -> set[str]:
    """The ways to write a name without accents: "Jürgen" is jurgen and juergen."""
    low = unicodedata.normalize("NFC", text.lower())
    bare = "".join(c for c in unicodedata.normalize("NFKD", low) if not unicodedata.combining(c))
    return {bare.replace("ß", "ss"), low.translate(_GERMAN)}


def is_called(said: str, name: str) -> bool:
    """Whether both are the same but for case and accents."""
    return bool(folded(said) & folded(name))


def slip_of(word: str, known: Iterable[str]) -> str:
    """The one known word of which this may be a slip: neighbours exchanged, a letter too many or too few."""
    found = [name for name in known if _is_slip(word.lower(), name.lower())]
    return found[0] if len(found) == 1 else ""


def _is_slip(word: str, name: str) -> bool:
    if len(word) == len(name):
        return len(word) >= 3 and is_swapped(word, name)
    short, long = sorted((word, name), key=len)
    if len(short) < LONG_ENOUGH or long == f"{short}s":
        return False
    return any(long[:k] + long[k + 1 :] == short for k in range(1, len(long)))


def is_swapped(word: str, other: str) -> bool:
    """Whether two neighbouring letters are all in which two words of one length differ."""
    pairs = range(len(word) - 1)
    return word != other and any(word[:k] + word[k + 1] + word[k] + word[k + 2 :] == other for k in pairs)


def respelled(text: str, phrases: Iterable[str]) -> tuple[str, list[tuple[str, str]]]:
    """A question in the words that are known, and which were taken to be slips of names, [(said, meant)].

    phrases : names of classes, places, people and predicates, in plain words.
    """
    known = [phrase for phrase in phrases if phrase]
    single = sorted({word for phrase in known for word in phrase.split()})
    words, slips = text.split(), []
    index = 0
    while index < len(words):
        for count in (2, 1):
            meant = _same(" ".join(words[index : index + count]), known)
            if meant and count <= len(words) - index:
                words[index : index + count] = [meant]
                break
        else:
            words[index], slip = _put_right(words[index], single)
            slips += slip
        index += 1
    return " ".join(words), slips


def _put_right(word: str, single: list[str]) -> tuple[str, list[tuple[str, str]]]:
    """A word of a question as it is known; as a slip where it is not just written otherwise."""
    if word in single or word in FUNCTION_WORDS:
        return word, []
    # Of the words of the grammar only letters that changed places are put right: "three" is no slip.
    swapped = (name for name in FUNCTION_WORDS if len(name) == len(word) > 2 and is_swapped(word, name))
    written = next((name for name in single if is_called(word, name)), "") or next(swapped, "")
    if written:
        return written, []
    near = slip_of(word, single)
    return near or word, [(word, near)] if near else []


def _same(said: str, known: list[str]) -> str:
    """The one known word for the same, in the plural where that was said; "" where there is none, or several."""
    for ending in ("", "s", "es"):
        bare = said.removesuffix(ending)
        if said.endswith(ending) and said not in known and bare not in known:
            others = {other for group in SAME if bare in group for other in group}
            found = [name for name in dict.fromkeys(known) if name in others]
            if len(found) == 1:
                return found[0] + ("s" if ending and not found[0].endswith("s") else "")
    return ""
