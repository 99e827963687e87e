"""SLAM over a recorded log, without ROS: odometry, loop closure and a map of the log's scans or clouds."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

from estimation.checks import FloatArray as Array
from estimation.geometry.grid import OccupancyGrid
from estimation.geometry.poses import compound, inverse
from loop_closure.maps.localization import Localizer
from loop_closure.maps.map_file import write_map
from loop_closure.maps.map_grid import MapGrid
from loop_closure.slam.trajectory import Slam
from loop_closure.slam_config import Proposals, SlamConfig
from registration.odometry.odometry_config import OdometryConfig
from whereabouts.logs import Log
from whereabouts.messages.message_rotations import to_plane
from whereabouts.recorded.follow import FollowedPose, follow
from whereabouts.system.atomic import atomic_path


@dataclass
class Mapped:
    """What SLAM made of a log.

    stamps (N,) and poses (N, 3) or (N, 4, 4) of the robot, one per scan in the log's order, first one at the origin.
    odometry : the same before any loop was closed. closures : between robot poses. mounts : (N, 3) or None each.
    """

    slam: Slam
    stamps: list[float] = field(default_factory=list)
    odometry: list[Array] = field(default_factory=list)
    mounts: list[Array | None] = field(default_factory=list)
    poses: list[Array] = field(default_factory=list)
    closures: list[tuple[float, float, Array]] = field(default_factory=list)


def map_log(
    log: Log,
    config: SlamConfig | None = None,
    use_wheels: bool = True,
    topic: str | None = None,
    on_scan: Callable[[int], None] = lambda count: None,
    proposals: Proposals = "both",
    odometry: OdometryConfig | None = None,
) -> Mapped:
    """Follow a log by `odometry`'s settings and close its loops; `proposals` : what says where, see `Slam`."""
    mapped = Mapped(Slam(config, proposals=proposals))
    for followed in follow(log, odometry, use_wheels=use_wheels, topic=topic):
        add(mapped, followed)
        on_scan(len(mapped.stamps))
    if mapped.stamps:
        finish(mapped)
    return mapped


def add(mapped: Mapped, followed: FollowedPose) -> None:
    mount, sensor = followed.mount, followed.pose
    mapped.stamps.append(followed.stamp)
    mapped.odometry.append(followed.pose)
    mapped.mounts.append(mount)
    if mount is not None:
        # The map is made in the frame the sensor started in: there its scans need no mounting.
        sensor = compound(compound(inverse(mount), sensor), mount)
    mapped.slam.process(followed.view, sensor, followed.covariance, followed.stamp)


def finish(mapped: Mapped) -> None:
    """Settle the map and take poses and closures from it, moved from the sensor to the robot."""
    slam = mapped.slam
    slam.finish()
    mapped.poses = [
        pose if mount is None else compound(compound(mount, pose), inverse(mount))
        for pose, mount in zip(slam.visited(), mapped.mounts, strict=True)
    ]
    first = slam.first_visits()
    mapped.closures = []
    for closure in slam.closures:
        mount = mapped.mounts[first[closure.later]]
        relative = closure.relative
        if mount is not None:
            relative = compound(compound(mount, relative), inverse(mount))
        mapped.closures.append((closure.earlier_stamp, closure.later_stamp, relative))


@dataclass
class LocatedLog:
    """A log followed in a saved map.

    stamps (N,) : of all scans. poses : (3,) or (4, 4) of the robot in the map's frame; None while it was not known
    where. confirmed (N,) : whether the scan itself fits the map there.
    """

    stamps: list[float] = field(default_factory=list)
    poses: list[Array | None] = field(default_factory=list)
    confirmed: list[bool] = field(default_factory=list)


def locate_log(
    log: Log,
    places: Slam,
    initial: Array | None = None,
    use_wheels: bool = True,
    topic: str | None = None,
    on_scan: Callable[[int], None] = lambda count: None,
) -> LocatedLog:
    """Follow a log in a map that stays as it is; `initial` (3,) or (4, 4) : the robot's first pose, where it is known.

    Raises InputError: a log of clouds and a map of scans, or the other way round.
    """
    located, localizer = LocatedLog(), Localizer(places.keyframes, places.graph.poses)
    for followed in follow(log, use_wheels=use_wheels, topic=topic):
        mount = followed.mount
        if initial is not None and not located.stamps:
            localizer.place(initial if mount is None else compound(initial, mount))
        sensor = followed.pose if mount is None else compound(followed.pose, mount)
        found = localizer.process(followed.view, sensor)
        pose = found.pose
        if pose is not None and mount is not None:
            pose = compound(pose, inverse(mount))
        located.stamps.append(followed.stamp)
        located.poses.append(pose)
        located.confirmed.append(found.sure)
        on_scan(len(located.stamps))
    return located


def draw_grid(
    path: Path, grid: OccupancyGrid, poses: Array, closures: list[tuple[Array, Array]] | None = None
) -> None:
    """The grid from above with the trajectory (N, 2 | 3) through it and lines between closed places."""
    from matplotlib.collections import LineCollection
    from matplotlib.figure import Figure

    figure = Figure(figsize=(10.0, 8.0), dpi=130, layout="constrained")
    axes = figure.add_subplot()
    shade = np.where(grid.occupied, 0.0, np.where(grid.free, 1.0, 0.82))
    height, width = grid.shape
    x, y = grid.origin
    extent = (x, x + width * grid.resolution, y, y + height * grid.resolution)
    axes.imshow(
        shade, origin="lower", extent=extent, cmap="gray", vmin=0.0, vmax=1.0, interpolation="nearest"
    )
    if len(poses):
        axes.plot(poses[:, 0], poses[:, 1], color="tab:blue", linewidth=0.7)
    if closures:
        lines = LineCollection([[a[:2], b[:2]] for a, b in closures], colors="tab:red", linewidths=0.6)
        axes.add_collection(lines)
    axes.set_xlabel("x [m]")
    axes.set_ylabel("y [m]")
    figure.savefig(path, format="png")


def write_map_files(slam: Slam, picture: Path, warn: Callable[[str], None] = lambda text: None) -> None:
    """The map to go on with (.npz) beside `picture`; of scans the picture, and map_saver's .pgm and .yaml, too.

    warn : told what is too far off for the picture.
    """
    with atomic_path(picture.with_suffix(".npz")) as temporary, temporary.open("wb") as file:
        write_map(slam, file)
    nodes = slam.graph.poses
    if nodes.ndim == 2:
        made = MapGrid()
        made.update(slam)
        grid = made.bounded(warn=warn)
        draw_grid(picture, grid, nodes, [(nodes[c.earlier], nodes[c.later]) for c in slam.closures])
        grid.save(picture.with_suffix(""))


def closure_rows(mapped: Mapped) -> list[str]:
    """Lines of the closures file: stamp_a, stamp_b and the pose of b in a."""
    rows = ["stamp_a,stamp_b,x,y,yaw"]
    for a, b, relative in mapped.closures:
        x, y, yaw = relative if relative.shape == (3,) else to_plane(relative)
        rows.append(f"{a:.9f},{b:.9f},{x:.6f},{y:.6f},{yaw:.6f}")
    return rows
