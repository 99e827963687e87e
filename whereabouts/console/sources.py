"""Where the console's page gets its answers from: what every source can do, and a store as one."""

from __future__ import annotations

import threading
from collections.abc import Callable
from pathlib import Path
from typing import Any, Protocol, TypeVar

from estimation.errors import WhereaboutsError
from whereabouts.agents.knowledge import read_store
from whereabouts.console.shown import Shown, empty, thing
from world_model.queries import Words
from world_model.questions import Recall, recall

T = TypeVar("T")


class ConsoleError(WhereaboutsError):
    """A request that cannot be answered; the message says why, for the one who asked."""


class Source(Protocol):
    """What the page's server needs. All functions may be called from any thread."""

    live: bool

    @property
    def version(self) -> int:
        """Grows whenever `world()` may say something new."""

    def world(self) -> Shown:
        """The newest world."""

    def span(self) -> tuple[float, float] | None:
        """First and last stamp, s, of what `world_at` knows; None where there is no history."""

    def world_at(self, stamp: float) -> Shown:
        """The world as it was known at a stamp. Raises ConsoleError where there is no history."""

    def picture(self) -> bytes | None:
        """The map as PNG; None where there is none yet."""

    def ask(self, question: str) -> Shown:
        """An answer: sentence, probability, stamp, evidence, alternatives, as `whereabouts ask --json` has it."""

    def act(self, name: str, arguments: dict[str, Any]) -> str:
        """Do something (find, cancel, save_map); returns a sentence. Raises ConsoleError."""


class StoreSource:
    """A store, also one that a node is writing. Raises WhereaboutsError where it is none, or cannot be read."""

    live = False

    def __init__(self, path: Path) -> None:
        self._store = read_store(path)
        self._lock = threading.Lock()

    @property
    def version(self) -> int:
        with self._lock:
            return self._store.data_version

    def close(self) -> None:
        self._store.close()

    def span(self) -> tuple[float, float] | None:
        with self._lock:
            runs = self._store.epochs()
        firsts = [first for _, first, _ in runs if first is not None]
        lasts = [last for _, _, last in runs if last is not None]
        return (min(firsts), max(lasts)) if firsts and lasts else None

    def world(self) -> Shown:
        span = self.span()
        return empty() if span is None else self.world_at(span[1])

    def world_at(self, stamp: float) -> Shown:
        with self._lock:
            items, words = self._store.objects_at(stamp), Words(self._store.places())
        return {**empty(), "stamp": stamp, "things": [thing(words.described(item)) for item in items]}

    def picture(self) -> bytes | None:
        return None

    def ask(self, question: str) -> Shown:
        from world_model import ask

        with self._lock:
            return ask(self._store, question).to_dict()

    def told(self, call: Callable[[Recall], T]) -> T:
        """What a call makes of all that the store remembers."""
        with self._lock:
            return call(recall(self._store))

    def act(self, name: str, arguments: dict[str, Any]) -> str:
        raise ConsoleError("this page shows a store; to act, start the console beside the running suite")
