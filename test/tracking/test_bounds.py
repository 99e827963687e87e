"""Scans of a single beam, places nobody knows, and steps that divide by nothing."""

from __future__ import annotations

import numpy as np
import pytest

from registration.laser.scan import Scan
from tracking.mixture.occluders import _shares, seen_shares
from tracking.people.free_space import Background


def test_a_scan_of_one_beam_shows_what_it_shows() -> None:
    shares, _ = seen_shares(Scan([5.0], 0.0, 0.0), np.array([[2.0, 0.0]]), 1e-6 * np.eye(2)[None], 20.0)
    assert np.isfinite(shares).all()
    assert ((shares >= 0.0) & (shares <= 1.0)).all()


@pytest.mark.parametrize("step", [7.0, -7.0, 1e6])
def test_steps_above_a_turn_divide_by_nothing(step: float) -> None:
    place = np.array([[2.0, 0.0]])
    assert np.isfinite(_shares(np.array([5.0]), 0.0, step, 20.0, place[None])).all()


def test_a_place_that_nobody_knows_is_neither_fresh_nor_old() -> None:
    fresh, old, unseen = Background().evidence(
        np.array([[1.0, 1.0], [1e19, -1e19]]), np.array([1e12, np.inf])
    )
    assert fresh.tolist() == [0.0, 0.0]
    assert old.tolist() == [0.0, 0.0]
    assert unseen.tolist() == [1.0, 1.0]
