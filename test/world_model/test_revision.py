"""Looking back: places, errors and owners from all looks together."""

from __future__ import annotations

import gc
import weakref
from dataclasses import replace

import numpy as np
import pytest

from world_model import ObjectEvidence, WorldEvidence, WorldModel, WorldModelConfig, WorldState
from world_model.calibration.revision import Explanation, Sightings, assign, explain, misfit, solve
from world_model.calibration.sensor_bias import JITTER, QUICK, SECONDS, SLOW

PLACES = np.array([[2.0 + 0.2 * (k % 5), 1.2 * (k // 5)] for k in range(10)])
SIGMA = np.array([0.02, 0.006])


def looks(count: int, seed: int) -> tuple[Sightings, np.ndarray, np.ndarray]:
    """Sightings, whose they are (N,), and the errors (F, 2) that looks share: a wave, slower than `SECONDS`."""
    rng = np.random.default_rng(seed)
    stamps = 0.5 * np.arange(count)
    shared = np.stack([0.02 * np.sin(stamps / 15.0), 0.025 * np.sin(stamps / 12.0)], -1)
    poses, look, seen, whose = [], [], [], []
    for f in range(count):
        x, y = np.sin(0.11 * f), 0.6 + 1.2 * np.sin(0.07 * f)
        yaw = 0.5 * np.sin(0.3 * f)
        poses.append([x, y, 0.0, yaw])
        off = PLACES - (x, y)
        bearing = np.arctan2(off[:, 1], off[:, 0]) - yaw
        for k in np.flatnonzero((np.abs(bearing) < 0.6) & (rng.random(len(off)) < 0.5)).tolist():
            look.append(f)
            whose.append(k)
            seen.append(np.array([np.hypot(*off[k]), bearing[k]]) + shared[f] + SIGMA * rng.normal(size=2))
    N = len(look)
    data = Sightings(
        stamps,
        np.array(poses),
        np.array(look),
        np.array(seen),
        np.tile(SIGMA, (N, 1)),
        np.zeros((N, len(PLACES))),
        np.zeros((count, 3)),
    )
    return data, np.array(whose), shared


def test_one_step_is_the_least_squares_of_everything() -> None:
    """Against a dense system with numerical derivatives, at the solution."""
    data, whose, _ = looks(12, 0)
    rng = np.random.default_rng(9)
    data = replace(data, rates=rng.normal(0.0, [0.2, 0.2, 0.5], (12, 3)))
    found = Explanation(PLACES.copy(), np.zeros(8), np.zeros((12, 2)), whose)
    for _ in range(6):
        found = solve(data, found, np.zeros(8))
    K, F = len(PLACES), len(data.stamps)

    def errors(x: np.ndarray) -> np.ndarray:
        places, constant, parts = (
            x[: 2 * K].reshape(K, 2),
            x[2 * K : 2 * K + 8],
            x[2 * K + 8 :].reshape(2, 2, F),
        )
        off = places[whose] - data.poses[data.look, :2]
        d, b = np.hypot(*off.T), np.arctan2(off[:, 1], off[:, 0]) - data.poses[data.look, 3]
        common = parts.sum(1)[:, data.look]
        offset, scale, depth, turn, lean, stretch, bend, delay = constant
        vx, vy, w = data.rates[data.look].T
        # A delay: where the object was from the sensor then.
        nearer = delay * (vx * off[:, 0] + vy * off[:, 1]) / d
        turned = delay * ((vy * off[:, 0] - vx * off[:, 1]) / d**2 + w)
        r = data.seen[:, 0] - d * (1 + scale + 0.5 * b**2 * depth + b * lean) - offset - nearer - common[0]
        a = data.seen[:, 1] - b * (1 + stretch + b * bend) - turn - turned - common[1]
        out = [
            r / SIGMA[0],
            a / SIGMA[1],
            constant / [0.1, 0.05, 1.0, 0.02, 0.03, 0.03, 0.05, 0.05],
            1e-3 * (places - PLACES).ravel(),
        ]
        fade = np.exp(-np.diff(data.stamps) / SECONDS)
        for kind in range(2):
            slow, quick = parts[kind]
            jitter = JITTER * data.rates[:, 2] if kind else np.zeros(F)
            out += [slow[:1] / SLOW[kind], quick / np.hypot(QUICK[kind], jitter)]
            out.append((slow[1:] - fade * slow[:-1]) / (SLOW[kind] * np.sqrt(1.0 - fade**2)))
        return np.concatenate(out)

    from scipy.optimize import least_squares

    start = np.concatenate([PLACES.ravel(), np.zeros(8 + 4 * F)])
    dense = least_squares(errors, start, method="trf", x_scale="jac", xtol=1e-12, ftol=1e-12).x
    seen = np.unique(whose)
    assert found.places[seen] == pytest.approx(dense[: 2 * K].reshape(K, 2)[seen], abs=3e-3)
    assert found.shared == pytest.approx(dense[2 * K + 8 :].reshape(2, 2, F).sum(1).T, abs=3e-3)


def test_each_object_explains_one_detection_of_a_look() -> None:
    data, whose, shared = looks(40, 1)
    owner = assign(data, Explanation(PLACES, np.zeros(8), shared, whose))
    assert (owner == whose).mean() > 0.99
    for f in range(40):
        mine = owner[(data.look == f) & (owner >= 0)]
        assert len(set(mine.tolist())) == len(mine)


def test_all_is_explained_from_places_that_are_off() -> None:
    data, whose, shared = looks(200, 2)
    rng = np.random.default_rng(3)
    wrong = whose.copy()
    some = rng.random(len(whose)) < 0.15
    wrong[some] = rng.integers(0, len(PLACES), some.sum())
    begun = Explanation(PLACES + rng.normal(0.0, 0.04, PLACES.shape), np.zeros(8), np.zeros((200, 2)), wrong)
    found = explain(data, begun, np.zeros(8))
    assert (found.owner == whose).mean() > 0.985
    assert misfit(data, found) < misfit(data, begun)
    # What is common to all looks is the constant error's or everything's, not to be told apart.
    off = found.places - PLACES
    assert np.abs(off - off.mean(0)).max() < 0.03
    assert np.corrcoef(found.shared[:, 1], shared[:, 1])[0, 1] > 0.95


def test_looking_back_names_what_was_not_known_yet() -> None:
    """The first detections of an object have no symbol then; in the end they have that of their object."""
    config = WorldModelConfig(
        region=((-2.0, 6.0), (-4.0, 4.0), (-0.5, 0.5)),
        rate_hz=2.0,
        detection_probability=0.4,
        clutter_per_frame=0.02,
    )
    model = WorldModel(config)
    data, whose, _ = looks(120, 4)
    given, said = [], []
    for f, stamp in enumerate(data.stamps.tolist()):
        mine = np.flatnonzero(data.look == f)
        pose = data.poses[f]
        angle = data.seen[mine, 1] + pose[3]
        ends = pose[:2] + data.seen[mine, :1] * np.stack([np.cos(angle), np.sin(angle)], -1)
        seen = [ObjectEvidence([*z, 0.0], np.diag([4e-4, 4e-4, 1e-4])) for z in ends]
        state = model.update(WorldEvidence(seen, {"pose": tuple(pose), "range": 6.0, "angle": 1.2}), stamp)
        if seen:
            given.append(mine)
            said.append(state.associations)
    corrected = model.look_back()
    assert [len(names) for _, names in corrected] == [len(mine) for mine in given]
    assert any(None in names for names in said)
    known = {item.id for item in model.propagate(float(data.stamps[-1])).objects}
    names = [name for _, look in corrected for name in look]
    assert sum(name in known for name in names) > 0.97 * len(names)
    # One object stands for one landmark.
    order = np.concatenate(given)
    for name in known:
        own = whose[order[[n == name for n in names]]]
        assert len(own) == 0 or np.bincount(own).max() > 0.9 * len(own)


class ChangedWords(dict):  # type: ignore[type-arg]
    """The words of one detection, of which it can be said whether they are still there."""


def drive_past(model: WorldModel, count: int) -> tuple[list[WorldState], list[weakref.ref[ChangedWords]]]:
    """What a model says after each look of a sensor that moves past landmarks; and the words they are called by."""
    data, whose, _ = looks(count, 4)
    states, said = [], []
    for f, stamp in enumerate(data.stamps.tolist()):
        mine, pose = np.flatnonzero(data.look == f), data.poses[f]
        angle = data.seen[mine, 1] + pose[3]
        ends = pose[:2] + data.seen[mine, :1] * np.stack([np.cos(angle), np.sin(angle)], -1)
        words = [ChangedWords({"class": {f"thing-{k}": 1.0}}) for k in whose[mine].tolist()]
        spread = np.diag([4e-4, 4e-4, 1e-4])
        seen = [ObjectEvidence([*z, 0.0], spread, w) for z, w in zip(ends, words, strict=True)]
        states.append(
            model.update(WorldEvidence(seen, {"pose": tuple(pose), "range": 6.0, "angle": 1.2}), stamp)
        )
        said += [weakref.ref(w) for w in words]
    return states, said


def test_who_does_not_look_back_keeps_few_looks_and_says_the_same() -> None:
    config = WorldModelConfig(
        region=((-2.0, 6.0), (-4.0, 4.0), (-0.5, 0.5)),
        rate_hz=2.0,
        clutter_per_frame=0.02,
        classes=tuple(f"thing-{k}" for k in range(len(PLACES))),
    )
    keeps, forgets = WorldModel(config), WorldModel(config, looks_back=False)
    (first, said), (second, _) = drive_past(keeps, 250), drive_past(forgets, 250)
    for one, other in zip(first, second, strict=True):
        assert one.associations == other.associations
        places = [[item.position for item in state.objects] for state in (one, other)]
        np.testing.assert_array_equal(*places)
    # Looks are kept as numbers, without the words of their detections.
    gc.collect()
    assert sum(words() is not None for words in said) < 10
    assert len(said) > 250
    assert len(keeps.look_back()) > 200
    assert len(forgets.look_back()) == 100


def test_looks_from_before_a_word_was_known_are_looked_back_at_as_well() -> None:
    """With an open vocabulary a look is as wide as the words that were known then."""
    config = WorldModelConfig(
        region=((-2.0, 6.0), (-4.0, 4.0), (-0.5, 0.5)), rate_hz=2.0, clutter_per_frame=0.02
    )
    model = WorldModel(config)
    states, _ = drive_past(model, 120)
    corrected = model.look_back()
    said = [names for state in states if (names := state.associations)]
    same = [
        a == b
        for one, other in zip(corrected, said, strict=True)
        for a, b in zip(one[1], other, strict=True)
        if b
    ]
    assert np.mean(same) > 0.95


def test_nothing_to_look_back_at() -> None:
    assert WorldModel(WorldModelConfig()).look_back() == []
