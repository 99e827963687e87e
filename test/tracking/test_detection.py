"""Detection behind other targets, walls, and out of reach: values, smoothness, and what a miss says."""

from __future__ import annotations

import numpy as np
import pytest

from estimation.errors import InputError
from evaluation.phd.phd_hidden import FILTERS, follow
from tracking import ExtendedTargetPhd, PhdConfig
from tracking.mixture.components import Components
from tracking.mixture.detection import BearingDetection, OcclusionDetection
from tracking.mixture.phd_models import ConstantVelocityMotion, Labels, Sight

POSE = np.array([0.0, 0.0, 0.5 * np.pi])
CONFIG = PhdConfig(measurement_noise=0.1, measurement_rate=12.0, detection_probability=0.95)


def people(positions: list[tuple[float, float]], deviation: float = 0.05) -> Components:
    """People at known places, each with its own label."""
    count = len(positions)
    means = np.hstack([np.array(positions), np.zeros((count, 2))])
    P = np.tile(np.diag([deviation**2, deviation**2, 1.0, 1.0]), (count, 1, 1))
    return ConstantVelocityMotion(CONFIG).fresh(np.ones(count), means, P, Labels())


def sight(components: Components, weights: list[float] | None = None, **settings: object) -> Sight:
    walls = settings.pop("walls", None)
    config = PhdConfig(**{**CONFIG.__dict__, **settings})
    model = OcclusionDetection(config, walls)
    weights = [1.0] * len(components) if weights is None else weights
    return model.in_scene(components, np.array(weights), len(components), POSE)


def effective(seen: Sight) -> np.ndarray:
    """Probability of any return."""
    return seen.probability * -np.expm1(-CONFIG.measurement_rate * seen.share)


def test_in_the_open_it_is_as_configured() -> None:
    seen = sight(people([(0.0, 5.0), (3.0, 5.0), (-4.0, 2.0)]))
    np.testing.assert_allclose(seen.probability, 0.95, rtol=1e-6)
    np.testing.assert_allclose(seen.share, 1.0, rtol=1e-6)


def test_behind_another_nothing_is_seen_and_before_it_all() -> None:
    seen = effective(sight(people([(0.0, 3.0), (0.0, 8.0), (0.0, 3.1)])))
    assert seen[1] < 0.05
    assert seen[0] == pytest.approx(0.95, abs=0.01)
    # Side by side, or the same body twice, hides nothing.
    assert seen[2] > 0.9


def test_an_improbable_target_hides_little() -> None:
    values = [effective(sight(people([(0.0, 3.0), (0.0, 8.0)]), [w, 1.0]))[1] for w in (1.0, 0.7, 0.3, 0.1)]
    assert (np.diff(values) > 0).all()
    assert values[-1] > 0.8


