"""Which objects and places words stand for: ids, names, classes, colours, also plural; rooms and furniture."""

from __future__ import annotations

import math
import re
from collections import Counter
from collections.abc import Iterable
from dataclasses import dataclass

from estimation.checks import require_word
from world_model.memory.stays import ObjectStay
from world_model.questions.answers import AmbiguousError, NothingKnownError, clean, listed
from world_model.questions.recall import Recall, Trust, remembered, singulars
from world_model.questions.wording import is_called, respelled
from world_model.state import PERSON, WorldObject
from world_model.symbols import parse_symbol

LEAST = 0.3  # Probability of class and colours from which on an object is meant
MOST_PAST = 60  # Objects of a class that are no longer there, among which one is looked for
NAMES = ("name", "identity")  # Attributes that say what a person is called
MOST_PEOPLE = 200  # Ids of people among whom one with a name is looked for
AT, NOT_AT = (
    "on top of|on|in|at|inside|within|from",
    "next to|close to|in front of|under|near|by|beside|around|behind|between|above|below|opposite|"
    "(?:(?:on|to) )?(?:the )?(?:left|right)(?: side)? of",
)
PREPOSITIONS = f"{NOT_AT}|{AT}"
_ARTICLES = re.compile(
    r"^(?:(?:the|a|an|my|your|our|his|her|their|this|that|any|some|all|other|one of the) )+", re.IGNORECASE
)
_OBJECTS = ("thing", "one", "object", "item", "anything", "something", "everything", "stuff")


@dataclass(frozen=True)
class Meant:
    """Objects that words stand for. ids : the most probable first. words : what was said. plural : several are asked
    for. by_name : one object by its id. kind : class that was said, None without one."""

    ids: tuple[str, ...]
    words: str
    plural: bool = False
    by_name: bool = False
    kind: str | None = None


def plain(text: str) -> str:
    """Lower-case words without articles, quotes and underscores."""
    words = re.sub(r"[\s_]+", " ", require_word("name", text).lower()).strip(" ?!.,")
    if len(words) > 1 and words[0] == words[-1] and words[0] in "'\"`":
        words = words[1:-1].strip()
    words = _ARTICLES.sub("", words)
    # "everything red" are red things.
    return re.sub(r"^(?:every|any|some)thing (?:that is )?(?!in\b|on\b|at\b)(\w+)$", r"\1 things", words)


def spoken(world: Recall, where: str | ObjectStay) -> str:
    """ "on the kitchen table", of a place or a stay; of a stay at no place with a name its position."""
    place = where if isinstance(where, str) else where.place
    if not place and not isinstance(where, str):
        return position_of(where)
    if place not in world.places:
        return f"near {clean(place)}" if place else "at no place with a name"
    return clean(world.places[place].spoken, 160)


def position_of(stay: ObjectStay) -> str:
    """ "at (1.20, 3.40, 0.75) m"."""
    x, y, z = stay.position
    return f"at ({x:.2f}, {y:.2f}, {z:.2f}) m"


def at_the(world: Recall, place: str) -> str:
    """ " on the kitchen table", "" where no place is said."""
    return f" {spoken(world, place)}" if place else ""


def name_of(place: str) -> str:
    """A place's name in words."""
    return clean(place).replace("_", " ")


def described(world: Recall, object_id: str) -> str:
    """ "cup-3 (red)", what has turned out to be a bowl "cup-3 (red bowl)", a person with a name "Anna (person-3)"."""
    item = world.item(object_id)
    called = name_of_person(item)
    if called:
        return f"{clean(called)} ({clean(object_id)})"
    symbol, color, kind = parse_symbol(object_id), _likely(item, "color"), _likely(item, "class")
    told = [color] if symbol is None or kind == symbol[0] else [color, kind]
    words = " ".join(name_of(word) for word in told if word)
    return f"{clean(object_id)} ({words})" if words else clean(object_id)


def _likely(item: WorldObject | None, attribute: str) -> str:
    """The value of an attribute that is likelier than all others together, "" where none is."""
    best = item.most_probable(attribute) if item is not None else ""
    return best if item is not None and best and item.attributes[attribute][best] > 0.5 else ""


