"""The association kernels against brute force, quadrature and SciPy's distributions."""

from __future__ import annotations

from itertools import product

import numpy as np
import pytest
from scipy.special import gammaln, logsumexp
from scipy.stats import multivariate_normal, nbinom

from tracking.mixture import association_kernels as kernels

GATE, LOG_CLUTTER = 1e9, -6.0
MODEL = kernels.CellModel(GATE, True, 30)


def source(
    position: tuple[float, float], variance: float = 4.0, on: float = -0.1, off: float = -3.0
) -> np.ndarray:
    """A row of the table: known rate 3 and spread I."""
    row = np.zeros(kernels.COLUMNS)
    row[[kernels.MX, kernels.MY]] = position
    row[[kernels.PXX, kernels.PXY, kernels.PYY]] = variance, 0.3, variance
    row[[kernels.XXX, kernels.XXY, kernels.XYY]] = 1.0, 0.1, 1.2
    row[[kernels.ALPHA, kernels.BETA]] = 3.0, 1.0
    row[[kernels.ON, kernels.OFF, kernels.CLASS]] = on, off, 0.7
    return row


def matrix(row: np.ndarray, first: int) -> np.ndarray:
    return np.array([[row[first], row[first + 1]], [row[first + 1], row[first + 2]]])


def cell_of(z: np.ndarray) -> np.ndarray:
    """Statistics of a whole cell."""
    mean = z.mean(0)
    scatter = (z - mean).T @ (z - mean)
    return np.array([len(z), *mean, scatter[0, 0], scatter[0, 1], scatter[1, 1], 0, 0, 0])


def log_stacked(row: np.ndarray, z: np.ndarray) -> float:
    """(9d) with 2n × 2n matrices, and the Poisson weight e^-γ γ^n."""
    n = len(z)
    X = matrix(row, kernels.XXX)
    S = np.tile(matrix(row, kernels.PXX), (n, n)) + np.kron(np.eye(n), X)
    rate = row[kernels.ALPHA] / row[kernels.BETA]
    density = multivariate_normal(np.tile(row[[kernels.MX, kernels.MY]], n), S).logpdf(z.ravel())
    return float(density + n * np.log(rate) - rate)


@pytest.mark.parametrize("n", [1, 2, 6])
def test_known_cell_is_the_stacked_likelihood(n: int) -> None:
    row, z = source((1.0, -0.5)), np.random.default_rng(n).normal(0, 2, (n, 2))
    assert kernels.log_cell(kernels.with_constants(row[None])[0], cell_of(z), True) == pytest.approx(
        log_stacked(row, z), rel=1e-10
    )


def test_unknown_rate_is_negative_binomial() -> None:
    """Returns are a set: n! orders of them are one."""
    row = source((0.0, 0.0))
    row[[kernels.ALPHA, kernels.BETA]] = 4.5, 1.7
    for n in (1, 3, 8):
        cell = cell_of(np.random.default_rng(n).normal(0, 1, (n, 2)))
        with_rate = kernels.log_cell(kernels.with_constants(row[None])[0], cell, False) - kernels.log_cell(
            kernels.with_constants(row[None])[0], cell, True
        )
        rate = 4.5 / 1.7
        expected = nbinom(4.5, 1.7 / 2.7).logpmf(n) + gammaln(n + 1) - (n * np.log(rate) - rate)
        assert with_rate == pytest.approx(expected, rel=1e-9)


def clutter_at(z: np.ndarray) -> np.ndarray:
    """Log-density of clutter at returns (n, 2): it need not be uniform."""
    return LOG_CLUTTER - 0.2 * (1.0 + np.sin(z[:, 0]))


def look_at(z: np.ndarray) -> np.ndarray:
    """Log-likelihood ratio of the two classes of targets for returns (n, 2)."""
    return 1.5 * np.cos(3.0 * z[:, 1])


def returns_of(z: np.ndarray) -> np.ndarray:
    return np.column_stack((z, clutter_at(z), look_at(z)))


