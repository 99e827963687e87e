"""How much time labels may take, on a clock that is moved by hand."""

from __future__ import annotations

import numpy as np
import pytest

from evaluation.scenes.labelled_pairs import random_labelled_pairs
from registration.crf.online import ScanSegmenter, SegmenterConfig
from registration.odometry.pace import DURATIONS, Duration, Pace
from whereabouts.simulation import Lidar

ROUND = Lidar(beams=361, opening=2.0 * np.pi, range_max=25.0)


class Clock:
    """Seconds, as told."""

    def __init__(self) -> None:
        self.now = 100.0

    def __call__(self) -> float:
        return self.now


def test_time_left_counts_from_arrival_in_periods_of_the_sensor() -> None:
    clock = Clock()
    pace = Pace(clock)
    assert pace.left == np.inf
    # Two scans in ten are lost on the way: the sensor's period is still the sensor's.
    for k in (0, 1, 2, 5, 6, 7, 8):
        pace.begin(0.025 * k, clock.now)
    assert pace.left == pytest.approx(0.015)
    clock.now += 0.004
    assert pace.left == pytest.approx(0.011)
    pace.begin(0.025 * 9, clock.now - 0.03)
    assert pace.left < 0.0
    pace.reset()
    assert pace.left == np.inf


def test_one_hiccup_is_not_what_work_takes_but_a_change_is() -> None:
    duration = Duration()
    assert duration.expected == 0.0
    for seconds in (0.01, 0.011, 0.3, 0.01, 0.012):
        duration.took(seconds)
    assert duration.expected == pytest.approx(0.011)
    for _ in range(DURATIONS):
        duration.took(0.04)
    assert duration.expected == pytest.approx(0.04)


def test_what_does_not_fit_is_tried_again_but_seldom() -> None:
    duration = Duration()
    duration.took(0.04)
    tried = 0
    for _ in range(10_000):
        if duration.expected <= 0.01:
            duration.took(0.04)
            tried += 1
        else:
            duration.not_done()
    assert 10 <= tried <= 100


def test_comparisons_that_do_not_fit_the_limit_are_left_out() -> None:
    (pair,) = random_labelled_pairs(np.random.default_rng(82), "office", 1, lidar=ROUND)
    ticks = iter(np.arange(0.0, 1e4, 0.004))
    segmenter = ScanSegmenter(SegmenterConfig(), clock=lambda: float(next(ticks)))

    def label(stamp: float, limit: float) -> bool:
        segmenter.reset()
        segmenter._duration.took(0.01)
        segmenter.keep(pair.scan_a, stamp - 1.0, np.zeros(3))
        segmenter.keep(pair.scan_a, stamp - 0.5, np.zeros(3))
        return bool((segmenter.segment(pair.scan_b, stamp, np.zeros(3), limit).labels >= 0).any())

    assert label(10.0, 0.02)
    assert (segmenter.labelled, segmenter.skipped) == (1, 0)
    assert not label(20.0, 0.01)
    assert (segmenter.labelled, segmenter.skipped) == (0, 1)
    assert segmenter.fits(0.01)
    assert not segmenter.fits(0.005)
