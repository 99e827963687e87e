"""The mixture with clusters of laser scans: what can be seen, what is clutter, and who is followed through hiding."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from estimation.errors import InputError
from estimation.learning.gradient_boosting import GradientBoosting
from evaluation.people.people_density_training import likeliest
from evaluation.people.people_yardsticks import measure
from evaluation.scenes.occlusion_scenes import (
    BODIES,
    LAYOUTS,
    MOTIONS,
    OcclusionKind,
    occlusions,
    one_hardly_moves,
)
from evaluation.scenes.people_scenes import PeopleScene
from registration.laser.scan import Scan
from tracking.mixture.phd_config import PhdConfig
from tracking.mixture.phd_models import ConstantVelocityMotion, Labels
from tracking.people.cluster_model import MOVING, ClusterScan, ScanDetection, StandingOrWalking
from tracking.people.free_space import Background
from tracking.people.legs import clusters_of
from tracking.people.people_shape import shape_model
from tracking.people.people_sweep import Sweep
from tracking.people.people_tracker import PeopleTracker
from tracking.people.person_class import NAMES, ClassModel
from whereabouts.simulation import Drive, Lidar, box, circle, joined
from whereabouts.simulation.walkers import Build, SimulatedWalker

LIDAR = Lidar(361, np.pi, range_max=12.0, sigma=0.01)


class Everybody(ClassModel):
    """Calls everything a person."""

    def odds(self, features: list[list[float]]) -> np.ndarray:
        assert all(len(row) == len(NAMES) for row in features)
        return np.full(len(features), 9.0)


def everybody() -> PeopleTracker:
    return PeopleTracker(classes=Everybody(GradientBoosting(), 1.0, 0.0))


def seen_of(scan: Scan, background: Background | None = None) -> ClusterScan:
    sweep = Sweep.of(scan, np.zeros(3), None, 0.1)
    none = np.zeros(len(scan), dtype=bool)
    return ClusterScan.of(scan, sweep, clusters_of(scan), background or Background(), shape_model(), none)


def test_legs_are_measurements_at_their_middles_and_walls_are_none() -> None:
    legs = [(2.0, 0.12), (2.0, -0.12)]
    world = joined([box(10.0, 8.0), *(circle(x, y, 0.06) for x, y in legs)])
    seen = seen_of(LIDAR.scan(world, np.zeros(3), np.random.default_rng(0)).scan)
    assert len(seen.places) == 2
    np.testing.assert_allclose(seen.places[np.argsort(-seen.places[:, 1])], legs, atol=0.03)


def test_what_registration_says_moves_came_from_somewhere() -> None:
    world = joined([box(10.0, 8.0), circle(2.0, 0.5, 0.06), circle(2.0, -0.5, 0.06)])
    scan = LIDAR.scan(world, np.zeros(3), np.random.default_rng(0)).scan
    sweep, moving = Sweep.of(scan, np.zeros(3), None, 0.1), scan.bearings > 0.0
    seen = ClusterScan.of(scan, sweep, clusters_of(scan), Background(), shape_model(), moving)
    assert seen.fresh[seen.places[:, 1] > 0.0] == pytest.approx([MOVING])
    assert seen.fresh[seen.places[:, 1] < 0.0].tolist() == [0.0]


def test_what_always_stood_somewhere_is_dense_in_clutter_there() -> None:
    world = joined([box(10.0, 8.0), circle(2.0, 0.0, 0.06), circle(3.0, 1.5, 0.06)])
    before = joined([box(10.0, 8.0), circle(2.0, 0.0, 0.06)])
    background, rng = Background(), np.random.default_rng(1)
    for k in range(40):
        scan = LIDAR.scan(before, np.zeros(3), rng).scan
        background.add(Sweep.of(scan, np.zeros(3), None, 0.1), 0.1 * k, np.zeros(361, dtype=bool))
    seen = seen_of(LIDAR.scan(world, np.zeros(3), rng).scan, background)
    order = np.argsort(seen.places[:, 0])
    stood, new = seen.log_clutter[order]
    assert stood > new + 3.0


def test_densities_are_learned_from_what_came_up_where() -> None:
    rng, true = np.random.default_rng(4), np.array([-4.0, -1.0, -2.0, -3.0])
    kinds, weights = rng.dirichlet(np.full(4, 0.3), 20000), rng.uniform(0.5, 2.0, 20000)
    found = np.repeat(kinds, rng.poisson(weights * np.exp(kinds @ true)), axis=0)
    np.testing.assert_allclose(likeliest(found, np.column_stack((kinds, weights))), true, atol=0.15)
    # Where nothing tells, a kind of place is as any other.
    some = np.column_stack((kinds[:, 0], np.zeros((20000, 3)), weights))
    alone = likeliest(found[:50] * [1.0, 0.0, 0.0, 0.0], some)
    assert np.ptp(alone[1:]) == 0.0


def test_a_hidden_target_that_comes_out_keeps_its_weight_where_it_is_seen() -> None:
    world = joined([box(20.0, 20.0), circle(2.0, 0.0, 0.3)])
    detection = ScanDetection(0.98, 10.0)
    detection.scan = LIDAR.scan(world, np.zeros(3), np.random.default_rng(2)).scan
    hidden = ConstantVelocityMotion(PhdConfig()).fresh(
        np.ones(1), np.array([[5.0, 0.0, 0.0, 0.0]]), np.diag([0.1, 0.1, 0.1, 0.1])[None], Labels()
    )
    sight = detection.in_scene(hidden, np.ones(1), 1, np.zeros(3))
    assert sight.probability[0] < 0.5
    assert sight.at_return.tolist() == [0.98]


def test_a_scan_beyond_its_range_shows_free_floor_and_a_beam_without_a_reading_nothing() -> None:
    background, own = Background(), np.zeros(3, dtype=bool)
    for k in range(40):
        scan = Scan(np.array([np.inf, np.nan, 0.0]), -0.5, 0.5, 0.05, 8.0, 0.1 * k)
        background.add(Sweep.of(scan, np.zeros(3), None, 0.1), 0.1 * k, own)
    spots = np.array(
        [[4.0 * np.cos(0.5), -4.0 * np.sin(0.5)], [4.0, 0.0], [4.0 * np.cos(0.5), 4.0 * np.sin(0.5)]]
    )
    empty, _, unseen = background.evidence(spots, np.full(3, 2.5))
    assert empty.tolist() == [1.0, 0.0, 0.0]
    assert unseen.tolist() == [0.0, 1.0, 1.0]


def test_what_a_scan_cannot_show_is_not_missed_and_is_believed_to_be_behind_what_hides_it() -> None:
    world = joined([box(20.0, 20.0), circle(2.0, 0.0, 0.3)])
    detection = ScanDetection(0.98, 10.0)
    detection.scan = LIDAR.scan(world, np.zeros(3), np.random.default_rng(2)).scan
    spots = np.array([[5.0, 0.0, 0.0, 0.0], [4.0, 3.0, 0.0, 0.0], [5.0, 1.0, 0.0, 0.0]])
    P = np.tile(np.diag([0.01, 0.01, 0.1, 0.1]), (3, 1, 1))
    P[2, 1, 1] = 0.2
    people = ConstantVelocityMotion(PhdConfig()).fresh(np.ones(3), spots, P, Labels())
    sight = detection.in_scene(people, np.ones(3), 3, np.zeros(3))
    assert sight.probability[0] < 0.1
    assert sight.probability[1] == pytest.approx(0.98, abs=0.01)
    np.testing.assert_allclose(sight.means[1], spots[1], atol=0.01)
    # Of one who may be hidden or not: the mean over samples of his place, weighted by the chance of not being seen.
    drawn = 1.0 + np.sqrt(0.2) * np.random.default_rng(3).standard_normal(4000)
    single = ConstantVelocityMotion(PhdConfig()).fresh(
        np.ones(4000),
        np.column_stack([np.full(4000, 5.0), drawn, np.zeros((4000, 2))]),
        np.tile(1e-6 * np.eye(4), (4000, 1, 1)),
        Labels(),
    )
    missed = 1.0 - detection.in_scene(single, np.ones(4000), 4000, np.zeros(3)).probability
    assert sight.means[2, 1] == pytest.approx(float(missed @ drawn / missed.sum()), abs=0.15)
    assert sight.means[2, 1] < 0.8
    assert np.linalg.eigvalsh(sight.covariances).min() > 0.0
    assert detection.in_scene(people, np.ones(3), 3, None).probability.tolist() == [0.98] * 3


def test_people_who_hide_each_other_and_one_who_hardly_moves_are_followed() -> None:
    rng = np.random.default_rng(11)
    marks = measure(one_hardly_moves(rng), rng, everybody(), everybody=True)
    assert marks.found[0] / marks.there[0] > 0.94
    assert marks.found[1] / marks.there[1] > 0.9
    assert np.mean(marks.ospa_all) < 0.15


def test_the_legs_of_one_person_are_not_followed_as_two_for_long() -> None:
    """Somebody whose legs are taken for two people where he comes up."""
    rng = np.random.default_rng([500, 4, 0])
    kind = OcclusionKind(str(rng.choice(LAYOUTS)), str(rng.choice(MOTIONS)), str(rng.choice(BODIES)))
    scene = replace(occlusions(rng, kind), duration=8.0)
    tracker, counts = everybody(), []
    for scan in scene.scans(np.random.default_rng([500, 40, 0])):
        tracker.step(scan.scan, scan.pose, scan.scan.stamp)
        spots = np.array([target.mean[:2] for target in tracker.targets]).reshape(-1, 2)
        gaps = np.linalg.norm(spots[:, None] - scan.people[None], axis=2)
        counts.append([(gaps < 0.6).sum(), (gaps.min(axis=0, initial=np.inf) < 0.6).sum()])
    told, people = np.array(counts[45:]).sum(0)
    assert people > 200
    assert told < 1.05 * people


def test_people_abreast_stay_two() -> None:
    strides = Build("legs", leg_radius=0.05, leg_gap=0.28, stride=0.75)
    ways = [[(3.0, -3.0), (3.0, 3.0)], [(3.6, -3.0), (3.6, 3.0)]]
    people = [SimulatedWalker(np.array(way), 1.0, strides, phase=1.0 + k) for k, way in enumerate(ways)]
    scene = PeopleScene(box(16.0, 12.0), people, 5.5, Lidar(1081, 1.5 * np.pi, range_max=12.0), rate=25.0)
    tracker, counts = everybody(), []
    for scan in scene.scans(np.random.default_rng(5)):
        tracker.step(scan.scan, scan.pose, scan.scan.stamp)
        spots = np.array([target.mean[:2] for target in tracker.targets]).reshape(-1, 2)
        gaps = np.linalg.norm(spots[:, None] - scan.people[None], axis=2).min(axis=1, initial=np.inf)
        counts.append((gaps < 0.6).sum())
    assert np.mean(counts[50:]) == pytest.approx(2.0, abs=0.2)


def test_bad_input_is_refused_and_late_scans_change_nothing() -> None:
    tracker, scan = everybody(), Scan(np.full(10, 3.0), -0.5, 0.1, 0.05, 10.0, 0.0)
    with pytest.raises(InputError, match="pose"):
        tracker.step(scan, np.zeros(2), 0.0)
    with pytest.raises(InputError, match="stamp"):
        tracker.step(scan, np.zeros(3), np.inf)
    for stamp in (10.0, 10.1, 9.9, 10.2, 1.0, 1.1):
        tracker.step(scan, np.zeros(3), stamp)
    assert (tracker.health.late, tracker.health.restarts) == (2, 1)
    empty = Scan(np.full(10, np.inf), -0.5, 0.1, 0.05, 10.0, 0.0)
    assert tracker.step(empty, np.zeros(3), 1.1) == []


def test_velocity_fades_the_same_over_two_steps_as_over_one_and_who_stands_stays_better_known() -> None:
    config = PhdConfig(process_noise=2.5, scan_period=0.1, survival_probability=1.0)
    motion = StandingOrWalking(config)
    means = np.array([[1.0, 2.0, 1.2, -0.4], [1.0, 2.0, 0.0, 0.0]])
    P = np.tile(np.diag([0.01, 0.01, 1e-4, 1e-4]), (2, 1, 1))
    both = motion.fresh(np.ones(2), means, P, Labels())
    once, _ = motion.survivors(both, 0.2)
    halfway, _ = motion.survivors(both, 0.1)
    twice, _ = motion.survivors(halfway, 0.1)
    np.testing.assert_allclose(once.means, twice.means, rtol=1e-12)
    np.testing.assert_allclose(once.means[0, 2:], np.exp(-0.2 / 3.0) * means[0, 2:])
    # The way is the integral of the fading velocity.
    times = np.linspace(0.0, 0.2, 2001)
    way = np.trapezoid(np.exp(-times / 3.0), times) * means[0, 2:]
    np.testing.assert_allclose(once.means[0, :2] - means[0, :2], way, rtol=1e-6)
    added = [once.covariances[k] - 0.0 for k in range(2)]
    assert added[0][2, 2] > 10.0 * (added[1][2, 2] - 1e-4)
    assert np.linalg.eigvalsh(once.covariances).min() > 0.0


def test_the_shipped_classes_tell_somebody_who_stands_from_a_pole() -> None:
    """Neither ever moves; the robot drives past both."""
    person = SimulatedWalker(np.array([[3.0, 1.2]]), build=Build("legs"))
    drive = Drive([(0.0, 0.0), (2.0, 0.0)], 0.4)
    scene = PeopleScene(box(14.0, 9.0), [person], 5.0, LIDAR, drive, things=circle(3.0, -1.2, 0.04))
    tracker, odds = PeopleTracker(), []
    for scan in scene.scans(np.random.default_rng(4)):
        tracker.step(scan.scan, scan.pose, scan.scan.stamp)
        near = {
            name: [t.person for t in tracker.targets if np.hypot(*(t.mean[:2] - spot)) < 0.4]  # type: ignore[attr-defined]
            for name, spot in (("person", (3.0, 1.2)), ("pole", (3.0, -1.2)))
        }
        odds.append((np.mean(near["person"] or [0.0]), max(near["pole"], default=0.0)))
    who, what = np.array(odds[10:]).mean(0)
    assert who > 0.5 > what
