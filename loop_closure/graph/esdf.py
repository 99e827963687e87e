"""Exactly sparse delayed-state filter: the text's own trajectory estimator (chapter 4, Paper A; Eustice et al. 2006).

An extended information filter over all poses the robot kept. Augmenting by odometry and measuring relative poses only
touch the blocks of the poses they join, so that the information matrix is sparse without approximation:

    augment   x' = x_n ⊕ u, F = J1⊕, W = J2⊕ Q J2⊕ᵀ:   Λ_nn += Fᵀ W⁻¹ F, Λ_nn' = -Fᵀ W⁻¹, Λ_n'n' = W⁻¹,
              η_n -= Fᵀ W⁻¹ (f(μ) - F μ_n),  η_n' = W⁻¹ (f(μ) - F μ_n)
    measure   z = ⊖x_i ⊕ x_j + v, R:                    Λ += Hᵀ R⁻¹ H,  η += Hᵀ R⁻¹ (z - h(μ) + H μ)
    recover   Λ μ = η, by a sparse factorisation

Each measurement is linearised once, where the estimate was when it came: that is what distinguishes it from smoothing.
Headings are kept unwrapped, so that the linear algebra sees no jumps.
"""

from __future__ import annotations

import numpy as np
from scipy.sparse import csc_matrix
from scipy.sparse.linalg import splu

from estimation.checks import FloatArray
from estimation.geometry.poses import (
    between,
    between_jacobians,
    compound,
    compound_jacobians,
    pose_from_matrix,
    pose_to_matrix,
)
from estimation.geometry.rotations import euler_rates_inverse, wrap_angle
from loop_closure.graph.edges import Edge
from loop_closure.motions import planar

ANCHOR = 1e-4  # metres and radians, standard deviation of the first pose


class EsdfGraph:
    """`PoseGraph` by the delayed-state information filter.

    Attributes
    ----------
    edges : as given. mean : (N, 3) x, y, yaw or (N, 6) x, y, z, roll, pitch, yaw.
    """

    def __init__(self) -> None:
        self.edges: list[Edge] = []
        self.mean: FloatArray = np.zeros((0, 3))
        self._planar = True
        self._forget()

    def _forget(self) -> None:
        self._eta: list[FloatArray] = []
        self._blocks: list[tuple[int, int, FloatArray]] = []  # (d, d) that are added to Λ at block i, j

    @property
    def poses(self) -> FloatArray:
        """(N, 3) or (N, 4, 4)."""
        if not self._planar:
            return pose_to_matrix(self.mean)
        out = self.mean.copy()
        out[:, 2] = wrap_angle(out[:, 2])
        return out

    @property
    def information(self) -> csc_matrix:
        """Λ, (Nd, Nd) sparse."""
        within = np.arange(self.mean.shape[1])
        i, j = (np.array([block[k] for block in self._blocks], dtype=int) for k in (0, 1))
        values = np.array([block for _, _, block in self._blocks]).reshape(-1, len(within), len(within))
        rows, columns = np.broadcast_arrays(
            (i[:, None] * len(within) + within)[:, :, None], (j[:, None] * len(within) + within)[:, None, :]
        )
        size = self.mean.size
        return csc_matrix((values.ravel(), (rows.ravel(), columns.ravel())), shape=(size, size))

    @property
    def vector(self) -> FloatArray:
        """η, (Nd,)."""
        return np.concatenate(self._eta)

    def begin(self, pose: FloatArray) -> None:
        """The first node; it stays where it is."""
        self.edges = []
        self._planar = planar(pose)
        self._forget()
        start = pose.copy() if self._planar else pose_from_matrix(pose)
        self.mean = start[None, :]
        W = np.eye(len(start)) / ANCHOR**2
        self._blocks.append((0, 0, W))
        self._eta.append(W @ start)

    def extend(self, step: FloatArray, covariance: FloatArray) -> int:
        """Augment by a node at `step` from the last; returns its number."""
        edge = Edge(len(self.mean) - 1, len(self.mean), step, covariance)
        self.edges.append(edge)
        return self._augment(edge)

    def _augment(self, edge: Edge) -> int:
        n = len(self.mean) - 1
        u, Q = self._measurement(edge)
        last = self.mean[n]
        # As the angles of the last pose run, without jumps.
        made = _unwrapped(compound(last, u), last)
        F, J2 = compound_jacobians(last, u)
        inverse: FloatArray = np.asarray(np.linalg.inv(J2 @ Q @ J2.T))
        offset = made - F @ last
        self._blocks += [(n, n, F.T @ inverse @ F), (n, n + 1, -F.T @ inverse)]
        self._blocks += [(n + 1, n, -inverse @ F), (n + 1, n + 1, inverse)]
        self._eta[n] = self._eta[n] - F.T @ inverse @ offset
        self._eta.append(inverse @ offset)
        self.mean = np.vstack((self.mean, made))
        return n + 1

    def close(self, edges: list[Edge]) -> None:
        """Measure relative poses and recover the state."""
        self.edges += edges
        for edge in edges:
            self._measure(edge)
        self._recover()

    def _measure(self, edge: Edge) -> None:
        i, j = edge.a, edge.b
        z, R = self._measurement(edge)
        predicted = between(self.mean[i], self.mean[j])
        Hi, Hj = between_jacobians(self.mean[i], self.mean[j])
        innovation = z - predicted
        first = 2 if self._planar else 3
        innovation[first:] = wrap_angle(innovation[first:])
        inverse = np.linalg.inv(R)
        target = innovation + Hi @ self.mean[i] + Hj @ self.mean[j]
        for a, H in ((i, Hi), (j, Hj)):
            for b, G in ((i, Hi), (j, Hj)):
                self._blocks.append((a, b, H.T @ inverse @ G))
            self._eta[a] = self._eta[a] + H.T @ inverse @ target

    def settle(self, without: set[int] | None = None) -> None:
        """Nothing is linearised anew; without some edges, the filter is run again over the others."""
        if not without:
            return
        kept = [edge for number, edge in enumerate(self.edges) if number not in without]
        self._rerun(self.poses[0], kept)

    def restore(self, poses: FloatArray, edges: list[Edge]) -> None:
        """Run over saved edges again."""
        self._rerun(poses[0], edges)

    def _rerun(self, first: FloatArray, edges: list[Edge]) -> None:
        self.begin(first)
        self.edges = list(edges)
        fresh = False
        for edge in edges:
            if edge.closure:
                self._measure(edge)
                fresh = True
                continue
            if fresh:
                self._recover()
                fresh = False
            self._augment(edge)
        self._recover()

    def _recover(self) -> None:
        self.mean = np.asarray(splu(self.information).solve(self.vector)).reshape(self.mean.shape)

    def _measurement(self, edge: Edge) -> tuple[FloatArray, FloatArray]:
        """The motion as a state difference and its covariance; in space of Euler angles instead of a turn vector."""
        if self._planar:
            return edge.motion, edge.covariance
        motion = pose_from_matrix(edge.motion)
        turn = np.eye(6)
        turn[3:, 3:] = euler_rates_inverse(motion[3:])
        return motion, turn @ edge.covariance @ turn.T


def _unwrapped(pose: FloatArray, near: FloatArray) -> FloatArray:
    """Angles moved by whole turns to where they are closest to those of `near`."""
    first = 2 if len(pose) == 3 else 3
    out = pose.copy()
    out[first:] = near[first:] + wrap_angle(pose[first:] - near[first:])
    return out
