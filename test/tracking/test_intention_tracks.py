"""Tracks that are kept until they end."""

from __future__ import annotations

import numpy as np
import pytest

from estimation.errors import InputError
from tracking.intentions.tracks import TrackKeeper


def test_a_track_ends_when_it_has_not_been_seen_for_the_timeout() -> None:
    keeper = TrackKeeper(timeout=1.0)
    for k in range(10):
        people = {1: np.array([0.1 * k, 0.0])} | ({2: np.array([5.0, 0.1 * k])} if k < 4 else {})
        assert keeper.observe(0.2 * k, people) == [] or k == 9
    assert set(keeper.present()) == {1}
    ended = keeper.observe(10.0, {})
    assert len(ended) == 1
    np.testing.assert_allclose(ended[0][:, 0], 0.1 * np.arange(10))
    np.testing.assert_allclose(ended[0][:, 2], 0.2 * np.arange(10))
    assert len(keeper) == 0


def test_who_is_hidden_but_tracked_has_not_gone() -> None:
    keeper = TrackKeeper(timeout=1.0)
    keeper.observe(0.0, {1: np.zeros(2), 2: np.ones(2)})
    for k in range(1, 40):
        ended = keeper.observe(0.1 * k, {}, hidden=[1])
        assert len(ended) == (1 if k == 11 else 0)
    assert list(keeper.present()) == [1]
    # A label that was never seen is no track.
    assert keeper.observe(4.0, {}, hidden=[9]) == []
    assert len(keeper.observe(9.0, {})) == 1
    assert len(keeper) == 0


def test_late_and_repeated_stamps_add_nothing_and_memory_is_bounded() -> None:
    keeper = TrackKeeper(timeout=5.0, longest=10)
    keeper.observe(1.0, {1: np.zeros(2)})
    keeper.observe(1.0, {1: np.ones(2)})
    keeper.observe(0.5, {1: np.ones(2), 2: np.ones(2)})
    assert len(keeper.present()[1]) == 1
    assert keeper.present()[2][0, 2] == 0.5
    for k in range(50):
        keeper.observe(2.0 + 0.1 * k, {1: np.zeros(2)})
    assert len(keeper.present()[1]) == 10
    assert len(keeper.finish()) == 1
    with pytest.raises(InputError, match="timeout"):
        TrackKeeper(timeout=0.0)
