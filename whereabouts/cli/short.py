"""`whereabouts find`, `forget`, `save-map`, `load-map`: one thing each, done by the running suite."""

from __future__ import annotations

import sys
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, NoReturn

import typer

from whereabouts.cli.ask import StoreFile
from whereabouts.cli.common import Namespace, argument, option

if TYPE_CHECKING:
    from whereabouts.agents.knowledge import Knowledge

Named = Annotated[list[str], argument("NAME", 'An id ("cup-3"), a class, or a colour and a class.')]
MapPath = Annotated[
    str, argument("[PATH]", "Folder or file stem on the node's machine; default: as configured.")
]


def find(name: Named, store: StoreFile = None, namespace: Namespace = "") -> None:
    """Search for an object with the robot; Ctrl-C cancels. With --store: the places where to look, in order.

    Exit status: 0 found, 1 not found, 2 no store and nobody who searches.
    """
    from world_model.questions import answered, where_to_look

    words = " ".join(name)
    if store is None:
        _live(namespace, lambda knowledge: _found(knowledge, words))
        return
    with _stored(store, failure=2) as knowledge:
        answer = knowledge.ask(lambda world: answered(world, lambda known: where_to_look(known, words)))
    typer.echo(answer.sentence)
    if answer.value is None:
        sys.exit(1)


def _found(knowledge: Knowledge, words: str) -> tuple[bool, str]:
    said: list[str] = []

    def step(reason: str, probability: float) -> None:
        if reason and reason not in said[-1:]:
            said.append(reason)
            typer.echo(f"{reason} (p = {probability:.2f})")

    done = knowledge.find(words, step)
    return done.ok, done.sentence


def forget(name: Named, store: StoreFile = None, namespace: Namespace = "") -> None:
    """Take an object out of the world for good; its history stays. With --store: out of that file."""
    words = " ".join(name)
    if store is None:
        _live(namespace, lambda knowledge: _forgotten(knowledge, words))
        return
    with _stored(store, failure=1) as knowledge:
        _, sentence = _forgotten(knowledge, words)
    typer.echo(sentence)


def _forgotten(knowledge: Knowledge, words: str) -> tuple[bool, str]:
    from world_model.questions.naming import one_present

    return knowledge.change("forget", knowledge.ask(lambda world: one_present(world, words)))


def save_map(path: MapPath = "", namespace: Namespace = "") -> None:
    """Have the running node loop_closure write its map."""
    _live(namespace, lambda knowledge: knowledge.act("save_map", path=path))


def load_map(
    path: MapPath = "",
    extend: Annotated[bool, option("--extend", "Go on mapping; else only localise in it.")] = False,
    namespace: Namespace = "",
) -> None:
    """Have the running node loop_closure read a map and localise in it."""
    asked = {"path": path, "localization_only": not extend}
    _live(namespace, lambda knowledge: knowledge.act("load_map", **asked))


@contextmanager
def _stored(store: Path, failure: int) -> Iterator[Knowledge]:
    """What a store knows; ends with the status `failure` where something is wrong with it."""
    from estimation.errors import WhereaboutsError
    from whereabouts.agents.knowledge import Knowledge

    try:
        with Knowledge(store) as knowledge:
            yield knowledge
    except WhereaboutsError as error:
        _end(failure, f"whereabouts: {error}")


def _live(namespace: str, call: Callable[[Knowledge], tuple[bool, str]]) -> None:
    """Do something with the running suite; ends with 0 where it is done, 1 where not, 2 where nobody runs."""
    from estimation.errors import WhereaboutsError
    from whereabouts.agents.knowledge import Knowledge

    with Knowledge(None, namespace=namespace) as knowledge:
        try:
            knowledge.client()
        except WhereaboutsError as error:
            _end(2, f"whereabouts: {error}")
        from whereabouts.nodes.live.live_world import NoWorldError

        try:
            ok, sentence = call(knowledge)
        except KeyboardInterrupt:
            _end(1, "cancelled")
        except WhereaboutsError as error:
            _end(2 if isinstance(error, NoWorldError) else 1, f"whereabouts: {error}")
    typer.echo(sentence)
    if not ok:
        sys.exit(1)


def _end(code: int, why: str) -> NoReturn:
    typer.echo(why, err=True)
    sys.exit(code)
