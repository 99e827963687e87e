"""SLAM on simulated rounds: closed from the same and the opposite direction, saved, found again."""

from __future__ import annotations

import io
import pickle
from collections.abc import Callable
from copy import deepcopy
from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from estimation.errors import InputError
from estimation.geometry.poses import between, compound, inverse
from estimation.metrics.statistics import absolute_trajectory_error, align_points
from loop_closure.graph.edges import Edge
from loop_closure.maps.localization import Localizer
from loop_closure.maps.map_file import read_map, write_map
from loop_closure.maps.merging import merge
from loop_closure.slam import closing
from loop_closure.slam.closure_hypotheses import Guess
from loop_closure.slam.trajectory import Slam
from loop_closure.slam_config import SlamConfig
from loop_closure.work import Steps
from registration import Odometry, Scan
from whereabouts.simulation import Drive, Lidar, Shapes, box, joined

SPOTS = (
    (-7.5, 5.4), (-3.0, 5.5), (1.2, 5.3), (6.0, 5.4), (7.6, 0.8), (7.4, -3.0), (4.2, -5.5), (0.3, -5.4),
    (-4.4, -5.5), (-7.6, -1.2), (-7.4, 2.2), (2.5, 2.9), (-4.0, -2.9),
)  # fmt: skip
CORNERS = [(-6.8, -4.7), (6.8, -4.7), (6.8, 4.7), (-6.8, 4.7)]


def ring() -> Shapes:
    """A round of 46 m through a furnished building."""
    rng = np.random.default_rng(3)
    furniture = [
        box(rng.uniform(0.3, 1.2), rng.uniform(0.2, 0.5), (x, y, rng.uniform(0.0, 3.0))) for x, y in SPOTS
    ]
    return joined([box(16.0, 12.0), box(11.0, 7.0), *furniture])


def drive_of(corners: list[tuple[float, float]]) -> Drive:
    return Drive(corners, speed=0.7, turn_rate=0.8)


def recorded(drive: Drive, seed: int, drift: float) -> tuple[list[Scan], np.ndarray, np.ndarray]:
    """Scans, odometry that drifts (m and rad per metre), and the truth; at 4 Hz."""
    rng, lidar, world = np.random.default_rng(seed), Lidar(181), ring()
    scans, odometry, truth = [], [np.zeros(3)], []
    for k in range(int(drive.duration / 0.25)):
        pose = drive(0.25 * k)
        scans.append(lidar.scan(world, pose, rng, 0.25 * k).scan)
        truth.append(pose)
        if k:
            step = between(truth[-2], pose)
            far = np.hypot(*step[:2])
            step = (
                step * (1.0 + 0.3 * drift)
                + np.array([0.0, 0.0, drift * far])
                + 0.002 * rng.standard_normal(3)
            )
            odometry.append(compound(odometry[-1], step))
    return scans, np.array(odometry), np.array(truth)


def mapped(scans: list[Scan], odometry: np.ndarray, **more: Any) -> Slam:
    slam = Slam(**more)
    for scan, pose in zip(scans, odometry, strict=True):
        slam.process(scan, pose)
    return slam


@pytest.fixture(scope="module")
def same_way() -> tuple[Slam, np.ndarray, np.ndarray]:
    scans, odometry, truth = recorded(drive_of([*CORNERS, *CORNERS[:3]]), 1, 0.004)
    return mapped(scans, odometry), odometry, truth


