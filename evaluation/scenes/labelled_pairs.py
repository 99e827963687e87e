"""Pairs of scans of one scene with movers, with the truth of the joint model: who is who, what moves, and how.

Every outline of the first scan is known again in the second, so the true association of a beam is the beam that
hit the same thing nearest to where the first beam's spot has moved to. Spots that no beam of the second scan is
near to, and spurious readings, are outliers.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from estimation.geometry.poses import compound, inverse
from evaluation.scenes.streets import LANE, SCENES, traffic
from registration.laser.scan import Scan
from whereabouts.simulation.lidar import Lidar
from whereabouts.simulation.movers import Mover, outlines
from whereabouts.simulation.rays import cast_shapes
from whereabouts.simulation.shapes import Array, Shapes, joined

NEAR = 0.6  # of the distance between two beams of the second scan: how near a beam has to be to be associated
LEAST_NEAR = 0.03  # metres
FARTHEST = 1.0  # metres between neighbouring spots of one surface
LEAST_BEAMS = 4  # of a mover, to be an object of its own
INTERVALS = {
    "street": 0.12,
    "hall": 0.4,
    "office": 0.4,
    "crowd": 0.5,
}  # seconds: cars are seen again sooner than people
CROWD = 8  # movers
SICK = Lidar(361, np.pi, range_max=40.0)


@dataclass(frozen=True, eq=False)
class LabelledPair:
    """Two scans and the truth about the beams of the first, in the conventions of `registration.crf`.

    associations : (N,) beam of `scan_b` that sees the same spot, -1 outlier or no return.
    clusters : (N,) 0 background, 1.. objects, -1 outlier or no return.
    owners : (N,) what each beam hit: 0 building, movers from 1, -1 no return, -2 spurious.
    motions : (D, 3) of background and objects: where points of scan_a are in the frame of scan_b.
    movers : (D - 1,) owner of each object.
    interval : seconds between the scans. sequence : number of the run of scans the pair is from.
    """

    scan_a: Scan
    scan_b: Scan
    associations: NDArray[np.int64]
    clusters: NDArray[np.int64]
    owners: NDArray[np.int64]
    motions: Array
    movers: NDArray[np.int64]
    interval: float
    scene: str = ""
    sequence: int = 0

    @property
    def valid(self) -> NDArray[np.bool_]:
        """Beams of scan_a that returned, (N,)."""
        return self.scan_a.valid

    @property
    def moving(self) -> NDArray[np.bool_]:
        """Beams of scan_a that hit something that moves, (N,), associated or not."""
        return self.owners > 0


@dataclass(frozen=True, eq=False)
class _Look:
    """A scan with what each beam hit (outline number, -1 nothing, -2 spurious) and where, without noise."""

    scan: Scan
    pose: Array
    hits: NDArray[np.int64]
    spots: Array
    shapes: Shapes

    @property
    def owners(self) -> NDArray[np.int64]:
        every = np.concatenate((self.shapes.segment_owners, self.shapes.circle_owners, [-2, -1]))
        return every[self.hits]


def _look(
    shapes: Shapes, pose: Array, lidar: Lidar, rng: np.random.Generator, stamp: float, spurious: float
) -> _Look:
    angles = pose[2] + lidar.bearings
    ranges, hits = cast_shapes(shapes, pose[:2], angles, lidar.range_max)
    spots = pose[:2] + np.where(hits >= 0, ranges, 0.0)[:, None] * np.column_stack(
        (np.cos(angles), np.sin(angles))
    )
    read = ranges + lidar.sigma * rng.standard_normal(lidar.beams)
    false = (rng.random(lidar.beams) < spurious) & (hits >= 0)
    read = np.where(false, read * rng.uniform(0.2, 0.97, lidar.beams), read)
    hits = np.where(false, -2, hits)
    gone = ~np.isfinite(read) | (rng.random(lidar.beams) < lidar.dropout)
    gone |= (np.nan_to_num(read, posinf=0.0) < lidar.range_min) | (read >= lidar.range_max)
    read[gone], hits[gone] = lidar.range_max, -1
    step = lidar.opening / (lidar.beams - 1)
    scan = Scan(read, -0.5 * lidar.opening, step, lidar.range_min, lidar.range_max, stamp)
    return _Look(scan, pose, hits, spots, shapes)


def _carried(look: _Look, shapes: Shapes) -> Array:
    """(N, 2) where the spots of `look` are when its outlines are at `shapes`; NaN where nothing was hit."""
    then, moved = look.shapes, np.full((len(look.hits), 2), np.nan)
    count = len(then.segments)
    on_segment = (look.hits >= 0) & (look.hits < count)
    k = look.hits[on_segment]
    start, along = then.segments[k, :2], then.segments[k, 2:] - then.segments[k, :2]
    share = np.einsum("ij,ij->i", look.spots[on_segment] - start, along) / np.einsum("ij,ij->i", along, along)
    moved[on_segment] = shapes.segments[k, :2] + share[:, None] * (
        shapes.segments[k, 2:] - shapes.segments[k, :2]
    )
    on_circle = look.hits >= count
    k = look.hits[on_circle] - count
    moved[on_circle] = look.spots[on_circle] - then.circles[k, :2] + shapes.circles[k, :2]
    return moved


def _associate(a: _Look, b: _Look) -> NDArray[np.int64]:
    """True beam of `b` for every beam of `a`, -1 without one."""
    moved, owners, others = _carried(a, b.shapes), a.owners, b.owners
    # How far apart beams land on a surface: to the farther neighbour on the same thing.
    gap = np.linalg.norm(np.diff(b.spots, axis=0), axis=1)
    gap = np.where((others[1:] == others[:-1]) & (others[1:] >= 0) & (gap < FARTHEST), gap, 0.0)
    spacing = np.maximum(np.append(gap, 0.0), np.insert(gap, 0, 0.0))
    found = np.full(len(owners), -1, dtype=np.int64)
    for i in np.flatnonzero(owners >= 0):
        same = np.flatnonzero(others == owners[i])
        if len(same):
            away = np.linalg.norm(b.spots[same] - moved[i], axis=1)
            best = int(np.argmin(away))
            if away[best] <= max(NEAR * spacing[same[best]], LEAST_NEAR):
                found[i] = same[best]
    return found


def labelled(
    building: Shapes,
    movers: list[Mover],
    poses: tuple[Array, Array],
    times: tuple[float, float],
    lidar: Lidar,
    rng: np.random.Generator,
    spurious: float = 0.0,
) -> LabelledPair:
    """The pair of scans taken at two poses (3,) and times (s), `spurious` of the readings falsely short."""
    a, b = (
        _look(joined([building, outlines(movers, time)]), pose, lidar, rng, time, spurious)
        for pose, time in zip(poses, times, strict=True)
    )
    associations = _associate(a, b)
    background = compound(inverse(poses[1]), poses[0])
    clusters = np.where(associations >= 0, 0, -1)
    motions, owners = [background], []
    for owner, mover in enumerate(movers, start=1):
        members = (a.owners == owner) & (associations >= 0)
        if members.sum() < LEAST_BEAMS:
            clusters[members], associations[members] = -1, -1
            continue
        owners.append(owner)
        clusters[members] = len(owners)
        world = compound(_body(mover, times[1]), inverse(_body(mover, times[0])))
        motions.append(compound(compound(inverse(poses[1]), world), poses[0]))
    return LabelledPair(
        a.scan, b.scan, associations, clusters, a.owners, np.array(motions), np.array(owners, dtype=np.int64),
        times[1] - times[0],
    )  # fmt: skip


def _body(mover: Mover, time: float) -> Array:
    """Pose of a mover; what looks the same from all sides does not turn."""
    pose = mover.pose(time)
    return pose if mover.kind == "box" else np.array([*pose[:2], mover.start[2]])


def _run(
    scene: str, rng: np.random.Generator, length: int, interval: float, lidar: Lidar, spurious: float
) -> list[LabelledPair] | None:
    """`length` consecutive pairs in one scene, None where the ego or a mover would run into something."""
    building = SCENES[scene](rng)
    movers = traffic(rng, scene, CROWD if scene == "crowd" else int(rng.integers(1, 6)))
    if scene == "street":
        speed, heading = rng.uniform(0.0, 6.0), rng.uniform(-0.05, 0.05)
        start = np.array([rng.uniform(-4.0, 0.0), -LANE + rng.uniform(-0.4, 0.4), heading])
    else:
        speed, heading = rng.uniform(0.0, 1.0), rng.uniform(-np.pi, np.pi)
        start = np.array([*rng.uniform(-1.0, 1.0, 2), heading])
    turn = rng.uniform(-0.05, 0.05) if scene == "street" else rng.uniform(-0.5, 0.5)
    times = interval * np.arange(length + 1)
    poses = [
        start + np.array([speed * t * np.cos(heading), speed * t * np.sin(heading), turn * t]) for t in times
    ]
    clear = 2.0 if scene == "street" else 0.5
    for time, pose in zip(times, poses, strict=True):
        if building.distance(pose[:2]) < min(clear, 1.2) or outlines(movers, time).distance(pose[:2]) < clear:
            return None
        # A mover in a wall, or within another, is no scene; a crowd is never without.
        for k, mover in enumerate(movers if scene != "crowd" else []):
            rest = joined([building, outlines(movers[:k] + movers[k + 1 :], time)])
            if rest.distance(mover.pose(time)[:2]) < 0.5 * (mover.width if mover.kind == "box" else 0.6):
                return None
    return [
        replace(labelled(building, movers, (poses[k], poses[k + 1]), (times[k], times[k + 1]), lidar, rng, spurious),
                scene=scene)
        for k in range(length)
    ]  # fmt: skip


def random_labelled_pairs(
    rng: np.random.Generator,
    scene: str,
    count: int,
    length: int = 1,
    interval: float | None = None,
    lidar: Lidar = SICK,
    spurious: float = 0.02,
) -> list[LabelledPair]:
    """`count` runs of `length` pairs each with at least one visible mover in every run; scene: see `SCENES`."""
    pairs: list[LabelledPair] = []
    sequence = 0
    interval = INTERVALS[scene] if interval is None else interval
    while sequence < count:
        run = _run(scene, rng, length, interval, lidar, spurious)
        if run is None or not any(len(pair.movers) for pair in run):
            continue
        pairs += [replace(pair, sequence=sequence) for pair in run]
        sequence += 1
    return pairs


def protocol(seed: int = 0) -> list[LabelledPair]:
    """31 pairs in 8 sequences like the text's: streets seen by a 361-beam scanner on a car, 11 % outliers."""
    rng = np.random.default_rng(seed)
    pairs: list[LabelledPair] = []
    for sequence, length in enumerate((4, 4, 4, 4, 4, 4, 4, 3)):
        run = random_labelled_pairs(rng, "street", 1, length, spurious=0.008)
        pairs += [replace(pair, sequence=sequence) for pair in run]
    return pairs
