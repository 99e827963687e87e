"""A bag, drawn from its beginning to its end, or to a moment."""

from __future__ import annotations

import heapq
from collections.abc import Callable, Iterable, Iterator, Sequence
from pathlib import Path
from typing import Protocol

from whereabouts.logs import open_raw
from whereabouts.system.log_errors import NothingRecognisedError, UnreadableTypeError
from whereabouts.viewer.drawable import Shape
from whereabouts.viewer.scene import Scene, stamp_of


class Sink(Protocol):
    """What draws shapes."""

    def draw(self, stamp: float, shapes: Iterable[Shape]) -> None:
        """Shapes that hold from `stamp` (s) on."""


def play(
    paths: Iterable[Path],
    sink: Sink,
    until: float | None = None,
    namespace: str = "",
    hidden: Sequence[str] = (),
    progress: Callable[[float], None] = lambda share: None,
) -> Scene:
    """Draw bags, one after the other or, where they overlap, together: a recording of the suite and the bag it heard.

    until : seconds after the first message. hidden : beginnings of topics that are not shown, in the namespace.
    Raises LogError: a bag cannot be read; NothingRecognisedError: there is nothing in it that can be drawn.
    """
    scene, drawn = Scene(), 0
    given = list(paths)
    start: float | None = None
    streams = [_messages(path, scene.types, namespace, hidden, progress) for path in given]
    for log_time, type_name, topic, message in heapq.merge(*streams, key=lambda item: item[0]):
        stamp = stamp_of(message, log_time)
        start = stamp if start is None else start
        if until is not None and stamp > start + until:
            break
        shapes = scene.take(type_name, topic, message)
        drawn += len(shapes)
        sink.draw(stamp, shapes)
    if not drawn:
        raise NothingRecognisedError(
            given[0], "holds nothing that can be drawn; types that can: " + ", ".join(sorted(scene.types))
        )
    return scene


def _messages(
    path: Path,
    types: frozenset[str],
    namespace: str,
    hidden: Sequence[str],
    progress: Callable[[float], None],
) -> Iterator[tuple[int, str, str, object]]:
    """(time of recording, type, topic, message) of what can be drawn."""
    with open_raw(path) as bag:
        for raw in bag:
            topic = raw.name.removeprefix(namespace)
            if raw.type_name not in types or not raw.name.startswith(namespace):
                continue
            if topic.lstrip("/").startswith(tuple(hidden)):
                continue
            try:
                message = raw.decoded()
            except UnreadableTypeError:
                continue
            progress(bag.progress)
            yield raw.log_time, raw.type_name, topic, message
