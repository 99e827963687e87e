"""Names as people write them: without accents, in other words for the same thing, with a slip of the finger."""

from __future__ import annotations

import unicodedata
from collections.abc import Iterable

from world_model.questions.wording import FUNCTION_WORDS, is_swapped, spelled

SAME = (
    ("cup", "mug", "teacup", "coffee cup"), ("sofa", "couch", "settee"), ("tv", "television", "telly"),
    ("remote", "remote control", "tv remote"), ("laptop", "notebook computer", "macbook"),
    ("phone", "cell phone", "mobile", "mobile phone", "cellphone", "smartphone"), ("bag", "handbag", "purse"),
    ("backpack", "rucksack"), ("glasses", "spectacles", "eyeglasses"), ("bin", "trash can", "garbage can"),
    ("fridge", "refrigerator"), ("bottle", "flask"), ("person", "human", "somebody"),
    ("living room", "lounge", "sitting room"), ("hall", "hallway", "corridor"), ("office", "study"),
    ("counter", "worktop", "countertop", "kitchen counter"), ("low table", "coffee table"), ("plant", "potted plant"),
    ("clock", "alarm clock"), ("shoes", "shoe", "trainers", "sneakers"), ("bicycle", "bike"),
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


def same_as(word: str, known: Iterable[str]) -> str:
    """What of the known words means the same, "" for nothing, or several."""
    others = {other for group in SAME if word in group for other in group}
    found = [name for name in dict.fromkeys(known) if name != word and name in others]
    return found[0] if len(found) == 1 else ""


def slip_of(word: str, known: Iterable[str]) -> str:
    """The one known word of which this may be a slip: neighbours exchanged, a letter too many or too few."""
    low = word.lower()
    found = [name for name in known if _is_slip(low, name.lower())]
    return found[0] if len(found) == 1 else ""


def _is_slip(word: str, name: str) -> bool:
    if len(word) == len(name):
        return len(word) >= 3 and is_swapped(word, name)
    short, long = sorted((word, name), key=len)
    if len(long) - len(short) != 1 or len(short) < LONG_ENOUGH or long == f"{short}s":
        return False
    return any(long[:k] + long[k + 1 :] == short for k in range(1, len(long)))


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
    written = next((name for name in single if is_called(word, name)), "") or spelled(word)
    if written != word:
        return written, []
    near = slip_of(word, single)
    return near or word, [(word, near)] if near else []


def _same(said: str, known: list[str]) -> str:
    """A known word for the same, in the plural where that was said."""
    for ending in ("", "s", "es"):
        bare = said.removesuffix(ending) if ending else said
        if said.endswith(ending) and said not in known and bare not in known:
            other = same_as(bare, known)
            if other:
                return other + ("s" if ending and not other.endswith("s") else "")
    return ""
