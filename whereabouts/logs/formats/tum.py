"""TUM trajectories: one line `stamp x y z qx qy qz qw` per pose, metres and seconds, `#` starts a comment."""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import ArrayLike

from estimation.checks import FloatArray as Array
from estimation.errors import InputError
from estimation.geometry.rotations import quaternion_from_rotation, rotation_from_quaternion
from whereabouts.logs.formats.text import TextSource
from whereabouts.logs.summary import Summary
from whereabouts.messages.message_rotations import quaternion_of_yaw, to_plane
from whereabouts.system.atomic import atomic_path
from whereabouts.system.log_errors import EmptyLogError, TrajectoryError

HEADER = "# stamp x y z qx qy qz qw\n"
UNIT_TOLERANCE = 1e-2


@dataclass(frozen=True, eq=False)
class Trajectory:
    """Poses with stamps, in file order.

    stamps : (N,) seconds.
    positions : (N, 3) metres.
    quaternions : (N, 4) x, y, z, w of unit length.
    """

    stamps: Array
    positions: Array
    quaternions: Array

    def __len__(self) -> int:
        return len(self.stamps)

    def se2(self) -> Array:
        """(N, 3) [x, y, yaw]."""
        return to_plane(self.se3())

    def se3(self) -> Array:
        """(N, 4, 4) matrices."""
        matrices = np.tile(np.eye(4), (len(self), 1, 1))
        matrices[:, :3, :3] = rotation_from_quaternion(self.quaternions)
        matrices[:, :3, 3] = self.positions
        return matrices


def format_line(stamp: float, pose: Array) -> str:
    """One line of a TUM file.

    Raises InputError: the pose is neither (3,) nor (4, 4).
    """
    if pose.shape == (3,):
        x, y, z = float(pose[0]), float(pose[1]), 0.0
        quaternion = quaternion_of_yaw(float(pose[2]))
    elif pose.shape == (4, 4):
        x, y, z = (float(v) for v in pose[:3, 3])
        quaternion = quaternion_from_rotation(pose[:3, :3]).tolist()
    else:
        raise InputError(f"pose: shape (3,) or (4, 4) expected, got {pose.shape}")
    time = np.format_float_positional(stamp, unique=True, trim="0")
    numbers = " ".join(f"{value + 0.0:.9f}" for value in (x, y, z))
    return f"{time} {numbers} {' '.join(f'{value + 0.0:.12f}' for value in quaternion)}\n"


def write_tum(path: Path | str, stamps: ArrayLike, poses: ArrayLike | Sequence[ArrayLike]) -> None:
    """Write a whole trajectory: stamps (N,) seconds, poses (N, 3) or (N, 4, 4).

    Stamps are written with the digits that give the same float64 back, poses with nine decimals. The file appears
    whole; after an error one that was there is unchanged.
    Raises InputError: the numbers of stamps and poses differ, or a pose is not finite or of another shape; WriteError:
    the directory is missing or not writable.
    """
    times = np.asarray(stamps, dtype=np.float64)
    values = np.asarray(poses, dtype=np.float64)
    if times.ndim != 1 or len(times) != len(values):
        raise InputError(f"stamps: one for each of the {len(values)} poses expected, got shape {times.shape}")
    with atomic_path(Path(path)) as temporary, temporary.open("w", encoding="ascii", newline="\n") as file:
        file.write(HEADER)
        for number, (stamp, pose) in enumerate(zip(times, values, strict=True)):
            if not np.isfinite(pose).all() or not math.isfinite(stamp):
                got = f"finite numbers expected, got {pose.tolist()}"
                raise InputError(f"pose {number} at stamp {stamp}: {got}")
            file.write(format_line(float(stamp), pose))


def read_tum(path: Path | str) -> Trajectory:
    """Read a trajectory; planar ones have z = 0 and turn about z only.

    Raises LogNotFoundError, EmptyLogError: nothing there; TrajectoryError: a line has not eight finite numbers or no
    unit quaternion; the message has its number.
    """
    rows = np.array(list(_rows(Path(path))), dtype=np.float64)
    if not len(rows):
        raise EmptyLogError(path, "holds no pose; lines `stamp x y z qx qy qz qw` expected")
    quaternions = rows[:, 4:8] / np.linalg.norm(rows[:, 4:8], axis=1, keepdims=True)
    return Trajectory(rows[:, 0], rows[:, 1:4], quaternions)


def _rows(path: Path) -> Iterator[list[float]]:
    for number, words in TextSource(path).fields(Summary()):
        try:
            values = [float(part) for part in b" ".join(words).replace(b",", b" ").split()]
        except ValueError:
            raise TrajectoryError(path, "`stamp x y z qx qy qz qw` expected", f"line {number}") from None
        if len(values) != 8 or not all(map(math.isfinite, values)):
            problem = f"eight finite numbers expected, got {len(values)}"
            raise TrajectoryError(path, problem, f"line {number}")
        if abs(math.hypot(*values[4:]) - 1.0) > UNIT_TOLERANCE:
            problem = "the last four numbers are no unit quaternion qx qy qz qw"
            raise TrajectoryError(path, problem, f"line {number}")
        yield values
