"""`whereabouts ask`: a question in plain words, to a store or to the running suite."""

from __future__ import annotations

import sys
from pathlib import Path
from typing import Annotated

import typer

from estimation.errors import WhereaboutsError
from whereabouts.cli.common import Namespace, argument, option, require_places

NOT_UNDERSTOOD, NO_WORLD = 1, 2
StoreFile = Annotated[
    Path | None, option("--store", "Use this store, not the running suite.", metavar="world.sqlite")
]
PlacesFile = Annotated[
    Path | None,
    option("--places", "Rooms and furniture in place of those the store has.", metavar="home.yaml"),
]


def ask(
    words: Annotated[
        list[str], argument("[STORE] QUESTION...", "A store, where it is not the running suite; a question.")
    ],
    as_json: Annotated[bool, option("--json", "Print the whole record as JSON.")] = False,
    places: PlacesFile = None,
    namespace: Namespace = "",
) -> None:
    """Ask where things are and were, what changed, what is missing, who was where.

    The first argument is the store if there is such a file; without one the running node world_model is asked. Exit
    status: 0 answered, 1 not understood (it is said what can be asked), 2 no store and no running node, or
    one that has seen nothing yet.
    """
    import json

    from estimation.geometry.places import Places
    from whereabouts.agents.knowledge import Knowledge
    from world_model.questions import ask as answer_to

    store, question = stored(words)
    try:
        require_places(places)
        others = Places.load(places) if places else None
        with Knowledge(store, namespace=namespace, places=others) as knowledge:
            answer = knowledge.ask(lambda world: answer_to(world, question))
    except WhereaboutsError as error:
        typer.echo(f"whereabouts: {error}", err=True)
        sys.exit(NO_WORLD)
    typer.echo(json.dumps(answer.to_dict(), indent=2, ensure_ascii=False) if as_json else answer.sentence)
    if not answer.understood:
        sys.exit(NOT_UNDERSTOOD)


def stored(words: list[str]) -> tuple[Path | None, str]:
    """The store among the arguments, and the question."""
    first = Path(words[0])
    named = first.suffix in (".sqlite", ".sqlite3", ".db") and " " not in words[0]
    try:
        there = first.is_file()
    except (OSError, ValueError):
        there = False
    if there or named:
        return first, " ".join(words[1:])
    return None, " ".join(words)
