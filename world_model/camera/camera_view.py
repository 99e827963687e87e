"""What would have been detected if it were there: in the image, not hidden, and large enough to be recognised.

This is the probability of detection of (2.10) as geometry gives it: an object that is not reported counts as missed
only as far as it could be seen. Where the depth image has a hole, nobody knows, and nothing is concluded.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from functools import cached_property
from typing import Any

import numpy as np

from estimation.checks import FloatArray
from estimation.geometry.rotations import wrap_angle
from world_model.camera.boxes import ImageBox
from world_model.camera.depth import DepthImage, LevelScan
from world_model.camera.lens import CameraModel
from world_model.camera.rates import SightRates
from world_model.state import SURE, WorldObject

SIZE = 0.1  # m: of things whose size nobody measured. Small: less is concluded then.
NEAR = 0.2  # m: nearer nothing is recognised
FARTHEST = 30.0  # m
AROUND = 8
SHARE, SPREAD = 0.25, 1.5
"""How far beside an object's middle is looked as well: of its size, and of the deviation of its position."""
SLACK, FRONT, SURELY = 0.02, 0.3, 2.5
"""m, share of its size, and deviations (its position's and the depth's): what is in front of the middle of an object by
less than these together does not hide it."""
LEAST, FULL = 0.5, 0.9  # Shares of an object in view that say nothing, and all, about its absence
IN_VIEW = 0.6  # Probability of having been in view from which on a look says how good the detector is
KNOWN = 5  # Of all samples; fewer with a depth say nothing


