"""The running suite as a source of the console: listens to its topics, calls its services and its search."""

from __future__ import annotations

import contextlib
import threading
import time
from collections import Counter, deque
from collections.abc import Callable
from functools import cache
from pathlib import Path
from typing import Any

from rclpy.serialization import deserialize_message

from whereabouts.console.heard import EVERY_ONE, TOPICS, Heard
from whereabouts.console.shown import Shown
from whereabouts.console.sources import ConsoleError, StoreSource
from whereabouts.logs import Topic
from whereabouts.logs.bags.ros_types import decoded, types_of
from whereabouts.nodes.live.live_actions import goal_for
from whereabouts.nodes.live.searching import RunningSearch, Searches
from whereabouts.nodes.messages.message_types import definition, message_class
from whereabouts.nodes.ros.executor import leave, private_node
from whereabouts.nodes.ros.qos import LATCHED, best_effort
from whereabouts.system.log_errors import UnreadableTypeError
from whereabouts_msgs.action import FindObject
from whereabouts_msgs.srv import SaveMap

KEPT = frozenset({"map", "tf_static", "world_state", "search_goal", "maintenance_goal"})
ANSWER_WITHIN = 10.0
"""s that a service or the search has to answer a request."""


class LiveSource:
    """Hears the suite in a thread of its own; a context manager.

    namespace : "" or "/robot1". store : the world model's, for the past and for questions. Messages are decoded when
    somebody looks. unusable : messages that could not be used, by topic and reason.
    """

    live = True

    def __init__(self, namespace: str = "", store: Path | None = None) -> None:
        self._past = StoreSource(store) if store is not None else None
        self._node, self._executor = private_node("whereabouts_console", namespace)
        self._heard = Heard(namespace)
        self._waiting: deque[tuple[str, bytes]] = deque(maxlen=10_000)
        self._newest: dict[str, bytes] = {}
        self._lock = threading.Lock()
        self.version = 0
        self._search: Shown | None = None
        self._running: RunningSearch | None = None
        self._ended = threading.Event()
        self.unusable: Counter[str] = Counter()
        for topic, name in TOPICS.items():
            qos = LATCHED if topic in KEPT else best_effort()
            self._node.create_subscription(message_class(name), topic, self._keep(topic), qos, raw=True)
        self._searches = Searches(self._node)
        self._save = self._node.create_client(SaveMap, "loop_closure/save_map")
        self._thread = threading.Thread(target=self._spin, name="console", daemon=True)

    def __enter__(self) -> LiveSource:
        self._thread.start()
        return self

    def __exit__(self, *_: object) -> None:
        self._ended.set()
        self._thread.join()
        leave(self._node)
        if self._past is not None:
            self._past.close()

    def world(self) -> Shown:
        with self._lock:
            self._decode()
            return {**self._heard.world(), "search": self._search and dict(self._search)}

    def span(self) -> tuple[float, float] | None:
        return None if self._past is None else self._past.span()

    def world_at(self, stamp: float) -> Shown:
        if self._past is None:
            raise ConsoleError("there is no history here; start the console with --store FILE")
        with self._lock:
            return {**self._past.world_at(stamp), "map": self._heard.world()["map"]}

    def picture(self) -> bytes | None:
        with self._lock:
            self._decode()
            self._heard.world()
            return self._heard.picture

    def ask(self, question: str) -> Shown:
        if self._past is None:
            raise ConsoleError("questions need the world model's memory; start the console with --store FILE")
        return self._past.ask(question)

    def act(self, name: str, arguments: dict[str, Any]) -> str:
        actions = {"find": self._search_for, "cancel": self._cancel, "save_map": self._save_map}
        return actions[name](arguments)

    def _spin(self) -> None:
        while not self._ended.is_set() and self._node.context.ok():
            self._executor.spin_once(timeout_sec=0.1)

    def _keep(self, topic: str) -> Any:
        def keep(data: bytes) -> None:
            with self._lock:
                if topic in EVERY_ONE:
                    self._waiting.append((topic, data))
                else:
                    self._newest[topic] = data
                self.version += 1

        return keep

    def _decode(self) -> None:
        """Transforms first: what else has come is placed by them. An update comes after its map."""
        newest = list(self._newest.items())
        every_one = list(self._waiting)
        self._newest.clear()
        self._waiting.clear()
        first = [item for item in every_one if item[0].startswith("tf")]
        last = [item for item in every_one if not item[0].startswith("tf")]
        for topic, data in first + newest + last:
            try:
                self._heard.take(topic, reader_of(TOPICS[topic])(bytes(data)))
            except Exception as error:
                # Whatever is published: the page goes on with all the others.
                self.unusable[f"{topic}: {error}"] += 1

    def _search_for(self, arguments: dict[str, Any]) -> str:
        name = str(arguments.get("name", "")).strip()
        if not name:
            raise ConsoleError("say what to find")
        if not self._searches.ready:
            raise ConsoleError("the search does not run: `whereabouts run object_search` starts it")
        known = any(item["id"] == name for item in self.world()["things"])
        goal = FindObject.Goal(object_id=name) if known else self._goal_for(name)
        asked: Shown = {"name": name, "text": "asked", "done": False}
        self._search = asked
        self._running = self._searches.ask(
            goal, lambda step: self._told(asked, step), lambda result: self._found(asked, result)
        )
        if not self._answer(self._running.answered, "the search").accepted:
            self._running = self._search = None
            raise ConsoleError("the search refused; it may be busy")
        return f"searching for {name}"

    def _goal_for(self, name: str) -> FindObject.Goal:
        if self._past is None:
            return goal_for(name, None)
        return self._past.told(lambda world: goal_for(name, world))

    def _told(self, asked: Shown, step: FindObject.Feedback) -> None:
        # A search ends when another one is asked for: what it says last is not about the new one.
        asked["text"] = str(step.reason)
        self.version += 1

    def _found(self, asked: Shown, result: FindObject.Result) -> None:
        asked |= {"text": str(result.message), "done": True, "found": result.code == result.FOUND}
        self.version += 1

    def _cancel(self, _: dict[str, Any]) -> str:
        running = self._running
        if running is None or running.result is not None:
            raise ConsoleError("nothing is being searched for")
        self._answer(running.cancel(), "the search")
        return "the search is being cancelled"

    def _save_map(self, arguments: dict[str, Any]) -> str:
        if not self._save.service_is_ready():
            raise ConsoleError("loop_closure does not run: there is no map to save")
        request = SaveMap.Request(path=str(arguments.get("name", "")))
        answer = self._answer(self._save.call_async(request), "loop_closure")
        if answer.code != SaveMap.Response.SUCCESS:
            raise ConsoleError(answer.message)
        return f"saved as {answer.path}"

    def _answer(self, future: Any, who: str) -> Any:
        until = time.monotonic() + ANSWER_WITHIN
        while not future.done():
            if time.monotonic() > until:
                future.cancel()
                raise ConsoleError(f"{who} does not answer")
            time.sleep(0.01)
        with contextlib.suppress(Exception):
            return future.result()
        raise ConsoleError(f"{who} does not answer: {future.exception()}")


@cache
def reader_of(type_name: str) -> Callable[[bytes], Any]:
    """Decodes messages of a type; by rclpy, which takes several times as long, where its definition is not at hand."""
    topic = Topic("", type_name, definition(type_name))
    try:
        types_of(topic)
        return lambda data: decoded(topic, data)
    except UnreadableTypeError:
        return lambda data: deserialize_message(data, message_class(type_name))
