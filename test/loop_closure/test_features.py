"""Every feature of App. A.A against definitions written out point by point, and what must not change them."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from estimation.errors import InputError
from loop_closure import features_2d, features_3d, scan_order
from loop_closure.places.features import BIN_WIDTHS
from registration import Scan

GATE = 2.5


def fit(points):
    """Centre and radius of the circle or sphere by the linear least squares problem as it stands."""
    A = np.column_stack((2 * points, np.ones(len(points))))
    solution = np.linalg.lstsq(A, (points**2).sum(1), rcond=None)[0]
    centre = solution[:-1]
    return centre, np.sqrt(solution[-1] + centre @ centre)


def spread(values):
    return [np.mean(values), np.std(values)] if len(values) else [0.0, 0.0]


def peak(values):
    if len(values) == 0 or np.ptp(values) == 0:
        return 0.0
    m = np.mean(values)
    return np.mean((values - m) ** 4) / np.mean((values - m) ** 2) ** 2 - 3


def expected(r, P, limit, closed, planar):
    """Features in the order of the text, in plain loops; P holds no unknown positions."""
    n = len(r)
    pairs = [(i, (i + 1) % n) for i in range(n if closed else n - 1)]
    triples = [((i - 1) % n, i, (i + 1) % n) for i in (range(n) if closed else range(1, n - 1))]
    low = r[r < limit]
    power = 2 if planar else 3
    f = [np.mean((r / limit) ** power), np.mean((low / limit) ** power) if len(low) else 0.0]
    f += [spread(low)[0] / limit, np.mean(r) / limit, spread(low)[1] / limit, np.std(r) / limit]
    centre, radius = fit(P)
    residual = sum((radius - np.linalg.norm(centre - p)) ** 2 for p in P)
    f += [radius / limit, residual / (n * radius), np.linalg.norm(centre) / limit]
    near = P[r < limit]
    if len(near):
        mean = near.mean(0)
        f += [np.linalg.norm(mean), *spread([np.linalg.norm(p - mean) for p in near])]
    else:
        f += [0.0, 0.0, 0.0]
    f += [n - len(low), len(low)]
    gap = {(i, j): np.linalg.norm(P[i] - P[j]) for i, j in pairs}
    short = [gap[i, j] for i, j in pairs if r[i] < limit and r[j] < limit]
    f += [sum(gap.values()), sum(short), sum(d for d in short if d < GATE), spread(short)[1]]
    bends = []
    for i, j, k in triples:
        a, b, c = (np.linalg.norm(P[u] - P[v]) for u, v in ((i, j), (j, k), (k, i)))
        if max(r[i], r[j], r[k]) < limit and min(a, b, c) > 0 and max(a, b, c) < GATE:
            h = (a + b + c) / 2
            bends.append(4 * np.sqrt(max(h * (h - a) * (h - b) * (h - c), 0)) / (a * b * c))
    f += spread(bends)
    f += [peak(low), peak(r)]
    f += spread([r[i] / r[j] for i, j in pairs])
    f += spread([r[i] / r[j] for i, j in pairs if r[i] < limit and r[j] < limit])
    for gate in (limit, 0.75 * limit, 0.5 * limit):
        f += [s / gate for s in spread([abs(r[i] - r[j]) for i, j in pairs if max(r[i], r[j]) <= gate])]
    if planar:
        f += grouped(n, pairs, gap)
        angle = 0.0
        for i, j, k in triples:
            u, v = P[j] - P[i], P[k] - P[j]
            if max(r[i], r[j], r[k]) < limit and np.any(u) and np.any(v):
                angle += np.arccos(np.clip(u @ v / np.linalg.norm(u) / np.linalg.norm(v), -1, 1))
        f.append(angle)
    return np.array(f)


def grouped(n, pairs, gap):
    """Connected components of the chain with more than three points."""
    label = list(range(n))
    for i, j in pairs:
        if gap[i, j] < GATE:
            old, new = label[j], label[i]
            label = [new if value == old else value for value in label]
    sizes = [label.count(value) for value in set(label) if label.count(value) > 3]
    return [len(sizes), np.mean(sizes) if sizes else 0.0]


def room(n, seed=0, span=2 * np.pi, jumps=3):
    """Ranges of smooth walls with jumps and some no-returns."""
    rng = np.random.default_rng(seed)
    angle = np.linspace(0, 2 * np.pi, n, endpoint=False)
    r = 6 + 2 * np.sin(angle) + np.sin(3 * angle + 1) + rng.normal(0, 0.05, n)
    for start in rng.integers(0, n, jumps):
        r[start : start + n // 8] += rng.uniform(2, 8)
    r[rng.random(n) < 0.05] = np.inf
    return Scan(r, -span / 2, span / n, 0.1, 60.0)


def brute(scan, limit):
    r, P = [], []
    for value, valid, bearing in zip(scan.ranges, scan.valid, scan.bearings, strict=True):
        value = min(value, limit) if valid else limit
        r.append(value)
        P.append(value * np.array([np.cos(bearing), np.sin(bearing)]))
    closed = abs(len(r) * abs(scan.angle_increment) - 2 * np.pi) < 1e-6
    return expected(np.array(r), np.array(P), limit, closed, True), np.array(r)


@pytest.mark.parametrize("seed", range(4))
@pytest.mark.parametrize("span", [np.pi, 2 * np.pi])
@pytest.mark.parametrize("limit", [9.0, 50.0])
def test_definitions_in_2d(seed, span, limit):
    scan = room(90 + 31 * seed, seed, span)
    place = features_2d(scan, limit)
    values, r = brute(scan, limit)
    assert place.values.shape == (35,)
    # Heron's formula of the reference loses digits on straight walls.
    np.testing.assert_allclose(place.values, values, rtol=1e-6, atol=1e-9)
    check_histograms(place, r, limit)


@pytest.mark.parametrize("seed", range(3))
@pytest.mark.parametrize("limit", [4.0, 30.0])
def test_definitions_in_3d(seed, limit):
    rng = np.random.default_rng(seed)
    points = np.cumsum(rng.normal(0, 0.4, (300, 3)), axis=0) + np.array([1, 2, 0.5])
    distance = np.linalg.norm(points, axis=1)
    limited = points * np.minimum(1, limit / distance)[:, None]
    r = np.minimum(distance, limit)
    place = features_3d(points, limit)
    assert place.values.shape == (32,)
    np.testing.assert_allclose(place.values, expected(r, limited, limit, False, False), rtol=1e-6, atol=1e-9)
    check_histograms(place, r, limit)


def check_histograms(place, r, limit):
    assert len(place.histograms) == 9
    for histogram, width in zip(place.histograms, BIN_WIDTHS, strict=True):
        assert len(histogram) == int(np.ceil(round(limit / width, 6)))
        counts = np.zeros(len(histogram))
        for value in r:
            counts[min(int(value / width), len(histogram) - 1)] += 1
        np.testing.assert_array_equal(histogram, counts)


def test_known_values_of_a_circle():
    scan = Scan(np.full(360, 4.0), -np.pi, np.radians(1), 0.1, 60.0)
    f = features_2d(scan, 8.0).values
    chord = 8 * np.sin(np.radians(0.5))
    np.testing.assert_allclose(f[:9], [0.25, 0.25, 0.5, 0.5, 0, 0, 0.5, 0, 0], atol=1e-12)
    np.testing.assert_allclose(f[9:14], [0, 4, 0, 0, 360], atol=1e-12)
    np.testing.assert_allclose(f[14:18], [360 * chord, 360 * chord, 360 * chord, 0], atol=1e-9)
    np.testing.assert_allclose(f[18:22], [0.25, 0, 0, 0], atol=1e-9)
    np.testing.assert_allclose(f[22:32], [1, 0, 1, 0, 0, 0, 0, 0, 0, 0], atol=1e-12)
    np.testing.assert_allclose(f[32:], [1, 360, 2 * np.pi], atol=1e-9)


@given(st.integers(0, 119), st.floats(-7, 7))
@settings(max_examples=40)
def test_turning_a_full_circle_changes_nothing(shift, offset):
    scan = room(120, 5)
    turned = Scan(np.roll(scan.ranges, shift), scan.angle_min + offset, scan.angle_increment, 0.1, 60.0)
    for limit in (9.0, 50.0):
        a, b = features_2d(scan, limit), features_2d(turned, limit)
        np.testing.assert_allclose(a.values, b.values, rtol=1e-9, atol=1e-9)
        np.testing.assert_array_equal(np.concatenate(a.histograms), np.concatenate(b.histograms))


def test_an_upside_down_scanner_sees_the_same_place():
    scan = room(181, 2, np.pi)
    last = scan.bearings[-1]
    flipped = Scan(scan.ranges[::-1], last, -scan.angle_increment, 0.1, 60.0)
    np.testing.assert_allclose(features_2d(scan, 20.0).values, features_2d(flipped, 20.0).values, rtol=1e-9)


@given(st.lists(st.floats(-1, 1), min_size=4, max_size=4).filter(lambda q: np.linalg.norm(q) > 0.1))
@settings(max_examples=30)
def test_turning_a_cloud_about_any_axis_changes_nothing(quaternion):
    w, x, y, z = np.array(quaternion) / np.linalg.norm(quaternion)
    R = np.array(
        [
            [1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)],
            [2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)],
            [2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)],
        ]
    )
    points = np.cumsum(np.random.default_rng(3).normal(0, 0.5, (200, 3)), axis=0) + np.array([2, 0, 1])
    a, b = features_3d(points, 30.0), features_3d(points @ R.T, 30.0)
    np.testing.assert_allclose(a.values, b.values, rtol=1e-8, atol=1e-9)


def test_every_kind_of_no_return_is_a_range_at_the_limit():
    ranges = np.full(40, 5.0)
    ranges[::8] = [np.nan, np.inf, -np.inf, 0.0, 70.0]
    ranges[1] = 0.05
    scan = Scan(ranges, -np.pi / 2, np.pi / 40, 0.1, 60.0)
    at_limit = np.where(scan.valid, ranges, 20.0)
    same = features_2d(Scan(at_limit, -np.pi / 2, np.pi / 40, 0.1, 60.0), 20.0)
    place = features_2d(scan, 20.0)
    np.testing.assert_array_equal(place.values, same.values)
    assert (place.values[12], place.values[13]) == (6, 34)
    assert place.values[0] == pytest.approx((6 + 34 / 16) / 40)


def test_rows_without_a_direction_count_as_ranges_only():
    points = np.random.default_rng(1).uniform(1, 5, (50, 3))
    holes = np.insert(points, [10, 10, 30], [[np.nan] * 3, [0, 0, 0], [np.inf, 1, 1]], axis=0)
    f, plain = features_3d(holes, 20.0).values, features_3d(points, 20.0).values
    assert (f[12], f[13]) == (3, 50)
    assert f[0] == pytest.approx((3 + 50 * plain[0]) / 53)
    np.testing.assert_allclose(f[[1, 2, 4, 6, 7, 8, 9, 10, 11]], plain[[1, 2, 4, 6, 7, 8, 9, 10, 11]])
    assert f[14] < plain[14]
    assert features_3d(holes, 20.0).histograms[0][-1] == 3


@pytest.mark.parametrize("ranges", [np.full(20, np.inf), [np.nan], [3.0], [3.0, 3.0], [3.0, 3.0, 4.0]])
def test_small_and_empty_views_have_finite_features(ranges):
    place = features_2d(Scan(ranges, 0.0, 0.1, 0.1, 60.0), 20.0)
    assert np.isfinite(place.values).all()
    points = np.column_stack((ranges, np.zeros((len(ranges), 2))))
    place = features_3d(points, 20.0)
    assert np.isfinite(place.values).all()


def test_points_on_a_line_or_plane_or_spot():
    line = np.column_stack((np.linspace(-3, 3, 20), np.ones(20), np.zeros(20)))
    for points in (
        line,
        np.ones((10, 3)),
        np.random.default_rng(0).normal(size=(30, 3)) * [1, 1, 0] + [0, 0, 1],
    ):
        f = features_3d(points, 10.0).values
        assert np.isfinite(f).all()
        assert (f[6:9] < 10).all()


def test_no_returns_only_has_the_features_of_nothing():
    f = features_2d(Scan(np.full(36, np.inf), -np.pi, np.radians(10), 0.1, 60.0), 20.0).values
    assert (f[0], f[3], f[12], f[13]) == (1.0, 1.0, 36, 0)
    np.testing.assert_array_equal(f[[1, 2, 4, 9, 10, 11, 15, 16, 17, 18, 19, 20, 21]], 0.0)


def test_groups_join_across_the_seam_of_a_full_circle():
    ranges = np.full(72, 4.0)
    ranges[20:30] = 15.0
    ranges[50:53] = 15.0
    place = features_2d(Scan(ranges, -np.pi, np.radians(5), 0.1, 60.0), 30.0)
    # Near: 30..49 and 53..71 with 0..19; far: ten points; three points are no group.
    assert (place.values[32], place.values[33]) == (3, pytest.approx((20 + 39 + 10) / 3))
    open_ended = features_2d(Scan(ranges, -np.pi, np.radians(4), 0.1, 60.0), 30.0)
    assert open_ended.values[32] == 4


def test_scan_order_undoes_shuffling():
    rng = np.random.default_rng(2)
    azimuth = np.tile(np.linspace(-3, 3, 40), 5)
    elevation = np.repeat(np.radians([-8.2, -4.2, 0.3, 4.3, 8.3]), 40)
    direction = np.column_stack(
        (np.cos(elevation) * np.cos(azimuth), np.cos(elevation) * np.sin(azimuth), np.sin(elevation))
    )
    cloud = direction * rng.uniform(3, 9, (200, 1))
    np.testing.assert_allclose(scan_order(rng.permutation(cloud)), cloud)


@pytest.mark.parametrize("limit", [0.0, -1.0, np.nan, np.inf])
def test_limits_that_are_none(limit):
    with pytest.raises(InputError, match="max_range"):
        features_2d(room(20), limit)
    with pytest.raises(InputError, match="max_range"):
        features_3d(np.ones((4, 3)), limit)


def test_nothing_to_describe():
    with pytest.raises(InputError, match="at least one beam"):
        features_2d(Scan([], 0.0, 0.1), 20.0)
    for points in (np.zeros((0, 3)), np.ones((4, 2)), np.ones(3)):
        with pytest.raises(InputError, match="shape"):
            features_3d(points, 20.0)
