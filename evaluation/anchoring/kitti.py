"""KITTI tracking sequences: labelled 3D boxes by identity, brought into a fixed frame by the vehicle's own motion."""

from __future__ import annotations

import gzip
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import numpy.typing as npt

from estimation.errors import InputError

Array = npt.NDArray[np.float64]
RATE = 10.0
EARTH_RADIUS = 6378137.0


@dataclass(frozen=True)
class KittiFrame:
    """One frame: stamp (s), sensor pose (4,) x, y, z, yaw of the camera looking ahead, and per label identity,
    class and position (N, 3) of the box's centre, m, in the frame of the sequence's first pose.

    hidden (N,) : 0 not, 1 partly, 2 largely hidden, 3 unknown. sizes (N, 3) : height, width, length, m. pose (4, 4) :
    of the left colour camera (x to the right, y down, z ahead); camera (3, 3) : its matrix, pixels.
    boxes (N, 4) : left, top, right, bottom in its image, pixels.
    """

    stamp: float
    sensor: Array
    identities: tuple[int, ...]
    classes: tuple[str, ...]
    positions: Array
    hidden: npt.NDArray[np.int64]
    sizes: Array
    pose: Array
    camera: Array
    boxes: Array


def _lines(path: Path) -> list[str]:
    packed = path.with_name(path.name + ".gz")
    try:
        if packed.exists():
            return gzip.decompress(packed.read_bytes()).decode().splitlines()
        return path.read_text(encoding="utf-8").splitlines()
    except OSError as error:
        raise InputError(f"{path}: not readable ({error})") from error


def _calibration(path: Path) -> dict[str, Array]:
    found = {}
    for line in _lines(path):
        name, *numbers = line.replace(":", " ").split() or [""]
        if numbers:
            found[name] = np.array([float(number) for number in numbers])
    return found


def _rigid(rotation: Array, translation: Array) -> Array:
    out = np.eye(4)
    out[:3, :3], out[:3, 3] = rotation, translation
    return out


def _vehicle_poses(path: Path) -> Array:
    """(F, 4, 4) poses of the inertial unit; x, y on a Mercator projection about the first latitude."""
    rows = np.array([[float(value) for value in line.split()] for line in _lines(path) if line.strip()])
    scale = np.cos(np.deg2rad(rows[0, 0]))
    x = scale * EARTH_RADIUS * np.deg2rad(rows[:, 1])
    y = scale * EARTH_RADIUS * np.log(np.tan(np.pi / 4.0 + np.deg2rad(rows[:, 0]) / 2.0))
    poses = []
    for px, py, pz, roll, pitch, yaw in np.column_stack([x, y, rows[:, 2:6]]):
        cr, sr, cp, sp, cy, sy = *_turn(roll), *_turn(pitch), *_turn(yaw)
        about_x = np.array([[1, 0, 0], [0, cr, -sr], [0, sr, cr]])
        about_y = np.array([[cp, 0, sp], [0, 1, 0], [-sp, 0, cp]])
        about_z = np.array([[cy, -sy, 0], [sy, cy, 0], [0, 0, 1]])
        poses.append(_rigid(about_z @ about_y @ about_x, np.array([px, py, pz])))
    stacked = np.stack(poses)
    origin = stacked[0, :3, 3].copy()
    stacked[:, :3, 3] -= origin
    return stacked


def _turn(angle: float) -> tuple[float, float]:
    return float(np.cos(angle)), float(np.sin(angle))


def frames(folder: Path, sequence: str) -> Iterator[KittiFrame]:
    """All frames of a sequence ("0000"), also those without labels."""
    calibration = _calibration(folder / f"calib_{sequence}.txt")
    cam = _rigid(*_split(calibration["Tr_velo_cam"]))
    cam = _rigid(calibration["R_rect"].reshape(3, 3), np.zeros(3)) @ cam
    inertial = _rigid(*_split(calibration["Tr_imu_velo"]))
    camera_in_vehicle = np.linalg.inv(cam @ inertial)
    matrix = calibration["P2"].reshape(3, 4)
    # The second camera stands beside the first, whose frame the labels are in.
    offset = np.asarray(np.linalg.solve(matrix[:, :3], matrix[:, 3]), dtype=np.float64)
    beside = _rigid(np.eye(3), -offset)
    labels: dict[int, list[list[str]]] = {}
    for line in _lines(folder / f"label_{sequence}.txt"):
        row = line.split()
        if row and row[2] != "DontCare":
            labels.setdefault(int(row[0]), []).append(row)
    for index, vehicle in enumerate(_vehicle_poses(folder / f"oxts_{sequence}.txt")):
        pose = vehicle @ camera_in_vehicle
        rows = labels.get(index, [])
        # A label holds height, width, length and the middle of the bottom, in the camera's frame (y down).
        numbers = np.array([[float(value) for value in row[3:17]] for row in rows]).reshape(-1, 14)
        centre = numbers[:, 10:13] - 0.5 * np.outer(numbers[:, 7], [0.0, 1.0, 0.0])
        ahead = pose[:3, 2]
        sensor = np.array([*pose[:3, 3], np.arctan2(ahead[1], ahead[0])])
        positions = centre @ pose[:3, :3].T + pose[:3, 3]
        yield KittiFrame(
            index / RATE,
            sensor,
            tuple(int(row[1]) for row in rows),
            tuple(row[2] for row in rows),
            positions,
            numbers[:, 1].astype(np.int64),
            numbers[:, 7:10],
            pose @ beside,
            matrix[:, :3],
            numbers[:, 3:7],
        )


def _split(numbers: Array) -> tuple[Array, Array]:
    matrix = numbers.reshape(3, 4)
    return matrix[:, :3], matrix[:, 3]
