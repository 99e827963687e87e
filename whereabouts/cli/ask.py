"""`whereabouts ask`: a question in plain words, to a store or to the running suite."""

from __future__ import annotations

import sys
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from estimation.errors import WhereaboutsError
from whereabouts.cli.common import require_places

if TYPE_CHECKING:
    from collections.abc import Iterator

    from world_model.questions import Recall

NOT_UNDERSTOOD, NO_WORLD = 1, 2
StoreFile = Annotated[
    Path | None,
    typer.Option("--store", metavar="world.sqlite", help="Use this store, not the running suite."),
]
PlacesFile = Annotated[
    Path | None,
    typer.Option(
        "--places", metavar="home.yaml", help="Rooms and furniture in place of those the store has."
    ),
]
Namespace = Annotated[str, typer.Option("--namespace", help="Of the running suite, such as /robot1.")]


def ask(
    words: Annotated[
        list[str],
        typer.Argument(
            metavar="[STORE] QUESTION...", help="A store, where it is not the running suite; a question."
        ),
    ],
    as_json: Annotated[bool, typer.Option("--json", help="Print the whole record as JSON.")] = False,
    places: PlacesFile = None,
    namespace: Namespace = "",
) -> None:
    """Ask where things are and were, what changed, what is missing, who was where.

    The first argument is the store if there is such a file; without one the running node world_model is asked. Exit
    status: 0 answered, 1 not understood (it is said what can be asked), 2 no store and no running node, or
    one that has seen nothing yet.
    """
    import json

    from world_model.questions import ask as answer_to

    store, question = stored(words)
    try:
        with opened(store, places, namespace) as world:
            answer = answer_to(world, question)
    except (WhereaboutsError, ImportError) as error:
        typer.echo(f"whereabouts: {without_ros(error)}", err=True)
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


@contextmanager
def opened(store: Path | None, places: Path | None = None, namespace: str = "") -> Iterator[Recall]:
    """What a store knows, or the running suite. Raises WhereaboutsError, and ImportError without ROS."""
    from estimation.errors import InputError
    from estimation.geometry.places import Places

    require_places(places)
    others = Places.load(places) if places else None
    if store is None:
        from whereabouts.nodes.live.live_world import Client, live_world

        client = Client(namespace)
        try:
            with live_world(client, others) as world:
                yield world
        finally:
            client.close()
        return
    from world_model.memory.store import Store
    from world_model.memory.store_file import is_store
    from world_model.questions import Recall

    if store.is_file() and not is_store(store):
        raise InputError(f"{store}: is no world model's store")
    with Store(store, read_only=True) as source:
        yield Recall.of_store(source, others)


def without_ros(error: Exception) -> str:
    """What is wrong, also where ROS is missing."""
    if isinstance(error, ImportError):
        return f"to ask the running suite needs ROS 2 ({error.name} is not installed here); or name a store"
    return str(error)
