"""A robot that drives among people, and odometry that leaves out what moved, as the node `scan_registration` does."""

from __future__ import annotations

from collections.abc import Iterable

import numpy as np
from numpy.typing import NDArray

from estimation.geometry.poses import compound
from evaluation.scenes.people_scenes import PeopleScene
from registration import Odometry, Scan
from registration.crf.online import ScanSegmenter
from whereabouts.logs import ScanRecord
from whereabouts.simulation import Wheels

Array = NDArray[np.float64]


class WithoutMovers:
    """`Odometry` that is given each scan without what moved in the one before."""

    def __init__(self) -> None:
        self._odometry, self._segmenter = Odometry(), ScanSegmenter(in_time=False)

    @property
    def unsure(self) -> bool:
        return self._odometry.unsure

    def register(self, measurement: Scan, stamp: float, guess: Array | None = None) -> Array:
        """As `Odometry.register`."""
        odometry, segmenter = self._odometry, self._segmenter
        motion = odometry.increment if guess is None else guess
        still = segmenter.still(measurement, stamp, compound(odometry.pose, motion))
        pose = odometry.register(still, stamp, guess)
        segmenter.segment(measurement, stamp, pose)
        segmenter.keep(measurement, stamp, pose)
        return pose


def drive_among(scene: PeopleScene, rng: np.random.Generator) -> tuple[list[ScanRecord], Array]:
    """Scans of a scene, with wheel odometry, and the true poses."""
    return with_wheels(((seen.scan, seen.pose) for seen in scene.scans(rng)), rng)


def with_wheels(
    scans: Iterable[tuple[Scan, Array]], rng: np.random.Generator
) -> tuple[list[ScanRecord], Array]:
    """Records of scans at their true poses (3,), with the odometry of wheels, and these poses."""
    wheels, reported = Wheels(), np.zeros(3)
    records: list[ScanRecord] = []
    truth: list[Array] = []
    for scan, pose in scans:
        if truth:
            reported = compound(reported, wheels.motion(truth[-1], pose, rng))
        records.append(ScanRecord(scan, scan.stamp, odometry=reported))
        truth.append(pose)
    return records, np.array(truth)
