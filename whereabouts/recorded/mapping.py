"""SLAM over a recorded log, without ROS: odometry, loop closure and a map of the log's scans or clouds."""

from __future__ import annotations

from collections.abc import Callable, Container, Sequence
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from estimation.errors import InputError
from estimation.geometry.grid import OccupancyGrid
from estimation.geometry.poses import compound, inverse
from estimation.geometry.tiles import VIEW_CELLS, TiledGrid, Tiles, TileView
from loop_closure.keyframes import Keyframe
from loop_closure.maps.localization import Localizer
from loop_closure.maps.map_file import write_map
from loop_closure.slam.trajectory import Slam
from loop_closure.slam_config import Proposals, SlamConfig
from registration.odometry.odometry_config import OdometryConfig
from whereabouts.logs import CloudRecord, Log
from whereabouts.recorded.follow import FollowedPose, follow
from whereabouts.system.atomic import atomic_path

Array = NDArray[np.float64]


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
    """One more scan."""
    record = followed.record
    mapped.stamps.append(followed.stamp)
    mapped.odometry.append(followed.pose)
    if isinstance(record, CloudRecord):
        mapped.mounts.append(None)
        mapped.slam.process(record.points, followed.pose, followed.covariance, followed.stamp)
        return
    mount = np.zeros(3) if record.sensor_pose is None else np.asarray(record.sensor_pose)
    mapped.mounts.append(mount)
    # The map is made in the frame the sensor started in: there its scans need no mounting.
    sensor = compound(compound(inverse(mount), followed.pose), mount)
    mapped.slam.process(record.scan, sensor, followed.covariance, followed.stamp)


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

    Raises
    ------
    InputError : a log of clouds and a map of scans, or the other way round.
    """
    located, localizer = LocatedLog(), Localizer(places.keyframes, places.graph.poses)
    for followed in follow(log, use_wheels=use_wheels, topic=topic):
        record = followed.record
        if isinstance(record, CloudRecord):
            if initial is not None and not located.stamps:
                localizer.place(initial)
            found = localizer.process(record.points, followed.pose)
            pose = found.pose
        else:
            mount = np.zeros(3) if record.sensor_pose is None else np.asarray(record.sensor_pose)
            if initial is not None and not located.stamps:
                localizer.place(compound(initial, mount))
            found = localizer.process(record.scan, compound(followed.pose, mount))
            pose = None if found.pose is None else compound(found.pose, inverse(mount))
        located.stamps.append(followed.stamp)
        located.poses.append(pose)
        located.confirmed.append(found.sure)
        on_scan(len(located.stamps))
    return located


@dataclass
class Drawn:
    """Where a keyframe was drawn, the tiles it is in, and whether it lies where no map reaches."""

    pose: Array
    tiles: Tiles = frozenset()
    beyond: bool = False


NOTHING: tuple[NDArray[np.int64], Array] = (np.zeros(0, dtype=np.int64), np.zeros(0))
REDRAWN = 4  # keyframes around each that moved, about, which have to be drawn again with it


class MapGrid:
    """Occupancy of a map's keyframes that is kept up to date: drawn anew only where it has changed.

    What moved fades from it: two later scans that see through a cell outweigh one that hit something there.

    Attributes
    ----------
    tiles : the cells.
    """

    def __init__(self, resolution: float = 0.05) -> None:
        self.tiles = TiledGrid(resolution)
        self._drawn: dict[int, Drawn] = {}
        self._seen = NOTHING
        self._gone: Tiles = frozenset()  # with keyframes that were taken out of the map
        self._changed: Tiles = frozenset()
        self._anew: MapGrid | None = None  # the same, drawn from the beginning, until it is done
        self._left: list[tuple[Keyframe, Array]] = []  # what is still to be drawn there, last first

    @property
    def grid(self) -> OccupancyGrid:
        """What was seen as one dense grid, of a bounded size; see `TiledGrid.view`."""
        return self.bounded()

    def bounded(
        self, most: int = VIEW_CELLS, warn: Callable[[str], None] = lambda text: None
    ) -> OccupancyGrid:
        """The largest part of what was seen, of at most `most` cells; `warn` is told what is left out."""
        view = self.tiles.view(most=most)
        left_out = self.left_out(view)
        if left_out:
            warn(f"map: {left_out}")
        return self.tiles.dense(view)

    def update(self, slam: Slam, most: int | None = None) -> None:
        """Draw what is new or has moved. What was taken out of the map stays until its tiles are drawn anew.

        most : keyframes that are drawn with this call, None for all. Where more would have to be, the whole is drawn
        anew beside what there is, call by call, and takes its place once it is done.
        """
        poses, numbers = slam.graph.poses, slam.keyframes.numbers
        moved = not self._as_before(numbers, poses)
        self._seen = (numbers.copy(), poses.copy())
        if moved:
            self._take_out(numbers.tolist())
        if self._anew is not None:
            self._go_on(most)
        elif moved:
            self._take_up_moves(_placed(slam, self._drawn), most)
        new = [k for k, number in enumerate(numbers.tolist()) if number not in self._drawn]
        for k in new[:most]:
            frame = slam.keyframes[k]
            self._drawn[frame.number] = Drawn(poses[k].copy())
            self._changed |= self._integrate(frame, None)
        if most is None and self._outdated(slam):
            self.update(slam)

    def _as_before(self, numbers: NDArray[np.int64], poses: Array) -> bool:
        """Whether all keyframes looked at the last time are still there, where they were."""
        known, placed = self._seen
        same = np.array_equal(known, numbers[: len(known)])
        return same and np.array_equal(placed, poses[: len(placed)])

    def _take_out(self, left: list[int]) -> None:
        """Only the keyframes with the numbers `left` are in the map."""
        drawn = self._drawn
        self._drawn = {number: drawn.pop(number) for number in left if number in drawn}
        self._gone = self._gone.union(*(item.tiles for item in drawn.values()))

    @property
    def behind(self) -> bool:
        """Whether it is being drawn anew."""
        return self._anew is not None

    def _outdated(self, slam: Slam) -> bool:
        """Whether what was drawn anew was drawn where it is not any more."""
        return self._away(_placed(slam, self._drawn)).max(initial=0.0) > 0.5 * self.tiles.resolution

    def _away(self, known: Sequence[tuple[Keyframe, Array]]) -> Array:
        """How far each has moved since it was drawn (small steps add up), (N,) m or rad."""
        if not known:
            return np.zeros(0)
        now = np.array([pose for _, pose in known])
        then = np.array([self._drawn[frame.number].pose for frame, _ in known])
        return np.asarray(np.abs(now - then).reshape(len(known), -1).max(axis=1))

    def _take_up_moves(self, known: Sequence[tuple[Keyframe, Array]], most: int | None) -> None:
        away, allowed = self._away(known), 0.5 * self.tiles.resolution
        if away.max(initial=0.0) <= allowed:
            return
        # With what will soon be too far off: the tiles are the same.
        moved = [known[k] for k in np.flatnonzero(away > 0.5 * allowed).tolist()]
        if most is not None and len(moved) > most // REDRAWN:
            self._anew, self._left = MapGrid(self.tiles.resolution), list(known[::-1])
            self._go_on(most)
        elif 2 * len(moved) > len(known):
            self._forget()
        else:
            self._redraw(known, moved)

    def _go_on(self, most: int | None) -> None:
        """Draw more of what is drawn anew; once nothing is left, it replaces what was there."""
        anew = self._anew
        assert anew is not None
        count = len(self._left) if most is None else min(most, len(self._left))
        for _ in range(count):
            frame, pose = self._left.pop()
            anew._drawn[frame.number] = Drawn(pose.copy())
            anew._integrate(frame, None)
        if self._left:
            return
        both = (*self.tiles.tiles.tolist(), *anew.tiles.tiles.tolist())
        self._changed |= frozenset((j, i) for j, i in both)
        self.tiles, self._drawn = anew.tiles, anew._drawn
        self._gone, self._anew, self._seen = frozenset(), None, NOTHING

    @property
    def beyond(self) -> int:
        """How many keyframes lie where no map reaches; they are not drawn."""
        return sum(item.beyond for item in self._drawn.values())

    def left_out(self, view: TileView) -> str:
        """What a view does not show, in a sentence; empty where that is nothing."""
        tiles, parts = self.tiles, []
        if view.left_out:
            share = view.left_out / len(tiles)
            parts.append(
                f"{share:.0%} of the map is left out, up to {view.farthest:.0f} m away: it lies apart from the part "
                "shown, or the map would have too many cells"
            )
        if self.beyond:
            parts.append(f"{self.beyond} keyframes are not drawn: they are too far away for a map")
        return "; ".join(parts)

    def changed(self) -> Tiles:
        """Tiles that have changed since this was last asked."""
        changed, self._changed = self._changed, frozenset()
        return changed

    def _forget(self) -> None:
        """Begin anew with an empty grid."""
        everything = frozenset((j, i) for j, i in self.tiles.tiles.tolist())
        self.tiles.erase(everything)
        self._drawn.clear()
        self._gone, self._changed = frozenset(), self._changed | everything

    def _redraw(
        self, known: Sequence[tuple[Keyframe, Array]], moved: Sequence[tuple[Keyframe, Array]]
    ) -> None:
        """Draw the tiles anew that keyframes have moved out of or into."""
        dirty = set(self._gone)
        self._gone = frozenset()
        for frame, pose in moved:
            dirty |= self._drawn[frame.number].tiles
            self._drawn[frame.number] = Drawn(pose.copy())
            dirty |= self._integrate(frame, frozenset())
        wanted = frozenset(dirty)
        self.tiles.erase(wanted)
        for frame, _ in known:
            if not wanted.isdisjoint(self._drawn[frame.number].tiles):
                self._integrate(frame, wanted)
        self._changed |= wanted

    def _integrate(self, frame: Keyframe, only: Tiles | None) -> Tiles:
        """Draw a scan where it is, into some tiles or all, and note which it touches; clouds are not drawn."""
        item = self._drawn[frame.number]
        if frame.prepared is not None:
            try:
                item.tiles = self.tiles.integrate(item.pose, frame.prepared.surface.points, only=only)
            except InputError:
                item.beyond = True
        return item.tiles


def _placed(slam: Slam, among: Container[int]) -> list[tuple[Keyframe, Array]]:
    """Keyframes of a map whose numbers are `among` some, with their poses."""
    numbers, poses = slam.keyframes.numbers.tolist(), slam.graph.poses
    return [(slam.keyframes[k], poses[k]) for k, number in enumerate(numbers) if number in among]


def map_points(slam: Slam, tiles: TiledGrid) -> Array:
    """The map as points (M, 2 | 3): occupied cells in the plane, thinned clouds in space."""
    if slam.keyframes[0].scan is not None:
        return tiles.occupied_points()
    clouds = []
    for k, pose in enumerate(slam.graph.poses):
        points = slam.keyframes[k].points
        assert points is not None
        clouds.append(points @ pose[:3, :3].T + pose[:3, 3])
    points = np.concatenate(clouds)
    _, first = np.unique(
        np.floor(points / (4.0 * tiles.resolution)).astype(np.int64), axis=0, return_index=True
    )
    return points[np.sort(first)]


def draw_grid(
    path: Path, grid: OccupancyGrid, poses: Array, closures: list[tuple[Array, Array]] | None = None
) -> None:
    """The grid from above with the trajectory (N, 2 | 3) through it and lines between closed places."""
    from matplotlib.backends.backend_agg import FigureCanvasAgg
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
    FigureCanvasAgg(figure).print_png(str(path))


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
        planar = relative if relative.shape == (3,) else _planar(relative)
        rows.append(f"{a:.9f},{b:.9f},{planar[0]:.6f},{planar[1]:.6f},{planar[2]:.6f}")
    return rows


def _planar(matrix: Array) -> Array:
    return np.array([matrix[0, 3], matrix[1, 3], np.arctan2(matrix[1, 0], matrix[0, 0])])