@dataclass(frozen=True)
class CameraView:
    """One image: camera, its pose (4, 4) in the world (optical frame), and what tells about hiding.

    pose_covariance (3, 3), origin (2,) : of the robot's x, y, yaw, and where it stands; doubt about the pose blurs what
    was in view. rates : how well the detector finds what is in view, learned with every look. taken : boxes of
    detections that could not be placed: whatever is there may be what was detected. turned : (4, 4) from the camera
    to where it was when `depth` was taken; None where that is the same. name : of the camera, where there are several.
    """

    camera: CameraModel
    pose: FloatArray
    depth: DepthImage | None = None
    scan: LevelScan | None = None
    pose_covariance: FloatArray | None = None
    origin: FloatArray | None = None
    rates: SightRates = field(default_factory=SightRates)
    taken: tuple[ImageBox, ...] = ()
    turned: FloatArray | None = None
    name: str = ""

    def seen(self, positions: FloatArray, sigmas: FloatArray, sizes: FloatArray) -> FloatArray:
        """Probability (N,) that objects would have been in the picture, whole and large enough.

        positions (N, 3) m, world. sigmas (N,) m, of these. sizes (N,) m; NaN where unknown.
        """
        return self.visible(positions, sigmas, sizes) * self.recognisable(positions, sizes)

    def visible(self, positions: FloatArray, sigmas: FloatArray, sizes: FloatArray) -> FloatArray:
        """Probability (N,) that objects would have been in the picture and unhidden; arguments as of `seen`."""
        if len(positions) == 0:
            return np.zeros(0)
        size = np.where(np.isfinite(sizes), sizes, SIZE)
        spread = np.hypot(sigmas, self._doubt(positions))
        reach = SHARE * size + SPREAD * spread
        samples = (positions[:, None, :] + reach[:, None, None] * self._beside[None]).reshape(-1, 3)
        seen, known = self._unhidden(samples, *np.repeat([size, spread], AROUND + 1, axis=1))
        seen, known = (each.reshape(-1, AROUND + 1) for each in (seen, known))
        total = known.sum(1) * ~self._taken(positions, spread)
        share = np.where(total >= KNOWN, seen.sum(1) / np.maximum(total, 1), 0.0)
        return np.clip((share - LEAST) / (FULL - LEAST), 0.0, 1.0)

    def recognisable(self, positions: FloatArray, sizes: FloatArray) -> FloatArray:
        """Probability (N,) that a detector recognises something as small as it appears."""
        return self.rates.recognisable(self.apparent(positions, sizes))

    def apparent(self, positions: FloatArray, sizes: FloatArray) -> FloatArray:
        """Apparent size (N,) of objects, pixels."""
        size = np.where(np.isfinite(sizes), sizes, SIZE)
        away = np.maximum(np.linalg.norm(positions - self.pose[:3, 3], axis=1), NEAR)
        return self.camera.fx * size / away

    def learn(
        self, objects: Sequence[WorldObject], found: Sequence[str | None], said: Sequence[Mapping[str, float]]
    ) -> None:
        """How the detector did: objects believed in, whose each detection (M,) was, and its class distribution."""
        self.rates.forget(item.id for item in objects if item.lost)
        resting = [item for item in objects if item.behaviors.get("constant_position", 0.0) > SURE]
        if resting:
            positions = np.array([item.position for item in resting])
            sigmas = np.sqrt(np.array([np.max(np.diagonal(item.covariance)) for item in resting]))
            sizes = np.array([item.quantities.get("size", (np.nan, 0.0))[0] for item in resting])
            clear = self.visible(positions, sigmas, sizes) > IN_VIEW
            surely = [item for item, good in zip(resting, clear.tolist(), strict=True) if good]
            self.rates.look(surely, self.apparent(positions, sizes)[clear], found, self.name)
        self.rates.name(objects, {name: given for name, given in zip(found, said, strict=True) if name})

    def cells(self, centres: FloatArray, heights: FloatArray, size: float) -> FloatArray:
        """Share (N,) of the heights at places (N, 2) where a thing of that size, m, would have been detected."""
        size = size if np.isfinite(size) else SIZE
        points = np.concatenate([np.column_stack([centres, np.full(len(centres), z)]) for z in heights])
        seen, known = self._unhidden(points, np.full(len(points), size), np.zeros(len(points)))
        seen &= known & ~self._taken(points, np.zeros(len(points)))
        chance = seen * self.recognisable(points, np.full(len(points), size))
        return chance.reshape(len(heights), -1).mean(0)

    def density(self, positions: FloatArray, covariances: FloatArray) -> FloatArray | None:
        """Density (M,), 1/m³, of a false detection: anywhere in the picture, and there at the depth of what is seen."""
        if self.depth is None:
            return None
        away = positions - self.pose[:3, 3]
        ahead = np.maximum(away @ self.pose[:3, 2], NEAR)
        ray = away / np.maximum(np.linalg.norm(away, axis=1), NEAR)[:, None]
        deep = np.sqrt(2.0 * np.pi * np.einsum("ma,mab,mb->m", ray, covariances, ray))
        pixels = self.camera.fx * self.camera.fy / ahead**2  # of a square metre there
        return pixels / (self.camera.width * self.camera.height * deep)

    @cached_property
    def sensor(self) -> dict[str, Any]:
        """The view as `WorldEvidence.sensor`: a cone about the vertical that holds all of it."""
        rays = self.camera.border @ self.pose[:3, :3].T
        ahead = self.pose[:3, :3] @ self.camera.rays([[self.camera.cx, self.camera.cy]])[0]
        yaw = float(np.arctan2(ahead[1], ahead[0]))
        off = np.abs(wrap_angle(np.arctan2(rays[:, 1], rays[:, 0]) - yaw))
        up = self.pose[2, :3]
        over = self.camera.inside(self.camera.project(np.array([-up, up]))).any()  # sees all around
        half = np.pi if over else min(float(off.max()) + 0.02, np.pi)
        return {"pose": (*self.pose[:3, 3].tolist(), yaw), "range": FARTHEST, "angle": 2.0 * half}

    @cached_property
    def _beside(self) -> FloatArray:
        """Unit offsets (AROUND + 1, 3) in the picture's plane, the middle first."""
        angle = np.arange(AROUND) * 2.0 * np.pi / AROUND
        flat = np.vstack([np.zeros(3), np.column_stack([np.cos(angle), np.sin(angle), np.zeros(AROUND)])])
        return flat @ self.pose[:3, :3].T

    def _doubt(self, positions: FloatArray) -> FloatArray:
        """Standard deviation (N,) m of where objects are relative to the camera, by the robot's own pose."""
        if self.pose_covariance is None:
            return np.zeros(len(positions))
        origin = self.pose[:2, 3] if self.origin is None else self.origin
        away = np.hypot(*(positions[:, :2] - origin).T)
        planar = max(float(self.pose_covariance[0, 0]), float(self.pose_covariance[1, 1]))
        return np.sqrt(planar + away**2 * float(self.pose_covariance[2, 2]))

    def _unhidden(self, points: FloatArray, size: FloatArray, spread: FloatArray) -> tuple[Any, Any]:
        """Which points (N, 3), of things of a size and with deviations (N,) m, are in the picture and unhidden; which
        are known.
        """
        local = (points - self.pose[:3, 3]) @ self.pose[:3, :3]
        pixels = self.camera.project(local)
        inside = self.camera.inside(pixels) & (local[:, 2] > NEAR)
        known = np.ones(len(points), bool)
        hidden = np.zeros(len(points), bool)
        if self.depth is not None:
            seen = local if self.turned is None else local @ self.turned[:3, :3].T + self.turned[:3, 3]
            met = self.depth.at(pixels if self.turned is None else self.camera.project(seen))
            known = ~inside | np.isfinite(met)
            with np.errstate(invalid="ignore"):
                slack = SLACK + FRONT * size + SURELY * np.hypot(spread, self.depth.sigma(seen[:, 2]))
                hidden = met < seen[:, 2] - slack
        if self.scan is not None:
            hidden |= self.scan.hides(points)
        return inside & known & ~hidden, known

    def _taken(self, positions: FloatArray, spread: FloatArray) -> Any:
        """Which objects at positions (N, 3), with deviations (N,) m, a detection that could not be placed may be of."""
        if not self.taken:
            return np.zeros(len(positions), bool)
        local = (positions - self.pose[:3, 3]) @ self.pose[:3, :3]
        pixels, blur = self.camera.project(local), self.camera.fx * spread / np.maximum(local[:, 2], NEAR)
        found = np.zeros(len(positions), bool)
        for box in self.taken:
            near = np.abs(pixels - (box.x, box.y)) <= 0.5 * np.array([box.width, box.height]) + blur[:, None]
            found |= near.all(axis=1)
        return found
