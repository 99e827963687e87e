"""Figures 6.3 to 6.6: consistency, Kullback-Leibler distance and normality of converted measurements."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.stats import chi2

from estimation.checks import FloatArray
from estimation.conversion.polar import Method, convert, convert_samples, mardia_test
from estimation.metrics.statistics import anees_bounds, nees

METHODS: tuple[Method, ...] = ("linear", "dcm", "ucm", "mucm", "unscented")
RANGE, BEARING, SIGMA_RANGE = 4.0, np.pi / 4, 0.02
ANES_SAMPLES = 500  # N of (6.8)
KL_SAMPLES, KL_BINS = 20_000, 60


def _polar_nodes(sigma_bearing: float) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Measurements (Q,), (Q,) and weights (Q,) of Gauss-Hermite quadrature around the true object."""
    x, w = np.polynomial.hermite_e.hermegauss(80)
    w = w / w.sum()
    r, theta = np.meshgrid(RANGE + SIGMA_RANGE * x, BEARING + sigma_bearing * x)
    weights = np.outer(w, w)
    # Nodes beyond ±π carry no weight at the angles used here, and no conversion takes them.
    kept = (np.abs(theta) <= np.pi) & (weights > 1e-30)
    return r[kept], theta[kept], weights[kept] / weights[kept].sum()


def exact_anes(sigma_bearing: float, method: Method) -> float:
    """The expectation of (6.8): NEES of the converted measurement over the measurement noise, by quadrature."""
    r, theta, w = _polar_nodes(sigma_bearing)
    mean, cov = convert(r, theta, SIGMA_RANGE, sigma_bearing, method)
    truth = RANGE * np.array([np.cos(BEARING), np.sin(BEARING)])
    return float(w @ nees(mean - truth, cov))


def sampled_anes(sigma_bearing: float, method: Method, rng: np.random.Generator) -> float:
    """(6.8) with the text's 500 measurements."""
    r = RANGE + SIGMA_RANGE * rng.standard_normal(ANES_SAMPLES)
    theta = BEARING + sigma_bearing * rng.standard_normal(ANES_SAMPLES)
    theta = np.clip(theta, -np.pi, np.pi)
    mean, cov = convert(r, theta, SIGMA_RANGE, sigma_bearing, method)
    truth = RANGE * np.array([np.cos(BEARING), np.sin(BEARING)])
    return float(np.mean(nees(mean - truth, cov)))


def consistent_up_to(sigmas: FloatArray, anes: FloatArray) -> float:
    """Largest σ_θ before the exact ANES leaves the 95 % interval of a mean over 500 measurements."""
    low, high = anees_bounds(ANES_SAMPLES, 2)
    outside = np.flatnonzero((anes < low) | (anes > high))
    return float(sigmas[-1] if outside.size == 0 else sigmas[max(outside[0] - 1, 0)])


def exact_kl(sigma_bearing: float, method: Method) -> float:
    """KL(converted samples ‖ Gaussian), nat, without bins.

    The samples' density is known: its entropy is that of the polar Gaussian plus E[ln r]. The Gaussian's
    cross-entropy needs only the samples' mean and covariance, which are those of the MUCM.
    """
    mean, cov = convert(RANGE, BEARING, SIGMA_RANGE, sigma_bearing, method)
    true_mean, true_cov = convert(RANGE, BEARING, SIGMA_RANGE, sigma_bearing, "mucm")
    offset = true_mean - mean
    second = true_cov + np.outer(offset, offset)
    cross = np.log(2 * np.pi) + 0.5 * np.linalg.slogdet(cov)[1] + 0.5 * np.trace(np.linalg.solve(cov, second))
    nodes, w = np.polynomial.hermite_e.hermegauss(40)
    log_r = float(w / w.sum() @ np.log(RANGE + SIGMA_RANGE * nodes))
    entropy = 1 + np.log(2 * np.pi) + np.log(SIGMA_RANGE * sigma_bearing) + log_r
    return float(cross - entropy)


