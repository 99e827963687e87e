"""A sweep on the way, beside one that was taken all at once from the same place."""

from dataclasses import replace

import numpy as np
import pytest

from estimation.geometry.poses import compound
from registration.laser.scan import Scan
from registration.laser.sweep import at_first_beam, beam_shares
from whereabouts.simulation import Lidar, Shapes, box, joined

ROOM = joined([box(6.0, 5.0), box(0.8, 0.5, (1.5, 1.0, 0.4))])
MOTION = np.array([0.06, 0.0, 0.16])  # over 0.2 s
POSE = np.array([-0.5, 0.3, 0.4])


def sweep(lidar: Lidar, shapes: Shapes = ROOM) -> tuple[Scan, Scan]:
    """One on the way, and one at once."""
    still = replace(lidar, sweep_time=0.0)
    scans = [
        lidar.scan(
            shapes, lambda t: compound(POSE, (t - 10.0) / 0.2 * MOTION), np.random.default_rng(0), 10.0
        ),
        still.scan(shapes, POSE, np.random.default_rng(0), 10.0),
    ]
    return scans[0].scan, scans[1].scan


@pytest.mark.parametrize("opening", [np.deg2rad(359.0), np.deg2rad(240.0)])
def test_it_looks_as_if_it_had_been_taken_at_once(opening: float) -> None:
    moving, still = sweep(Lidar(360, opening, sigma=0.0, sweep_time=0.199))
    seen = at_first_beam(moving, MOTION, 0.2)
    assert seen.time_increment == 0.0
    both = seen.valid & still.valid
    assert both.sum() > 320
    off = np.abs(seen.ranges - still.ranges)[both]
    assert np.quantile(off, 0.9) < 0.02
    assert np.quantile(np.abs(moving.ranges - still.ranges)[both], 0.5) > 0.05


def test_what_met_nothing_stays_where_it_points() -> None:
    moving, still = sweep(Lidar(360, np.deg2rad(359.0), range_max=3.0, sigma=0.0, sweep_time=0.199))
    seen = at_first_beam(moving, MOTION, 0.2)
    nothing = still.ranges == 3.0
    assert nothing.sum() > 20
    assert np.mean(seen.ranges[nothing] == 3.0) > 0.85
    assert not np.any(seen.valid & nothing & np.roll(nothing, 3) & np.roll(nothing, -3))


@pytest.mark.parametrize("elapsed", [0.0, -0.1, 1.0, np.nan])
def test_without_a_motion_it_is_left_alone(elapsed: float) -> None:
    moving, still = sweep(Lidar(360, np.deg2rad(359.0), sweep_time=0.199))
    assert at_first_beam(moving, MOTION, elapsed) is moving
    assert at_first_beam(still, MOTION, 0.2) is still


@pytest.mark.parametrize("increment", [0.2, -0.2, 0.002])
def test_a_time_that_no_beam_can_take_is_not_believed(increment: float) -> None:
    """As from a driver that gives the scan's time for the beam's; half a sweep more than a period is jitter."""
    _, still = sweep(Lidar(360, np.deg2rad(359.0)))
    assert at_first_beam(replace(still, time_increment=increment), MOTION, 0.2).time_increment == increment
    late = beam_shares(replace(still, time_increment=0.3 / 360), 0.2)
    assert late[-1] == pytest.approx(1.5, rel=0.01)


def test_beams_may_come_in_the_order_of_their_times_or_against_it() -> None:
    moving, _ = sweep(Lidar(360, np.deg2rad(359.0)))
    against = replace(moving, time_increment=-moving.time_increment)
    np.testing.assert_allclose(beam_shares(against, 0.2), -beam_shares(moving, 0.2))
