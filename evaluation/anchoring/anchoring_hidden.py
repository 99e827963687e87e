"""Traffic that hides itself: KITTI's recorded paths, with misses by the occlusion that its labels tell."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from scipy.special import ndtr

from evaluation.anchoring import kitti
from evaluation.anchoring.anchoring_recorded import (
    DETECTED,
    FALSE,
    NEAR,
    SIGMA,
    false_ones,
    nearest_neighbour,
    traffic,
)
from evaluation.anchoring.identities import IdentityScore
from world_model import ObjectEvidence, WorldEvidence, WorldModel
from world_model.camera import CameraModel, CameraView, DepthImage, ImageBox, LocatedBox, located

SEEN = (DETECTED, 0.6, 0.05, 0.05)
"""p_D of what is not, partly, largely hidden, and where nobody knows."""
LASTING = 0.8
"""Correlation of an object's luck from frame to frame: misses come in runs."""
COARSE = 4
"""Pixels of the recording to one of the depth image, a side."""
JITTER = 0.03
"""Standard deviation of a box's edges, of its sides."""


@dataclass(frozen=True)
class Detected:
    """positions (M, 3) m. evidence : the same as a detector says it. Some of them are false."""

    positions: np.ndarray
    evidence: WorldEvidence


class Luck:
    """Which labels are detected: a hidden normal process for each object, compared with its p_D."""

    def __init__(self, seed: int) -> None:
        self.rng = np.random.default_rng(seed)
        self._now: dict[int, float] = {}

    def found(self, frame: kitti.KittiFrame) -> list[int]:
        """Indices of the labels that are detected in the next frame."""
        found = []
        for index, (name, hidden) in enumerate(zip(frame.identities, frame.hidden, strict=True)):
            last, new = self._now.get(name), float(self.rng.normal())
            self._now[name] = new if last is None else LASTING * last + (1.0 - LASTING**2) ** 0.5 * new
            if ndtr(self._now[name]) < SEEN[hidden]:
                found.append(index)
        return found


def in_space(frame: kitti.KittiFrame, luck: Luck) -> Detected:
    """Positions with σ 0.2 m, and false ones in the camera's view."""
    rng = luck.rng
    seen = [frame.positions[k] + rng.normal(0.0, SIGMA, 3) for k in luck.found(frame)]
    seen += false_ones(frame, rng)
    evidence = WorldEvidence([ObjectEvidence(place, SIGMA**2 * np.eye(3)) for place in seen])
    return Detected(np.array(seen).reshape(-1, 3), evidence)


def lens(frame: kitti.KittiFrame) -> CameraModel:
    """The recording's camera, of coarser pixels."""
    scaled = np.diag([1.0 / COARSE, 1.0 / COARSE, 1.0]) @ frame.camera
    return CameraModel.checked((1242 // COARSE, 375 // COARSE), scaled.ravel())


def depth_image(frame: kitti.KittiFrame, camera: CameraModel) -> DepthImage:
    """What stands where, of the labelled boxes alone: the nearer one in front; 80 m where there is none."""
    metres = np.full((camera.height, camera.width), 80.0, np.float32)
    ahead = ((frame.positions - frame.pose[:3, 3]) @ frame.pose[:3, :3])[:, 2]
    for k in np.argsort(-ahead, kind="stable"):
        left, top, right, bottom = (frame.boxes[k] / COARSE).round().astype(int).tolist()
        front = max(float(ahead[k]) - 0.5 * float(frame.sizes[k, 1]), 0.5)
        metres[max(top, 0) : bottom + 1, max(left, 0) : right + 1] = front
    return DepthImage(metres, noise=0.0)  # as from a lidar


def through_camera(frame: kitti.KittiFrame, luck: Luck) -> Detected:
    """Boxes in the image, placed by the depth image, as the node does with Detection2DArray, CameraInfo and depth."""
    camera, rng = lens(frame), luck.rng
    depth = depth_image(frame, camera)
    boxes = []
    for k in luck.found(frame):
        left, top, right, bottom = frame.boxes[k] / COARSE
        sides = np.array([right - left, bottom - top])
        x, y = 0.5 * np.array([left + right, top + bottom]) + JITTER * sides * rng.normal(size=2)
        width, height = np.maximum(sides * (1.0 + JITTER * rng.normal(size=2)), 4.0)
        boxes.append(ImageBox(float(x), float(y), float(width), float(height)))
    for _ in range(rng.poisson(FALSE)):
        x, y = rng.uniform([0.0, 0.35], [1.0, 0.7]) * [camera.width, camera.height]
        boxes.append(ImageBox(float(x), float(y), *rng.uniform(5.0, 25.0, 2).tolist()))
    seen, items = [], []
    for box in boxes:
        place = located(box, camera, depth)
        position = frame.pose[:3, :3] @ place.position + frame.pose[:3, 3]
        if place.position[2] > 75.0:
            continue  # the road, as far as this depth image tells
        seen.append(position)
        spread = frame.pose[:3, :3] @ place.covariance @ frame.pose[:3, :3].T
        items.append(ObjectEvidence(position, spread, quantities=_extent(place)))
    view = CameraView(camera, frame.pose, depth)
    return Detected(np.array(seen).reshape(-1, 3), WorldEvidence(items, view=view))


def _extent(place: LocatedBox) -> dict[str, tuple[float, float]]:
    """Diagonal and height by width, where the image holds all of it."""
    if place.width <= 0.0:
        return {}
    size, ratio = float(np.sqrt(2.0 * place.width**2 + place.height**2)), place.height / place.width
    return {"size": (size, (0.3 * size) ** 2), "ratio": (ratio, (0.3 * ratio) ** 2)}


def hidden_run(
    frames: Sequence[kitti.KittiFrame], run: float | None, seed: int, look: Any = in_space
) -> IdentityScore:
    """Identities of a sequence, of all labels, hidden ones as well. run None: by global nearest neighbour."""
    luck, score = Luck(seed), IdentityScore(NEAR)
    model = (
        None
        if run is None
        else WorldModel(
            traffic(frames, missed_run_frames=run, quantities={"size": (3.0, 2.0), "ratio": (1.0, 0.7)})
        )
    )
    other = nearest_neighbour()
    for frame in frames:
        seen = look(frame, luck)
        if model is None:
            tracks = other.step(seen.positions, frame.stamp)
            names: list[Any] = [track.id for track in tracks]
            places = [track.mean[:3] for track in tracks]
        else:
            objects = model.update(seen.evidence, frame.stamp).objects
            names, places = [item.id for item in objects], [item.position for item in objects]
        truth = dict(zip(frame.identities, frame.positions, strict=True))
        score.add(truth, names, np.array(places).reshape(-1, 3))
    return score
