"""What hangs on one small piece is added to a covariance, and never taken off it."""

import numpy as np
from hypothesis import example, given, settings
from hypothesis import strategies as st

from registration.crf.online import _segment
from registration.laser.prepared import prepare
from registration.placement.align import among_movers
from registration.placement.influence import _more
from whereabouts.simulation import Lidar, box, corridor, joined

ROUND = Lidar(361, 2.0 * np.pi * 360 / 361)
SEEDS = st.integers(0, 2**31)


def in_a_corridor(seed: int) -> np.ndarray:
    """Covariance (3, 3) of two scans of a corridor with one to three boxes, some alone in telling the way along."""
    rng = np.random.default_rng(seed)
    sizes, places = rng.uniform(0.2, 0.9, (3, 2)), rng.uniform(-1.0, 1.0, (3, 3)) * [5.0, 0.8, 3.0]
    count = rng.integers(1, 4)
    boxes = [box(*size, tuple(place)) for size, place in zip(sizes[:count], places[:count], strict=True)]
    poses = rng.uniform(-1.0, 1.0, (2, 3)) * [0.3, 0.2, 0.2]
    scans = [ROUND.scan(joined([corridor(), *boxes]), pose, rng).scan for pose in poses]
    found = among_movers(prepare("source", scans[0]), prepare("target", scans[1]), np.zeros(3))
    return found.covariance


@settings(max_examples=25)
@given(SEEDS)
@example(36)
@example(580)
def test_the_covariance_of_an_open_direction_is_one(seed: int) -> None:
    covariance = in_a_corridor(seed)
    np.testing.assert_allclose(covariance, covariance.T, atol=1e-15)
    assert np.linalg.eigvalsh(covariance)[0] > 0.0
    forward = _segment(0, np.array([0.3, -0.2, 0.1]), covariance, 0.5, 0.0).covariance
    assert np.linalg.eigvalsh(forward)[0] > 0.0


@given(SEEDS)
def test_more_is_the_difference_where_that_is_a_covariance_and_its_positive_part_elsewhere(seed: int) -> None:
    rng = np.random.default_rng(seed)
    whole, other, grown = (a @ a.T for a in rng.normal(0.0, 1.0, (3, 3, 3)))
    np.testing.assert_allclose(_more(whole + grown, whole), grown, atol=1e-12)
    more = _more(other, whole)
    assert np.linalg.eigvalsh(more)[0] > -1e-12
    # At least the difference in every direction, and no more than is needed: what is beyond it is orthogonal.
    beyond = more - (other - whole)
    assert np.linalg.eigvalsh(beyond)[0] > -1e-12
    np.testing.assert_allclose(more @ beyond, np.zeros((3, 3)), atol=1e-10)
