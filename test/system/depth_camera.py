"""A camera with a depth image in the apartment, and a detector that frames things, misses some and confuses others."""

from __future__ import annotations

import io
from collections.abc import Mapping
from dataclasses import dataclass, field

import numpy as np
import numpy.typing as npt
from PIL import Image as Picture

from whereabouts.simulation.home.apartment_camera import Item
from whereabouts.simulation.home.floor_plan import first_hits
from whereabouts.simulation.shapes import Array
from world_model.camera import CameraModel, ImageBox

Mask = npt.NDArray[np.bool_]
SEEN = 0.4
"""Share of a thing's pixels that must be unhidden for the detector to frame it."""


@dataclass(frozen=True)
class Framed:
    """One detection: a box in the image, and probabilities of classes."""

    box: ImageBox
    scores: dict[str, float]


@dataclass(frozen=True)
class DepthCamera:
    """camera : the lens. reach : m, farther there is no depth. noise : m per m². holes : share of pixels without depth.
    detected : share of visible things that are framed. accuracy : how often their class is right.
    """

    camera: CameraModel = field(
        default_factory=lambda: CameraModel(160, 120, fx=140.0, fy=140.0, cx=79.5, cy=59.5)
    )
    reach: float = 8.0
    noise: float = 0.002
    holes: float = 0.02
    detected: float = 0.85
    accuracy: float = 0.9

    def scene(self, pose: Array, blocks: Array, things: Mapping[str, tuple[Item, Array]]) -> CameraScene:
        """What is before the camera, from its optical frame's pose (4, 4).

        blocks (B, 6) : boxes x0, y0, z0, x1, y1, z1 in m; the floor is at z = 0. things : by name, with the position
        (3,) of the middle of each; they are in the picture, too.
        """
        directions, lengths = self._rays(pose)
        origin = pose[:3, 3]
        with np.errstate(divide="ignore"):
            floor = np.where(directions[:, 2] < 0.0, -origin[2] / directions[:, 2], np.inf)
        ranges = np.minimum(first_hits(blocks, origin, directions), floor)
        alone = {}
        for name, (item, position) in things.items():
            block = np.concatenate([position - item.half, position + item.half])[None]
            alone[name] = first_hits(block, origin, directions)
            ranges = np.minimum(ranges, alone[name])
        outlines = {}
        for name, own in alone.items():
            pixels = np.isfinite(own)
            outlines[name] = self._outline(pixels, pixels & (own <= ranges))
        kinds = {name: item.kind for name, (item, _) in things.items()}
        return CameraScene(self, self._image(ranges / lengths), kinds, outlines)

    def _rays(self, pose: Array) -> tuple[Array, Array]:
        """Directions (N, 3) of all pixels in the world, and how long each is for 1 m ahead."""
        x, y = np.meshgrid(np.arange(self.camera.width), np.arange(self.camera.height))
        rays = self.camera.rays(np.column_stack([x.ravel(), y.ravel()]))
        lengths = np.linalg.norm(rays, axis=1)
        return rays @ pose[:3, :3].T / lengths[:, None], lengths

    def _image(self, values: Array) -> Array:
        return values.reshape(self.camera.height, self.camera.width)

    def _outline(self, pixels: Mask, clear: Mask) -> tuple[ImageBox | None, float]:
        """The box of a thing's unhidden pixels, and their share of all it has in the image."""
        if not clear.any():
            return None, 0.0
        rows, columns = np.nonzero(clear.reshape(self.camera.height, self.camera.width))
        x0, x1, y0, y1 = columns.min(), columns.max(), rows.min(), rows.max()
        box = ImageBox(0.5 * (x0 + x1), 0.5 * (y0 + y1), x1 - x0 + 1.0, y1 - y0 + 1.0)
        return box, float(clear.sum() / pixels.sum())


@dataclass(frozen=True)
class CameraScene:
    """What stands before a camera: exact depths (height, width) m, and of each thing its class, its box and how much of
    it is to be seen."""

    camera: DepthCamera
    exact: Array
    kinds: Mapping[str, str]
    outlines: Mapping[str, tuple[ImageBox | None, float]]

    def depth(self, rng: np.random.Generator) -> Array:
        """A depth image (height, width) float32 m with errors; 0 where there is none."""
        camera = self.camera
        depth = np.minimum(self.exact, 2.0 * camera.reach)
        depth = depth + camera.noise * depth * depth * rng.standard_normal(depth.shape)
        lost = (rng.random(depth.shape) < camera.holes) | ~(depth < camera.reach)
        return np.asarray(np.where(lost, 0.0, depth), dtype=np.float32)

    def detections(self, rng: np.random.Generator) -> list[Framed]:
        """What the detector frames of the things that are mostly to be seen, with its errors."""
        camera = self.camera
        found = []
        for name, (box, share) in self.outlines.items():
            if box is None or share < SEEN or rng.random() > camera.detected:
                continue
            others = sorted(set(self.kinds.values()) - {self.kinds[name]})
            right = not others or rng.random() < camera.accuracy
            kind = self.kinds[name] if right else str(rng.choice(others))
            sides = np.array([box.width, box.height, box.width, box.height])
            x, y, width, height = np.array([box.x, box.y, box.width, box.height]) + 0.03 * sides * (
                rng.standard_normal(4)
            )
            found.append(Framed(ImageBox(x, y, width, height), {kind: camera.accuracy}))
        return found


def looking(origin: Array, target: Array) -> Array:
    """Pose (4, 4) of an optical frame at origin (3,) that looks at target (3,), upright."""
    ahead = np.asarray(target, dtype=np.float64) - origin
    ahead /= np.linalg.norm(ahead)
    right = np.cross(ahead, [0.0, 0.0, 1.0])
    right /= np.linalg.norm(right)
    pose = np.eye(4)
    pose[:3, :3] = np.column_stack([right, np.cross(ahead, right), ahead])
    pose[:3, 3] = origin
    return pose


def compressed(metres: Array) -> bytes:
    """A picture in mm as compressedDepth packs it."""
    packed = io.BytesIO()
    Picture.fromarray(np.round(1000.0 * metres).astype(np.uint16)).save(packed, "PNG")
    return bytes(12) + packed.getvalue()
