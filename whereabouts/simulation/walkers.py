"""People who walk through waypoints, stand, and are seen by a planar laser as two legs or as a trunk."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
from numpy.typing import ArrayLike

from estimation.errors import InputError
from whereabouts.simulation.shapes import Array, Shapes, circle, joined, polygon, unit

BODIES = ("legs", "trunk", "skirt")
CORNERS = 16  # of the ellipse of a trunk
SWAY = 0.015  # metres a standing person moves about


@dataclass(frozen=True)
class Build:
    """What a laser sees of a person; metres.

    body : "legs" at knee height, "trunk" at waist height, "skirt" where the legs are inside one round outline.
    leg_radius, leg_gap : of a leg and between the middles of both. stride : from one footprint to the next.
    shoulders, chest : full width and depth of a trunk; a skirt is a circle of half the shoulders.
    """

    body: str = "legs"
    leg_radius: float = 0.065
    leg_gap: float = 0.22
    stride: float = 0.65
    shoulders: float = 0.45
    chest: float = 0.28

    def __post_init__(self) -> None:
        if self.body not in BODIES:
            raise InputError(f"body: one of {', '.join(BODIES)}, got {self.body!r}")


def random_build(rng: np.random.Generator, body: str = "legs") -> Build:
    """A person of any size."""
    return Build(
        body,
        rng.uniform(0.05, 0.09),
        rng.uniform(0.16, 0.3),
        rng.uniform(0.5, 0.75),
        rng.uniform(0.4, 0.55),
        rng.uniform(0.22, 0.34),
    )


@dataclass(frozen=True)
class SimulatedWalker:
    """A person who walks straight from waypoint to waypoint and rests at some.

    waypoints : (K, 2) metres. speed : m/s. start : seconds at which the walk begins. rests : (K,) seconds at each
    waypoint, zeros where left out. phase : radians, of the gait. Before and after the walk the person stands.
    """

    waypoints: Array
    speed: float = 1.2
    build: Build = field(default_factory=Build)
    start: float = 0.0
    rests: Array | None = None
    phase: float = 0.0

    def __post_init__(self) -> None:
        points = np.asarray(self.waypoints, dtype=np.float64)
        if points.ndim != 2 or points.shape[1] != 2 or len(points) < 1:
            raise InputError(f"waypoints: shape (K >= 1, 2) expected, got {points.shape}")
        rests = np.zeros(len(points)) if self.rests is None else np.asarray(self.rests, dtype=np.float64)
        lengths = np.linalg.norm(np.diff(points, axis=0), axis=1)
        times, walked = [self.start], [0.0]
        for k, length in enumerate([*lengths, 0.0]):
            times.append(times[-1] + rests[k])
            walked.append(walked[-1])
            if k < len(lengths):
                times.append(times[-1] + length / self.speed)
                walked.append(walked[-1] + length)
        object.__setattr__(self, "waypoints", points)
        object.__setattr__(self, "_times", np.array(times))
        object.__setattr__(self, "_walked", np.array(walked))
        object.__setattr__(self, "_marks", np.concatenate(([0.0], np.cumsum(lengths))))

    @property
    def duration(self) -> float:
        """Seconds at which the last waypoint is left."""
        return float(self._times[-1])  # type: ignore[attr-defined]

    def walked(self, time: float) -> float:
        """Metres walked until `time` seconds."""
        return float(np.interp(time, self._times, self._walked))  # type: ignore[attr-defined]

    def position(self, time: float) -> Array:
        """(2,) metres at `time` seconds."""
        return self.path(np.array([time]))[0]

    def path(self, times: Array) -> Array:
        """(T, 2) metres at `times` (T,) s."""
        along = np.interp(times, self._times, self._walked)  # type: ignore[attr-defined]
        marks = self._marks  # type: ignore[attr-defined]
        return np.stack([np.interp(along, marks, self.waypoints[:, k]) for k in range(2)], axis=1)

    def velocity(self, time: float) -> Array:
        """(2,) m/s at `time` seconds."""
        step = 1e-3
        return (self.position(time + step) - self.position(time - step)) / (2.0 * step)

    def heading(self, time: float) -> float:
        """Direction of walking, of the last leg walked while resting, radians."""
        along, marks = self.walked(time), self._marks  # type: ignore[attr-defined]
        if len(marks) < 2:
            return self.phase
        leg = int(np.clip(np.searchsorted(marks, along, side="left") - 1, 0, len(marks) - 2))
        ahead = self.waypoints[leg + 1] - self.waypoints[leg]
        return float(np.arctan2(ahead[1], ahead[0]))

    def shapes(self, time: float, owner: int) -> Shapes:
        """Outline at `time` seconds, belonging to `owner`."""
        build = self.build
        x, y = self.position(time)
        heading = self.heading(time)
        ahead = unit(heading)
        aside = np.array([-ahead[1], ahead[0]])
        if build.body == "skirt":
            return circle(x, y, 0.5 * build.shoulders).owned_by(owner)
        if build.body == "trunk":
            turn = 2.0 * np.pi * np.arange(CORNERS) / CORNERS
            ellipse = np.outer(np.cos(turn), 0.5 * build.chest * ahead)
            ellipse += np.outer(np.sin(turn), 0.5 * build.shoulders * aside)
            return polygon(np.array([x, y]) + ellipse).owned_by(owner)
        sway = SWAY * np.array([np.sin(1.1 * time + self.phase), np.cos(0.7 * time + self.phase)])
        swing = self._swing(time)
        legs = []
        for side in (1.0, -1.0):
            leg = np.array([x, y]) + side * (0.5 * build.leg_gap * aside + swing * ahead) + sway
            legs.append(circle(leg[0], leg[1], build.leg_radius))
        return joined(legs).owned_by(owner)

    def _swing(self, time: float) -> float:
        """How far the left leg is ahead of the middle: a planted foot stays where it is, the other one overtakes."""
        moving = np.linalg.norm(self.velocity(time)) > 0.05
        angle = self.phase + np.pi * self.walked(time) / self.build.stride
        # A rounded triangle wave: the planted foot moves back at nearly walking speed as the trunk sees it.
        wave = np.arcsin(0.95 * np.sin(angle)) / np.arcsin(0.95)
        return float((0.5 if moving else 0.15) * self.build.stride * 0.9 * wave)


def positions(walkers: list[SimulatedWalker], time: float) -> Array:
    """Where they are at `time` seconds, (P, 2) metres."""
    return np.array([walker.position(time) for walker in walkers]).reshape(-1, 2)


def wander(
    rng: np.random.Generator,
    room: Shapes,
    reach: tuple[float, float],
    duration: float,
    build: Build | None = None,
    speed: tuple[float, float] = (0.7, 1.4),
    rest: tuple[float, float] = (0.0, 4.0),
) -> SimulatedWalker:
    """Somebody who walks about for `duration` seconds, 0.5 m off every outline, within ±reach (x, y) metres."""

    def clear(a: ArrayLike, b: ArrayLike) -> bool:
        way = np.linspace(np.asarray(a), np.asarray(b), 12)
        return min(room.distance(spot) for spot in way) > 0.45

    here = np.zeros(2)
    for _ in range(300):
        here = rng.uniform(-1.0, 1.0, 2) * reach
        if room.distance(here) > 0.5:
            break
    points, rests, time, pace = [here], [0.0], 0.0, rng.uniform(*speed)
    for _ in range(2000):
        if time > duration:
            break
        there = rng.uniform(-1.0, 1.0, 2) * reach
        if np.linalg.norm(there - here) < 0.8 or not clear(here, there):
            continue
        pause = rng.uniform(*rest) if rng.random() < 0.4 else 0.0
        time += float(np.linalg.norm(there - here)) / pace + pause
        points.append(there)
        rests.append(pause)
        here = there
    return SimulatedWalker(
        np.array(points), pace, build or random_build(rng), 0.0, np.array(rests), rng.uniform(0, 6)
    )
