"""Social forces as printed, against the formulas written out and against simulation."""

import numpy as np
import pytest

from estimation.errors import InputError
from tracking.intentions import IntentionConfig, IntentionModel
from tracking.intentions.printed import PrintedModel
from tracking.prediction.social_forces_printed import PrintedForces, SocialForceFilter, jacobian, step

X = np.array([1.0, 2.0, 0.4, -0.3])
THINGS, RADII = np.array([[1.5, 2.2], [0.8, 1.8], [4.0, 4.0]]), np.array([0.3, 0.3, 0.0])
GOAL = np.array([5.0, 1.0])


def test_forces_by_hand():
    f = PrintedForces()
    assert f.f == pytest.approx(1.235)
    social, physical = np.zeros(2), np.zeros(2)
    for thing, radius in zip(THINGS, RADII, strict=True):
        away = X[:2] - thing
        d = np.sqrt(away @ away)
        r = f.radius + radius
        social += 25.0 * np.exp((r - d) / 1.235) * away / d
        if r > d:
            physical += 2.5 * (r - d) * away / d
    np.testing.assert_allclose(f.social(X, THINGS, RADII), social)
    np.testing.assert_allclose(f.physical(X, THINGS, RADII), physical)
    assert np.linalg.norm(physical) > 0
    e = (GOAL - X[:2]) / np.linalg.norm(GOAL - X[:2])
    np.testing.assert_allclose(f.personal(X, GOAL), 80.0 * (0.988 * e - X[2:]) / 4.0)
    total = f.acceleration(X, GOAL, THINGS, RADII)
    np.testing.assert_allclose(80.0 * total, f.personal(X, GOAL) + social + physical)


def test_motion_without_forces_is_uniform_and_with_a_goal_relaxes_to_the_wanted_speed():
    np.testing.assert_allclose(step(X, np.array([0.2, 0.0]), 0.5), [1.225, 1.85, 0.5, -0.3])
    f, x = PrintedForces(), np.array([0.0, 0.0, 0.0, 0.0])
    goal, none = np.array([1000.0, 0.0]), (np.zeros((0, 2)), np.zeros(0))
    for _ in range(400):
        x = step(x, f.acceleration(x, goal, *none), 0.01)
    # After τ = 4 s: 1 - 1/e of the wanted speed.
    assert x[2] == pytest.approx(f.speed * (1.0 - np.exp(-1.0)), rel=0.005)


def test_the_filter_keeps_the_moments_of_samples():
    """Mean and covariance after a second against 4000 people who walk with the same noise."""
    f, none = PrintedForces(), (np.zeros((0, 2)), np.zeros(0))

    def a(x):
        return f.acceleration(x, GOAL, *none)

    P = np.diag([0.01, 0.01, 0.04, 0.04])
    found = SocialForceFilter(X, P, noise=0.5, dt=0.1)
    found.predict(1.0, a)
    rng = np.random.default_rng(0)
    ends = []
    for x in rng.multivariate_normal(X, P, 4000):
        for _ in range(10):
            x = step(x, a(x) + 0.5 * rng.standard_normal(2), 0.1)
        ends.append(x)
    np.testing.assert_allclose(found.state, np.mean(ends, axis=0), atol=0.02)
    np.testing.assert_allclose(found.covariance, np.cov(np.transpose(ends)), atol=0.008)


def test_jacobian_of_free_motion():
    F = jacobian(X, lambda x: -x[2:] / 4.0, 0.2)
    wanted = np.eye(4)
    wanted[:2, 2:] = (0.2 - 0.5 * 0.04 / 4.0) * np.eye(2)
    wanted[2:, 2:] = 0.95 * np.eye(2)
    np.testing.assert_allclose(F, wanted, atol=1e-8)


def walk(end, start=(0.0, 0.0), rate=9.0):
    start, end = np.array(start), np.array(end)
    t = np.arange(0.0, np.hypot(*(end - start)), 1.0 / rate)
    return np.column_stack((start + t[:, None] * (end - start) / np.hypot(*(end - start)), t))


def test_a_learned_goal_is_walked_to_and_people_are_given_way():
    model = PrintedModel()
    for k in range(6):
        model.learn(walk((10.0, 0.1 * k)))
    seen = walk((10.0, 0.2))[:45]
    goals, probabilities = model.hmm.intentions(model.hmm.belief(model._thinned(seen[:, :2])))
    told = model.predict(seen, 3.0)
    np.testing.assert_array_equal(told.goals, model.hmm.places.positions[goals])
    np.testing.assert_allclose(told.probabilities, probabilities)
    assert np.hypot(*(told.goals[0] - [10.0, 0.2])) < 1.0
    assert told.path[0, 2] == pytest.approx(seen[-1, 2])
    assert told.path[-1, 0] > seen[-1, 0] + 2.0
    assert np.trace(told.covariances[-1]) > np.trace(told.covariances[0])
    standing = np.array([[seen[-1, 0] + 1.5, seen[-1, 1] - 0.3, 0.0, 0.0]])
    turned = model.predict(seen, 3.0, others=standing)
    assert turned.path[7, 1] > told.path[7, 1] + 0.02


def test_the_time_of_day_changes_no_path():
    seen = walk((10.0, 2.0), rate=5.0)[:20]
    told, today = (PrintedModel().predict(seen + np.array([0.0, 0.0, begun]), 3.0) for begun in (0.0, 1.7e9))
    np.testing.assert_allclose(today.path[:, :2], told.path[:, :2], atol=1e-4)


def test_what_was_seen_before_a_gap_says_nothing_of_the_velocity():
    t = 0.2 * np.arange(10)
    walk = np.column_stack((t, 0.0 * t, t))
    model = IntentionModel.of(IntentionConfig(method="printed"))
    for gap in (60.0, 1e12):
        track = np.concatenate((walk - [30.0, 0.0, gap], walk))
        np.testing.assert_array_equal(model.predict(track, 2.0).path, model.predict(walk, 2.0).path)


def test_everybody_present_is_predicted_with_the_others_in_the_way(tmp_path):
    model = IntentionModel.of(IntentionConfig(method="printed"))
    for k in range(6):
        model.learn(walk((10.0, 0.1 * k)))
    seen = walk((10.0, 0.2))[:45]
    beside = seen + np.array([1.5, -0.3, 0.0])
    first, second = model.predict_all([seen, beside], 3.0)
    alone = model.predict_all([seen], 3.0)[0]
    assert np.array_equal(first.path, model.predict(seen, 3.0, others=[beside]).path)
    assert not np.allclose(first.path, alone.path, atol=1e-3)
    assert second.path[0, :2] == pytest.approx(beside[-1, :2], abs=0.1)
    again = IntentionModel.load(model.save(tmp_path / "printed.npz"))
    assert np.array_equal(again.predict_all([seen], 3.0)[0].path, alone.path)


def test_bad_arguments_are_named():
    with pytest.raises(InputError, match="mass"):
        PrintedForces(mass=0.0)
    with pytest.raises(InputError, match="horizon"):
        PrintedModel().predict(walk((3.0, 0.0)), 0.0)
