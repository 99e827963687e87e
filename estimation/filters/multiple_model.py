"""Interacting multiple models (Blom, Bar-Shalom 1988): one Kalman filter per motion model, mixed each step."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt
from scipy.special import logsumexp

from estimation.checks import FloatArray, as_finite, as_square, as_vectors
from estimation.errors import InputError
from estimation.filters import kalman
from estimation.filters.gaussians import GaussianMixture, repair_covariance


class MultipleModelFilter:
    """State of M models: `means` (M, d), `covariances` (M, d, d), `probabilities` (M,).

    transition : (M, M), row i the probabilities of passing from model i to each; rows add up to 1. means, covariances :
    (M, d), (M, d, d), or (d,), (d, d) where all models start alike. Raises InputError naming the argument.
    """

    def __init__(
        self,
        transition: npt.ArrayLike,
        probabilities: npt.ArrayLike,
        means: npt.ArrayLike,
        covariances: npt.ArrayLike,
    ) -> None:
        self.probabilities = as_finite("probabilities", probabilities)
        models = self.probabilities.size
        if self.probabilities.ndim != 1 or (self.probabilities < 0).any():
            raise InputError("probabilities must be (M,) numbers of at least 0")
        if not np.isclose(self.probabilities.sum(), 1.0):
            raise InputError("probabilities must add up to 1")
        self.transition = as_square("transition", transition, models)
        if (self.transition < 0).any() or not np.allclose(self.transition.sum(1), 1.0):
            raise InputError("transition must hold probabilities; each row must add up to 1")
        mean = as_vectors("means", means)
        d = mean.shape[-1]
        self.means = np.array(np.broadcast_to(mean, (models, d)))
        P = repair_covariance(covariances, "covariances")
        self.covariances = np.array(np.broadcast_to(P, (models, d, d)))

    def predict(self, F: npt.ArrayLike, Q: npt.ArrayLike) -> None:
        """Mix the models by their transitions, then predict each with its F and Q, (M, d, d)."""
        # joint[i, j]: being in model i before and in model j now.
        joint = self.probabilities[:, None] * self.transition
        self.probabilities = joint.sum(0)
        shares = joint / np.where(self.probabilities > 0, self.probabilities, 1.0)
        mixed = shares.T @ self.means
        offsets = self.means[:, None] - mixed[None]
        spread = np.einsum("ij,ija,ijb->jab", shares, offsets, offsets)
        inner = np.einsum("ij,iab->jab", shares, self.covariances)
        # A model nobody can enter keeps a valid state of its own.
        idle = self.probabilities == 0
        mixed[idle] = self.means[idle]
        covariances = np.where(idle[:, None, None], self.covariances, inner + spread)
        self.means, self.covariances = kalman.predict(mixed, covariances, F, Q)

    def update(self, z: npt.ArrayLike, H: npt.ArrayLike, R: npt.ArrayLike) -> float:
        """Kalman update of every model; returns log p(z | past). z (m,), H (m, d), R (m, m)."""
        z = as_vectors("z", z)
        self.means, self.covariances, log_likelihood = kalman.update(self.means, self.covariances, z, H, R)
        with np.errstate(divide="ignore"):
            joint = np.log(self.probabilities) + log_likelihood
        evidence = float(logsumexp(joint))
        self.probabilities = np.exp(joint - evidence)
        return evidence

    @property
    def mixture(self) -> GaussianMixture:
        """The posterior over all models."""
        return GaussianMixture(self.probabilities, self.means, self.covariances)

    @property
    def mean(self) -> FloatArray:
        """(d,), over all models."""
        result: FloatArray = self.probabilities @ self.means
        return result

    @property
    def covariance(self) -> FloatArray:
        """(d, d), over all models, their spread included."""
        return self.mixture.moments().covariance
