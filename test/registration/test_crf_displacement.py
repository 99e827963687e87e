"""Shortcuts of the search for motions of groups say what looking at everything would."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.spatial import cKDTree

from estimation.geometry.sight import AGREES, THROUGH
from evaluation.scenes.labelled_pairs import SICK, LabelledPair, random_labelled_pairs
from registration.crf.beams import beams_of, nearness, seen_by
from registration.crf.displacement import Group, Views, _explained, _nearest


@pytest.fixture(scope="module")
def pair() -> LabelledPair:
    return random_labelled_pairs(np.random.default_rng(7), "office", 1, lidar=SICK)[0]


@pytest.mark.parametrize("reach", [0.12, 0.4, 0.9])
def test_the_nearest_in_order_is_the_nearest(reach: float) -> None:
    rng = np.random.default_rng(3)
    targets = rng.uniform(-2.0, 2.0, (150, 2))
    targets = targets[np.argsort(targets[:, 0])]
    tree = cKDTree(targets)
    outside = 0
    for x, y in rng.uniform(-3.0, 3.0, (400, 2)):
        away, number = tree.query((x, y))
        square, found = _nearest(x, y, reach, targets)
        if away >= reach:
            assert found < 0
            outside += 1
        else:
            assert square == pytest.approx(away**2)
            assert found == number
    assert 20 < outside < 380


def test_a_motion_is_given_up_only_where_it_cannot_be_good_enough(pair: LabelledPair) -> None:
    a, b = beams_of(pair.scan_a), beams_of(pair.scan_b)
    near, worth, standing = nearness(a, 0.01), np.ones(len(b.ranges)), np.zeros(len(a), dtype=bool)
    group = np.flatnonzero(a.pieces == np.bincount(a.pieces).argmax())[:200]
    points = Group(a.points[group], near[group], a.spacing[group], standing[group])
    views = Views(b.xy, b.ranges, b.clear, worth, b.angle_min, b.step)
    given_up = 0
    for shift in np.linspace(-0.6, 0.6, 13):
        motion = pair.motions[0] + [shift, 0.5 * shift, 0.0]
        labels, _ = seen_by(a, b, motion, 0.01)
        wanted = np.sum(labels[group] == AGREES) - np.sum(labels[group] == THROUGH) + 1.0
        for least in (-1e9, wanted - 0.5, wanted + 0.5, 1e9):
            found = _explained(points, motion, 1.0, least, views)
            assert found == pytest.approx(wanted) or (found == -np.inf and least > wanted)
            given_up += found == -np.inf
    assert given_up >= 13