def test_a_robot_that_is_carried_away_while_it_maps_is_found_again() -> None:
    """Odometry says that it knows nothing of how it came there, so that it is looked for where its map allows it."""
    drive, lidar, rng = drive_of([*CORNERS, *CORNERS]), Lidar(361, 2.0 * np.pi), np.random.default_rng(2)
    whole = np.array([drive(0.25 * k) for k in range(int(drive.duration / 0.25))])
    first = int(0.62 * len(whole))
    truth = np.delete(whole, slice(first, first + 60), axis=0)
    assert np.hypot(*(truth[first] - truth[first - 1])[:2]) > 9.0
    odometry, slam, world, reasons = Odometry(), Slam(), ring(), []
    for k, pose in enumerate(truth):
        stamp = 0.25 * k + (5.0 if k >= first else 0.0)
        scan = lidar.scan(world, pose, rng, stamp).scan
        slam.process(scan, odometry.register(scan, stamp), odometry.covariance, stamp)
        if "a new one begins" in odometry.reason:
            reasons.append(k - first)
            assert np.sqrt(np.linalg.eigvalsh(odometry.increment_covariance)[1:]).min() > 5.0
    assert len(reasons) == 1
    assert reasons[0] < 10
    start = compound(truth[0], inverse(slam.trajectory()[0, 1:]))
    misses = np.array([compound(start, pose) for pose in slam.trajectory()[:, 1:]]) - truth
    assert np.hypot(*misses[first + 20 :, :2].T).max() < 0.2


def wrong(slam: Slam, truth: np.ndarray) -> list[float]:
    first = slam.first_visits()
    misses = [
        between(between(truth[first[c.earlier]], truth[first[c.later]]), c.relative) for c in slam.closures
    ]
    return [float(np.hypot(*miss[:2])) for miss in misses]


def test_a_second_round_is_closed_and_the_drift_gone(same_way: tuple[Slam, np.ndarray, np.ndarray]) -> None:
    slam, odometry, truth = same_way
    trajectory = slam.trajectory()
    assert trajectory.shape == (len(truth), 4)
    np.testing.assert_allclose(trajectory[:, 0], 0.25 * np.arange(len(truth)))
    before = absolute_trajectory_error(odometry[:, :2], truth[:, :2]).rmse
    after = absolute_trajectory_error(trajectory[:, 1:3], truth[:, :2]).rmse
    assert before > 0.4
    assert after < 0.12
    assert len(slam.closures) > 20
    assert max(wrong(slam, truth)) < 0.2
    for closure in slam.closures:
        assert np.linalg.eigvalsh(closure.covariance).min() > 0.0


def test_closures_that_were_told_are_no_handle_on_the_graph(
    same_way: tuple[Slam, np.ndarray, np.ndarray],
) -> None:
    slam = same_way[0]
    told = slam.closures
    told.clear()
    assert slam.closures
    for closure in slam.closures:
        for edge in slam.graph.edges:
            assert not np.shares_memory(closure.relative, edge.motion)
            assert not np.shares_memory(closure.covariance, edge.covariance)


def test_the_classifier_alone_proposes_what_the_path_does_not_allow() -> None:
    scans, odometry, truth = recorded(drive_of([*CORNERS, *CORNERS[:3]]), 1, 0.004)
    # A guessed step of odometry that is sure of itself puts the second round where the first never was.
    half = len(scans) // 2
    odometry[half:, :2] += [60.0, -40.0]
    by_path, by_places = (mapped(scans, odometry, proposals=mode) for mode in ("path", "places"))
    for slam in (by_path, by_places):
        assert max(wrong(slam, truth), default=0.0) < 0.2
    assert not [c for c in by_path.closures if c.later > half]
    assert len([c for c in by_places.closures if c.earlier_stamp < 0.25 * half <= c.later_stamp]) >= 8


def test_proposals_are_one_of_three_words() -> None:
    with pytest.raises(InputError, match="proposals: both"):
        Slam(proposals="nose")  # type: ignore[arg-type]
    with pytest.raises(InputError, match="needs scans"):
        Slam(proposals="places").process(np.zeros((100, 3)), np.eye(4))


