"""Registration from where odometry has the sensor: as the wide search has it, and the search where it is wrong."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.testing import assert_allclose

from evaluation.scenes.labelled_pairs import random_labelled_pairs
from registration.laser.prepared import PreparedScan, prepare
from registration.placement import expected
from registration.placement.align import among_movers
from registration.placement.expected import near_expected
from registration.result import UNKNOWN


def outlines_of(seed: int, count: int) -> list[tuple[PreparedScan, PreparedScan, np.ndarray]]:
    pairs = random_labelled_pairs(np.random.default_rng(seed), "office", count)
    return [(prepare("a", p.scan_a), prepare("b", p.scan_b), p.motions[0]) for p in pairs]


def test_it_is_what_the_search_finds() -> None:
    rng = np.random.default_rng(1)
    for moving, still, truth in outlines_of(71, 12):
        searched = among_movers(moving, still, truth)
        assert searched.converged
        found = near_expected(moving, still, truth + rng.normal(0.0, [0.02, 0.02, 0.01]))
        assert found.converged
        assert_allclose(found.transform, searched.transform, atol=2e-3)
        assert_allclose(found.covariance, searched.covariance, rtol=0.3, atol=1e-7)
        quick = near_expected(moving, still, truth, covariance=False)
        assert_allclose(quick.transform, searched.transform, atol=5e-3)


def test_the_search_is_spared_where_odometry_is_right_and_not_where_it_is_wrong(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    asked = []

    def counting(moving: PreparedScan, still: PreparedScan, start: np.ndarray):  # type: ignore[no-untyped-def]
        asked.append(start)
        return among_movers(moving, still, start)

    monkeypatch.setattr(expected, "among_movers", counting)
    pairs = outlines_of(72, 12)
    quick = [near_expected(moving, still, truth, covariance=False) for moving, still, truth in pairs]
    assert sum((found.covariance == UNKNOWN).all() for found in quick) == len(pairs) - len(asked) >= 9
    for moving, still, truth in pairs:
        found = near_expected(moving, still, truth + np.array([0.4, -0.3, 0.3]))
        assert found.converged
        assert_allclose(found.transform, truth, atol=0.02)
    assert len(asked) >= len(pairs)
