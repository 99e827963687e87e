"""Where questions and tools have their knowledge from, and what they may do: a store file, or the running suite."""

from __future__ import annotations

import threading
from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING, Any, TypeVar

from estimation.errors import InputError, WhereaboutsError
from estimation.geometry.places import Places
from world_model.memory.store import Store
from world_model.memory.store_file import is_store
from world_model.questions import Recall, recall
from world_model.questions.answers import clean

if TYPE_CHECKING:
    from whereabouts.nodes.live.live_actions import Done

ACTING = ("find_object", "verify_object", "forget", "relabel")
T = TypeVar("T")


def read_store(path: Path) -> Store:
    """A store, also one that a node is writing. Raises WhereaboutsError where it is none, or cannot be read."""
    # Any file is looked through for rows of a store, which takes long with a large one of another kind.
    if path.is_file() and not is_store(path):
        raise InputError(f"{path}: is no world model's store")
    return Store(path, read_only=True)


class Knowledge:
    """One store, opened once, or the running suite; a context manager. One caller at a time.

    allowed : tools that may act. places : rooms and furniture in place of those that are known. Raises WhereaboutsError
    where the store cannot be opened.
    """

    def __init__(
        self,
        store: Path | None,
        allowed: tuple[str, ...] = (),
        namespace: str = "",
        places: Places | None = None,
    ) -> None:
        unknown = set(allowed) - set(ACTING)
        if unknown:
            raise InputError(
                f"--allow: one of {', '.join(ACTING)} expected, got {', '.join(sorted(unknown))}"
            )
        self.path, self.allowed, self._namespace, self._places = store, allowed, namespace, places
        self._lock = threading.Lock()
        self._store: Store | None = None
        self._client: Any = None
        if store is not None:
            self._store = read_store(store)

    def __enter__(self) -> Knowledge:
        return self

    def __exit__(self, *_: object) -> None:
        if self._store is not None:
            self._store.close()
        if self._client is not None:
            self._client.close()

    def ask(self, call: Callable[[Recall], T]) -> T:
        """What a function says of the world as it is known now. Raises WhereaboutsError."""
        with self._lock:
            if self._store is not None:
                return call(recall(self._store, self._places))
            client = self.client()
            from whereabouts.nodes.live.live_world import live_world

            with live_world(client, self._places) as world:
                return call(world)

    def client(self) -> Any:
        """A node of this process; made when it is first needed. Raises WhereaboutsError without ROS."""
        if self._client is None:
            try:
                from whereabouts.nodes.live.live_world import Client
            except ImportError as error:
                raise InputError(
                    f"the running suite needs ROS 2 ({error.name} is not installed here); or name a store: "
                    "`ask world.sqlite ...`, or `--store world.sqlite` with other commands"
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

    def find(
        self, words: str, on_step: Callable[[str, float], None], stopped: Callable[[], bool] = lambda: False
    ) -> Done:
        """Search with the robot for what words mean; as `live_actions.find`. Raises WhereaboutsError."""
        client = self.client()
        from whereabouts.nodes.live.live_actions import find, goal_for
        from whereabouts.nodes.live.live_world import NoWorldError

        try:
            goal = self.ask(lambda world: goal_for(words, world))
        except NoWorldError:
            goal = goal_for(words, None)
        with self._lock:
            return find(client, goal, on_step, stopped)

    def change(self, tool: str, object_id: str, class_name: str = "") -> tuple[bool, str]:
        """Forget, relabel or verify an object: whether it is done, and a sentence. Raises WhereaboutsError.

        In a store file also where a node writes to it too.
        """
        if self.path is not None:
            with self._lock:
                return True, self._correct(self.path, tool, object_id, class_name)
        more = {"relabel": {"class_name": class_name}, "verify_object": {"requester": "a question"}}
        return self.act(tool, object_id=object_id, **more.get(tool, {}))

    def act(self, name: str, **fields: Any) -> tuple[bool, str]:
        """Have the running suite do something: whether it is done, and a sentence; as `live_actions.act`."""
        with self._lock:
            client = self.client()
            from whereabouts.nodes.live.live_actions import act

            done = act(client, name, **fields)
            return done.ok, done.sentence

    def _correct(self, path: Path, tool: str, object_id: str, class_name: str) -> str:
        from world_model import WorldModel

        assert self._store is not None
        self._store.close()
        try:
            with Store(path) as store:
                model = WorldModel(places=store.places() or None, store=store, looks_back=False)
                if tool == "forget":
                    model.forget(object_id)
                else:
                    model.relabel(object_id, class_name)
                if store.problem:
                    raise WhereaboutsError(store.problem)
        finally:
            self._store = Store(path, read_only=True)
        said = "is forgotten" if tool == "forget" else f"is a {clean(class_name)} from now on"
        return f"{clean(object_id)} {said}."
