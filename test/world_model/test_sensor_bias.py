"""Systematic errors of a moving sensor: found from what it says about resting objects, without knowing them."""

from __future__ import annotations

import numpy as np
import pytest

from estimation.errors import InputError
from world_model import ObjectEvidence, WorldEvidence, WorldModel, WorldModelConfig
from world_model.calibration.sensor_bias import CONSTANT, PRIOR, QUICK, SECONDS, SLOW, basis, rates
from world_model.calibration.sensor_errors import SensorErrors, SensorEvidence
from world_model.calibration.sensor_filter import SensorFilter, error_basis
from world_model.calibration.sensor_worlds import SensorDetections, SensorWorlds

LANDMARKS = np.array([[0.0, 3.0, 0.0], [2.5, 0.5, 0.0], [-2.5, -0.5, 0.0], [0.5, -3.0, 0.0], [3.0, 3.0, 0.0]])
REGION = ((-6.0, 6.0), (-6.0, 6.0), (-0.5, 0.5))


def measured(pose: np.ndarray, errors: np.ndarray, rng: np.random.Generator) -> tuple[list[int], np.ndarray]:
    """Landmarks ahead as a sensor reports them: range and bearing with these errors, written out by hand."""
    seen, out = [], []
    for k, landmark in enumerate(LANDMARKS):
        off = landmark[:2] - pose[:2]
        distance, angle = np.hypot(*off), np.arctan2(off[1], off[0])
        bearing = (angle - pose[3] + np.pi) % (2.0 * np.pi) - np.pi
        if abs(bearing) > 0.6 or distance > 6.0:
            continue
        offset, scale, depth, turn, lean, stretch, bend = errors
        share = scale + 0.5 * depth * bearing**2 + lean * bearing
        reported = distance * (1.0 + share) + offset + rng.normal(0.0, 0.01)
        angle += turn + stretch * bearing + bend * bearing**2 + rng.normal(0.0, 0.003)
        seen.append(k)
        out.append([pose[0] + reported * np.cos(angle), pose[1] + reported * np.sin(angle), 0.0])
    return seen, np.array(out).reshape(-1, 3)


def round_trip(step: int) -> np.ndarray:
    """A pose on a circle about the landmarks' middle, looking to and fro across it."""
    at = 0.05 * step
    return np.array([1.5 * np.cos(at), 1.5 * np.sin(at), 0.0, at + np.pi + 0.5 * np.sin(0.37 * step)])


def test_basis_is_the_derivative_of_what_a_sensor_reports() -> None:
    """Numerical derivative of (range, bearing) to position by each error."""
    pose, place = np.array([0.3, -0.2, 0.0, 0.7]), np.array([[2.0, 1.1, 0.0]])
    rate = np.array([0.2, -0.3, 0.4])

    def reported(
        offset: float,
        scale: float,
        depth: float,
        turn: float,
        lean: float,
        stretch: float,
        bend: float,
        delay: float,
    ) -> np.ndarray:
        # What was read when the sensor was where it was `delay` ago, put where it is now.
        then = pose[:2] - delay * rate[:2], pose[3] - delay * rate[2]
        off = place[0, :2] - then[0]
        distance, b = np.hypot(*off), np.arctan2(off[1], off[0]) - then[1]
        r = distance * (1.0 + scale + 0.5 * depth * b**2 + lean * b) + offset
        angle = pose[3] + b + turn + stretch * b + bend * b**2
        return pose[:2] + r * np.array([np.cos(angle), np.sin(angle)])

    step = 1e-6
    columns = [(reported(*e) - reported(*-e)) / (2.0 * step) for e in step * np.eye(8)]
    assert basis(place, pose, rate)[0] == pytest.approx(np.column_stack(columns), abs=1e-8)


def test_rates_are_of_poses_that_are_near_in_time() -> None:
    before = np.array([1.0, 2.0, 0.0, 3.1])
    pose = np.array([1.02, 1.98, 0.0, -3.1])
    assert rates(pose, before, np.asarray(0.1)) == pytest.approx([0.2, -0.2, (2.0 * np.pi - 6.2) / 0.1])
    for elapsed in (0.0, 0.001, 2.0):
        assert not rates(pose, before, np.asarray(elapsed)).any()
    # What jumps has been put somewhere else.
    assert not rates(pose + np.array([3.0, 0.0, 0.0, 0.0]), before, np.asarray(0.1)).any()


