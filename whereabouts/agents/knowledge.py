"""Where the tools have their knowledge from, and what they may do: a store file, or the running suite."""

from __future__ import annotations

import threading
from collections.abc import Callable
from contextlib import ExitStack
from pathlib import Path
from typing import TYPE_CHECKING, Any

from estimation.errors import InputError, WhereaboutsError
from world_model.memory.store import Store
from world_model.memory.store_file import is_store
from world_model.questions import Recall, recall

if TYPE_CHECKING:
    from whereabouts.nodes.live.live_actions import Done

ACTING = ("find_object", "verify_object", "forget", "relabel")


class Knowledge:
    """One store, opened once, or the running suite. allowed : tools that may act. One caller at a time.

    Raises WhereaboutsError where the store cannot be opened.
    """

    def __init__(self, store: Path | None, allowed: tuple[str, ...] = (), namespace: str = "") -> None:
        unknown = set(allowed) - set(ACTING)
        if unknown:
            raise InputError(
                f"--allow: one of {', '.join(ACTING)} expected, got {', '.join(sorted(unknown))}"
            )
        self.path, self.allowed, self._namespace = store, allowed, namespace
        self._lock = threading.Lock()
        self._store: Store | None = None
        self._client: Any = None
        if store is not None:
            if store.is_file() and not is_store(store):
                raise InputError(f"{store}: is no world model's store")
            self._store = Store(store, read_only=True)

    def close(self) -> None:
        """Close the store, leave the graph."""
        if self._store is not None:
            self._store.close()
        if self._client is not None:
            self._client.close()

    def ask(self, call: Callable[[Recall], Any]) -> Any:
        """What a function says of the world as it is known now. Raises WhereaboutsError."""
        with self._lock, ExitStack() as stack:
            if self._store is not None:
                return call(recall(self._store))
            from whereabouts.nodes.live.live_world import live_world

            return call(stack.enter_context(live_world(self.client())))

    def client(self) -> Any:
        """A node of this process; made when it is first needed. Raises WhereaboutsError without ROS."""
        if self._client is None:
            try:
                from whereabouts.nodes.live.live_world import Client
            except ImportError as error:
                raise InputError(
                    f"there is no running suite here ({error.name} is not installed): start the server with "
                    "--store world.sqlite, or where ROS 2 is"
                ) from error
            self._client = Client(self._namespace)
        return self._client

    def refusal(self, tool: str) -> str:
        """Why a tool may not act, and what to start or allow; "" where it may."""
        if tool not in self.allowed:
            return (
                f"{tool} changes things and is not allowed: start the server with `whereabouts mcp --allow {tool}` "
                "if it shall."
            )
        if self.path is not None and tool in ("find_object", "verify_object"):
            return (
                f"{tool} needs the robot, and this server answers from the store {self.path.name}: start it without "
                "--store beside the running suite (`whereabouts run`)."
            )
        return ""

    def act(self, call: Callable[[Any], Done]) -> Done:
        """Do something with the running suite. Raises WhereaboutsError."""
        with self._lock:
            return call(self.client())

    def change(self, call: Callable[[Any], None]) -> None:
        """Correct the store file. Raises WhereaboutsError, where a node writes to it too."""
        from world_model import WorldModel

        assert self.path is not None
        with self._lock:
            assert self._store is not None
            self._store.close()
            try:
                with Store(self.path) as store:
                    model = WorldModel(places=store.places() or None, store=store, looks_back=False)
                    call(model)
                    if store.problem:
                        raise WhereaboutsError(store.problem)
            finally:
                self._store = Store(self.path, read_only=True)
