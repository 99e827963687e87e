"""Plain scenes in which people get wholly hidden: behind pillars, screens and each other, in rooms and in the open.

`occlusions` draws them at random; in `to_and_fro` people walk given routes and turn round at the ends.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field

import numpy as np

from evaluation.scenes.people_scenes import PeopleScene
from whereabouts.simulation.lidar import Lidar
from whereabouts.simulation.robot import Drive
from whereabouts.simulation.shapes import Array, Shapes, box, circle, joined, polygon, unit
from whereabouts.simulation.walkers import Build, SimulatedWalker, random_build, wander

LAYOUTS = ("pillars", "screens", "open", "pillars in the open")
MOTIONS = ("straight", "rounds", "waypoints")
BODIES = ("round", "legs", "trunk")
Route = list[tuple[float, float]]


@dataclass(frozen=True)
class Plan:
    """A room of 13 m by 11 m. routes : of the people. pillars : x, y, radius. walls : from x, y to x, y; metres.

    lidar : the scanner, at 10 Hz. drives : whether the robot drives round a square of 2 m.
    """

    routes: tuple[Route, ...]
    pillars: tuple[tuple[float, float, float], ...] = ()
    walls: tuple[Route, ...] = ()
    lidar: Lidar = field(default_factory=lambda: Lidar(720, 2.0 * np.pi * 719 / 720, 0.05, 12.0, 0.01))
    drives: bool = False


PLANS = {
    "pillars": Plan(
        ([(3.6, -3.5), (3.6, 3.5)], [(-4, 3.4), (2.6, 3.4)], [(-3, -3.5), (2, -2)]),
        pillars=((2.0, 0.0, 0.35), (-1.0, 2.2, 0.35)),
        lidar=Lidar(811, 1.5 * np.pi, 0.05, 12.0, 0.01),
    ),
    "walls": Plan(
        (
            [(3.5, -2.4), (3.5, 3.0)],
            [(-4.5, 3.9), (4.0, 3.9)],
            [(-4.0, -2.5), (4.0, -3.4)],
            [(1.2, -2.2), (1.2, 3.0)],
        ),
        walls=([(2.0, -0.6), (2.0, 0.6)], [(-1.5, 2.0), (0.5, 2.0)]),
        lidar=Lidar(720, 2.0 * np.pi * 719 / 720, 0.05, 12.0, 0.02),
    ),
    "people": Plan(
        (
            [(2.0, -2.5), (2.0, 2.5)],
            [(4.0, 3.0), (4.0, -3.0)],
            [(-2.0, 3.0), (-2.2, -3.0)],
            [(-4.0, -3.5), (-4.0, 3.5)],
        ),
        lidar=Lidar(360, 2.0 * np.pi * 359 / 360, 0.05, 12.0, 0.01),
    ),
    "robot drives": Plan(
        (
            [(5.0, -4.0), (5.0, 4.0), (-1.0, 4.0)],
            [(-5.0, 4.0), (-5.0, -4.0), (2.0, -4.0)],
            [(3.5, -1.0), (3.8, 3.0), (-3.5, 3.0)],
        ),
        pillars=((2.5, 1.5, 0.3), (-2.5, 1.5, 0.3), (0.0, -2.5, 0.3)),
        walls=([(3.0, -2.5), (4.5, -2.5)], [(-4.0, -1.5), (-4.0, 0.5)]),
        drives=True,
    ),
}
APART = 0.75  # metres between the middles of people, and between them and the robot
CLEAR = 0.35  # metres from the middle of a person to an outline


@dataclass(frozen=True)
class OcclusionKind:
    """layout : what hides people. motion : how they walk. body : how they are seen. drives : whether the robot does."""

    layout: str = "pillars"
    motion: str = "straight"
    body: str = "round"
    drives: bool = False

    def __str__(self) -> str:
        return f"{self.layout}, {self.motion}, {self.body}, robot {'drives' if self.drives else 'stands'}"


def occlusions(rng: np.random.Generator, kind: OcclusionKind, duration: float = 20.0) -> PeopleScene:
    """Two to four people who walk about for `duration` seconds and are hidden now and then.

    The scanner has 180 to 1081 beams, 10 to 40 Hz and 1 to 3 cm of noise; it stands, or drives at 0.3 to 0.6 m/s.
    """
    lidar, rate = _scanner(rng, kind.drives)
    all_round = lidar.opening > 1.6 * np.pi
    room = _room(rng, kind.layout, all_round)
    pose: Array | Callable[[float], Array] = np.zeros(3)
    if kind.drives:
        pose = _drive(rng, room)
    times = np.arange(0.0, duration, 0.1)
    taken = [np.array([(pose(time) if callable(pose) else pose)[:2] for time in times])]
    people: list[SimulatedWalker] = []
    count = int(rng.integers(2, 5))
    for _ in range(400):
        walker = _walker(rng, kind, room, all_round, duration)
        path = walker.path(times)
        if min(np.linalg.norm(path - other, axis=1).min() for other in taken) < APART:
            continue
        if min(room.distance(spot) for spot in path[::3]) < CLEAR:
            continue
        people.append(walker)
        taken.append(path)
        if len(people) == count:
            break
    return PeopleScene(room, people, duration, lidar, pose, rate)


def to_and_fro(
    rng: np.random.Generator, name: str, body: str = "round", duration: float = 30.0
) -> PeopleScene:
    """People who walk the routes of one of the `PLANS` to and fro, at 0.7 to 1.2 m/s, for `duration` seconds."""
    plan = PLANS[name]
    parts = [box(13.0, 11.0)]
    parts += [circle(*pillar) for pillar in plan.pillars]
    parts += [polygon(np.array(wall), closed=False) for wall in plan.walls]
    people = []
    for route in plan.routes:
        speed, points = rng.uniform(0.7, 1.2), np.array(route, dtype=np.float64)
        start = points[0] + rng.uniform(0.0, 1.0) * (points[1] - points[0])
        turns = 1 + int(duration * speed / np.linalg.norm(np.diff(points, axis=0), axis=1).sum())
        way = [start[None], points[1:], *((points[-2::-1], points[1:])[k % 2] for k in range(turns + 1))]
        people.append(
            SimulatedWalker(np.concatenate(way), speed, _build(rng, body), phase=rng.uniform(0.0, 6.0))
        )
    square = np.array([[-1.0, -1.0], [1.0, -1.0], [1.0, 1.0], [-1.0, 1.0]])
    pose = Drive(np.concatenate([square] * 4), 0.4) if plan.drives else np.zeros(3)
    return PeopleScene(joined(parts), people, duration, plan.lidar, pose)


def one_hardly_moves(rng: np.random.Generator, duration: float = 20.0) -> PeopleScene:
    """Three round people who walk to and fro and one who goes 0.4 m in `duration` seconds, on an empty floor.

    The scanner stands and looks ahead. Of the ways drawn, those are taken on which somebody is wholly hidden for half a
    second in all.
    """
    times = np.arange(0.0, duration, 0.1)
    kind = OcclusionKind("open", "straight")
    while True:
        bearing, away = rng.uniform(-0.8, 0.8), rng.uniform(2.0, 5.0)
        spot, way = away * unit(bearing), unit(rng.uniform(-np.pi, np.pi))
        slow = SimulatedWalker(
            np.array([spot - 0.2 * way, spot + 0.2 * way]), 0.4 / duration, _build(rng, "round")
        )
        people = [slow]
        paths = [slow.path(times)]
        for _ in range(100):
            walker = _walker(rng, kind, Shapes(), False, duration)
            path = walker.path(times)
            if min(np.linalg.norm(path - other, axis=1).min() for other in [*paths, 0.0 * path]) < APART:
                continue
            people.append(walker)
            paths.append(path)
            if len(people) == 4:
                break
        scene = PeopleScene(Shapes(), [*people[1:], people[0]], duration)
        hidden = sum(int((scan.in_view & (scan.returns == 0)).sum()) for scan in scene.scans(rng))
        if len(people) == 4 and hidden >= 0.5 * scene.rate:
            return scene


def _scanner(rng: np.random.Generator, drives: bool) -> tuple[Lidar, float]:
    """Scanners one meets: (the scanner, Hz). One that looks ahead only would lose people by driving."""
    choices = [
        (181, 1.0, 10.0),
        (361, 1.0, 25.0),
        (541, 1.5, 40.0),
        (1081, 1.5, 40.0),
        (360, 2.0, 10.0),
        (720, 2.0, 15.0),
    ]
    beams, half_turns, rate = choices[int(rng.integers(4 if drives else 0, len(choices)))]
    opening = half_turns * np.pi * (1.0 if half_turns < 2.0 else (beams - 1) / beams)
    sigma = float(rng.choice([0.01, 0.02, 0.03]))
    return Lidar(int(beams), opening, 0.05, float(rng.choice([12.0, 30.0])), sigma), float(rate)


def _room(rng: np.random.Generator, layout: str, all_round: bool) -> Shapes:
    parts: list[Shapes] = []
    if layout in ("pillars", "screens"):
        shift = 0.0 if all_round else 4.0
        parts.append(box(rng.uniform(12.0, 15.0), rng.uniform(10.0, 13.0), (shift, 0.0, 0.0)))
    spread = np.pi if all_round else 0.35 * np.pi
    if layout.startswith("pillars"):
        for bearing in rng.uniform(-spread, spread, int(rng.integers(3, 6))):
            spot = rng.uniform(1.7, 3.0) * unit(bearing)
            parts.append(circle(spot[0], spot[1], rng.uniform(0.15, 0.4)))
    if layout == "screens":
        bearing, away = rng.uniform(-0.4 * spread, 0.4 * spread), rng.uniform(2.0, 3.0)
        middle, along = away * unit(bearing), unit(bearing + 0.5 * np.pi)
        gap = 0.5 * rng.uniform(0.9, 1.4)
        for side in (1.0, -1.0):
            ends = middle + side * np.array([gap, gap + rng.uniform(0.6, 1.2)])[:, None] * along
            parts.append(polygon(ends, closed=False))
    return joined(parts) if parts else Shapes()


def _drive(rng: np.random.Generator, room: Shapes) -> Drive:
    """To and fro near the middle."""
    for _ in range(200):
        ends = rng.uniform(-2.2, 2.2, (2, 2))
        line = ends[0] + np.linspace(0.0, 1.0, 20)[:, None] * (ends[1] - ends[0])
        if np.linalg.norm(ends[1] - ends[0]) > 1.5 and (
            not len(room.segments) + len(room.circles) or min(room.distance(spot) for spot in line) > 0.5
        ):
            break
    return Drive(np.array([*ends, *ends, *ends]), rng.uniform(0.3, 0.6))


def _build(rng: np.random.Generator, body: str) -> Build:
    if body != "round":
        return random_build(rng, body)
    return Build("skirt", shoulders=2.0 * rng.uniform(0.2, 0.3))


def _walker(
    rng: np.random.Generator, kind: OcclusionKind, room: Shapes, all_round: bool, duration: float
) -> SimulatedWalker:
    """Somebody; whether the way is free is not looked at."""
    build, speed, phase = _build(rng, kind.body), rng.uniform(0.5, 1.3), rng.uniform(0.0, 6.0)
    if kind.motion == "waypoints":
        walker = wander(rng, room, (4.8, 4.2), duration, build, (speed, speed), (0.0, 1.5))
        if all_round:
            return walker
        return SimulatedWalker(
            walker.waypoints + np.array([4.0, 0.0]), speed, build, 0.0, walker.rests, phase
        )
    if kind.motion == "rounds":
        axes, turn = rng.uniform(1.4, 4.5, 2), rng.choice([-1.0, 1.0])
        centre = np.zeros(2) if all_round else np.array([axes[0] + 1.0, 0.0])
        angles = rng.uniform(-np.pi, np.pi) + turn * np.linspace(0.0, 8.0 * np.pi, 192)
        return SimulatedWalker(
            centre + axes * np.column_stack((np.cos(angles), np.sin(angles))), speed, build, phase=phase
        )
    bearing = rng.uniform(-np.pi, np.pi) if all_round else rng.uniform(-0.9, 0.9)
    middle, way = rng.uniform(1.2, 4.8) * unit(bearing), unit(bearing + rng.uniform(0.25, 0.75) * np.pi)
    reach = rng.uniform(2.0, 5.0)
    ends = [middle - reach * way, middle + reach * way]
    points = np.array([ends[k % 2] for k in range(2 + int(speed * duration / (2.0 * reach)))])
    if not all_round:
        points[:, 0] = np.maximum(points[:, 0], 0.6 + 0.25 * np.abs(points[:, 1]))
    return SimulatedWalker(points, speed, build, phase=phase)