def test_what_stayed_undecided_is_decided_in_hindsight(monkeypatch: pytest.MonkeyPatch) -> None:
    """Placements found on the way can only speak against others here: the path on both sides has to do it."""

    def undecided(*given: Any) -> Steps[list[Guess]]:
        in_hindsight = given[-1]
        fits = yield from closing.looking(*given)
        return [replace(fit, certain=False, expected=in_hindsight and fit.expected) for fit in fits]

    monkeypatch.setattr("loop_closure.slam.loop_closer.looking", undecided)
    scans, odometry, truth = recorded(drive_of([*CORNERS, *CORNERS[:2]]), 1, 0.004)
    slam = mapped(scans, odometry)
    assert slam.closures == []
    slam.trajectory()
    assert len(slam.closures) > 10
    assert max(wrong(slam, truth)) < 0.2


def test_a_group_that_has_won_is_closed_with_other_passes_too(monkeypatch: pytest.MonkeyPatch) -> None:
    """On the way placements on the first round alone are found, and have to wait; in hindsight others follow."""

    def first_round_only(*given: Any) -> Steps[list[Guess]]:
        frames, in_hindsight = given[1], given[-1]
        fits = yield from closing.looking(*given)
        if in_hindsight:
            return fits
        return [replace(fit, certain=False) for fit in fits if frames[fit.edge.a].path < 40.0]

    monkeypatch.setattr("loop_closure.slam.loop_closer.looking", first_round_only)
    scans, odometry, truth = recorded(drive_of([*CORNERS, *CORNERS, *CORNERS[:3]]), 1, 0.004)
    slam = mapped(scans, odometry)
    slam.trajectory()
    paths = slam.keyframes.paths
    waited = {c.later for c in slam.closures if "along the path agree" in c.reason and paths[c.later] > 95.0}
    again = {c.later for c in slam.closures if "second look" in c.reason and 46.0 < paths[c.earlier] < 90.0}
    assert len(waited & again) > 5
    pairs = [(c.earlier, c.later) for c in slam.closures]
    assert len(set(pairs)) == len(pairs)
    assert max(wrong(slam, truth)) < 0.2


def test_the_way_back_is_closed_from_the_opposite_direction() -> None:
    scans, odometry, truth = recorded(drive_of([*CORNERS, CORNERS[2], CORNERS[1], CORNERS[0]]), 2, 0.003)
    slam = mapped(scans, odometry)
    after = absolute_trajectory_error(slam.trajectory()[:, 1:3], truth[:, :2]).rmse
    assert after < 0.12
    assert max(wrong(slam, truth)) < 0.2
    assert any(abs(abs(c.relative[2]) - np.pi) < 0.5 for c in slam.closures)


def test_the_same_scans_give_the_same_map(same_way: tuple[Slam, np.ndarray, np.ndarray]) -> None:
    scans, odometry, _ = recorded(drive_of([*CORNERS, *CORNERS[:2]]), 1, 0.004)
    np.testing.assert_array_equal(mapped(scans, odometry).trajectory(), mapped(scans, odometry).trajectory())


def test_a_saved_map_is_the_same_and_the_robot_is_found_in_it(
    same_way: tuple[Slam, np.ndarray, np.ndarray], tmp_path
) -> None:
    slam, _, truth = same_way
    slam.finish()
    file = tmp_path / "ring.npz"
    with file.open("wb") as out:
        write_map(slam, out)
    again = read_map(file)
    np.testing.assert_allclose(again.graph.poses, slam.graph.poses, atol=1e-9)
    assert [(c.earlier, c.later) for c in again.closures] == [(c.earlier, c.later) for c in slam.closures]
    scans, odometry, way = recorded(drive_of([CORNERS[1], CORNERS[2], CORNERS[3]]), 9, 0.0)
    localizer = Localizer(again.keyframes, again.graph.poses)
    located = []
    for k, (scan, pose) in enumerate(zip(scans, odometry, strict=True)):
        if k in (5, 80):
            localizer = deepcopy(localizer)  # while it is lost, and later
        located.append(localizer.process(scan, pose))
    found = [k for k, item in enumerate(located) if item.pose is not None]
    assert found, "never found"
    assert found[0] * 0.25 * 0.7 < 12.0, "metres until it was found"
    lag = align_points(np.array(slam.visited())[:, :2], truth[:, :2])
    for k in found:
        pose = located[k].pose
        assert pose is not None
        assert np.linalg.norm(lag[:2, :2] @ pose[:2] + lag[:2, 2] - way[k, :2]) < 0.25