def test_pace_is_of_more_than_two_poses_where_they_come_fast() -> None:
    """Poses that are off by a millimetre each, 100 times a second, do not make a sensor dart to and fro."""
    errors = SensorErrors(np.zeros(8))
    for step in range(40):
        jump = 0.001 * (-1.0) ** step
        errors.follow(np.array([0.002 * step + jump, 0.0, 0.0, 0.005 * step]), 0.01 * step)
    assert errors.rate == pytest.approx([0.2, 0.0, 0.5], abs=0.03)
    errors.follow(np.array([0.1, 0.0, 0.0, 0.2]), 10.0)
    assert not errors.rate.any()


@pytest.mark.parametrize("seed", [3, 4, 5])
def test_errors_are_found_from_different_places(seed: int) -> None:
    """Also what was taken for another object before they were known is one in the end."""
    errors, rng = np.array([0.12, 0.03, -0.8, 0.01, 0.04, 0.0, -0.05]), np.random.default_rng(seed)
    model = WorldModel(
        WorldModelConfig(
            region=REGION,
            rate_hz=5.0,
            clutter_per_frame=0.01,
            motion={"*": {"moved_per_second": 0.0}},
        )
    )
    for step in range(400):
        pose = round_trip(step)
        _, positions = measured(pose, errors, rng)
        spread = 0.03**2 * np.eye(3)
        given = WorldEvidence(
            [ObjectEvidence(p, spread) for p in positions],
            {"pose": tuple(pose.tolist()), "range": 6.0, "angle": 1.2},
        )
        state = model.update(given, 0.2 * step)
    # Constant errors and those that change slowly are told apart by time alone.
    assert model.sensor_bias[:7] == pytest.approx(errors, abs=0.04)
    found = np.array([item.position for item in state.objects])
    assert len(found) == len(LANDMARKS)
    # As they are reported they are 0.2 m off.
    nearest = np.linalg.norm(LANDMARKS[:, None] - found[None], axis=2).min(1)
    assert nearest.max() < 0.06


def test_filter_is_the_regression_on_everything() -> None:
    """Against Gaussian regression of all detections on places, constant errors and those that looks share."""
    rng, filter = np.random.default_rng(5), SensorFilter(np.zeros(8))
    for k, landmark in enumerate(LANDMARKS):
        filter.remember(k, landmark[:2] + 0.1, 0.3**2 * np.eye(2))
    K, R, lines, right, stamps = len(LANDMARKS), 0.02**2 * np.eye(2), [], [], []
    for step in range(0, 60, 2):
        pose = round_trip(step)
        seen, positions = measured(pose, np.array([0.05, 0.02, -0.3, 0.01, 0.02, 0.01, 0.0]), rng)
        if not seen:
            continue
        filter.predict(float(step))
        stamps.append(float(step))
        z = positions[:, :2]
        J = error_basis(z, pose)
        filter.correct(np.array(seen), z, np.tile(R, (len(seen), 1, 1)), J)
        for k, spot, slope in zip(seen, z, J, strict=True):
            lines.append((len(stamps) - 1, k, slope))
            right.append(spot - LANDMARKS[k, :2] - 0.1)
    F = len(stamps)
    C = CONSTANT
    prior = np.zeros((C + 2 * K + 2 * F, C + 2 * K + 2 * F))
    prior[:C, :C] = np.diag(PRIOR**2)
    prior[C : C + 2 * K, C : C + 2 * K] = 0.3**2 * np.eye(2 * K)
    fade = np.exp(-np.abs(np.subtract.outer(stamps, stamps)) / SECONDS)
    A = np.zeros((2 * len(lines), len(prior)))
    for kind in range(2):
        at = C + 2 * K + kind * F + np.arange(F)
        prior[np.ix_(at, at)] = SLOW[kind] ** 2 * fade + QUICK[kind] ** 2 * np.eye(F)
        for row, (f, _, slope) in enumerate(lines):
            A[2 * row : 2 * row + 2, at[f]] = slope[:, C + kind]
    for row, (_, k, slope) in enumerate(lines):
        A[2 * row : 2 * row + 2, :C] = slope[:, :C]
        A[2 * row : 2 * row + 2, C + 2 * k : C + 2 + 2 * k] = np.eye(2)
    S = A @ prior @ A.T + 0.02**2 * np.eye(len(A))
    mean = prior @ A.T @ np.linalg.solve(S, np.concatenate(right))
    assert filter.x[:C] == pytest.approx(mean[:C], abs=1e-6)
    assert filter.places == pytest.approx(
        LANDMARKS[:, :2] + 0.1 + mean[C : C + 2 * K].reshape(K, 2), abs=1e-6
    )
    spread = prior - prior @ A.T @ np.linalg.solve(S, A @ prior)
    assert filter.P[:C, C + 2 :] == pytest.approx(spread[:C, C : C + 2 * K], abs=1e-6)


