"""Recordings as places with poses: for `whereabouts loops` and the experiment of that name."""

from __future__ import annotations

import math
from collections.abc import Iterable, Iterator
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from estimation.errors import InputError
from estimation.geometry.poses import between, compound
from evaluation.loops.place_training import Recording
from loop_closure.places.features import BIN_WIDTHS, PlaceFeatures, features_2d
from loop_closure.places.outlines import LENGTH, LocalMap, outline_of_scan
from loop_closure.places.pairs import path_lengths
from loop_closure.places.place_model import TRAINED_RANGE
from registration.laser.scan import Scan
from whereabouts.logs import open_log
from whereabouts.simulation import Drive, Lidar, random_floor
from whereabouts.system.log_errors import NothingRecognisedError

Array = np.ndarray
# Of one building, under different names.
SAME_PLACE = {
    "killian": "mit",
    "infinite-corridor": "mit",
    "intel-corrected": "intel",
    "freiburg-079": "fr079",
}


@dataclass(frozen=True)
class Reading:
    """How a log becomes places.

    step, turn : metres and radians after which a scan is a place. local_map : metres of path in its outline, 0 for the
    scan alone. beams : keep every so many-th beam. limit : places at most, from the start; 0 for all.
    """

    step: float = 0.3
    turn: float = 0.35
    local_map: float = LENGTH
    beams: int = 1
    limit: int = 0


def read_recording(source: str | Path, reading: Reading | None = None) -> Recording:
    """Places of a log with poses: any readable log, or a table of 3D features (.csv).

    `FILE@PLACE` says which building it is of; otherwise its name does. The local maps are put together by the log's
    poses, which over ten metres are what scan matching gives.

    Raises
    ------
    InputError : fewer than two places. NothingRecognisedError : a log whose scans have no poses.
    """
    text, _, environment = str(source).partition("@")
    path, reading = Path(text), reading or Reading()
    name = path.name.partition(".")[0].removesuffix("-corrected")
    environment = environment or SAME_PLACE.get(name, name)
    if path.suffix == ".csv":
        return read_table(path, environment)
    with open_log(path) as log:
        scans = [(record.scan, record.pose, record.sensor_pose) for record in log.scans()]
    posed = [
        (scan, pose if mount is None else compound(pose, mount))
        for scan, pose, mount in scans
        if pose is not None
    ]
    if not posed:
        raise NothingRecognisedError(path, "no scan has a pose, which says what is the same place")
    return recording_of(name, environment, posed, reading)


def recording_of(
    name: str, environment: str, posed: Iterable[tuple[Scan, Array]], reading: Reading
) -> Recording:
    """Places of scans with sensor poses (3,), thinned to one per step or turn."""
    places: list[PlaceFeatures] = []
    kept: list[Array] = []
    lengths: list[float] = []
    around = LocalMap(reading.local_map) if reading.local_map > 0.0 else None
    last: Array | None = None
    travelled = 0.0
    for full, pose in posed:
        scan = full if reading.beams == 1 else every(full, reading.beams)
        moved = 0.0 if last is None else float(np.hypot(*(pose[:2] - last[:2])))
        travelled += moved
        last = pose
        if around is not None:
            if moved > 5.0:
                around.clear()
            around.add(scan, pose)
        if kept:
            motion = between(kept[-1], pose)
            if math.hypot(motion[0], motion[1]) < reading.step and abs(motion[2]) < reading.turn:
                continue
        outline = outline_of_scan(scan) if around is None else around.outline()
        places.append(features_2d(scan, TRAINED_RANGE, outline))
        kept.append(pose)
        lengths.append(travelled)
        if len(places) == reading.limit:
            break
    if len(places) < 2:
        raise InputError(f"recording {name}: at least two places are needed, there are {len(places)}")
    return Recording(name, environment, places, np.array(kept), np.array(lengths))


def every(scan: Scan, beams: int) -> Scan:
    """The scan with every so many-th beam only."""
    return replace(scan, ranges=scan.ranges[::beams].copy(), angle_increment=scan.angle_increment * beams)


def read_table(path: Path, environment: str) -> Recording:
    """Places of `loop_pairs_3d/raw_training_data.csv`: x, y, z, 32 scalar features and 9 range histograms a row.

    Two rows that stand at the same position within a millimetre stay two places.

    Raises InputError for any other table.
    """
    try:
        with path.open(encoding="utf-8") as lines:
            sizes = [int(size) for size in lines.readline().split(",")[1:] if size.strip()]
            rest = lines.readlines()[1:]
        rows = np.loadtxt(rest, delimiter=",", ndmin=2) if rest else np.zeros((0, 3))
    except ValueError as error:
        raise InputError(f"{path}: is no table of 3D features, which a .csv is taken for: {error}") from error
    if len(sizes) != 1 + len(BIN_WIDTHS) or rows.shape[1] != 3 + sum(sizes) or len(rows) < 2:
        raise InputError(
            f"{path}: two places or more of {3 + sum(sizes)} columns expected by the first line, "
            f"there are {len(rows)} of {rows.shape[1]}"
        )
    ends = np.cumsum(sizes[1:])[:-1]
    limit = sizes[1] * BIN_WIDTHS[0]
    features = rows[:, 3 : 3 + sizes[0]]
    places = [
        PlaceFeatures(values, tuple(np.split(counts, ends)), limit)
        for values, counts in zip(features, rows[:, 3 + sizes[0] :], strict=True)
    ]
    return Recording(path.stem, environment, places, rows[:, :2], path_lengths(rows[:, :3]))


def simulated(seed: int, reading: Reading | None = None) -> Recording:
    """A round through a simulated office floor, driven twice; the scanner (180, 270 or 360°) goes by the seed."""
    rng = np.random.default_rng(seed)
    shapes, waypoints = random_floor(rng, rooms=4)
    fields = (math.pi, 1.5 * math.pi, 2.0 * math.pi)
    beams = (181, 541, 360)[seed % 3]
    lidar = Lidar(beams, fields[seed % 3] * (1.0 - 1.0 / beams))
    drive = Drive(np.concatenate((waypoints, waypoints[::-1])), speed=0.6)

    def posed() -> Iterator[tuple[Scan, Array]]:
        for time in np.arange(0.0, drive.duration, 0.4):
            pose = drive(float(time))
            yield lidar.scan(shapes, pose, rng).scan, pose

    return recording_of(f"floor {seed}", "simulated floor", posed(), reading or Reading())