def name_of_person(item: WorldObject | None) -> str:
    """What a person is called, as an attribute says, "" where nothing does."""
    if item is None or item.most_probable("class") != PERSON:
        return ""
    return next((name for attribute in NAMES if (name := _likely(item, attribute))), "")


@remembered
def people(world: Recall) -> dict[str, list[str]]:
    """Ids by the names of people, the newest first; of those with names whom the newest `MOST_PEOPLE` ids are."""
    ids = [name for name in world.epochs if world.kind(name) == PERSON]
    numbered = sorted(ids, key=lambda name: -(parse_symbol(name) or ("", 0))[1])
    found: dict[str, list[str]] = {}
    for name in sorted(numbered[:MOST_PEOPLE], key=lambda name: name not in world.present):
        called = name_of_person(world.item(name))
        if called:
            found.setdefault(called, []).append(name)
    return found


def people_named(world: Recall, words: str) -> list[str]:
    """Ids of the person with a name, the newest first; [] where nobody is called so."""
    return next((ids for name, ids in people(world).items() if is_called(plain(words), name)), [])


def in_known_words(world: Recall, words: str) -> str:
    """The same in words that are known, "" where there are none, or where it may have been a slip."""
    said = plain(words)
    other, slips = respelled(said, phrases(world))
    return other if other != said and not slips else ""


def is_person(world: Recall, words: str) -> bool:
    """Whether words are somebody's name; those with a class among them are not, which is soon seen."""
    known = classes(world)
    if any(single in known for word in plain(words).split() for single in singulars(word)):
        return False
    return not _exact(world, words) and bool(people_named(world, words))


def phrases(world: Recall) -> list[str]:
    """Everything by which something is called: classes, places and their types, predicates, people."""
    return [*_phrases(world), *(name.lower() for name in people(world))]


@remembered
def name_words(world: Recall) -> set[str]:
    """Words of which names are made, but for those of people, which take long to read."""
    return {word for phrase in _phrases(world) for word in phrase.split()}


def _phrases(world: Recall) -> list[str]:
    placed = [plain(text) for place in world.places for text in (place.name, place.type or "")]
    values = {value.lower() for value in attribute_values(world)}
    attributes = {name for item in world.present.values() for name in item.attributes}
    return [*classes(world), *placed, *world.symbols.predicates, *sorted(values | attributes)]


def place_named(world: Recall, words: str, beside: bool = False) -> str:
    """Name of the place that words stand for, "" for none. beside : also where they say near it, or in front of it.

    Raises NothingKnownError or AmbiguousError.
    """
    around = re.match(rf"(?:{NOT_AT}) ", require_word("place", words).strip().lower())
    if around and not beside:
        seen_so = re.search("left|right|front|behind|opposite", around[0])
        why = ": that depends on from where one looks" if seen_so else ""
        raise NothingKnownError(
            f'I know what is on, in or next to something, not what is "{clean(around[0].strip())}" it{why}.'
        )
    wanted = plain(re.sub(rf"^(?:{PREPOSITIONS}) ", "", words.strip().lower()))
    names = {plain(place.name): place.name for place in world.places}
    if not words or words in world.places:
        return words
    if wanted in names:
        return names[wanted]
    nested = re.match(rf"(.+?) (?:that is )?(?:{AT}|of) (.+)", wanted)
    if nested:
        outer = place_named(world, nested[2])
        inner = {plain(name): name for name in names.values() if world.contains(outer, name)}
        names, wanted = inner, nested[1]
    typed = [name for name in names.values() if plain(world.places[name].type or "") == wanted]
    typed = typed or [full for short, full in names.items() if wanted == short]
    typed = typed or [full for short, full in names.items() if wanted and short.endswith(f" {wanted}")]
    typed = typed or [full for short, full in names.items() if wanted and wanted in short.split()]
    if len(typed) == 1:
        return typed[0]
    if typed:
        shown = [name_of(name) for name in typed]
        raise AmbiguousError(f"Which one: {listed(shown, final='or')}?", shown)
    other = in_known_words(world, wanted)
    if other:
        return place_named(world, other, beside)
    known = listed([name_of(place.name) for place in world.places], 20) or "none; give rooms and furniture"
    raise NothingKnownError(f'I know no place "{clean(wanted)}"; the places I know are {known}.')


