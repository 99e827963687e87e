"""What the joint model is made of, each part against something plain."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.testing import assert_allclose

from estimation.geometry.sight import AGREES, HIDDEN, THROUGH, UNSEEN
from evaluation.crf.crf_metrics import edit_distance, renumbered
from evaluation.scenes.labelled_pairs import protocol, random_labelled_pairs
from registration import Scan
from registration.crf.beams import beams_of, first_look, seen_by
from registration.crf.shape_features import NAMES, pair_features
from registration.laser.outline import CLEAR
from registration.laser.rigid import rigid_motion
from whereabouts.simulation import Lidar, box, joined

ROOM = box(8.0, 6.0)


def scan_at(pose: tuple[float, float, float], *things) -> Scan:
    lidar = Lidar(361, 2.0 * np.pi * 360 / 361, sigma=0.0)
    return lidar.scan(joined([ROOM, *things]), np.array(pose), np.random.default_rng(0)).scan


def test_closed_form_motion_is_the_least_squares_one() -> None:
    rng = np.random.default_rng(1)
    source = rng.normal(size=(30, 2))
    weights = rng.uniform(0.1, 2.0, 30)
    target = source @ np.array([[0.8, 0.6], [-0.6, 0.8]]) + [1.0, -2.0] + 0.1 * rng.normal(size=(30, 2))
    middle_a, middle_b = np.average(source, 0, weights), np.average(target, 0, weights)
    u, _, vt = np.linalg.svd((source - middle_a).T @ (weights[:, None] * (target - middle_b)))
    rotation = (u @ np.diag([1.0, np.linalg.det(u @ vt)]) @ vt).T
    motion = rigid_motion(source, target, weights)
    assert_allclose([np.cos(motion[2]), np.sin(motion[2])], rotation[:, 0], atol=1e-12)
    assert_allclose(motion[:2], middle_b - rotation @ middle_a, atol=1e-12)


def test_sight_tells_what_was_seen_through_from_what_is_hidden() -> None:
    empty, full = scan_at((0.0, 0.0, 0.0)), scan_at((0.0, 0.0, 0.0), box(0.5, 0.5, (1.5, 0.0, 0.0)))
    labels, off = seen_by(beams_of(full), beams_of(empty), np.zeros(3), 0.01)
    near = beams_of(full).ranges < 2.0
    assert (labels[near] == THROUGH).all()
    assert (labels[~near] == AGREES).mean() > 0.98
    assert off[~near].max() < 0.05
    back, _ = seen_by(beams_of(empty), beams_of(full), np.zeros(3), 0.01)
    assert (back[near] != AGREES).all()
    assert (back[near] == HIDDEN).mean() > 0.8


def test_a_run_without_returns_says_that_nothing_near_is_there() -> None:
    full = scan_at((0.0, 0.0, 0.0), box(0.5, 0.5, (1.5, 0.0, 0.0)))
    ranges = full.ranges.copy()
    near = ranges < 2.0
    ranges[near] = 30.0
    gone = Scan(ranges, full.angle_min, full.angle_increment, full.range_min, full.range_max)
    labels, _ = seen_by(beams_of(full), beams_of(gone), np.zeros(3), 0.01)
    middle = np.flatnonzero(near)[4:-4]
    assert (labels[middle] == CLEAR).all()
    ranges = full.ranges.copy()
    ranges[np.flatnonzero(near)[8]] = 30.0
    lost = Scan(ranges, full.angle_min, full.angle_increment, full.range_min, full.range_max)
    assert seen_by(beams_of(full), beams_of(lost), np.zeros(3), 0.01)[0][np.flatnonzero(near)[8]] in (
        AGREES,
        UNSEEN,
    )


def test_the_first_look_finds_the_noise_and_what_it_shows() -> None:
    rng = np.random.default_rng(5)
    for sigma in (0.008, 0.015, 0.05):
        lidar = Lidar(361, 2.0 * np.pi * 360 / 361, sigma=sigma)
        a, b = (
            beams_of(lidar.scan(joined([ROOM, *things]), np.zeros(3), rng).scan)
            for things in ([box(0.5, 0.5, (1.5, 0.0, 0.0))], [])
        )
        noise, labels, off = first_look(a, b, np.zeros(3))
        # Off a line between two readings as noisy as the point itself.
        assert 0.8 * sigma < noise < 1.6 * sigma
        again = seen_by(a, b, np.zeros(3), noise)
        assert np.mean(labels == again[0]) > 0.99
        assert_allclose(off, again[1], atol=1e-9)
    near = a.ranges[a.beams] < 2.0
    assert np.mean(labels[near] == THROUGH) > 0.9


def test_shape_features_are_differences_of_patterns() -> None:
    a, b = beams_of(scan_at((0.0, 0.0, 0.0))), beams_of(scan_at((0.1, 0.0, 0.0)))
    states = np.tile(np.array([[10, -1]]), (len(a), 1))
    features = pair_features(a, b, states, np.zeros((len(a), 3)))
    i, j = 50, 10
    expected = abs(np.hypot(*(a.points[i + 3] - a.points[i])) - np.hypot(*(b.points[j + 3] - b.points[j])))
    assert_allclose(features[i, 0, NAMES.index("distance 3")], expected)
    steps = [
        np.hypot(*(p.points[k + 1] - p.points[k])) for p, k0 in ((a, i), (b, j)) for k in range(k0, k0 + 5)
    ]
    assert_allclose(features[i, 0, NAMES.index("geodesic 5")], abs(sum(steps[:5]) - sum(steps[5:])))
    assert_allclose(
        features[i, 0, NAMES.index("translation")], min(np.hypot(*(a.points[i] - b.points[j])), 3.0)
    )


def test_string_edit_distance_on_known_words() -> None:
    for one, other, expected in (
        ("kitten", "sitting", 3),
        ("", "abc", 3),
        ("flaw", "lawn", 2),
        ("same", "same", 0),
    ):
        words = [np.array([ord(c) for c in word], dtype=np.int64) for word in (one, other)]
        assert edit_distance(*words) == expected


def test_objects_are_renumbered_as_the_true_ones() -> None:
    truth = np.array([0, 0, 1, 1, 2, 2, 2, -1])
    found = np.array([0, 0, 2, 2, 1, 1, 3, -1])
    clusters, mapping = renumbered(truth, found)
    assert mapping == {2: 1, 1: 2}
    assert_allclose(clusters[:6], truth[:6])
    assert clusters[6] not in truth


def test_true_motions_take_points_onto_their_true_partners() -> None:
    for scene in ("street", "hall", "office"):
        for pair in random_labelled_pairs(np.random.default_rng(4), scene, 3, spurious=0.0):
            xy = [np.zeros((len(scan), 2)) for scan in (pair.scan_a, pair.scan_b)]
            for points, scan in zip(xy, (pair.scan_a, pair.scan_b), strict=True):
                points[scan.valid] = scan.points()
            told = np.flatnonzero(pair.associations >= 0)
            moved = np.zeros((len(told), 2))
            for n, i in enumerate(told):
                x, y, yaw = pair.motions[pair.clusters[i]]
                c, s = np.cos(yaw), np.sin(yaw)
                moved[n] = [x + c * xy[0][i, 0] - s * xy[0][i, 1], y + s * xy[0][i, 0] + c * xy[0][i, 1]]
            away = np.hypot(*(moved - xy[1][pair.associations[told]]).T)
            # Legs swing as their person goes on.
            assert np.median(away) < 0.1
            assert np.mean(away < 0.6) > 0.97


def test_the_protocol_is_like_the_texts() -> None:
    pairs = protocol(3)
    assert len(pairs) == 31
    assert len({pair.sequence for pair in pairs}) == 8
    outliers = np.mean([np.mean(pair.associations[pair.valid] < 0) for pair in pairs])
    assert outliers == pytest.approx(0.11, abs=0.025)
    assert 280 < np.mean([pair.valid.sum() for pair in pairs]) < 362
