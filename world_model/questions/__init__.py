"""Questions in plain words, and the typed functions beneath them; no language model.

    ask("world.sqlite", "where was the red cup yesterday at nine?").sentence
    where_was(recall(store), "red cup", "yesterday at nine").probability

`ask` takes a `Store`, the path of its file, or a `WorldModel`. The functions take what `recall` makes of these, names
and times in words or s; they raise NothingKnownError and AmbiguousError, which `ask` puts into the answer.
"""

from world_model.questions.answers import AmbiguousError, Answer, NothingKnownError, NotUnderstoodError
from world_model.questions.company import (
    what_was_carried,
    who_has,
    who_is_here,
    who_moved,
    who_was_here,
    who_was_last,
)
from world_model.questions.grammar import CAN_BE_ASKED, answered, ask
from world_model.questions.moments import Span, moment
from world_model.questions.nearby import how_far, what_is_near
from world_model.questions.past import (
    history,
    how_long_at,
    how_long_there,
    how_often,
    what_changed,
    what_is_missing,
    what_left,
    what_moved,
    what_was_missing,
    when_last_at,
    when_moved,
)
from world_model.questions.recall import Recall, recall
from world_model.questions.traits import is_so, what_it_is, which_places
from world_model.questions.usual import (
    is_at_usual_place,
    is_usually_at,
    what_is_needed_next,
    what_is_usually_here,
    where_will_be,
    will_be_at,
)
from world_model.questions.where import (
    how_many,
    is_at,
    was_at,
    what_is_at,
    what_was_at,
    what_was_not_seen,
    when_last_seen,
    where_is,
    where_to_look,
    where_usually,
    where_was,
    which_room,
)

__all__ = [
    "CAN_BE_ASKED", "AmbiguousError", "Answer", "NotUnderstoodError", "NothingKnownError", "Recall", "Span",
    "answered", "ask", "history", "how_far", "how_long_at", "how_long_there", "how_many", "how_often",
    "is_at", "is_at_usual_place", "is_so", "is_usually_at", "moment", "recall", "was_at", "what_changed", "what_is_at",
    "what_is_missing", "what_is_near", "what_is_needed_next", "what_is_usually_here", "what_it_is",
    "what_left", "what_moved", "what_was_at", "what_was_carried", "what_was_missing", "what_was_not_seen",
    "when_last_at", "when_last_seen", "when_moved", "where_is", "where_to_look", "where_usually", "where_was",
    "where_will_be", "which_places", "which_room", "who_has", "who_is_here", "who_moved", "who_was_here",
    "who_was_last", "will_be_at",
]  # fmt: skip
