"""What the labelling of two scans is compared with (section V): the same tasks one after the other.

ICP with K-means, CRF-Matching with K-means, and free-space violation, which says what moved but neither whose it is
nor whereto. Each may begin where the product begins (`Start`), so that a table compares methods and not beginnings.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from estimation.checks import FloatArray
from estimation.geometry.sight import AGREES, THROUGH
from registration.crf.as_printed import PrintedCrf, k_means
from registration.crf.beams import Beams, beams_of, moved, per_beam
from registration.crf.estimate import JointEstimate
from registration.crf.setup import Start
from registration.laser.rigid import rigid_motion
from registration.laser.scan import Scan
from registration.placement.align import align
from registration.result import UNKNOWN

GATE = 0.25  # metres within which ICP's nearest point is taken to be the same


def icp_kmeans(scan_a: Scan, scan_b: Scan, start: Start | None = None) -> JointEstimate:
    """ICP for the associations, K-means on their displacements for the clusters.

    From a start: ICP of every group with its motion, and of the rest.
    """
    a, b = beams_of(scan_a), beams_of(scan_b)
    tree = cKDTree(b.points)
    partners = np.full(len(a), -1, dtype=np.int64)
    if start is None:
        motion = align(scan_a, scan_b, method="icp").transform
        parts = [(np.ones(len(a), dtype=bool), motion)]
    else:
        motion = start.registration.transform
        grouped = np.zeros(len(a), dtype=bool)
        for group in start.found:
            grouped |= group.members
        parts = [(~grouped, motion), *((group.members, group.motion) for group in start.found)]
    for members, begun in parts:
        away, nearest = tree.query(moved(a.points[members], begun))
        partners[members] = np.where(away < GATE, nearest, -1)
    return _by_kmeans(a, b, partners, motion, start)


def matching_kmeans(
    model: PrintedCrf, scan_a: Scan, scan_b: Scan, start: Start | None = None, nearest: int | None = None
) -> JointEstimate:
    """CRF-Matching, its displacements clustered by K-means."""
    a, b = beams_of(scan_a), beams_of(scan_b)
    motion = np.zeros(3) if start is None else start.registration.transform
    return _by_kmeans(a, b, model.match(scan_a, scan_b, start, nearest), motion, start)


def free_space(scan_a: Scan, scan_b: Scan, begun: Start) -> JointEstimate:
    """Background registration; what stands where scan b saw through has moved, each run of such points an object."""
    motion = begun.registration.transform
    _, nearest = cKDTree(begun.b.points).query(moved(begun.a.points, motion))
    clusters = np.where(begun.sight == AGREES, 0, -1)
    free = begun.sight == THROUGH
    fresh = np.flatnonzero(free & np.insert(~free[:-1], 0, True))
    clusters[free] = np.searchsorted(fresh, np.flatnonzero(free), side="right")
    partners = np.where(clusters == 0, nearest, -1)
    motions = np.repeat(motion[None], 1 + int(clusters.max(initial=0)), axis=0)
    return _estimate(begun.a, begun.b, partners, clusters, motions)


def _by_kmeans(
    a: Beams, b: Beams, partners: NDArray[np.int64], background: FloatArray, start: Start | None
) -> JointEstimate:
    """Clusters of displacements; from a start their centres begin at the background's and the groups' own."""
    displacements, told = b.points[partners] - a.points, partners >= 0
    centres = None
    if start is not None:
        groups = [told & (group.members) for group in start.found]
        rest = told & ~np.any([np.zeros(len(a), dtype=bool), *groups], axis=0)
        parts = [part for part in (rest, *groups) if part.any()]
        centres = np.array([displacements[part].mean(axis=0) for part in parts]) if parts else None
    clusters = k_means(displacements, told, centres)
    motions = [background]
    for number in range(int(clusters.max(initial=0)) + 1):
        members = clusters == number
        motion = background
        if members.sum() >= 2:
            motion = rigid_motion(a.points[members], b.points[partners[members]])
        if number == 0:
            motions = [motion]
        else:
            motions.append(motion)
    return _estimate(a, b, partners, clusters, np.array(motions))


def _estimate(
    a: Beams, b: Beams, partners: NDArray[np.int64], clusters: NDArray[np.int64], motions: FloatArray
) -> JointEstimate:
    associations, labels, unknown = per_beam(a, b, partners, clusters, np.full(len(a), np.nan))
    covariances = np.repeat(UNKNOWN[None], len(motions), axis=0)
    return JointEstimate(associations, labels, motions, 0.0, covariances, unknown)