@dataclass(frozen=True)
class BinnedKl:
    """(6.9) over 60 × 60 bins in three readings, nat, and the share of samples that `skipping_empty` leaves out."""

    around_gaussian: float
    skipping_empty: float
    dropped_empty: float
    every_bin: float


def binned_kl(sigma_bearing: float, method: Method, rng: np.random.Generator) -> BinnedKl:
    """The text's own measure, whose treatment of samples without a Gaussian counterpart is not printed.

    around_gaussian : bins cover ±3 σ of the Gaussian along x and y, samples outside are lost.
    skipping_empty : bins cover the samples; those where the Gaussian has less than one sample's worth of
    probability (1 / 20,000) are skipped as empty. every_bin : none is skipped.
    """
    samples = convert_samples(RANGE, BEARING, SIGMA_RANGE, sigma_bearing, KL_SAMPLES, rng)
    mean, cov = convert(RANGE, BEARING, SIGMA_RANGE, sigma_bearing, method)
    spread = 3 * np.sqrt(np.diag(cov))
    ps, log_pc = _discretised(samples, mean, cov, mean - spread, mean + spread)
    ps2, log_pc2 = _discretised(samples, mean, cov, samples.min(0), samples.max(0))
    filled = log_pc2 > -np.log(KL_SAMPLES)
    kept = np.where(filled, ps2, 0.0)
    return BinnedKl(
        _kl(ps / ps.sum(), log_pc),
        _kl(kept, log_pc2),
        1.0 - float(kept.sum()),
        _kl(ps2, log_pc2),
    )


def _discretised(
    samples: FloatArray, mean: FloatArray, cov: FloatArray, low: FloatArray, high: FloatArray
) -> tuple[FloatArray, FloatArray]:
    """Share of the samples per bin, and log probability of the Gaussian per bin, normalised over the bins."""
    edges = [np.linspace(a, b, KL_BINS + 1) for a, b in zip(low, high, strict=True)]
    counts, _, _ = np.histogram2d(samples[:, 0], samples[:, 1], bins=edges)
    # 8 × 8 points per bin: the Gaussian may be thinner than a bin.
    fine = [np.linspace(e[0], e[-1], 8 * KL_BINS + 1) for e in edges]
    centres = np.stack(np.meshgrid(*(0.5 * (f[1:] + f[:-1]) for f in fine), indexing="ij"), -1)
    log_density = -0.5 * np.asarray(nees(centres - mean, cov))
    blocks = log_density.reshape(KL_BINS, 8, KL_BINS, 8)
    top = blocks.max(axis=(1, 3), keepdims=True)
    log_pc = (top + np.log(np.exp(blocks - top).sum(axis=(1, 3), keepdims=True)))[:, 0, :, 0]
    log_pc -= np.logaddexp.reduce(log_pc, axis=None)
    return counts / len(samples), log_pc


def _kl(ps: FloatArray, log_pc: FloatArray) -> float:
    used = ps > 0
    return float((ps[used] * (np.log(ps[used]) - log_pc[used])).sum())


def passing_fraction(sigma_bearing: float, repetitions: int, rng: np.random.Generator) -> float:
    """Figure 6.6: fraction of sets of 500 converted samples that pass Mardia's test at α = 0.05."""
    passed = [
        mardia_test(convert_samples(RANGE, BEARING, SIGMA_RANGE, sigma_bearing, ANES_SAMPLES, rng))
        for _ in range(repetitions)
    ]
    return float(np.mean(passed))


def banana(sigma_bearing: float, seed: int) -> FloatArray:
    """Figure 6.4: the samples of one panel, (500, 2)."""
    return convert_samples(RANGE, BEARING, SIGMA_RANGE, sigma_bearing, ANES_SAMPLES, seed)


def ellipse(mean: FloatArray, cov: FloatArray, probability: float = 0.95) -> FloatArray:
    """Outline (100, 2) of the region that holds `probability` of a Gaussian."""
    angles = np.linspace(0, 2 * np.pi, 100)
    radius = np.sqrt(chi2.ppf(probability, 2))
    circle = radius * np.stack([np.cos(angles), np.sin(angles)])
    outline: FloatArray = mean + (np.linalg.cholesky(cov) @ circle).T
    return outline
