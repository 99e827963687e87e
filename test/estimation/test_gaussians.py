"""The repair of covariances."""

import numpy as np
import pytest

from estimation.errors import InputError
from estimation.filters.gaussians import repair_covariance, repairs

P2 = np.array([[2.0, 0.6], [0.6, 1.0]])


def test_rounding_is_repaired_and_counted():
    before = repairs.count
    flat = np.outer([1.0, 2.0, 3.0], [1.0, 2.0, 3.0])
    flat[0, 0] -= 1e-12
    fixed = repair_covariance(np.stack([flat, np.eye(3)]))
    assert repairs.count == before + 1
    np.linalg.cholesky(fixed)
    np.testing.assert_allclose(fixed[0], flat, atol=1e-9)
    np.testing.assert_array_equal(fixed[1], np.eye(3))
    assert repair_covariance(P2) is not None
    assert repairs.count == before + 1
    np.testing.assert_array_equal(repair_covariance(np.zeros((2, 2)), definite=False), np.zeros((2, 2)))
    asymmetric = P2 + np.array([[0.0, 1e-13], [0.0, 0.0]])
    repaired = repair_covariance(asymmetric)
    np.testing.assert_array_equal(repaired, repaired.T)


@pytest.mark.parametrize(
    "bad",
    [
        np.zeros((2, 2)),
        np.diag([1.0, -0.01]),
        np.array([[1.0, 0.5], [0.0, 1.0]]),
        np.full((2, 2), np.nan),
        np.ones((2, 3)),
    ],
)
def test_wrong_covariances_are_named(bad):
    with pytest.raises(InputError, match=r"^P must"):
        repair_covariance(bad, "P")
