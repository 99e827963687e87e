"""PDA and JPDA as baselines: two targets that walk apart are followed, and clutter is not told of."""

import numpy as np
import pytest

from tracking import PhdConfig

pytest.importorskip("stonesoup")

from evaluation.peers.stone_soup_jpda import StoneSoupJpda


@pytest.mark.parametrize("joint", [True, False])
def test_two_targets_are_followed_among_clutter(joint):
    rng = np.random.default_rng(0)
    config = PhdConfig()
    filter_ = StoneSoupJpda(config, joint)
    for k in range(15):
        truth = np.array([[-400.0 + 10.0 * k, 100.0], [300.0, -200.0 - 8.0 * k]])
        returns = [there + 20.0 * rng.standard_normal((10, 2)) for there in truth]
        found = filter_.step(np.vstack([*returns, rng.uniform(-1000, 1000, (10, 2))]), float(k))
    assert len(found) == 2 == filter_.expected_count
    for there in truth:
        assert np.hypot(*(found - there).T).min() < 25.0


def test_a_target_that_is_gone_is_forgotten():
    rng = np.random.default_rng(1)
    filter_ = StoneSoupJpda(PhdConfig())
    for k in range(6):
        found = filter_.step(20.0 * rng.standard_normal((10, 2)), float(k))
    assert len(found) == 1
    for k in range(6, 12):
        found = filter_.step(np.zeros((0, 2)), float(k))
    assert len(found) == 0
