"""The reference's filters on laser scans, and everything a tracker of people knows of beside people."""

from __future__ import annotations

import numpy as np
import pytest

from estimation.errors import InputError
from evaluation.scenes.people_scenes import PeopleScene
from registration.laser.scan import Scan
from tracking import PeopleTracker, PointsTracker, tracker_of
from whereabouts.simulation.shapes import box, circle, joined
from whereabouts.simulation.walkers import Build, SimulatedWalker


def _scene(duration: float = 6.0) -> PeopleScene:
    """Somebody walks by in a room with a pillar; he comes in after a second and a half."""
    walker = SimulatedWalker(np.array([[3.0, -6.0], [3.0, 6.0]]), 1.2, Build("trunk"))
    return PeopleScene(joined([box(16.0, 9.0), circle(5.0, 3.0, 0.15)]), [walker], duration)


@pytest.mark.parametrize("name", ["phd", "gmphd"])
def test_the_reference_s_filters_follow_a_walker_among_walls(name: str) -> None:
    tracker = tracker_of(name)
    assert isinstance(tracker, PointsTracker)
    gaps, counts, labels = [], [], set()
    scene = _scene()
    for scan in scene.scans(np.random.default_rng(0)):
        targets = tracker.step(scan.scan, scan.pose, scan.scan.stamp)
        if scan.scan.stamp > 4.0:
            away = [float(np.linalg.norm(target.mean[:2] - scan.people[0])) for target in targets]
            gaps.append(min(away, default=9.0))
            counts.append(len(targets))
            labels |= {target.label for target in targets}
    # A laser sees the front of a trunk.
    assert np.mean(np.array(gaps) < 0.4) > 0.9
    assert np.mean(counts) < 1.6
    assert tracker.targets == targets
    targets.clear()
    assert tracker.targets
    assert tracker.expected_count == pytest.approx(np.mean(counts), abs=0.6)


def test_names_and_inputs_that_mean_nothing_are_refused() -> None:
    assert isinstance(tracker_of("mixture"), PeopleTracker)
    for name in ("pmbm", ""):
        with pytest.raises(InputError, match="filter"):
            tracker_of(name)
    with pytest.raises(InputError, match="filter"):
        PointsTracker("mixture")
    with pytest.raises(InputError, match="config"):
        PointsTracker("phd", {})
    scan = Scan(np.full(10, 3.0), -0.5, 0.1, 0.05, 10.0, 0.0)
    tracker = PointsTracker("phd")
    with pytest.raises(InputError, match="pose"):
        tracker.step(scan, np.zeros(2), 0.0)
    with pytest.raises(InputError, match="stamp"):
        tracker.step(scan, np.zeros(3), np.nan)


def test_late_scans_change_nothing_and_older_ones_are_a_new_run() -> None:
    tracker = PointsTracker("phd")
    scan = Scan(np.full(10, 3.0), -0.5, 0.1, 0.05, 10.0, 0.0)
    for stamp in (10.0, 10.1, 9.9, 10.2, 1.0):
        tracker.step(scan, np.zeros(3), stamp)
    assert (tracker.health.late, tracker.health.restarts) == (1, 1)


def test_targets_are_everything_that_stands_free_and_people_keep_their_labels_among_them() -> None:
    """The pillar is a target and no person; people are told of under the same labels by both."""
    alone, tracker = PeopleTracker(), PeopleTracker()
    scene, classes = _scene(), []
    for scan in scene.scans(np.random.default_rng(0)):
        expected = alone.step(scan.scan, scan.pose, scan.scan.stamp)
        people = tracker.step(scan.scan, scan.pose, scan.scan.stamp)
        targets = {target.label: target for target in tracker.targets}
        np.testing.assert_array_equal([p.mean for p in people], [p.mean for p in expected])
        for person in people:
            np.testing.assert_array_equal(targets[person.label].mean, person.mean)
        others = [target for target in targets.values() if np.hypot(*(target.mean[:2] - [5.0, 3.0])) < 0.4]
        classes += [target.person for target in others]  # type: ignore[attr-defined]
    assert len(people) == 1
    assert len(classes) > 30
    assert max(classes) < 0.5