def test_new_place_is_as_one_that_was_not_known_at_all() -> None:
    pose, z = np.array([0.0, 0.0, 0.0, 0.4]), np.array([[2.0, 1.0]])
    R, J = 0.02**2 * np.eye(2)[None], error_basis(z, pose)
    one, other = SensorFilter(np.zeros(8)), SensorFilter(np.zeros(8))
    one.begin(1, z[0], R[0], J[0])
    other.remember(1, np.array([1.5, 0.5]), 1e5 * np.eye(2))
    other.correct(np.array([0]), z, R, J)
    assert one.x == pytest.approx(other.x, abs=1e-5)
    assert np.abs(one.P - other.P).max() < 1e-5


def neighbours() -> tuple[SensorWorlds, np.ndarray]:
    """Three objects 18 cm apart, known well, 4 m ahead; and their numbers' places."""
    worlds, places = SensorWorlds(np.zeros(8)), np.array([[4.0, -0.18], [4.0, 0.0], [4.0, 0.18]])
    worlds.best.P[:8, :8] = 1e-8 * np.eye(8)
    worlds.predict(0.0)
    for place in places:
        worlds.best.remember(worlds.number(), place, 0.005**2 * np.eye(2))
    return worlds, places


def ahead(z: np.ndarray) -> SensorDetections:
    """Detections from the origin, which see 3 cm well."""
    J = error_basis(z, np.zeros(4))
    return SensorDetections(z, np.tile(0.03**2 * np.eye(2), (len(z), 1, 1)), J, np.full(len(z), 6.0), {})


def test_detections_of_a_look_are_turned_together() -> None:
    """Each is nearer to the next object than to its own."""
    worlds, places = neighbours()
    turn = 0.03
    turned = places @ np.array([[np.cos(turn), np.sin(turn)], [-np.sin(turn), np.cos(turn)]])
    assert np.linalg.norm(turned[:, None] - places[None], axis=2).argmin(1).tolist() == [1, 2, 2]
    assert worlds.look(ahead(turned)) == list(worlds.best.numbers)
    assert worlds.best.x[9] == pytest.approx(turn, abs=0.005)


def test_later_looks_decide_whose_a_detection_was() -> None:
    """One detection, turned, is taken for the neighbour; all three of the next look show the turn."""
    worlds, places = neighbours()
    turn = 0.028
    rotation = np.array([[np.cos(turn), np.sin(turn)], [-np.sin(turn), np.cos(turn)]])
    assert worlds.look(ahead((places @ rotation)[1:2])) == [worlds.best.numbers[2]]
    worlds.predict(0.2)
    assert worlds.look(ahead(places @ rotation)) == list(worlds.best.numbers)
    assert worlds.hypotheses[0].last[0] == worlds.best.numbers[1]


def test_sensor_without_errors_is_left_alone() -> None:
    """Noise alone moves next to nothing, although the sensor goes about; nor does an object that is carried."""
    rng = np.random.default_rng(11)
    model = WorldModel(WorldModelConfig(region=REGION, rate_hz=5.0, clutter_per_frame=0.01))
    spots = LANDMARKS.copy()
    for step in range(200):
        if step == 100:
            spots[0, :2] += (0.4, 0.3)
        pose = round_trip(step)
        seen, _ = measured(pose, np.zeros(7), rng)
        objects = [ObjectEvidence(spots[k] + rng.normal(0.0, 0.01, 3), 0.01**2 * np.eye(3)) for k in seen]
        state = model.update(
            WorldEvidence(objects, {"pose": tuple(pose.tolist()), "range": 6.0, "angle": 1.2}), 0.2 * step
        )
    assert model.sensor_bias == pytest.approx(np.zeros(8), abs=0.03)
    for item in state.objects:
        assert np.linalg.norm(spots - item.position, axis=1).min() < 0.03


