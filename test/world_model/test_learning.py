"""What is learned from a log, against what made it."""

from __future__ import annotations

import numpy as np
import pytest

from estimation.errors import InputError
from whereabouts.simulation.objects import ObjectScene, scattered
from world_model import WorldEvidence, WorldModelConfig
from world_model.learning import learn

ROOM = ((-2.5, 2.5), (-2.5, 2.5), (0.0, 1.5))
SENSOR = {"pose": (-3.0, 0.0, 1.0, 0.0), "range": 10.0, "angle": 2.0 * np.pi}


@pytest.mark.parametrize(
    ("detection", "clutter", "run", "sigma"), [(0.9, 0.5, 1.0, 0.02), (0.7, 1.5, 4.0, 0.05)]
)
def test_learns_what_made_the_log(detection: float, clutter: float, run: float, sigma: float) -> None:
    things = scattered(12, np.random.default_rng(0), ROOM, 0.5)
    scene = ObjectScene(
        things, ROOM, detection=detection, clutter=clutter, missed_run=run, sigma=sigma, sensor=SENSOR
    )
    log = [(seen.stamp, seen.evidence) for seen in scene.looks(500)]
    start = WorldModelConfig(classes=scene.classes, colors=scene.colors, region=ROOM)
    learned = learn(log, start)
    assert learned.objects == 12
    assert learned.config.detection_probability == pytest.approx(detection, abs=0.03)
    assert learned.config.clutter_per_frame == pytest.approx(clutter, rel=0.15)
    assert learned.config.missed_run_frames == pytest.approx(max(run, 1.0 / detection), rel=0.15)
    assert learned.config.measurement_sigma == pytest.approx(sigma, rel=0.1)
    assert learned.config.rate_hz == pytest.approx(20.0, rel=0.01)
    for covariance in learned.covariances.values():
        np.testing.assert_allclose(covariance, sigma**2 * np.eye(3), atol=0.3 * sigma**2)


def test_too_short_a_log_is_refused() -> None:
    with pytest.raises(InputError, match="looks"):
        learn([(0.0, WorldEvidence([]))])
