"""`whereabouts find`, `forget`, `save-map`, `load-map`: one thing each, done by the running suite."""

from __future__ import annotations

import sys
from collections.abc import Callable
from typing import TYPE_CHECKING, Annotated, Any, NoReturn

import typer

from whereabouts.cli.ask import Namespace, StoreFile, opened

if TYPE_CHECKING:
    from whereabouts.nodes.live.live_actions import Done

Named = Annotated[
    list[str], typer.Argument(metavar="NAME", help='An id ("cup-3"), a class, or a colour and a class.')
]
MapPath = Annotated[
    str,
    typer.Argument(
        metavar="[PATH]", help="Folder or file stem on the node's machine; default: as configured."
    ),
]


def find(name: Named, store: StoreFile = None, namespace: Namespace = "") -> None:
    """Search for an object with the robot; Ctrl-C cancels. With --store: the places where to look, in order.

    Exit status: 0 found, 1 not found, 2 no store and nobody who searches.
    """
    from estimation.errors import WhereaboutsError
    from world_model.questions import answered, where_to_look

    words = " ".join(name)
    if store is None:
        _live(namespace, lambda actions, client: _found(actions, client, words))
        return
    try:
        with opened(store) as world:
            answer = answered(world, lambda known: where_to_look(known, words))
    except WhereaboutsError as error:
        _end(2, f"whereabouts: {error}")
    typer.echo(answer.sentence)
    if answer.value is None:
        sys.exit(1)


def _found(actions: Any, client: Any, words: str) -> Done:
    from whereabouts.nodes.live.live_world import NoWorldError, live_world

    try:
        with live_world(client) as world:
            goal = actions.goal_for(words, world)
    except NoWorldError:
        goal = actions.goal_for(words, None)
    said: list[str] = []

    def step(reason: str, probability: float) -> None:
        if reason and reason not in said[-1:]:
            said.append(reason)
            typer.echo(f"{reason} (p = {probability:.2f})")

    done: Done = actions.find(client, goal, step)
    return done


def forget(name: Named, store: StoreFile = None, namespace: Namespace = "") -> None:
    """Take an object out of the world for good; its history stays. With --store: out of that file."""
    words = " ".join(name)
    if store is None:
        _live(namespace, lambda actions, client: _forgotten(actions, client, words))
        return
    from estimation.errors import WhereaboutsError
    from whereabouts.agents.knowledge import Knowledge
    from world_model.questions.naming import one_present

    try:
        knowledge = Knowledge(store, ("forget",))
        try:
            object_id = knowledge.ask(lambda world: one_present(world, words))
            knowledge.change(lambda model: model.forget(object_id))
        finally:
            knowledge.close()
    except WhereaboutsError as error:
        _end(1, f"whereabouts: {error}")
    typer.echo(f"{object_id} is forgotten.")


def _forgotten(actions: Any, client: Any, words: str) -> Done:
    from whereabouts.nodes.live.live_world import live_world
    from world_model.questions.naming import one_present

    with live_world(client) as world:
        object_id = one_present(world, words)
    done: Done = actions.forget(client, object_id)
    return done


def save_map(path: MapPath = "", namespace: Namespace = "") -> None:
    """Have the running node loop_closure write its map."""
    _live(namespace, lambda actions, client: actions.save_map(client, path))


def load_map(
    path: MapPath = "",
    extend: Annotated[
        bool, typer.Option("--extend", help="Go on mapping; else only localise in it.")
    ] = False,
    namespace: Namespace = "",
) -> None:
    """Have the running node loop_closure read a map and localise in it."""
    _live(namespace, lambda actions, client: actions.load_map(client, path, extend))


def _live(namespace: str, call: Callable[[Any, Any], Done]) -> None:
    """Do something with the running suite; ends with 0 where it is done, 1 where not, 2 where nobody runs.

    call : given `whereabouts.nodes.live.live_actions`, which needs ROS, and a client.
    """
    from estimation.errors import InputError, WhereaboutsError
    from whereabouts.cli.ask import without_ros

    try:
        from whereabouts.nodes.live import live_actions
        from whereabouts.nodes.live.live_world import Client, NoWorldError
    except ImportError as error:
        _end(2, f"whereabouts: {without_ros(error)}")
    client = Client(namespace)
    try:
        done = call(live_actions, client)
    except KeyboardInterrupt:
        _end(1, "cancelled")
    except NoWorldError as error:
        _end(2, f"whereabouts: {error}")
    except (InputError, WhereaboutsError) as error:
        _end(1, f"whereabouts: {error}")
    finally:
        client.close()
    typer.echo(done.sentence)
    if not done.ok:
        sys.exit(1)


def _end(code: int, why: str) -> NoReturn:
    typer.echo(why, err=True)
    sys.exit(code)