def test_a_map_that_cannot_be_read_says_so(tmp_path) -> None:
    for content in (None, b"", b"nonsense"):
        file = tmp_path / "map.npz"
        if content is not None:
            file.write_bytes(content)
        with pytest.raises(InputError, match=r"map\.npz"):
            read_map(file)
    with pytest.raises(InputError, match=r"name the \.npz file"):
        read_map(tmp_path / "map.yaml")
    other = io.BytesIO()
    np.savez(other, something=np.zeros(3))
    (tmp_path / "map.npz").write_bytes(other.getvalue())
    with pytest.raises(InputError, match=r"map\.npz"):
        read_map(tmp_path / "map.npz")


@pytest.mark.parametrize(
    ("scan", "odometry"),
    [
        (Scan(np.ones(10), -1.0, 0.2), np.eye(4)),
        (np.zeros((5, 3)), np.zeros(3)),
        (Scan(np.ones(10), -1.0, 0.2), [0.0, np.nan, 0.0]),
        (Scan(np.ones(10), -1.0, 0.2), np.zeros(4)),
    ],
)
def test_bad_input_is_named(scan, odometry) -> None:
    with pytest.raises(InputError, match="odometry"):
        Slam().process(scan, odometry)


@pytest.mark.parametrize(
    ("covariance", "stamp", "named"),
    [
        (np.full((3, 3), np.nan), None, "covariance"),
        (np.eye(2), None, "covariance"),
        (-np.eye(3), None, "covariance"),
        (None, np.nan, "stamp"),
        (None, "now", "stamp"),
        (None, 1.7e12, "stamp"),
    ],
)
def test_what_odometry_says_of_itself_is_checked(covariance, stamp, named) -> None:
    slam = Slam()
    with pytest.raises(InputError, match=named):
        slam.process(Scan(np.ones(10), -1.0, 0.2), np.zeros(3), covariance, stamp)
    assert slam.trajectory().shape == (0, 4)


def test_a_cloud_that_is_none_is_refused_between_keyframes_too() -> None:
    slam, cloud = Slam(), np.random.default_rng(0).uniform(-5.0, 5.0, (300, 3))
    slam.process(cloud, np.eye(4))
    with pytest.raises(InputError, match="scan"):
        slam.process(np.zeros((5, 2)), np.eye(4))
    with pytest.raises(InputError, match="odometry"):
        slam.process(cloud, np.diag([1.0, 1.0, -1.0, 1.0]))
    assert len(slam.trajectory()) == 1


def test_buffers_that_are_filled_anew_change_nothing_that_was_kept() -> None:
    scans, odometry, _ = recorded(drive_of(CORNERS[:2]), 0, 0.0)
    pose, ranges, covariance = np.zeros(3), np.zeros(len(scans[0])), np.zeros((3, 3))
    slam, other = Slam(), Slam()
    for scan, here in zip(scans, odometry, strict=True):
        slam.process(scan, here, 1e-4 * np.eye(3))
        pose[:], ranges[:], covariance[:] = here, scan.ranges, 1e-4 * np.eye(3)
        other.process(replace(scan, ranges=ranges), pose, covariance)
        pose[:], ranges[:], covariance[:] = 1e3, 1.0, np.nan
    np.testing.assert_array_equal(other.trajectory(), slam.trajectory())


