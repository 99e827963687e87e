"""What things are, by class, colour and other predicates; and which places have names."""

from __future__ import annotations

from world_model.questions.answers import Answer, NothingKnownError, clean, hedged, listed, told
from world_model.questions.naming import attribute_values, classes, described, name_of, one_named, plain
from world_model.questions.recall import Recall, Trust
from world_model.state import WorldObject, most_probable


def what_it_is(world: Recall, what: str, attribute: str) -> Answer:
    """The most probable value of an attribute of an object: its color. Raises NothingKnownError, AmbiguousError."""
    name = one_named(world, what)
    item = world.item(name)
    values = {} if item is None else item.attributes.get(attribute, {})
    if not values:
        known = listed(map(clean, () if item is None else item.attributes)) or "place"
        raise NothingKnownError(
            f"I know no {clean(attribute)} of {described(world, name)}; I know its {known}."
        )
    best = most_probable(values)
    options = tuple({"object": name, attribute: value, "probability": p} for value, p in values.items())
    verb = hedged(values[best])
    sentence = f"The {clean(attribute)} of {described(world, name)} {verb} {name_of(best)}"
    return Answer.stated(sentence, "what_it_is", values[best], world.now, best, (), options)


def is_so(world: Recall, what: str, word: str) -> Answer:
    """Whether an object is of a class, a colour or meets another predicate. value : bool.

    Raises NothingKnownError, AmbiguousError.
    """
    name = one_named(world, what)
    item = world.item(name)
    p = None if item is None else _probability(world, item, plain(word))
    if p is None:
        raise NothingKnownError(f'I know nothing that is called "{clean(plain(word))}".')
    no = "" if p >= 0.5 else " not"
    sentence = f"{'No' if no else 'Yes'}, {described(world, name)} is{no} {clean(plain(word))}"
    return Answer.stated(sentence, "is_so", max(p, 1.0 - p), world.now, p >= 0.5)


def _probability(world: Recall, item: WorldObject, word: str) -> float | None:
    """That an object is what a word says; None where nothing is called so."""
    kind = classes(world).get(word)
    if kind is not None:
        return item.attributes.get("class", {}).get(kind, 0.0)
    if word in world.symbols.predicates or word in attribute_values(world):
        return world.symbols.probability(word, item.attributes, item.quantities)
    return None


def which_places(world: Recall, kind: str) -> Answer:
    """The places with a name; kind : only "room" or "furniture". value : names."""
    names = [place.name for place in world.places if kind in ("", place.kind)]
    if not names:
        raise NothingKnownError(f"I know no {kind or 'place'} by name: give `places_file`, or --places.")
    sentence = f"I know the {listed(map(name_of, names), 40)}, {told(Trust.EACH)}."
    return Answer(sentence, "which_places", Trust.EACH, "", names)