def test_detection_is_smooth_along_a_walk() -> None:
    """Steps of a centimetre through the shadow: no jump, one minimum, symmetric."""
    x = np.arange(-1.5, 1.501, 0.01)
    values = np.array([effective(sight(people([(0.0, 3.0), (at, 8.0)])))[1] for at in x])
    assert np.abs(np.diff(values)).max() < 0.08
    np.testing.assert_allclose(values, values[::-1], atol=1e-6)
    assert (np.diff(values[: len(x) // 2]) <= 1e-9).all()
    assert values[0] == pytest.approx(0.95, abs=0.01)


def test_walls_reach_and_opening() -> None:
    wall = [[[-5.0, 4.0], [0.0, 4.0]]]
    seen = effective(sight(people([(-2.0, 6.0), (2.0, 6.0), (-2.0, 3.0)]), walls=wall))
    np.testing.assert_allclose(seen, [0.0, 0.95, 0.95], atol=0.02)
    far = effective(sight(people([(0.0, 5.0), (0.0, 12.0)]), sensor_range=10.0))
    np.testing.assert_allclose(far, [0.95, 0.0], atol=0.02)
    aside = effective(sight(people([(0.0, 5.0), (5.0, 0.5)]), field_of_view=np.pi / 2))
    np.testing.assert_allclose(aside, [0.95, 0.0], atol=0.02)


def test_without_a_pose_nothing_is_hidden() -> None:
    hidden = people([(0.0, 3.0), (0.0, 8.0)])
    seen = OcclusionDetection(CONFIG).in_scene(hidden, np.ones(2), 2, None)
    np.testing.assert_array_equal(seen.probability, 0.95)
    assert seen.means is hidden.means


def test_an_unseen_target_is_where_it_is_hidden() -> None:
    """Mean and spread after a miss against samples of the target's place weighted by the chance of a miss."""
    front, at, deviation = (0.0, 3.0), (0.6, 8.0), 0.4
    both = people([front, at])
    both.covariances[1, :2, :2] = deviation**2 * np.eye(2)
    seen = sight(both)
    x = at[0] + deviation * np.linspace(-4, 4, 161)
    # A place known to the millimetre has the chance that the blur of the body leaves it.
    miss = 1.0 - np.array([effective(sight(people([front, (value, at[1])], 1e-3)))[1] for value in x])
    weights = np.exp(-0.5 * ((x - at[0]) / deviation) ** 2) * miss
    weights /= weights.sum()
    mean = weights @ x
    assert seen.means[1, 0] == pytest.approx(mean, abs=0.06)
    assert seen.means[1, 0] < at[0] - 0.2
    assert np.sqrt(seen.covariances[1, 0, 0]) == pytest.approx(np.sqrt(weights @ (x - mean) ** 2), abs=0.06)
    assert np.linalg.eigvalsh(seen.covariances).min() > 0
    np.testing.assert_allclose(seen.means[0, :2], front, atol=1e-3)


def test_walls_of_another_shape_are_refused() -> None:
    with pytest.raises(InputError, match="walls"):
        OcclusionDetection(CONFIG, np.zeros((3, 2)))


@pytest.mark.parametrize("walk", [(1.0, (5.0, 7.0)), (0.7, (4.0, 11.0))])
def test_a_hidden_person_is_kept_under_its_label(walk: tuple[float, tuple[float, float]]) -> None:
    """Hidden for up to a second: kept, and no surplus when it re-appears; lost with a constant p_D."""
    speed, away = walk
    for seed in range(3):
        run = follow(*FILTERS["mixture, variable p_D, own rates"], seed, speed, away)
        assert run.kept
        assert run.jump < 0.1
        assert not follow(*FILTERS["mixture, constant p_D"], seed, speed, away).kept


def test_p_d_of_the_text_falls_by_weight_and_bearing_deviation_behind_a_component() -> None:
    model = BearingDetection(CONFIG)

    def p(at: tuple[float, float], weight: float = 1.0, deviation: float = 1e-6) -> float:
        both = people([(0.0, 4.0), at], deviation)
        return float(model.in_scene(both, np.array([weight, 1.0]), 2, POSE).probability[1])

    assert p((0.0, 8.0)) == pytest.approx(0.01)
    assert p((0.0, 2.0)) == 0.95
    assert p((3.0, 8.0)) == pytest.approx(0.95)
    # Half as deep by half the weight; at the edge of a body; and nowhere near where a body stands.
    assert p((0.0, 8.0), 0.5) == pytest.approx(0.95 - 0.5)
    edge = CONFIG.occluder_width * CONFIG.measurement_noise / 4.0
    assert p((8.0 * np.sin(edge), 8.0 * np.cos(edge))) == pytest.approx(0.95 - 0.5, abs=1e-3)
    assert p((0.0, 4.3)) == pytest.approx(0.95)
    # A shadow whose bearing is uncertain is as much, but spread: its integral over bearing stays.
    bearings = np.linspace(-0.6, 0.6, 601)
    sums = [
        sum(0.95 - p((8.0 * np.sin(b), 8.0 * np.cos(b)), 0.5, deviation) for b in bearings)
        for deviation in (1e-6, 0.3)
    ]
    assert sums[1] == pytest.approx(sums[0], rel=0.01)
    assert p((0.0, 8.0), 0.5, 0.3) > p((0.0, 8.0), 0.5)


def test_the_text_s_filter_follows_a_hidden_person_and_jumps_by_less_than_one_and_a_half_when_it_is_back() -> (
    None
):
    """Figure 4: lost with constant p_D; with variable p_D no shortfall, and 1 + P_E (1 - p_D) at a detection."""
    for seed in range(2):
        run = follow(*FILTERS["as printed, variable p_D"], seed, 0.5, (5.0, 7.0))
        assert run.followed
        assert run.fall < 0.5 < run.jump < 1.5
        constant = follow(*FILTERS["as printed, constant p_D"], seed, 0.5, (5.0, 7.0))
        assert not constant.followed
        assert constant.fall > 0.9


def test_a_detection_model_sees_the_scene() -> None:
    """A filter told nothing of the sensor is the filter without occlusion."""
    rng = np.random.default_rng(8)
    births = [(0.1, [0.0, 0.0, 0.0, 0.0], np.diag([400.0, 400.0, 25.0, 25.0]))]
    filters = [ExtendedTargetPhd(PhdConfig(births=births, occlusion=flag)) for flag in (True, False)]
    for k in range(5):
        z = rng.normal(0, 20, (10, 2))
        found = [filter_.step(z, float(k)) for filter_ in filters]
    np.testing.assert_array_equal(found[0][0].mean, found[1][0].mean)