def things_named(world: Recall, words: str, past: bool = False) -> Meant:
    """The objects that words stand for: "cup-3", "cup 3", "the red cup", "cups", "red things", "cup on the desk".

    past : also those that are no longer there. Raises NothingKnownError.
    """
    exact = _exact(world, words)
    if exact:
        return Meant((exact,), words, by_name=True)
    wanted = plain(words)
    within = re.search(rf" (?:that (?:is|was|are|were) )?(?P<no>not )?(?:{AT}) (?P<place>.+)$", wanted)
    place, there = "", True
    if within:
        there = not within["no"]
        try:
            place = place_named(world, within["place"])
        except NothingKnownError:
            if not _matching(world, sort_of(world, wanted), past):
                raise
        else:
            wanted = plain(wanted[: within.start()])
    sort = sort_of(world, wanted)
    ids = _matching(world, sort, past) or people_named(world, wanted)[:1]
    if not ids and " and " in wanted:
        several = [things_named(world, part, past).ids for part in re.split(r",? and |, ", wanted) if part]
        return Meant(tuple(dict.fromkeys(name for found in several for name in found)), words, plural=True)
    if place:
        ids = [name for name in ids if _is_at(world, name, place) == there]
    if ids:
        return Meant(tuple(ids), words, sort is not None and sort.plural, kind=sort.kind if sort else None)
    other = in_known_words(world, words)
    if other:
        return things_named(world, other, past)
    raise NothingKnownError(_nothing(world, words, place))


def one_named(world: Recall, words: str, past: bool = True) -> str:
    """The one object that words stand for.

    Raises NothingKnownError, and AmbiguousError where they stand for several.
    """
    meant = things_named(world, words, past)
    ids = list(meant.ids)
    here = [name for name in ids if name in world.present]
    if len(here) == 1:
        ids = here
    if len(ids) == 1:
        return ids[0]
    shown = [f"{described(world, name)} {where_words(world, name)}" for name in ids]
    raise AmbiguousError(f"Which one: {listed(shown, 8, 'or')}?", ids)


def one_present(world: Recall, words: str) -> str:
    """The one object that words stand for and that is there. Raises NothingKnownError or AmbiguousError."""
    name = one_named(world, words, past=False)
    if name not in world.present:
        raise NothingKnownError(f"{described(world, name)} is no longer there: there is nothing to change.")
    return name


def where_words(world: Recall, object_id: str) -> str:
    """ "on the desk", or that it is not there."""
    line = world.latest(object_id)
    if not line.stays:
        return "that was never seen for certain"
    last = spoken(world, line.stays[-1])
    return f"last {last}, missing now" if line.lost else last


def _exact(world: Recall, words: str) -> str:
    if require_word("name", words) in world.epochs:
        return words
    bare = words.strip(" ?!.,")
    if len(bare) > 1 and bare[0] == bare[-1] and bare[0] in "'\"`":
        bare = bare[1:-1]
    known, said = _ids(world), re.sub("^(?:the|my) ", "", bare.lower())
    return known.get(_joined(bare), "") or known.get(_joined(said), "")


@remembered
def _ids(world: Recall) -> dict[str, str]:
    return {_joined(name): name for name in world.epochs}


def _joined(name: str) -> str:
    """An id by which "coffee_mug-2" is also "Coffee mug 2", "coffee mug number 2" and "coffee_mug2"."""
    numbered = re.sub(
        r"(?<=[^\W\d])[\s_-]*(?:#|(?<=\s)(?:number|no\.?)\s)?\s*(\d+)$", r"-\1", name.lower().strip()
    )
    return re.sub(r"[\s_-]+", "-", numbered)


@dataclass(frozen=True)
class Sort:
    """What sort of object words speak of. kind : class, None for any. predicates : of it. plural : several."""

    kind: str | None
    predicates: tuple[str, ...]
    plural: bool = False


