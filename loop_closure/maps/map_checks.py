"""Whether the arrays of a map file fit together and can be meant: counts, shapes, magnitudes."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

FARTHEST = 1e6
"""m: no map reaches farther."""
LARGEST = 1e12
"""Of any number that is no length."""
LARGEST_STAMP = 1e11
"""s, thousands of years."""
Arrays = dict[str, NDArray[Any]]


def check_map(data: Arrays) -> None:
    """Raises ValueError (KeyError where an array is missing), naming what is wrong."""
    count = len(_numbers(data, "stamps", LARGEST_STAMP))
    shape = data["odometry"].shape
    pose = shape[1:] if count else ()
    if count and pose not in ((3,), (4, 4)):
        raise ValueError(f"odometry: poses expected, got {shape}")
    freedom = {(): (), (3,): (3, 3), (4, 4): (6, 6)}[pose]
    edges = len(_numbers(data, "ends", float(max(count, 1))))
    for name, rows, inner in (
        ("odometry", count, pose),
        ("paths", count, ()),
        ("poses", count, pose),
        ("motions", edges, pose),
        ("covariances", edges, freedom),
    ):
        values = _numbers(data, name, LARGEST if name in ("covariances", "paths") else FARTHEST)
        if (rows or name != "poses") and values.shape != (rows, *(inner if rows else values.shape[1:])):
            raise ValueError(f"{name}: {(rows, *inner)} numbers expected, got {values.shape}")
        if inner == (4, 4) and rows:
            _check_rotations(name, values)
    _check_edges(data, count, edges)
    breaks = _numbers(data, "breaks", 1e9).reshape(-1, 2) if "breaks" in data else np.zeros((0, 2))
    if len(breaks) and (not _within(breaks[:, 0], count) or (breaks[:, 1] < 0.0).any()):
        raise ValueError("breaks: a keyframe does not exist")
    closures = _numbers(data, "closures", LARGEST).reshape(-1, 4)
    if len(closures) and not _within(closures[:, :2], count):
        raise ValueError("closures: a keyframe does not exist")
    if "scans" in data:
        _check_scans(data, count)
    else:
        _check_clouds(data, count)


def _numbers(data: Arrays, name: str, most: float) -> NDArray[Any]:
    values = data[name]
    if values.dtype.kind not in "biuf" or values.ndim == 0:
        raise ValueError(f"{name}: an array of numbers expected")
    if not np.isfinite(values).all() or (np.abs(values) > most).any():
        raise ValueError(f"{name}: finite numbers up to {most:g} expected")
    return values


def _within(numbers: NDArray[Any], count: int) -> bool:
    return bool(((numbers >= 0) & (numbers < count) & (numbers == np.floor(numbers))).all())


def _check_rotations(name: str, poses: NDArray[Any]) -> None:
    turns = poses[:, :3, :3]
    apart = np.abs(turns @ turns.transpose(0, 2, 1) - np.eye(3)).max()
    if apart > 1e-3 or np.linalg.det(turns).min() < 0.0 or np.abs(poses[:, 3] - (0, 0, 0, 1)).max() > 1e-6:
        raise ValueError(f"{name}: rigid motions expected")


def _check_edges(data: Arrays, count: int, edges: int) -> None:
    if not edges:
        return
    ends = data["ends"]
    if (
        ends.ndim != 2
        or ends.shape[1] != 3
        or not _within(ends[:, :2], count)
        or (ends[:, 0] == ends[:, 1]).any()
    ):
        raise ValueError("ends: edges between two keyframes expected")
    covariances = data["covariances"]
    lean = np.abs(covariances - covariances.transpose(0, 2, 1)).max(axis=(1, 2))
    size = np.abs(covariances).max(axis=(1, 2))
    if (lean > 1e-6 * size + 1e-12).any() or (np.linalg.eigvalsh(covariances)[:, 0] < -1e-6 * size).any():
        raise ValueError("covariances: symmetric matrices without negative eigenvalues expected")


def _check_scans(data: Arrays, count: int) -> None:
    scans, ranges = _numbers(data, "scans", 1e10), data["ranges"]
    if scans.shape != (count, 6):
        raise ValueError(f"scans: {(count, 6)} numbers expected, got {scans.shape}")
    if ranges.dtype.kind != "f" or ranges.ndim != 1:
        raise ValueError("ranges: a row of numbers expected")
    beams = scans[:, 0]
    if not _within(beams, len(ranges) + 1) or beams.sum() != len(ranges):
        raise ValueError("scans: the number of beams is not the number of ranges")
    turned = np.abs(scans[:, 1]) + np.abs(scans[:, 2]) * beams
    if (turned > 8.0 * np.pi).any() or (scans[:, 3] < 0.0).any() or (scans[:, 4] <= scans[:, 3]).any():
        raise ValueError("scans: bearings or range limits that no scanner has")


def _check_clouds(data: Arrays, count: int) -> None:
    points, counts = _numbers(data, "points", FARTHEST), data["counts"]
    if points.ndim != 2 or points.shape[1] != 3:
        raise ValueError(f"points: (M, 3) numbers expected, got {points.shape}")
    if counts.shape != (count,) or (
        count and (not _within(counts, len(points) + 1) or counts.sum() != len(points))
    ):
        raise ValueError("counts: their sum is not the number of points")
