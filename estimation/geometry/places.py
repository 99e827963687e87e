"""Rooms and furniture as named polygons, read from one YAML file per home.

They give regions to what may be anywhere in a room, and words to where something is: "on the kitchen table, p = 0.68".
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt
import yaml

from estimation.checks import FloatArray, as_own, as_vectors, require_word
from estimation.errors import InputError
from estimation.filters.gaussians import repair_covariance
from estimation.geometry.polygons import (
    box_share,
    check_outline,
    gaussian_mass,
    interval_mass,
    points_inside,
    signed_area,
)

KINDS = ("room", "furniture")
LIKELY = 0.5  # From this probability on something is said to be at a piece of furniture rather than in a room
ANY_HEIGHT = (-np.inf, np.inf)


@dataclass(frozen=True)
class Place:
    """A room or a piece of furniture.

    polygon : (N, 2) m, corners in the map frame, counterclockwise. height : from, to in m: of what is in the room,
    or of what is on or in the furniture. type : what rooms or furniture of this sort are called ("kitchen").
    preposition : "on" the table, "in" the cupboard.

    Raises InputError: an outline that bounds no area, heights that do not ascend, names that are no words.
    """

    name: str
    polygon: FloatArray
    kind: str = "room"
    type: str = ""
    height: tuple[float, float] = ANY_HEIGHT
    preposition: str = "at"

    def __post_init__(self) -> None:
        if not isinstance(self.name, str) or not self.name:
            raise InputError(f"place: {self.name!r} is no name")
        for field_name in ("type", "preposition"):
            require_word(f"place {self.name!r}, {field_name}", getattr(self, field_name))
        object.__setattr__(self, "height", _pair(f"place {self.name!r}, height", self.height))
        if self.kind not in KINDS:
            raise InputError(
                f"place {self.name!r}, kind: one of {', '.join(KINDS)} expected, got {self.kind!r}"
            )
        outline = check_outline(f"place {self.name!r}, polygon", self.polygon)
        object.__setattr__(self, "polygon", outline)

    @classmethod
    def checked(cls, name: str, given: Mapping[str, Any]) -> Place:
        """From an entry of a file. Raises InputError naming place and field."""
        if not isinstance(given, Mapping):
            raise InputError(f"place {name!r} must be a mapping with a polygon, not {given!r}")
        unknown = set(given) - {"polygon", "kind", "type", "height", "preposition"}
        if unknown:
            raise InputError(f"place {name!r} has unknown fields: {', '.join(map(str, sorted(unknown)))}")
        if "polygon" not in given:
            raise InputError(f"place {name!r} has no polygon")
        usual = "in" if given.get("kind", "room") == "room" else "at"
        return cls(name, **{**given, "preposition": given.get("preposition") or usual})

    @property
    def area(self) -> float:
        """m²."""
        return signed_area(self.polygon)

    @property
    def spoken(self) -> str:
        """ "on the kitchen table"."""
        return f"{self.preposition} the {self.name.replace('_', ' ')}"

    @property
    def center(self) -> FloatArray:
        """(2,) m, centre of the bounding box."""
        return np.asarray(0.5 * (self.polygon.min(0) + self.polygon.max(0)))

    def contains(self, points: npt.ArrayLike) -> npt.NDArray[np.bool_]:
        """Whether points (..., 2 | 3), m, are inside; heights count where they are given."""
        given = as_vectors("points", points, 2, 3)
        inside = points_inside(self.polygon, given[..., :2])
        if given.shape[-1] == 3:
            inside &= (given[..., 2] >= self.height[0]) & (given[..., 2] <= self.height[1])
        return inside

    def probability(self, position: npt.ArrayLike, covariance: npt.ArrayLike) -> float:
        """That a Gaussian position (2 | 3,) with covariance (d, d), m and m², is inside; height is independent."""
        mean, cov = _gaussian(position, covariance)
        mass = float(gaussian_mass(self.polygon, [0], mean[:2], cov[:2, :2])[0])
        return mass if len(mean) == 2 else mass * interval_mass(*self.height, mean[2], cov[2, 2])

    def share(self, box: npt.ArrayLike) -> float:
        """Share of a box ((x0, x1), (y0, y1), (z0, z1)), m, that is inside: of something that may be anywhere in it."""
        return box_share(self.polygon, self.height, as_own("box", box, (2, 2), (3, 2)))


@dataclass(frozen=True)
class Places:
    """All places of a home by name. frame : that of all polygons. Falsy where there are none."""

    by_name: Mapping[str, Place] = field(default_factory=dict)
    frame: str = "map"

    @classmethod
    def from_mapping(cls, given: Mapping[str, Any]) -> Places:
        """From {"frame": "map", "places": {name: {"polygon": [[x, y], ...], "kind": ..., ...}}}.

        Raises InputError naming place and field.
        """
        if not isinstance(given, Mapping) or not isinstance(given.get("places"), Mapping):
            raise InputError("places: a mapping of names to polygons expected")
        unknown = set(given) - {"frame", "places"}
        if unknown:
            raise InputError(f"places: unknown fields {', '.join(map(str, sorted(unknown)))}")
        frame = given.get("frame", "map")
        if not isinstance(frame, str) or not frame:
            raise InputError(f"places: frame must be a name, not {frame!r}")
        named: dict[str, Place] = {}
        for name, entry in given["places"].items():
            named[name] = Place.checked(name, entry)
        return cls(named, frame.lstrip("/"))

    @classmethod
    def load(cls, path: str | Path) -> Places:
        """Read a YAML file. Raises InputError naming the file and what is wrong with it."""
        try:
            with Path(path).open(encoding="utf-8") as file:
                given = yaml.load(file, Loader=_UniqueKeys)
        except (OSError, UnicodeDecodeError, yaml.YAMLError) as error:
            raise InputError(f"{path}: cannot be read as places: {error}") from error
        try:
            return cls.from_mapping(given)
        except InputError as error:
            raise InputError(f"{path}: {error}") from error

    def __len__(self) -> int:
        return len(self.by_name)

    def __iter__(self) -> Iterator[Place]:
        return iter(self.by_name.values())

    def __contains__(self, name: object) -> bool:
        return name in self.by_name

    def __getitem__(self, name: str) -> Place:
        """The place of this name; InputError where there is none."""
        try:
            return self.by_name[name]
        except KeyError:
            known = ", ".join(self.by_name) or "none"
            raise InputError(f"unknown place {name!r}; known are {known}") from None

    @property
    def rooms(self) -> list[Place]:
        """In the order of the file."""
        return [place for place in self if place.kind == "room"]

    @property
    def furniture(self) -> list[Place]:
        """In the order of the file."""
        return [place for place in self if place.kind == "furniture"]

    def room_of(self, position: npt.ArrayLike) -> Place | None:
        """The smallest room around a position (2 | 3,), m; None outside of all."""
        point = as_own("position", position, (2,), (3,))[:2]
        around = [place for place in self.rooms if place.contains(point)]
        return min(around, key=lambda place: place.area) if around else None

    def probabilities(self, position: npt.ArrayLike, covariance: npt.ArrayLike) -> dict[str, float]:
        """Probability by name that a Gaussian position (2 | 3,), covariance (d, d), m and m², is at each place.

        Exact in the plane (Owen's T function along the edges); height is taken as independent of x and y.
        """
        if not self.by_name:
            return {}
        mean, cov = _gaussian(position, covariance)
        corners, starts = self._stacked
        masses = gaussian_mass(corners, starts, mean[:2], cov[:2, :2]).tolist()
        if len(mean) == 3:
            masses = [
                mass * interval_mass(*place.height, mean[2], cov[2, 2]) if mass > 0.0 else 0.0
                for mass, place in zip(masses, self, strict=True)
            ]
        return dict(zip(self.by_name, masses, strict=True))

    def shares(self, box: npt.ArrayLike) -> dict[str, float]:
        """Probability by name of something that may be anywhere in a box ((x0, x1), (y0, y1), (z0, z1)), m."""
        return {place.name: place.share(box) for place in self}

    def word(self, probabilities: Mapping[str, float]) -> tuple[str, float]:
        """Where to say that it is: likely furniture before the room around it, else the most probable room.

        Returns name and probability, ("", 0) where nothing is known.
        """
        for kind, least in (("furniture", LIKELY), ("room", 1e-6), ("furniture", 1e-6)):
            found = [place.name for place in self if place.kind == kind]
            best = max(found, key=lambda name: probabilities.get(name, 0.0), default="")
            probability = float(probabilities.get(best, 0.0))
            if probability > least:
                return best, probability
        return "", 0.0

    @cached_property
    def _stacked(self) -> tuple[FloatArray, list[int]]:
        """Corners of all polygons (V, 2), and where each begins."""
        outlines = [place.polygon for place in self]
        return np.concatenate(outlines), np.cumsum([0, *map(len, outlines[:-1])]).tolist()


class _UniqueKeys(yaml.SafeLoader):
    """YAML forbids a key given twice; PyYAML would keep the last one silently."""

    def construct_mapping(self, node: Any, deep: bool = False) -> dict[Any, Any]:
        keys = [self.construct_object(key, deep=deep) for key, _ in node.value]
        twice = next((key for index, key in enumerate(keys) if key in keys[:index]), None)
        if twice is not None:
            raise yaml.YAMLError(f"{twice!r} is given twice, line {node.start_mark.line + 1} and after")
        return dict(super().construct_mapping(node, deep=deep))


def _pair(name: str, given: Any) -> tuple[float, float]:
    try:
        low, high = (float(value) for value in given)
    except (TypeError, ValueError):
        raise InputError(f"{name}: [from, to] in m expected, got {given!r}") from None
    if not low < high:
        raise InputError(f"{name}: [from, to] ascending expected, got {given!r}")
    return low, high


def _gaussian(position: npt.ArrayLike, covariance: npt.ArrayLike) -> tuple[FloatArray, FloatArray]:
    mean = as_own("position", position, (2,), (3,))
    cov = as_own("covariance", covariance, (len(mean), len(mean)))
    return mean, repair_covariance(cov, definite=False)