@pytest.mark.parametrize("copied", [deepcopy, lambda slam: pickle.loads(pickle.dumps(slam))])
def test_a_copy_goes_on_by_itself(copied: Callable[[Slam], Slam]) -> None:
    scans, odometry, _ = recorded(drive_of([*CORNERS, *CORNERS[:3]]), 1, 0.004)
    slam, half = Slam(pace=2.0), len(scans) * 3 // 4
    for scan, pose in zip(scans[:half], odometry[:half], strict=True):
        slam.process(scan, pose)
    assert slam.behind
    other = copied(slam)
    for scan, pose in zip(scans[half:], odometry[half:], strict=True):
        other.process(scan, pose)
    assert len(slam.trajectory()) == half
    after = other.trajectory()
    assert len(other.closures) > len(slam.closures)
    for scan, pose in zip(scans[half:], odometry[half:], strict=True):
        slam.process(scan, pose)
    np.testing.assert_allclose(slam.trajectory(), after, atol=0.05)


def test_settings_have_limits() -> None:
    with pytest.raises(InputError, match="key_distance"):
        SlamConfig(key_distance=-1.0)
    with pytest.raises(InputError, match="no scan"):
        _ = Slam().pose


def test_a_run_is_resumed_at_a_pose_in_the_map() -> None:
    slam = Slam()
    with pytest.raises(InputError, match="no scan"):
        _ = slam.correction
    with pytest.raises(InputError, match="no map"):
        slam.resume(np.zeros(3))
    slam.process(Scan(np.full(90, 3.0), -1.5, 3.0 / 90.0), np.zeros(3))
    for wrong_one in (np.full(3, np.nan), np.eye(4), [1.0, 2.0]):
        with pytest.raises(InputError, match="correction"):
            slam.resume(wrong_one)
    slam.resume([1.0, 2.0, 0.0])
    update = slam.process(Scan(np.full(90, 3.0), -1.5, 3.0 / 90.0), np.zeros(3))
    np.testing.assert_allclose(update.pose, [1.0, 2.0, 0.0], atol=1e-6)


def test_scans_without_returns_do_no_harm() -> None:
    slam = Slam()
    for k in range(30):
        update = slam.process(Scan(np.full(50, np.inf), -1.0, 0.04), np.array([0.6 * k, 0.0, 0.0]))
        assert update.closures == []
    assert slam.trajectory().shape == (30, 4)


def test_a_leap_of_the_odometry_is_not_believed_and_the_saved_map_knows(tmp_path) -> None:
    slam = Slam()
    steps = [(0.0, 0.0)] + [(0.6 * k, np.pi * (k == 4)) for k in range(1, 8)]
    for x, yaw in steps:
        slam.process(Scan(np.full(90, 3.0), -1.5, 3.0 / 90.0), np.array([x, 0.0, yaw]))
    # The leap to the turned pose and the one back.
    assert sorted(slam.keyframes.breaks) == [4, 5]
    doubts = [np.sqrt(edge.covariance[2, 2]) for edge in slam.graph.edges]
    assert min(doubts[3:5]) > 1.0 > 0.1 > max(doubts[:3] + doubts[5:])
    file = tmp_path / "leap.npz"
    with file.open("wb") as out:
        write_map(slam, out)
    assert read_map(file).keyframes.breaks == slam.keyframes.breaks


def test_a_false_closure_is_taken_out_and_the_true_ones_stay() -> None:
    scans, odometry, truth = recorded(drive_of([*CORNERS, *CORNERS[:3]]), 1, 0.004)
    slam = mapped(scans, odometry)
    true = len(slam.closures)
    before = absolute_trajectory_error(slam.trajectory()[:, 1:3], truth[:, :2]).rmse
    # Two keyframes of the first side and of the second round's far end are said to be one place.
    paths = slam.keyframes.paths
    a, b = int(np.searchsorted(paths, 3.0)), int(np.searchsorted(paths, 22.0))
    lie = Edge(a, b, np.array([0.2, 0.1, 0.0]), np.diag([0.01, 0.01, 0.001]) ** 2, True)
    slam.graph.close([lie])
    spoilt = absolute_trajectory_error(np.array(slam.visited())[:, :2], truth[:, :2]).rmse
    assert spoilt > 10.0 * before
    assert slam.remove_closure(lie) == 1
    after = absolute_trajectory_error(slam.trajectory()[:, 1:3], truth[:, :2]).rmse
    assert after == pytest.approx(before, abs=0.01)
    assert len(slam.closures) == true