def drive(stated: float, seed: int, learn: bool) -> tuple[WorldModel, list[tuple[str | None, ...]]]:
    """A sensor without errors, whose noise is 2 cm, goes about while an object is carried every 4 s; what is said."""
    rng = np.random.default_rng(seed)
    model = WorldModel(
        WorldModelConfig(region=REGION, rate_hz=5.0, clutter_per_frame=0.01, learn_sensor_bias=learn)
    )
    spots, said = LANDMARKS.copy(), []
    for step in range(300):
        if step % 20 == 19:
            spots[rng.integers(len(spots)), :2] += rng.normal(0.0, 0.2, 2)
        pose = round_trip(step)
        off = spots[:, :2] - pose[:2]
        bearing = (np.arctan2(off[:, 1], off[:, 0]) - pose[3] + np.pi) % (2.0 * np.pi) - np.pi
        objects = [
            ObjectEvidence(spot + rng.normal(0.0, 0.02, 3), stated**2 * np.eye(3))
            for spot in spots[np.abs(bearing) < 0.6]
        ]
        sensor = {"pose": tuple(pose.tolist()), "range": 8.0, "angle": 1.2}
        said.append(model.update(WorldEvidence(objects, sensor), 0.2 * step).associations)
    return model, said


@pytest.mark.parametrize("stated", [0.01, 0.02, 0.05])
def test_watching_changes_nothing_for_a_sensor_without_errors(stated: float) -> None:
    """Whatever covariances it states, and although things are carried about."""
    model, said = drive(stated, 7, learn=True)
    assert model.sensor_bias == (0.0,) * 8
    assert said == drive(stated, 7, learn=False)[1]


def test_sensor_that_stands_tells_nothing_about_its_errors() -> None:
    """Next to nothing: noise of bearings far off the axis is no change of place."""
    rng, errors = np.random.default_rng(1), SensorErrors(np.zeros(8))
    places, pose = np.array([[1.0, -0.5], [1.0, 0.4], [1.5, 0.5]]), np.zeros(4)
    R = np.tile(0.03**2 * np.eye(2), (3, 1, 1))
    for step in range(300):
        errors.worlds.predict(0.05 * step)
        errors.add([1, 2, 3], places + rng.normal(0.0, 0.03, (3, 2)), R, pose)
    spread = errors.worlds.best.P.diagonal()[:8]
    assert (np.sqrt(spread) > 0.4 * PRIOR).all()
    assert (np.abs(errors.worlds.best.x[:8]) < PRIOR).all()
    assert not errors.in_use


def test_evidence_is_a_bayes_factor() -> None:
    """Of what has no errors it is a sum whose exponential has mean one at most."""
    rng, ends = np.random.default_rng(2), []
    for _ in range(400):
        evidence, place = SensorEvidence(), np.zeros(2)
        evidence.begin(1, rng.normal(0.0, 0.1, 2), 0.01 * np.eye(2))
        x, P = evidence.places[1]
        for _ in range(20):
            z = place + rng.normal(0.0, 0.1, 2)
            evidence.weigh(1, z, 0.01 * np.eye(2), z - x, P + 0.03 * np.eye(2))
            x, P = evidence.places[1]
        ends.append(evidence.odds[1])
    assert np.mean(ends) < -1.0
    assert np.mean(np.array(ends) > 3.0) < np.exp(-3.0)


def test_one_witness_is_not_enough() -> None:
    evidence = SensorEvidence()
    evidence.odds = {1: 50.0, 2: -0.1, 3: -0.2}
    assert not evidence.enough(True)
    evidence.odds[2] = 4.0
    assert evidence.enough(True)
    assert not evidence.enough(False)
    evidence.odds[3] = 4.0
    assert evidence.enough(False)
    evidence.odds |= dict.fromkeys(range(4, 20), -0.5)
    assert not evidence.enough(True)


def test_resting_sensor_is_left_alone() -> None:
    errors = SensorErrors(np.zeros(8))
    assert not errors.follow(np.array([1.0, 2.0, 0.0, 0.0]), 0.0)
    assert not errors.follow(np.array([1.2, 2.0, 0.0, 3.0]), 0.1)
    assert errors.follow(np.array([1.6, 2.0, 0.0, 0.0]), 0.2)


def test_setting_is_checked() -> None:
    with pytest.raises(InputError, match="sensor_bias"):
        WorldModelConfig(sensor_bias=(0.1, 0.2))
