"""The first screen of the report of a replay: what the nodes said, moment by moment."""

from __future__ import annotations

from bisect import bisect_right
from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from estimation.geometry.places import Places
from evaluation.demo.reading import Said, Task, Truth
from evaluation.demo.reasons import plain
from evaluation.demo.screen import Screen, called, thinned

Array = NDArray[np.float64]
PERIOD = 0.5
"""s between two moments of the picture."""
MISSED = 1.0
"""m: who is farther from everybody is nobody."""


def screen_of(said: Said, truth: Truth, places: Places) -> Screen:
    """From a recording. Without ground truth in `truth` nobody is called false."""
    stamps, poses = said.replayed.stamps, _way(said)
    ends = [*stamps[:1], *stamps[-1:], *said.worlds, *said.people]
    screen = Screen(min(ends, default=0.0), max(ends, default=1.0), places)
    for stamp in thinned(stamps.tolist(), PERIOD):
        pose = poses[int(np.searchsorted(stamps, stamp))]
        screen.robot.append((stamp, *pose.tolist()))
    _take_people(screen, said, truth)
    for stamp in thinned(said.worlds, PERIOD):
        screen.take(stamp, said.worlds[stamp], lambda item: item.place)
    screen.tell_things()
    for task in said.tasks:
        x, y = task.region[:2].tolist()
        ended = task.ended if np.isfinite(task.ended) else task.stamp + 8.0
        screen.goals.append((task.stamp, ended, x, y, "looks again"))
        screen.events.append((task.stamp, told_task(task, said), task.object_id))
    screen.events.sort(key=lambda event: event[0])
    if said.grid is not None:
        screen.cells, screen.extent = said.grid.values, said.grid.extent
    return screen


def _way(said: Said) -> Array:
    """Poses (N, 3) in the map, loops closed where that is known."""
    corrected = said.replayed.corrected
    return corrected if len(corrected) else said.replayed.live().reshape(-1, 3)


def _take_people(screen: Screen, said: Said, truth: Truth) -> None:
    known = sorted(truth.people)
    for stamp in thinned(said.people, PERIOD):
        spots = _true_people(truth, known, stamp)
        for one in said.people[stamp]:
            x, y = one.position.tolist()
            nobody = spots is not None and not (np.hypot(*(spots - one.position).T) <= MISSED).any()
            screen.people.setdefault(f"person {one.label}", []).append((stamp, x, y, one.hidden, nobody))
        if spots is not None:
            screen.true_people.append((stamp, spots))
    for name, rows in sorted(truth.things.items()):
        for thing, spot in rows.items():
            track = screen.true_things.setdefault(thing, [])
            if not track or track[-1][1] is None or np.abs(track[-1][1] - spot).max() > 0.02:
                track.append((name, spot))


def _true_people(truth: Truth, known: Sequence[float], stamp: float) -> Array | None:
    at = bisect_right(known, stamp + 0.02) - 1
    return truth.people[known[at]][0].reshape(-1, 2) if at >= 0 else None


def told_task(task: Task, said: Said) -> str:
    """Why the robot looked again, and what came of it."""
    before = [stamp for stamp in said.worlds if stamp <= task.stamp]
    world = said.worlds[max(before)] if before else ()
    thing = next((each for each in world if each.id == task.object_id), None)
    name = called(thing) if thing is not None else task.object_id
    unseen = task.stamp - thing.last_seen if thing is not None else float("nan")
    return plain(task.reason, name, unseen) + (f"; {task.outcome}" if task.outcome else "")
