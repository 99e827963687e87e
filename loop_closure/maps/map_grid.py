"""A map as cells and as points, kept up to date while it is being made."""

from __future__ import annotations

from collections.abc import Callable, Container, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from estimation.errors import InputError
from estimation.geometry.grid import RESOLUTION, OccupancyGrid
from estimation.geometry.tiles import VIEW_CELLS, TiledGrid, Tiles, TileView
from loop_closure.keyframes import Keyframe
from loop_closure.slam.trajectory import Slam
from registration.clouds.cloud_registration import thin

Array = NDArray[np.float64]


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

    def __init__(self, resolution: float = RESOLUTION) -> None:
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
        allowed = 0.5 * self.tiles.resolution
        if most is None and self._away(_placed(slam, self._drawn)).max(initial=0.0) > allowed:
            self.update(slam)  # what was drawn anew was drawn where it is not any more

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
        self._changed |= _all_of(self.tiles) | _all_of(anew.tiles)
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
        everything = _all_of(self.tiles)
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


def _all_of(tiles: TiledGrid) -> Tiles:
    return frozenset((j, i) for j, i in tiles.tiles.tolist())


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
    return thin(np.concatenate(clouds), 4.0 * tiles.resolution)
