"""Kernels given points that are no numbers, too far away, or of a damaged file."""

from __future__ import annotations

import numpy as np
import pytest

from loop_closure.places.definitions import BINS_PER_METRE, range_histograms
from loop_closure.places.outline_kernels import CELLS, RADIUS, grids, sharp_grid, thin

NOWHERE = np.array([[np.nan, 0.0], [0.0, np.nan], [1e30, 0.0], [-1e19, 1e19], [np.inf, -np.inf]])
HERE = np.array([[1.0, 1.0]])
NOTHING_FREE = np.zeros(CELLS * CELLS // 8 + 1, dtype=np.uint8)


def test_points_that_are_nowhere_leave_no_trace() -> None:
    mixed = np.vstack((NOWHERE, HERE))
    assert np.allclose(thin(mixed, 0.1, RADIUS), HERE)
    for mine, alone in zip(grids(mixed, NOTHING_FREE), grids(HERE, NOTHING_FREE), strict=True):
        assert np.array_equal(mine, alone)
    assert np.array_equal(sharp_grid(mixed), sharp_grid(HERE))


def test_a_grid_with_too_few_cells_is_refused() -> None:
    with pytest.raises(ValueError, match="packed"):
        grids(HERE, NOTHING_FREE[:10])


def test_every_range_has_a_bin() -> None:
    multiples, starts = np.array([BINS_PER_METRE]), np.array([0, 4])
    ranges = np.array([-1e30, -1.0, 0.5, 3.5, 1e30, np.inf, np.nan])
    assert range_histograms(ranges, multiples, starts).tolist() == [3.0, 0.0, 0.0, 4.0]
