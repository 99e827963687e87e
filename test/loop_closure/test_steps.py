"""How far odometry steps may be off: predicted ones at both ends, leaps unless what was seen confirms them."""

from __future__ import annotations

import numpy as np
import pytest

from estimation.geometry.poses import between, compound
from loop_closure.graph.steps import DOUBTED, StepDoubt
from loop_closure.keyframes import Keyframes
from loop_closure.slam_config import SlamConfig
from registration.odometry.odometry_step import Step, accumulate
from whereabouts.simulation import Lidar, Shapes, box, joined

CONFIG = SlamConfig()


def room() -> Shapes:
    """A room with a desk, a shelf and a pillar: nothing in it looks the same after a turn."""
    pieces = [
        box(1.6, 0.8, (2.6, 1.9, 0.4)),
        box(0.4, 2.0, (-3.6, 0.5, 0.0)),
        box(0.5, 0.5, (1.0, -2.0, 0.2)),
    ]
    return joined([box(9.0, 6.0), *pieces])


def followed(poses: list[np.ndarray], odometry: list[np.ndarray], covariances: list[np.ndarray | None]):
    """Keyframes at `poses` and the covariances of the steps between them by `odometry`."""
    rng, lidar, world = np.random.default_rng(0), Lidar(361), room()
    doubt, keyframes, steps = StepDoubt(CONFIG), Keyframes(), []
    for pose, here, covariance in zip(poses, odometry, covariances, strict=True):
        if len(keyframes):
            doubt.watch(keyframes[-1].odometry, here)
        before = keyframes[-1].odometry if len(keyframes) else None
        keyframes.add_scan(lidar.scan(world, pose, rng, 0.0).scan, here, CONFIG.max_range)
        if before is not None:
            steps.append(doubt.of(between(before, here), before, covariance, keyframes))
        doubt.arrived(covariance)
    return keyframes, np.array(steps)


def test_both_ends_of_a_predicted_step_hang_loose() -> None:
    poses = [np.array([0.4 * k - 1.0, 0.0, 0.0]) for k in range(5)]
    measured, predicted = np.diag([1e-6, 1e-6, 1e-7]), np.diag([0.2**2, 0.1**2, 0.06**2])
    pose, whole = poses[0], np.zeros((3, 3))
    covariances = [whole]
    for k in range(1, 5):
        step = Step(
            between(pose, poses[k]), predicted if k == 2 else measured, True, "", 1.0, np.zeros((0, 2))
        )
        pose, whole = accumulate(pose, whole, step)
        covariances.append(whole)
    keyframes, steps = followed(poses, poses, covariances)
    away, turned = np.sqrt(steps[:, 0, 0]), np.sqrt(steps[:, 2, 2])
    assert sorted(keyframes.breaks) == [2, 3]
    # Into the scan that was predicted, and from it to the next, which was laid on the map again.
    assert min(away[1:3]) > 0.2 > 0.05 > max(away[0], away[3])
    assert min(turned[1:3]) > 0.06 > 0.02 > max(turned[0], turned[3])


@pytest.mark.parametrize("true", [True, False])
def test_a_leap_is_believed_where_the_scan_fits_there_only(true: bool) -> None:
    poses = [np.array([0.5 * k - 1.5, 0.3, 0.0]) for k in range(4)]
    odometry = list(poses)
    leap = np.array([0.4, 0.1, 1.5])
    # The robot turns as odometry has it, or not at all, while odometry says it did.
    poses.append(compound(poses[-1], leap if true else np.array([0.4, 0.1, 0.0])))
    odometry.append(compound(odometry[-1], leap))
    keyframes, steps = followed(poses, odometry, [None] * 5)
    turned = np.sqrt(steps[-1, 2, 2])
    assert sorted(keyframes.breaks) == ([] if true else [4])
    assert turned < 0.05 if true else turned > DOUBTED * 1.5
