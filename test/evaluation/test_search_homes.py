"""Homes to search in: every target can be found, and a robot that knows where it is drives the shortest way."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
import pytest

from estimation.geometry.grid_paths import GridPaths
from evaluation.scenes.search_homes import (
    CLEARANCE,
    FOUND,
    GOES_WITH,
    RESOLUTION,
    STRIDE,
    Home,
    driven_through,
    home,
    learned_homes,
)


class Knowing:
    """Goes straight to where the target is, or nowhere."""

    def __init__(self, goal: np.ndarray | None) -> None:
        self.goal, self.known = goal, dict[str, np.ndarray]()

    def next_goal(self, known: Mapping[str, np.ndarray], place: np.ndarray) -> np.ndarray | None:
        self.known |= known
        return self.goal

    def reached(self, place: np.ndarray) -> None: ...


@pytest.mark.parametrize("seed", range(4))
def test_who_knows_where_it_is_drives_the_shortest_way_until_it_is_in_sight(seed: int) -> None:
    made = home(seed)
    chooser = Knowing(made.spot)
    shortest = GridPaths(made.grid, made.start, CLEARANCE).lengths(made.spot[None])[0]
    length = driven_through(made, chooser)
    if made.sees(made.start, made.spot, FOUND):
        assert length == 0.0
        return
    # In sight at the latest when it is there, at the earliest FOUND metres before; around a corner, later.
    assert shortest - FOUND - 2.0 * STRIDE <= length <= shortest + 2.0 * STRIDE
    assert chooser.known
    corner = np.array(made.grid.shape[::-1]) * RESOLUTION
    assert all((spot > 0.0).all() and (spot < corner).all() for spot in chooser.known.values())
    assert driven_through(made, Knowing(None), limit=50.0) == 50.0


def test_a_seed_is_a_home_and_others_teach_where_things_are() -> None:
    one, again, other = Home(3), Home(3), Home(4)
    np.testing.assert_array_equal(one.grid.log_odds, again.grid.log_odds)
    assert one.target == again.target
    assert one.grid.shape != other.grid.shape
    relations = learned_homes(0, 30)
    assert {*GOES_WITH} <= {*relations.names}
    assert relations.probability("bathtub", "towel") > relations.probability("desk", "towel")
    rooms = relations.rooms("towel", ["bathroom", "office"])
    assert rooms["bathroom"] > rooms["office"]
