"""A tree of frames against chains of matrices and scipy's rotations."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.spatial.transform import Rotation, Slerp

from estimation.geometry.frame_tree import FrameTree, TransformError, interpolated, pose_matrix


def test_rotations_between_two_are_scipys_also_where_the_signs_differ() -> None:
    rng = np.random.default_rng(1)
    for _ in range(50):
        a, b = Rotation.random(rng=rng), Rotation.random(rng=rng)
        share = float(rng.random())
        expected = Slerp([0.0, 1.0], Rotation.concatenate([a, b]))(share).as_matrix()
        for sign in (1.0, -1.0):
            between = interpolated(
                np.array([0.0, 0.0, 0.0, *a.as_quat()]),
                np.array([1.0, 2.0, 3.0, *(sign * b.as_quat())]),
                share,
            )
            np.testing.assert_allclose(pose_matrix(between)[:3, :3], expected, atol=1e-12)
            np.testing.assert_allclose(between[:3], share * np.array([1.0, 2.0, 3.0]))


def test_frames_are_found_over_their_common_ancestor() -> None:
    tree, rng = FrameTree(), np.random.default_rng(2)
    left, right = rng.normal(size=(2, 7))
    for pose in (left, right):
        pose[3:] /= np.linalg.norm(pose[3:])
    tree.move("left", "middle", 5, left)
    tree.fix("right", "middle", pose_matrix(right))
    tree.fix("middle", "map", np.eye(4))
    expected = np.linalg.inv(pose_matrix(right)) @ pose_matrix(left)
    np.testing.assert_allclose(tree.lookup("right", "left", 5), expected, atol=1e-12)
    tree.fix("arm", "table", np.eye(4))
    with pytest.raises(TransformError, match="not connected"):
        tree.lookup("map", "arm")
    with pytest.raises(TransformError, match="'leg' is unknown"):
        tree.lookup("map", "leg")
