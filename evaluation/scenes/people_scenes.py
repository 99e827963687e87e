"""Scenes with people and a laser, and the truth about them: crossings, people hidden, rooms full of them."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass, field, replace
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from registration.laser.scan import Scan
from whereabouts.simulation.lidar import Lidar
from whereabouts.simulation.movers import outlines
from whereabouts.simulation.robot import Drive
from whereabouts.simulation.rooms import random_floor, random_room
from whereabouts.simulation.shapes import Array, Shapes, circle, joined, polygon, unit
from whereabouts.simulation.walkers import SimulatedWalker, positions, random_build, wander

SCANNER = Lidar(beams=361, opening=np.pi, range_max=12.0, sigma=0.01)


@dataclass(frozen=True)
class PeopleScan:
    """One scan of a scene.

    pose : (3,) of the scanner. people : (P, 2) m. returns : (P,) beams that hit each. in_view : (P,) whether each is
    within the scanner's range and opening, hidden or not.
    """

    scan: Scan
    pose: Array
    people: Array
    returns: NDArray[np.int64]
    in_view: NDArray[np.bool_]


@dataclass(frozen=True)
class PeopleScene:
    """Outlines, people, a scanner and how it moves: `pose` (3,) or a function of time that gives it.

    things : what stands about on open floor and may be taken for somebody.
    """

    room: Shapes
    people: list[SimulatedWalker]
    duration: float
    lidar: Lidar = SCANNER
    pose: Array | Callable[[float], Array] = field(default_factory=lambda: np.zeros(3))
    rate: float = 10.0
    things: Shapes = field(default_factory=Shapes)

    @property
    def standing(self) -> NDArray[np.bool_]:
        """Who walks less than a metre in all, (P,)."""
        return np.array([person.walked(np.inf) < 1.0 for person in self.people], dtype=bool)

    def scans(self, rng: np.random.Generator) -> Iterator[PeopleScan]:
        """The scene, scan by scan."""
        for k in range(int(self.duration * self.rate) + 1):
            time = k / self.rate
            shapes = joined([self.room, self.things, outlines(self.people, time)])
            # A scanner that needs no time for a sweep is in one place.
            still = callable(self.pose) and self.lidar.sweep_time == 0.0
            pose = self.pose(time) if still and callable(self.pose) else self.pose
            simulated = self.lidar.scan(shapes, pose, rng, time)
            people = positions(self.people, time)
            returns = np.array(
                [np.sum(simulated.owners == i + 1) for i in range(len(people))], dtype=np.int64
            )
            away = people - simulated.pose[:2]
            bearing = np.arctan2(away[:, 1], away[:, 0]) - simulated.pose[2]
            bearing = np.abs((bearing + np.pi) % (2.0 * np.pi) - np.pi)
            distance = np.hypot(away[:, 0], away[:, 1])
            in_view = (bearing < 0.5 * self.lidar.opening - 0.05) & (distance < 0.95 * self.lidar.range_max)
            yield PeopleScan(simulated.scan, simulated.pose, people, returns, in_view)


def crossing(rng: np.random.Generator, body: str = "legs") -> PeopleScene:
    """Two people whose ways cross 2 to 5 m away, 0.4 to 0.9 m apart at the closest (trunks 0.7 to 1 m)."""
    middle = np.array([rng.uniform(2.0, 5.0), rng.uniform(-1.0, 1.0)])
    heading = rng.uniform(-np.pi, np.pi)
    angle = rng.uniform(np.deg2rad(40.0), np.pi)
    people = []
    ways = [heading, heading + angle]
    speeds = rng.uniform(0.8, 1.4, 2)
    # Passing at a distance of `gap`: the second is late, or off to the side where they meet head on.
    gap = rng.uniform(0.4, 0.9) if body == "legs" else rng.uniform(0.7, 1.0)
    relative = speeds[0] * unit(ways[0]) - speeds[1] * unit(ways[1])
    aside = np.array([-relative[1], relative[0]]) / np.linalg.norm(relative)
    for k, way in enumerate(ways):
        offset = gap * aside * (0.5 if k == 0 else -0.5)
        before, after = 2.5 * speeds[k], 2.5 * speeds[k]
        ends = np.array([middle + offset - before * unit(way), middle + offset + after * unit(way)])
        people.append(
            SimulatedWalker(ends, speeds[k], random_build(rng, body), 0.5, phase=rng.uniform(0.0, 6.0))
        )
    return PeopleScene(_around(people, rng), people, 6.0)


def hidden(rng: np.random.Generator, behind: str = "pillar", body: str = "legs") -> PeopleScene:
    """Somebody walks behind a "pillar" or a "person" (who stands) and is wholly hidden for 1.4 to 2.2 s."""
    bearing, near = rng.uniform(-0.4, 0.4), rng.uniform(1.6, 2.4)
    speed, far = rng.uniform(0.6, 1.1), rng.uniform(3.5, 5.0)
    build = random_build(rng, body)
    wide = 0.5 * (build.stride + 0.2)
    # The shadow is as wide, where he walks, as a second and a bit of walking and his own stride.
    half_shadow = 0.5 * rng.uniform(1.1, 1.6) * speed + wide
    size = near * half_shadow / np.hypot(far, half_shadow)
    centre = near * unit(bearing)
    across = unit(bearing + 0.5 * np.pi) * rng.choice([-1.0, 1.0])
    spot = far * unit(bearing)
    length = 2.2 * max(speed, 0.8) + half_shadow
    begin = 1.6 if behind == "person" else 0.5
    way = np.array([spot - length * across, spot + length * across])
    people = [SimulatedWalker(way, speed, build, begin, phase=rng.uniform(0.0, 6.0))]
    obstacles: list[Shapes] = []
    if behind == "person":
        # Comes from the side, and stands there for the rest of the scene.
        big = replace(random_build(rng, "skirt"), shoulders=2.0 * size)
        from_aside = np.array([centre - 1.2 * unit(bearing + 0.5 * np.pi), centre])
        people.append(SimulatedWalker(from_aside, 1.0, big))
    else:
        obstacles = [circle(centre[0], centre[1], size)]
    return PeopleScene(joined([_around(people, rng), *obstacles]), people, people[0].duration + 0.5)


def crowded_room(
    rng: np.random.Generator, count: int = 4, moving: bool = False, duration: float = 20.0, body: str = "legs"
) -> PeopleScene:
    """`count` people who walk and rest in a furnished room with pillars; the scanner sees all around, or drives."""
    room = random_room(rng)
    lidar = Lidar(beams=720, opening=2.0 * np.pi * 719 / 720, range_max=12.0, sigma=0.01)
    spots = [spot for spot in rng.uniform(-2.5, 2.5, (200, 2)) if room.distance(spot) > 0.8]
    start = spots[0] if spots else np.zeros(2)
    pose: Array | Callable[[float], Array] = np.array([*start, rng.uniform(-np.pi, np.pi)])
    if moving:
        way = [start]
        for spot in spots[1:]:
            line = np.linspace(way[-1], spot, 10)
            if np.linalg.norm(spot - way[-1]) > 1.0 and min(room.distance(point) for point in line) > 0.5:
                way.append(spot)
        pose = Drive(np.array(way if len(way) > 1 else [start, start + 0.3]), 0.4)
    people: list[SimulatedWalker] = []
    keep = joined([room, circle(start[0], start[1], 0.3)])
    times = np.arange(0.0, duration, 0.2)
    robot = np.array([(pose(time) if callable(pose) else pose)[:2] for time in times])
    while len(people) < count:
        # People do not walk through each other, nor through the robot.
        for _ in range(40):
            walker = wander(rng, keep, (4.0, 3.5), duration, random_build(rng, body))
            path = walker.path(times)
            lines = [robot, *(other.path(times) for other in people)]
            if min(np.linalg.norm(path - line, axis=1).min() for line in lines) > 0.6:
                break
        people.append(walker)
    return PeopleScene(room, people, duration, lidar, pose)


def empty_floor(rng: np.random.Generator, rooms: int = 3, duration: float = 60.0) -> PeopleScene:
    """A robot that drives through furnished rooms along a corridor: chairs, tables, bins, poles, and nobody."""
    return _furnished_floor(rng, rooms, duration)[0]


def _furnished_floor(
    rng: np.random.Generator, rooms: int, duration: float
) -> tuple[PeopleScene, list[Array]]:
    """A floor without people, and the middles (2,) of its rooms."""
    floor, way = random_floor(rng, rooms)
    # The way turns round in the middle of each room.
    middles = [b for a, b, c in zip(way, way[1:], way[2:], strict=False) if np.allclose(a, c)]
    things: list[Shapes] = []
    path = np.concatenate([np.linspace(a, b, 20) for a, b in pairwise(way)])
    for room in middles:
        for spot in room + rng.uniform(-3.0, 3.0, (8, 2)):
            alone = [floor, *things]
            if np.linalg.norm(path - spot, axis=1).min() > 1.1 and joined(alone).distance(spot) > 1.0:
                things.append(_thing(rng, spot))
    return PeopleScene(floor, [], duration, SCANNER, Drive(way, 0.5), things=joined(things)), middles


def _thing(rng: np.random.Generator, spot: Array) -> Shapes:
    """A chair or a table, of which the legs are seen, a bin or a pole."""
    kind = str(rng.choice(["chair", "chair", "table", "bin", "pole"]))
    if kind in ("bin", "pole"):
        size = rng.uniform(0.03, 0.07) if kind == "pole" else rng.uniform(0.1, 0.2)
        return circle(spot[0], spot[1], size)
    length, width = (0.42, 0.42) if kind == "chair" else rng.uniform((0.8, 0.6), (1.4, 0.8))
    corners = 0.5 * np.array([[-length, -width], [length, -width], [length, width], [-length, width]])
    legs = joined([circle(x, y, rng.uniform(0.012, 0.035)) for x, y in corners])
    return legs.moved((*spot, rng.uniform(-np.pi, np.pi)))


def peopled_floor(
    rng: np.random.Generator, most: int = 12, duration: float = 60.0, standing: float = 0.4
) -> PeopleScene:
    """A robot that drives through rooms with up to `most` people, of whom a share `standing` stands all the time.

    The rooms are those of `empty_floor`, the scanner looks ahead. Legs are seen, of one in four a skirt. Walkers go to
    and fro and rest at the ends. Nobody comes nearer than 0.6 m to anybody or to the robot, or 0.45 m to an outline.
    """
    return with_people(rng, *_furnished_floor(rng, 3, duration), most, standing)


def with_people(
    rng: np.random.Generator, scene: PeopleScene, rooms: list[Array], most: int, standing: float
) -> PeopleScene:
    """A scene with up to `most` people about the middles (2,) of the rooms that the robot comes near."""
    assert callable(scene.pose)
    duration = scene.duration
    times = np.arange(0.0, duration, 0.2)
    robot = np.array([scene.pose(time)[:2] for time in times])
    visited = [room for room in rooms if np.linalg.norm(robot - room, axis=1).min() < 5.0]
    solid = joined([scene.room, scene.things])
    people: list[SimulatedWalker] = []
    taken = [robot]
    walking = most - round(standing * most)
    for _ in range(100 * most):
        build = random_build(rng, str(rng.choice(["legs", "legs", "legs", "skirt"])))
        spot = visited[int(rng.integers(len(visited)))] + rng.uniform(-3.0, 3.0, 2)
        points, rests = spot[None], np.zeros(1)
        if len(people) < walking:
            other = spot + rng.uniform(2.0, 5.0) * unit(rng.uniform(-np.pi, np.pi))
            points = np.array([spot, other] * 12)
            rests = rng.uniform(0.0, 3.0, len(points))
        line = np.linspace(points[0], points[-1], 15)
        if min(solid.distance(place) for place in line) < 0.45:
            continue
        walker = SimulatedWalker(points, rng.uniform(0.7, 1.4), build, 0.0, rests, rng.uniform(0.0, 6.0))
        path = walker.path(times)
        if min(np.linalg.norm(path - other, axis=1).min() for other in taken) < 0.6:
            continue
        people.append(walker)
        taken.append(path)
        if len(people) == most:
            break
    return replace(scene, people=people)


def _around(people: list[SimulatedWalker], rng: np.random.Generator) -> Shapes:
    """Walls a metre outside of all ways and of the scanner."""
    points = np.concatenate([np.zeros((1, 2)), *(walker.waypoints for walker in people)])
    low, high = points.min(0) - rng.uniform(0.8, 2.0, 2), points.max(0) + rng.uniform(0.8, 2.0, 2)
    return polygon([[low[0], low[1]], [high[0], low[1]], [high[0], high[1]], [low[0], high[1]]])
