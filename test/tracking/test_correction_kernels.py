"""The compiled correction and merging of tracks against their matrices."""

from __future__ import annotations

import numpy as np
import pytest

from tracking.mixture import association_kernels as kernels
from tracking.mixture.correction_kernels import Exactness, States, correct, moments


def states(rng: np.random.Generator, count: int) -> States:
    root = rng.normal(size=(count, 4, 4))
    return States(
        rng.normal(size=(count, 4)),
        root @ np.swapaxes(root, 1, 2) + 0.1 * np.eye(4),
        rng.uniform(1.0, 3.0, (count, 2)),
        np.tile(np.eye(2), (count, 1, 1)),
        rng.uniform(1.0, 3.0, count),
    )


def test_a_corrected_track_is_that_of_the_matrices() -> None:
    """One track of two returns, half hidden, and one of a single exact return; a third is left alone."""
    rng = np.random.default_rng(0)
    tracks = states(rng, 3)
    means, covariances = tracks.means.copy(), tracks.covariances.copy()
    cells = np.array([[2.0, 0.3, -0.2, 0.4, 0.1, 0.5, 0.2, 0.05, 0.1], [1.0, 1.0, 2.0, *np.zeros(6)]])
    table = np.zeros((2, kernels.COLUMNS))
    table[:, [kernels.XXX, kernels.XXY, kernels.XYY]] = 0.5, 0.1, 0.4
    looks = Exactness(np.array([[0.0, 0.0], [1.0, 2.0]]), np.array([1.0, 4.0]))
    shares = np.array([0.6, 1.0])
    correct(tracks, np.array([2, 0]), cells, table, shares, looks, -0.8)
    X, H = np.array([[0.5, 0.1], [0.1, 0.4]]), np.eye(2, 4)
    for row, cell, spread in ((2, cells[0], 0.2 / 2.0 + 0.4), (0, cells[1], 1.0 / 4.0)):
        P, R = covariances[row], spread * X
        doubt = np.array([[cell[6], cell[7]], [cell[7], cell[8]]]) / cell[0] ** 2
        K = P @ H.T @ np.linalg.inv(P[:2, :2] + R)
        keep = np.eye(4) - K @ H
        np.testing.assert_allclose(tracks.means[row], means[row] + K @ (cell[1:3] - means[row, :2]))
        np.testing.assert_allclose(tracks.covariances[row], keep @ P @ keep.T + K @ (R + doubt) @ K.T)
    np.testing.assert_array_equal(tracks.covariances[1], covariances[1])
    np.testing.assert_allclose(tracks.spread[2], [[1.4, 0.1], [0.1, 1.5]])


def test_merged_tracks_have_the_moments_of_their_mixture() -> None:
    rng = np.random.default_rng(1)
    tracks, weights, target = states(rng, 4), np.array([0.5, 0.2, 0.3, 0.0]), np.array([0, 1, 0, 3])
    totals, merged = moments(tracks, weights, target)
    assert totals.tolist() == pytest.approx([0.8, 0.2, 0.0, 0.0])
    share, both = np.array([0.625, 0.375]), [0, 2]
    mean = share @ tracks.means[both]
    gaps = tracks.means[both] - mean
    np.testing.assert_allclose(merged.means[0], mean)
    np.testing.assert_allclose(
        merged.covariances[0],
        np.einsum("k,kij->ij", share, tracks.covariances[both] + gaps[:, :, None] * gaps[:, None]),
    )
    np.testing.assert_allclose(merged.covariances[1], tracks.covariances[1])
    assert not merged.means[2].any()
