"""Grids and assignments asked for what they cannot hold."""

from __future__ import annotations

import numpy as np
import pytest

from estimation.errors import InputError
from estimation.filters.assignment import cheapest, k_best
from estimation.geometry.grid import OccupancyGrid


@pytest.mark.parametrize("far", [1e6, 1e12, 1e19, 1e300])
def test_a_grid_that_would_take_all_memory_is_not_made(far: float) -> None:
    grid = OccupancyGrid(0.05)
    grid.integrate(np.zeros(3), np.array([[1.0, 1.0]]))
    before = grid.log_odds.copy()
    with pytest.raises(InputError):
        grid.integrate(np.array([far, far, 0.0]), np.array([[1.0, 1.0]]))
    assert np.array_equal(grid.log_odds, before)


def test_costs_that_were_never_measured_assign_nothing() -> None:
    with pytest.raises(InputError, match="NaN"):
        cheapest(np.array([[np.nan, 1.0], [1.0, 2.0]]))
    with pytest.raises(InputError, match="added up"):
        k_best([[1e300, np.inf], [1e300, np.inf]], 2)