def test_a_revisit_that_was_taken_out_is_not_found_again() -> None:
    scans, odometry, _ = recorded(drive_of([*CORNERS, *CORNERS[:3]]), 1, 0.004)
    half = len(scans) * 3 // 4
    slam = mapped(scans[:half], odometry[:half])
    assert slam.closures
    one = next(item for item in slam.graph.edges if item.closure)
    refused = slam.keyframes.paths[[one.a, one.b]]
    count = slam.remove_closure(one)
    assert count >= 1
    for scan, pose in zip(scans[half:], odometry[half:], strict=True):
        slam.process(scan, pose)
    slam.trajectory()  # looks at everything once more
    assert slam.closures, "what lies farther on is closed as ever"
    paths = slam.keyframes.paths
    ends = np.array([[paths[c.earlier], paths[c.later]] for c in slam.closures])
    assert (np.abs(ends - refused).max(axis=1) >= 10.0).all()


def test_what_is_no_closure_cannot_be_taken_out() -> None:
    scans, odometry, _ = recorded(drive_of(CORNERS[:2]), 1, 0.0)
    slam = mapped(scans[:20], odometry[:20])
    other = Edge(0, 1, np.zeros(3), np.eye(3), True)
    for edge in (slam.graph.edges[0], other):
        with pytest.raises(InputError, match="none of the graph's closures"):
            slam.remove_closure(edge)


def test_two_sessions_become_one_map_without_a_guess() -> None:
    there = drive_of(CORNERS[:3])
    further = drive_of([(6.8, 2.0), *CORNERS[2:], CORNERS[0], (0.0, -4.7)])
    monday, drifted, truth = recorded(there, 1, 0.0004)
    tuesday, other, later = recorded(further, 2, 0.0004)
    # The second session's odometry has a frame of its own.
    other = np.array([compound(np.array([40.0, -7.0, 2.0]), pose) for pose in other])
    first, second = mapped(monday, drifted), mapped(tuesday, other)
    count, added = len(first.keyframes), len(second.keyframes)
    found = merge(first, second)
    assert 0 <= found < added
    assert len(first.keyframes) >= count + added
    known = {round(scan.stamp, 6): pose for scan, pose in zip(tuesday, later, strict=True)}
    places = np.array([known[round(first.keyframes[k].stamp, 6)] for k in range(count, len(first.keyframes))])
    # In the frame of the first session, which is that of its first scan.
    expected = np.array([between(truth[0], place) for place in places])
    misses = np.hypot(*(first.graph.poses[count:, :2] - expected[:, :2]).T)
    assert misses.max() < 0.2


def test_what_has_nothing_in_common_is_not_merged() -> None:
    scans, odometry, _ = recorded(drive_of(CORNERS[:2]), 1, 0.0)
    first, empty = mapped(scans, odometry), Slam()
    with pytest.raises(InputError, match="without keyframes"):
        merge(first, empty)
    rng, lidar = np.random.default_rng(0), Lidar(181)
    hall = joined([box(30.0, 4.0), box(0.3, 0.3, (9.0, 1.0, 0.4))])
    drive = Drive([(-12.0, 0.0), (-6.0, 0.0)], speed=0.7)
    elsewhere = Slam()
    for k in range(30):
        elsewhere.process(lidar.scan(hall, drive(0.25 * k), rng, 0.25 * k).scan, drive(0.25 * k))
    count = len(first.keyframes)
    with pytest.raises(InputError, match="not found in the first"):
        merge(first, elsewhere)
    assert len(first.keyframes) == count
