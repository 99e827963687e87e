"""Where movers are predicted to go: what a motion predictor says, as the world model takes it (chapters 2 and 4)."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any, Protocol

import numpy as np

from estimation.checks import FloatArray, as_finite
from estimation.errors import InputError
from world_model.state import WorldObject

UNSURE = 0.25  # m per second: how uncertain a path grows whose predictor does not say it
SAME_PLACE = 1.0  # m: a path without a name is that of a mover this near to its beginning


class Course(Protocol):
    """How one object goes on, weighed against its going straight on: a member of the set M of section 2.4.2."""

    @property
    def end(self) -> float:
        """Stamp from which it says nothing, s."""

    def step(self, begin: float, stamp: float) -> tuple[FloatArray, FloatArray, FloatArray]:
        """Displacement (3,), growth of the covariance (3, 3) and velocity at the end (3,) between two stamps."""


Behavior = Callable[[WorldObject, float], Course | None]
"""Of a class: the course of an object as it was last shown, from a stamp on; None where it has none."""


@dataclass(frozen=True)
class Path:
    """points (T, 3) : x, y in m and stamp in s, ascending, T at least 2. covariances (T, 2, 2) m²."""

    points: FloatArray
    covariances: FloatArray

    @classmethod
    def checked(cls, name: str, given: Any) -> Path:
        """From (T, 3) x, y, t, from a mapping or from anything with `path` and `covariances`.

        Raises InputError naming what is wrong.
        """
        if isinstance(given, Path):
            return given
        points, spread = given, None
        if isinstance(given, Mapping):
            points, spread = given.get("path"), given.get("covariances")
        elif hasattr(given, "path"):
            points, spread = given.path, getattr(given, "covariances", None)
        points = as_finite(f"{name}.path", points)
        if points.ndim != 2 or points.shape[1] != 3 or len(points) < 2:
            raise InputError(f"{name}.path must have shape (T, 3) with T at least 2, not {points.shape}")
        if (np.diff(points[:, 2]) <= 0.0).any():
            raise InputError(f"{name}.path: stamps must ascend")
        if spread is None:
            after = points[:, 2] - points[0, 2]
            return cls(points, (UNSURE * after[:, None, None]) ** 2 * np.eye(2))
        covariances = as_finite(f"{name}.covariances", spread)
        if covariances.shape != (len(points), 2, 2):
            raise InputError(
                f"{name}.covariances must have shape ({len(points)}, 2, 2), not {covariances.shape}"
            )
        return cls(points, covariances)

    @property
    def end(self) -> float:
        """Stamp from which it says nothing, s."""
        return float(self.points[-1, 2])

    def at(self, stamp: float) -> tuple[FloatArray, FloatArray, FloatArray]:
        """Position (2,), covariance (2, 2) and velocity (2,); straight back from the first point before it."""
        times = self.points[:, 2]
        k = min(max(int(np.searchsorted(times, stamp)) - 1, 0), len(times) - 2)
        seconds = times[k + 1] - times[k]
        velocity = (self.points[k + 1, :2] - self.points[k, :2]) / seconds
        share = min(max((stamp - times[k]) / seconds, 0.0), 1.0)
        position = self.points[k, :2] + velocity * (min(stamp, times[-1]) - times[k])
        covariance = (1.0 - share) * self.covariances[k] + share * self.covariances[k + 1]
        return position, covariance, velocity

    def step(self, begin: float, stamp: float) -> tuple[FloatArray, FloatArray, FloatArray]:
        """Displacement (3,), growth of the covariance (3, 3) and velocity at the end (3,) between two stamps."""
        before, covariance, _ = self.at(begin)
        after, grown, velocity = self.at(stamp)
        values, vectors = np.linalg.eigh(grown - covariance)
        growth = np.zeros((3, 3))
        growth[:2, :2] = (vectors * np.maximum(values, 0.0)) @ vectors.T
        return np.append(after - before, 0.0), growth, np.append(velocity, 0.0)


def checked_predictions(given: Any, objects: Iterable[WorldObject], stamp: float) -> dict[str, Path | None]:
    """Paths by id of object, None for one that is withdrawn.

    given : {id: path}, or paths without names, which belong to the movers nearest to where they are at `stamp`.
    Raises InputError naming the path.
    """
    if given is None:
        return {}
    if isinstance(given, Mapping):
        return {
            str(name): None if path is None else Path.checked(f"predictions[{name!r}]", path)
            for name, path in given.items()
        }
    if isinstance(given, str) or not isinstance(given, Sequence):
        raise InputError(
            f"predictions must be {{object id: path}} or a list of paths, not {type(given).__name__}"
        )
    paths = [Path.checked(f"predictions[{index}]", path) for index, path in enumerate(given)]
    movers = [
        item for item in objects if item.behaviors.get("constant_position", 0.0) < 0.5 and not item.lost
    ]
    pairs = sorted(
        (float(np.hypot(*(path.at(stamp)[0] - item.position[:2]))), index, item.id)
        for index, path in enumerate(paths)
        for item in movers
    )
    found: dict[str, Path | None] = {}
    used: set[int] = set()
    for apart, index, name in pairs:
        if apart < SAME_PLACE and index not in used and name not in found:
            found[name] = paths[index]
            used.add(index)
    return found
