"""A map on disk: keyframes, poses and edges in one NumPy archive, to localise in or to go on with."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any, BinaryIO

import numpy as np
from numpy.typing import NDArray

from estimation.archive import header_of, read_archive
from estimation.checks import FloatArray
from estimation.errors import InputError
from loop_closure.graph.edges import Edge
from loop_closure.graph.smoother_process import SmootherProcess
from loop_closure.keyframes import Keyframes
from loop_closure.maps.map_checks import check_map
from loop_closure.slam.loop_closer import Closure
from loop_closure.slam.trajectory import Slam
from loop_closure.slam_config import SlamConfig
from registration.laser.scan import Scan

FORMAT = 1
KIND = "whereabouts.map"
"""What the file says it is; those of before say a format only."""


def write_map(slam: Slam, file: BinaryIO) -> None:
    """Write keyframes, poses, edges and closures; NumPy's .npz, no pickles."""
    frames = [slam.keyframes[k] for k in range(len(slam.keyframes))]
    arrays: dict[str, Any] = {
        "stamps": np.array([frame.stamp for frame in frames]),
        "odometry": np.array([frame.odometry for frame in frames]),
        "paths": np.array([frame.path for frame in frames]),
        "poses": np.array(slam.graph.poses),
        "ends": np.array([(e.a, e.b, e.closure) for e in slam.graph.edges], dtype=np.int64).reshape(-1, 3),
        "motions": np.array([e.motion for e in slam.graph.edges]),
        "covariances": np.array([e.covariance for e in slam.graph.edges]),
        "breaks": np.array(list(slam.keyframes.breaks.items())).reshape(-1, 2),
        "closures": np.array([(c.earlier, c.later, c.likelihood, c.fitness) for c in slam.closures]),
    }
    if frames and frames[0].scan is not None:
        scans = [frame.scan for frame in frames if frame.scan is not None]
        arrays["ranges"] = np.concatenate([scan.ranges for scan in scans]).astype(np.float32)
        arrays["scans"] = np.array(
            [
                (len(s), s.angle_min, s.angle_increment, s.range_min, min(s.range_max, 1e9), s.time_increment)
                for s in scans
            ]
        )
    else:
        clouds = [frame.points for frame in frames if frame.points is not None]
        arrays["points"] = np.concatenate(clouds).astype(np.float32) if clouds else np.zeros((0, 3))
        arrays["counts"] = np.array([len(cloud) for cloud in clouds])
    about = json.dumps({"kind": KIND, "format": FORMAT, "keyframes": len(frames)})
    np.savez_compressed(file, about=np.array(about), **arrays)


def read_map(
    path: Path | str,
    config: SlamConfig | None = None,
    thin: bool = False,
    aside: SmootherProcess | None = None,
) -> Slam:
    """A `Slam` as it was saved; its next scan needs `Slam.resume` first, or a `Localizer` is given its keyframes.

    Raises
    ------
    InputError : the file is missing, is no map, holds what no map can hold, or was written by a newer version.
    """
    if Path(path).suffix in (".pgm", ".png", ".yaml"):
        raise InputError(f"{path}: is an image of a map; name the .npz file that was written with it")
    data = read_archive(path)
    try:
        _check_kind(data)
        check_map(data)
        return _restored(data, Slam(config, thin=thin, aside=aside))
    except KeyError as error:
        raise InputError(f"{path}: not a map that can be read: {error} is missing") from error
    except (ValueError, TypeError, IndexError, ArithmeticError, np.linalg.LinAlgError) as error:
        raise InputError(f"{path}: not a map that can be read: {error}") from error


def is_map(path: Path) -> bool:
    """Whether a file says of itself that it is a map that `write_map` wrote."""
    try:
        _check_kind(read_archive(path))
    except (InputError, ValueError):
        return False
    return True


def _check_kind(data: dict[str, NDArray[Any]]) -> None:
    about = header_of(data, "about")
    form, kind = about.get("format"), about.get("kind", KIND)
    if kind != KIND or not isinstance(form, int) or "keyframes" not in about:
        raise ValueError(f"kind {KIND!r} expected, got {about.get('kind', 'nothing')!r}")
    if form > FORMAT:
        raise ValueError(f"written by a newer version (format {form})")
    if about["keyframes"] != len(data["stamps"]):
        raise ValueError(f"{len(data['stamps'])} stamps for {about['keyframes']} keyframes")


def _restored(data: dict[str, FloatArray], slam: Slam) -> Slam:
    frames = Keyframes()
    offsets = np.concatenate(
        ([0], np.cumsum(data["scans"][:, 0] if "scans" in data else data["counts"]))
    ).astype(int)
    for k, (stamp, odometry, path) in enumerate(
        zip(data["stamps"], data["odometry"], data["paths"], strict=True)
    ):
        if "scans" in data:
            _, angle_min, step, low, high, between = data["scans"][k]
            ranges = data["ranges"][offsets[k] : offsets[k + 1]].astype(np.float64)
            scan = Scan(ranges, angle_min, step, low, high, float(stamp), between)
            frames.add_scan(scan, odometry, slam.config.max_range, float(path))
        else:
            points = data["points"][offsets[k] : offsets[k + 1]].astype(np.float64)
            frames.add_cloud(points, float(stamp), odometry, float(path))
    for k, sigma in data.get("breaks", np.zeros((0, 2))):
        frames.breaks[int(k)] = float(sigma)
    edges = [
        Edge(int(a), int(b), motion, covariance, bool(closure))
        for (a, b, closure), motion, covariance in zip(
            data["ends"], data["motions"], data["covariances"], strict=True
        )
    ]
    closures = []
    known = {(edge.a, edge.b): edge for edge in edges if edge.closure}
    for earlier, later, likelihood, fitness in data["closures"].reshape(-1, 4):
        edge = known.get((int(earlier), int(later)))
        if edge is not None:
            closures.append(
                Closure(
                    edge.a,
                    edge.b,
                    frames[edge.a].stamp,
                    frames[edge.b].stamp,
                    edge.motion.copy(),
                    edge.covariance.copy(),
                    float(likelihood),
                    float(fitness),
                    "from the saved map",
                )
            )
    slam.restore(frames, data["poses"], edges, closures)
    return slam
