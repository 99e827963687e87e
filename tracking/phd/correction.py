"""The correction (7) to (10) of Paper B, with cell likelihoods factorised and partition weights in the log domain.

A cell of n returns z with mean z̄ and scatter Σ = Σ (z - z̄)(z - z̄)ᵀ under a linear Gaussian target has the stacked
likelihood (9d)

    N(z_W; H_W m, H_W P H_Wᵀ + R_W)
        = N(z̄; H m, H P Hᵀ + R/n) · |2πR|^(-(n-1)/2) · n^(-d/2) · exp(-½ tr R⁻¹Σ)

exactly, and (10) is the update with z̄ and R/n: no matrix grows with the cell.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numba import njit

from estimation.checks import FloatArray
from estimation.filters.gaussians import LOG_TWO_PI
from tracking.mixture.components import Components, IntArray
from tracking.mixture.phd_config import PhdConfig
from tracking.mixture.phd_models import OneReturn, PoissonCount, PositionMeasurement, Sight
from tracking.phd.partitions import Partitions


@dataclass
class CellStatistics:
    """Numbers of returns (C,), means (C, 2) and scatters (C, 2, 2) of the cells."""

    counts: FloatArray
    means: FloatArray
    scatters: FloatArray

    @classmethod
    def of(cls, points: FloatArray, partitions: Partitions) -> CellStatistics:
        """The statistics of all cells, scatter about the mean in two passes for precision."""
        sizes = np.diff(partitions.starts)
        if len(sizes) == 0:
            return cls(np.zeros(0), np.zeros((0, 2)), np.zeros((0, 2, 2)))
        z = points[partitions.members]
        means = np.add.reduceat(z, partitions.starts[:-1]) / sizes[:, None]
        offsets = z - np.repeat(means, sizes, axis=0)
        outer = offsets[:, :, None] * offsets[:, None, :]
        return cls(sizes.astype(np.float64), means, np.add.reduceat(outer, partitions.starts[:-1]))


def cell_log_factor(cells: CellStatistics, R: FloatArray) -> FloatArray:
    """Log of what remains of (9d) beside the centroid's Gaussian, (C,)."""
    n, d = cells.counts, R.shape[0]
    volume = d * LOG_TWO_PI + np.linalg.slogdet(R)[1]
    spread = np.einsum("ij,cji->c", np.linalg.inv(R), cells.scatters)
    result: FloatArray = -0.5 * ((n - 1) * volume + d * np.log(n) + spread)
    return result


def partition_log_weights(log_d: FloatArray, partitions: Partitions) -> tuple[FloatArray, FloatArray]:
    """(9e): log ω of each partition within its group, and of each cell being in the true partition.

    Groups are independent, so normalising each by itself normalises their product. Returns (partitions,), (C,).
    """
    products = np.bincount(partitions.partition, log_d[partitions.cell], len(partitions.group))
    totals: FloatArray = products + partitions.multiplicity
    log_omega = totals - _group_logsumexp(totals, partitions.group)[partitions.group]
    inside = np.bincount(partitions.cell, np.exp(log_omega)[partitions.partition], len(log_d))
    with np.errstate(divide="ignore"):
        return log_omega, np.log(inside)


def _group_logsumexp(values: FloatArray, groups: IntArray) -> FloatArray:
    """Log of the sum of exponentials by group, groups in ascending order."""
    if len(values) == 0:
        return np.zeros(0)
    starts = np.concatenate([[0], np.flatnonzero(np.diff(groups)) + 1])
    top = np.maximum.reduceat(values, starts)
    result: FloatArray = top + np.log(np.add.reduceat(np.exp(values - top[groups]), starts))
    return result


