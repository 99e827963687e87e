"""Partitions that distances alone do not find, for targets that meet: the proposal at the end of Section 5.2.

Returns of targets closer than their spread are one cell at every threshold. They are divided here in two ways: among
the targets predicted nearby, and into as many clusters as their number suggests (n/γ), for targets nobody predicts.
"""

from __future__ import annotations

import numpy as np
import numpy.typing as npt
from scipy.special import chdtri

from estimation.checks import FloatArray
from tracking.mixture.components import IntArray
from tracking.mixture.hypothesis_kernels import squares
from tracking.mixture.phd_config import PhdConfig
from tracking.phd.partition_kernels import assign_to_targets, k_means
from tracking.phd.partitions import Choice, PartitionBuilder, PredictedTargets

# A cell of this many times a target's returns is suspected to hold more than one.
CROWDED = 1.5
# Sweeps of expectation and maximisation over a group of returns; they settle in two or three.
SWEEPS = 3


class Subpartitions:
    """Divides a group's returns by predicted targets and by likely counts."""

    def __init__(self, config: PhdConfig) -> None:
        self.gamma = config.measurement_rate
        self.variance = config.measurement_noise**2
        self.clutter = config.clutter_rate / config.area
        self.gate_square = float(chdtri(2, 1.0 - config.gate_probability))
        self.count = config.count_reassignments

    def gate(self, points: FloatArray, targets: PredictedTargets) -> npt.NDArray[np.bool_]:
        """Which returns (K, N) each target may have caused."""
        S = targets.covariances + self.variance * np.eye(2)
        return np.asarray(
            squares(points, targets.means, S[:, 0, 0], S[:, 0, 1], S[:, 1, 1]) < self.gate_square
        )

    def choices(
        self,
        points: FloatArray,
        indices: IntArray,
        targets: PredictedTargets,
        near: IntArray,
        cuts: list[Choice],
        builder: PartitionBuilder,
    ) -> list[Choice]:
        """Further partitions of the returns `indices`: `near` are the targets that gate any of them."""
        found: list[Choice] = []
        if len(near):
            found.append(self._by_targets(points, indices, targets, near, builder))
        divided: dict[int, tuple[list[int], float]] = {}
        for cells, multiplicity in [*cuts, *found]:
            crowded = [cell for cell in cells if builder.size(cell) >= CROWDED * self.gamma]
            if not crowded:
                continue
            parts = [cell for cell in cells if cell not in crowded]
            for cell in crowded:
                if cell not in divided:
                    divided[cell] = self._by_count(points, cell, builder)
                parts += divided[cell][0]
                multiplicity += divided[cell][1]
            found.append((tuple(parts), multiplicity))
        return found

    def _by_targets(
        self,
        points: FloatArray,
        indices: IntArray,
        targets: PredictedTargets,
        near: IntArray,
        builder: PartitionBuilder,
    ) -> Choice:
        """Every return to the target it most likely came from, what is likelier clutter alone.

        The targets' positions are corrected by their share of the returns before the last decision.
        """
        owner, share = assign_to_targets(
            points[indices],
            targets.means[near],
            targets.covariances[near],
            self.variance,
            self.gamma,
            self.clutter,
            SWEEPS,
        )
        cells = [builder.cell(indices[owner == k]) for k in np.unique(owner) if k > 0]
        cells += [builder.cell(indices[i : i + 1]) for i in np.flatnonzero(owner == 0)]
        return tuple(cells), self._reassignments(share)

    def _by_count(self, points: FloatArray, cell: int, builder: PartitionBuilder) -> tuple[list[int], float]:
        """The cell in n/γ clusters."""
        members = builder.members(cell)
        number = max(2, round(len(members) / self.gamma))
        z = points[members]
        cluster, centres = k_means(z, number, 10)
        parts = [builder.cell(members[cluster == k]) for k in range(number) if (cluster == k).any()]
        likelihoods = np.exp(-0.5 / self.variance * _nearest(((z[:, None] - centres) ** 2).sum(-1)))
        return parts, self._reassignments(likelihoods.max(1) / likelihoods.sum(1))

    def _reassignments(self, share: FloatArray) -> float:
        """Log of the weight of all ways to reassign single returns, relative to the likeliest way.

        Over targets at known places the returns are independent: the sum over all assignments is the product of
        each return's likelihood; `share` (n,) is the part of it that the likeliest origin has.
        """
        return float(-np.log(share).sum()) if self.count else 0.0


def _nearest(squares: FloatArray) -> FloatArray:
    """Squared distances less the smallest of each row, so that no row of likelihoods underflows."""
    return squares - squares.min(1, keepdims=True)