def sort_of(world: Recall, words: str) -> Sort | None:
    """A class that is known with predicates before it, or predicates alone; None for other words."""
    kinds = classes(world)
    parts = plain(words).split()
    for count in range(len(parts), -1, -1):  # the last `count` words are the class
        said = " ".join(parts[len(parts) - count :])
        for single in singulars(said) if said else [""]:
            kind = kinds.get(single)
            general = single in _OBJECTS or not said
            predicates = tuple(parts[: len(parts) - count])
            if (kind is None and not general) or not (said or predicates):
                continue
            others = set(predicates) - world.symbols.predicates.keys()
            if not others or others <= attribute_values(world):
                return Sort(kind, predicates, single != said or (general and not predicates))
    return None


def _matching(world: Recall, sort: Sort | None, past: bool) -> list[str]:
    """Objects of a sort, [] where there is none."""
    if sort is None:
        return []
    if sort.kind is None and not sort.predicates:
        return world.things()
    return _of(world, sort.kind, list(sort.predicates), past)


@remembered
def classes(world: Recall) -> dict[str, str]:
    """Every class that was ever seen, by its plain words."""
    names = {parsed[0] for name in world.epochs if (parsed := parse_symbol(name)) is not None}
    for item in world.present.values():
        names |= {kind for kind, p in item.attributes.get("class", {}).items() if p > Trust.NAMED}
    found = {plain(name): name for name in names}
    heads = Counter(short.split()[-1] for short in found if " " in short)
    # The mug is the coffee mug where there is no other.
    return found | {
        head: name
        for short, name in found.items()
        if heads[head := (short.split() or [""])[-1]] == 1 and head not in found
    }


def attribute_values(world: Recall) -> set[str]:
    """What attributes of present objects, but for their class, can be."""
    return {
        value
        for item in world.present.values()
        for name, values in item.attributes.items()
        if name != "class"
        for value in values
    }


def _of(world: Recall, kind: str | None, predicates: list[str], past: bool) -> list[str]:
    """Ids of a class that meet predicates, the most probable first."""
    found: list[tuple[float, str]] = []
    for item in world.present.values():
        p = 1.0 if kind is None else float(item.attributes.get("class", {}).get(kind, 0.0))
        p = _meets(world, item, predicates, p)
        if p >= LEAST and (kind or item.most_probable("class") != PERSON):
            found.append((-p * (0.5 if item.lost else 1.0), item.id))
    known = [name for _, name in sorted(found)]
    if past or not known:
        known += [name for name in _of_before(world, kind, predicates) if name not in known]
    return known if kind == PERSON else world.heads(known)


def _meets(world: Recall, item: WorldObject, predicates: Iterable[str], p: float = 1.0) -> float:
    """Probability that all predicates hold of an object, which is meant with probability p."""
    holds = (world.symbols.probability(word, item.attributes, item.quantities) for word in predicates)
    return math.prod(holds, start=p)


def _of_before(world: Recall, kind: str | None, predicates: list[str]) -> list[str]:
    """Those that are no longer there, the last seen first; of many the ones with the highest numbers."""
    numbered = [
        (-parsed[1], name)
        for name, epoch in world.epochs.items()
        if epoch == world.epoch and name not in world.present and (parsed := parse_symbol(name))
        if (parsed[0] == kind if kind else parsed[0] != PERSON)
    ]
    items = [item for _, name in sorted(numbered)[:MOST_PAST] if (item := world.item(name)) is not None]
    found = [
        (-item.last_seen, item.id)
        for item in items
        if item.last_seen - item.first_seen >= 1.0 and _meets(world, item, predicates) >= LEAST
    ]
    return [name for _, name in sorted(found)[:20]]


def _is_at(world: Recall, object_id: str, place: str) -> bool:
    chances, stay = world.latest(object_id).at(world.now)
    return stay is not None and bool(chances) and world.contains(place, stay.place)


def _nothing(world: Recall, words: str, place: str) -> str:
    said = clean(_ARTICLES.sub("", words.strip(" ?!.,")) or words)
    known = sorted(set(classes(world).values()))
    if place or (known and sort_of(world, said) is not None):
        return f'I know of no "{said}" now.'
    if plain(said) in {plain(each.name) for each in world.places}:
        return f'"{said}" is a place: ask what is there, what has changed there or who was there.'
    if not known:
        return f'I know of no "{said}": nothing has been seen yet.'
    return f'I know of no "{said}"; what I have seen are of the classes {listed(map(clean, known), 20)}.'
