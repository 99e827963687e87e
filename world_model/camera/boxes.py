"""Where the things are that a detector has framed in an image."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from estimation.checks import FloatArray
from estimation.errors import InputError
from world_model.camera.depth import DepthImage, LevelScan
from world_model.camera.lens import CameraModel

CORE = 0.5  # Share of a box's sides in which its object is looked for: at the edges is what stands behind
FRONT = 0.3  # Quantile of the depths there that is the object's front, as some of them go past it
SAME = 0.15  # m and more, of its size: depths that far from the front are of the same object
FEWEST = 4
ENOUGH = 0.25  # Share of the depths in a box that tells without those that are in another box as well
JITTER = 0.05  # Standard deviation of a box's edges, of its sides
SCAN_SIGMA = 0.25  # m: a scanner meets the furniture at its edge, and the thing lies somewhere on it


@dataclass(frozen=True)
class ImageBox:
    """A frame around an object in an image: middle and sides, pixels."""

    x: float
    y: float
    width: float
    height: float


def overlap(one: ImageBox, other: ImageBox) -> float:
    """Intersection over union of two boxes."""
    wide = 0.5 * (one.width + other.width) - abs(one.x - other.x)
    high = 0.5 * (one.height + other.height) - abs(one.y - other.y)
    shared = max(min(wide, one.width, other.width), 0.0) * max(min(high, one.height, other.height), 0.0)
    return shared / max(one.width * one.height + other.width * other.height - shared, 1e-12)


@dataclass(frozen=True)
class LocatedBox:
    """position (3,), covariance (3, 3) in the camera's optical frame, m and m²; width, height : m, 0 where unknown."""

    position: FloatArray
    covariance: FloatArray
    width: float
    height: float


def located(
    box: ImageBox,
    camera: CameraModel,
    depth: DepthImage,
    turned: FloatArray | None = None,
    others: Sequence[ImageBox] = (),
) -> LocatedBox:
    """Position and extent of the object in a box, by a depth image of the same camera.

    turned : (4, 4) from the camera to where it was when the depth image was taken; None where that is the same.
    others : boxes around other things, which may stand before it: what is in two boxes tells of neither, as long as
    enough is left.

    Raises InputError: a box without size or outside of the image, or nothing in it with a known depth.
    """
    _check(box, camera)
    x, y = middle = np.array([box.x, box.y])
    if turned is not None:
        ray = turned[:3, :3] @ camera.rays([[x, y]])[0]
        x, y = np.nan_to_num(camera.project(ray[None])[0], nan=-np.inf)
    half = 0.5 * CORE * box.width, 0.5 * CORE * box.height
    depths, pixels = depth.box(x - half[0], y - half[1], x + half[0], y + half[1])
    pixels += middle - (x, y)
    shared = np.zeros(len(depths), bool)
    for other in others:
        away = abs(other.x - box.x) - 0.5 * other.width, abs(other.y - box.y) - 0.5 * other.height
        if away[0] > half[0] + 1.0 or away[1] > half[1] + 1.0:  # pixels
            continue
        sides = 0.5 * np.array([other.width, other.height])
        shared |= (np.abs(pixels - (other.x, other.y)) <= sides).all(axis=1)
    if (~shared).sum() >= max(ENOUGH * len(depths), FEWEST):
        depths = depths[~shared]
    if turned is not None:
        depths = (depths - turned[2, 3]) / max(ray[2], 0.1)
    if len(depths) < FEWEST:
        raise InputError(
            f"bbox: no depth in the middle of the box at {box.x:.0f}, {box.y:.0f} "
            f"(of {len(depths)} pixels, {FEWEST} are needed)"
        )
    front = float(np.quantile(depths, FRONT, method="lower"))
    same = depths[np.abs(depths - front) < SAME + 0.5 * box.width * front / camera.fx]
    return _placed(
        box, camera, float(np.median(same)), float(np.hypot(same.std(), depth.sigma(np.array(front))))
    )


def located_by_scan(box: ImageBox, camera: CameraModel, pose: FloatArray, scan: LevelScan) -> LocatedBox:
    """The same by a level scan, from the camera's pose (4, 4) in the frame of the scan.

    Raises InputError: as `located`, or the scanner meets nothing in that direction.
    """
    _check(box, camera)
    ray = pose[:3, :3] @ camera.rays([[box.x, box.y]])[0]
    level = float(np.hypot(ray[0], ray[1]))
    away = float(scan.at((pose[:3, 3] + ray / max(level, 1e-6))[None])[0]) if level > 1e-3 else np.inf
    if not np.isfinite(away):
        raise InputError(f"bbox: the scan meets nothing in the direction of {box.x:.0f}, {box.y:.0f}")
    return _placed(box, camera, away / level, SCAN_SIGMA)


def _check(box: ImageBox, camera: CameraModel) -> None:
    if not (np.isfinite([box.x, box.y]).all() and 1.0 <= box.width < np.inf and 1.0 <= box.height < np.inf):
        raise InputError(
            f"bbox: a finite middle and sides of at least a pixel expected, got {box.x:g}, {box.y:g}, "
            f"{box.width:g} x {box.height:g}"
        )
    x, y = box.x / camera.width, box.y / camera.height
    if not (0.0 <= x <= 1.0 and 0.0 <= y <= 1.0):
        raise InputError(
            f"bbox: its middle at {box.x:g}, {box.y:g} is outside of the image of {camera.width} x {camera.height} "
            "that camera_info tells of; has the detector resized the image?"
        )


def _placed(box: ImageBox, camera: CameraModel, front: float, sigma: float) -> LocatedBox:
    ray = camera.rays([[box.x, box.y]])[0]
    width, height = box.width * front / camera.fx, box.height * front / camera.fy
    # The middle of a thing lies behind its front by about half of the smaller side.
    behind = 0.5 * min(width, height)
    ahead = front + behind
    cut_x = box.x - 0.5 * box.width < 1.0 or box.x + 0.5 * box.width > camera.width - 2.0
    cut_y = box.y - 0.5 * box.height < 1.0 or box.y + 0.5 * box.height > camera.height - 2.0
    # Of what the image cuts off the middle is anywhere within it.
    across = np.array([width * (0.5 if cut_x else JITTER), height * (0.5 if cut_y else JITTER)])
    across = np.hypot(across, front / np.array([camera.fx, camera.fy]))
    along = np.hypot(sigma, 0.5 * behind)
    direction = ray / np.linalg.norm(ray)
    covariance = np.diag([across[0] ** 2, across[1] ** 2, 0.0]) + along**2 * np.outer(direction, direction)
    # Nor does what is cut tell how large it is.
    width, height = (0.0, 0.0) if cut_x or cut_y else (width, height)
    return LocatedBox(ray * ahead, covariance + 1e-6 * np.eye(3), width, height)
