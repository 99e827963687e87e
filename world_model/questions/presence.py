"""Where things were in the last weeks, as a store or a model remembers it, read at once."""

from __future__ import annotations

from world_model.memory.courses import PlaceCourse, Sight, courses_of, courses_of_rows
from world_model.questions.recall import Recall, Timeline


def presence_of(world: Recall, start: float) -> dict[str, PlaceCourse]:
    """Where all that is no person was since a moment, or since what can be read at once, by newest id; read once."""
    return world.once(f"presence {start}", lambda: _read(world, start))


def course_of(world: Recall, name: str, start: float) -> PlaceCourse | None:
    """Where one object was since a moment, None where it was not seen: of few objects cheaper than `presence_of`."""
    whole = world.kept.get(f"presence {start}")
    if isinstance(whole, dict):
        return whole.get(name)
    return world.once(f"course {name} {start}", lambda: _of_one(world, name, start))


def _of_one(world: Recall, name: str, start: float) -> PlaceCourse | None:
    if world.store is None:
        return _of_line(world.timeline(name))
    rows: list[Sight] = []
    for known in world.names_of(name):
        rows += [row[:6] for row in world.store.sights(known, world.epoch, start, again=False)]
    return courses_of_rows(world.store, {name: rows}, world.words, world.present, start).get(name)


def _read(world: Recall, start: float) -> dict[str, PlaceCourse]:
    if world.store is not None:
        return courses_of(
            world.store, world.words, world.present, start, lambda name: world.individual(name)[0]
        )
    courses = {name: _of_line(world.timeline(name)) for name in world.things()}
    return {name: course for name, course in courses.items() if course is not None}


def _of_line(line: Timeline) -> PlaceCourse | None:
    stamps: list[float] = []
    places: list[str | None] = []
    for stay in line.stays:
        stamps.append(stay.since)
        places.append(stay.place)
        if stay.gone and stay.left_by is not None:
            stamps.append(stay.left_by)
            places.append(None)
    return PlaceCourse.of(stamps, places, line.stays[-1].until) if line.stays else None