@njit(cache=True)
def centroid_log_likelihood(
    centroids: FloatArray, counts: FloatArray, means: FloatArray, P: FloatArray, R: FloatArray
) -> FloatArray:
    """log N(z̄_c; m_j, P_j + R / n_c) (C, J) of centroids (C, 2) under positions (J, 2), (J, 2, 2)."""
    out = np.empty((len(centroids), len(means)))
    for c in range(len(centroids)):
        share = 1.0 / counts[c]
        for j in range(len(means)):
            a = P[j, 0, 0] + R[0, 0] * share
            b = P[j, 0, 1] + R[0, 1] * share
            d = P[j, 1, 1] + R[1, 1] * share
            determinant = a * d - b * b
            x, y = centroids[c, 0] - means[j, 0], centroids[c, 1] - means[j, 1]
            square = (d * x * x - 2.0 * b * x * y + a * y * y) / determinant
            out[c, j] = -0.5 * (square + math.log(determinant)) - LOG_TWO_PI
    return out


class Corrector:
    """Turns the predicted intensity and a partitioned scan into the corrected intensity."""

    def __init__(
        self, config: PhdConfig, measurement: PositionMeasurement, returns: PoissonCount | OneReturn
    ) -> None:
        self.measurement, self.returns = measurement, returns
        self.log_clutter = float(np.log(config.clutter_rate / config.area))
        # One joined gate for the centroid: outside it a pair weighs nothing.
        self.log_floor = float(np.log(max(config.prune_weight, 1e-12))) - 7.0

    def correct(
        self,
        predicted: Components,
        sight: Sight,
        points: FloatArray,
        partitions: Partitions,
    ) -> Components:
        """The corrected intensity (7): missed components (8), then one per cell and component (9)."""
        missed = predicted.select(np.arange(len(predicted)))
        missed.weights *= 1.0 - self.returns.seen(sight.share) * sight.probability
        missed.means, missed.covariances = sight.means, sight.covariances
        if len(points) == 0 or len(predicted) == 0:
            return missed
        cells = CellStatistics.of(points, partitions)
        log_pairs = self._log_pairs(predicted, sight, cells)
        alone = np.where(cells.counts == 1, 0.0, -np.inf)
        log_d = np.logaddexp(alone, np.logaddexp.reduce(log_pairs, axis=1))
        # A cell nothing explains is impossible, yet a group must keep a partition to be normalised by.
        log_d = np.maximum(log_d, -1e6 * cells.counts)
        _, log_inside = partition_log_weights(log_d, partitions)
        log_weights = (log_inside - log_d)[:, None] + log_pairs
        c, j = np.nonzero(log_weights > self.log_floor)
        return Components.join([missed, self._detected(predicted, cells, c, j, np.exp(log_weights[c, j]))])

    def _log_pairs(self, predicted: Components, sight: Sight, cells: CellStatistics) -> FloatArray:
        """Log of Γ p_D Φ w (C, J): the summands of (9f)."""
        H, R = self.measurement.H, self.measurement.R
        log_phi = centroid_log_likelihood(
            cells.means, cells.counts, predicted.means @ H.T, H @ predicted.covariances @ H.T, R
        )
        by_cell = cell_log_factor(cells, R) - cells.counts * self.log_clutter
        with np.errstate(divide="ignore"):
            by_component = np.log(predicted.weights * sight.probability)
        result: FloatArray = (
            log_phi + by_cell[:, None] + by_component + self.returns.log_weight(cells.counts, sight.share)
        )
        return result

    def _detected(
        self, predicted: Components, cells: CellStatistics, c: IntArray, j: IntArray, weights: FloatArray
    ) -> Components:
        """The Kalman update (10) of components j by cells c."""
        H, n = self.measurement.H, cells.counts[c]
        R = self.measurement.R / n[:, None, None]
        P, m = predicted.covariances[j], predicted.means[j]
        PHt = P @ H.T
        gain = PHt @ np.linalg.inv(H @ PHt + R)
        keep = np.eye(P.shape[-1]) - gain @ H
        covariances = keep @ P @ np.swapaxes(keep, 1, 2) + gain @ R @ np.swapaxes(gain, 1, 2)
        return Components(
            weights,
            m + (gain @ (cells.means[c] - m @ H.T)[..., None])[..., 0],
            0.5 * (covariances + np.swapaxes(covariances, 1, 2)),
            predicted.labels[j],
            predicted.counts[j] + np.column_stack([n, np.ones(len(n))]),
            predicted.spread[j] + cells.scatters[c],
            predicted.freedom[j] + n - 1.0,
        )