def exact(z: np.ndarray, sources: np.ndarray, on: np.ndarray) -> float:
    """Log of the sum over all associations in which every source that is on gives a return."""
    active = np.flatnonzero(on)
    base = sources[~on, kernels.OFF].sum() + sources[on, kernels.ON].sum()
    logs = []
    for choice in product([-1, *active], repeat=len(z)):
        owners = np.array(choice)
        if not set(active) <= set(choice):
            continue
        value = base + clutter_at(z)[owners == -1].sum()
        for k in active:
            first = sources[k, kernels.CLASS]
            looks = np.log(first * np.exp(look_at(z[owners == k])) + 1.0 - first)
            value += log_stacked(sources[k], z[owners == k]) + looks.sum()
        logs.append(value)
    return float(logsumexp(logs))


def bound(z: np.ndarray, sources: np.ndarray, on: np.ndarray) -> float:
    S = len(sources)
    cells, centres = np.zeros((S, kernels.CELL)), np.zeros((S, 2))
    return float(kernels.evaluate(kernels.posed(returns_of(z), sources), on, cells, centres, False, MODEL))


@pytest.mark.parametrize(("apart", "slack"), [(12.0, 0.05), (3.0, 1.0), (0.5, 1.2)])
def test_structure_weight_is_a_tight_bound_below_the_sum_over_associations(
    apart: float, slack: float
) -> None:
    # Of two targets in one place the bound takes one way to tell them apart: log 2 of the slack.
    rng = np.random.default_rng(5)
    sources = np.array([source((0.0, 0.0)), source((apart, 0.0))])
    z = np.vstack([rng.normal(0, 1, (3, 2)), rng.normal((apart, 0.0), 1, (3, 2))])
    on = np.array([True, True])
    value, whole = bound(z, sources, on), exact(z, sources, on)
    assert value <= whole + 1e-9
    assert whole - value < slack


def test_search_finds_the_best_of_all_structures() -> None:
    """Two known targets, one unseen, and two places for new ones: all 32 structures, by the same bound."""
    rng = np.random.default_rng(6)
    sources = np.array(
        [
            source((0.0, 0.0)),
            source((6.0, 0.0)),
            source((0.0, 9.0), on=-2.0, off=0.0),
            source((30.0, 30.0), on=-2.0, off=0.0),
        ]
    )
    z = np.vstack([rng.normal(0, 1, (4, 2)), rng.normal((0.0, 9.0), 1, (3, 2)), [[20.0, -20.0]]])
    seeds = sources[2:, :2].copy()
    values, active, cells = kernels.search(
        returns_of(z), sources, 2, seeds, MODEL, kernels.SearchBudget(20.0, 20, 10)
    )
    every = {}
    for choice in product([False, True], repeat=4):
        every[choice] = bound(z, sources, np.array(choice))
    best = max(every, key=lambda choice: every[choice])
    assert best == (True, False, True, False)
    assert tuple(active[0].tolist()) == best
    assert values[0] == pytest.approx(every[best], abs=1e-3)
    assert (np.diff(values) <= 0).all()
    assert cells[0, 0, kernels.N] == pytest.approx(4.0, abs=0.5)
    assert cells[0, 2, kernels.N] == pytest.approx(3.0, abs=0.5)


def test_a_target_may_split() -> None:
    """Twice the returns in two clumps about one prediction: the best structure has a second target."""
    rng = np.random.default_rng(7)
    parent = source((0.0, 0.0))
    parent[[kernels.ALPHA, kernels.BETA]] = 8.0, 1.0
    child = parent.copy()
    child[[kernels.ON, kernels.OFF]] = -3.0, 0.0
    z = np.vstack([rng.normal((-2.0, 0.0), 1, (8, 2)), rng.normal((2.0, 0.0), 1, (8, 2))])
    sources = np.array([parent, child, child])
    _, active, cells = kernels.search(
        returns_of(z), sources, 1, np.zeros((0, 2)), MODEL, kernels.SearchBudget(9.0, 20, 4)
    )
    assert active[0].tolist() in ([True, True, False], [True, False, True])
    found = cells[0, active[0]]
    np.testing.assert_allclose(found[:, kernels.N], 8.0, atol=1.0)
    assert np.ptp(found[:, kernels.ZX]) > 2.0
