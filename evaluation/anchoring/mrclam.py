"""UTIAS multi-robot landmark recordings (MRCLAM): range and bearing of landmarks and robots, with true poses.

What the files call range is the depth along the camera's axis, as the height of a barcode in the image gives it:
held against the true poses of mrclam6 the stated ranges fall short by the distance times half the squared bearing, for
all five robots. `sightings` turns it into the distance.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from estimation.errors import InputError

Array = NDArray[np.float64]
FIRST_LANDMARK = 6


@dataclass(frozen=True)
class Sighting:
    """What one robot saw at one stamp (s): pose (3,) x, y, yaw, true; distance and bearing (M, 2), m and rad;
    subjects (M,): landmark or robot by barcode, 0 where the code belongs to nobody."""

    stamp: float
    robot: int
    pose: Array
    readings: Array
    subjects: NDArray[np.int64]


def _table(path: Path) -> Array:
    """Rows of a .dat file, also where it is compressed; InputError where it is absent or no table."""
    packed = path.with_name(path.name + ".gz")
    try:
        return np.loadtxt(packed if packed.exists() else path, ndmin=2)
    except (OSError, ValueError) as error:
        raise InputError(f"{path}: not a readable MRCLAM table ({error})") from error


def landmarks(folder: Path) -> dict[int, Array]:
    """True position (2,) m of each landmark."""
    return {int(row[0]): row[1:3] for row in _table(folder / "Landmark_Groundtruth.dat")}


def sightings(folder: Path, robot: int) -> Iterator[Sighting]:
    """All that a robot (1 to 5) saw, by stamp, where its true pose is known."""
    codes = {int(code): int(subject) for subject, code in _table(folder / "Barcodes.dat")}
    truth = _table(folder / f"Robot{robot}_Groundtruth.dat")
    seen = _table(folder / f"Robot{robot}_Measurement.dat")
    yaw = np.unwrap(truth[:, 3])
    for stamp in np.unique(seen[:, 0]):
        if not truth[0, 0] <= stamp <= truth[-1, 0]:
            continue
        rows = seen[seen[:, 0] == stamp]
        pose = np.array([np.interp(stamp, truth[:, 0], column) for column in (truth[:, 1], truth[:, 2], yaw)])
        subjects = np.array([codes.get(int(code), 0) for code in rows[:, 1]])
        readings = np.column_stack([rows[:, 2] / np.cos(rows[:, 3]), rows[:, 3]])
        yield Sighting(float(stamp), robot, pose, readings, subjects)
