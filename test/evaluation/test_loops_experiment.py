"""The loop-closure experiment on simulated floors: its tables are whole and say what they should."""

from __future__ import annotations

import math
from pathlib import Path

import pytest

from estimation.learning.gradient_boosting import GradientBoosting
from evaluation.experiments.loops import THEIRS, within_recordings
from evaluation.loops import loops_across
from evaluation.loops.loops_across import across_places, shipped_models
from evaluation.loops.loops_changes import dynamic_objects
from evaluation.loops.loops_data import Reading, every, simulated
from evaluation.loops.loops_features import repetitive_structure, training_rounds
from evaluation.loops.loops_training import _curves
from evaluation.loops.place_training import CascadeConfig, Recording, train_plain
from evaluation.report import Report, RunOptions
from loop_closure.places.pairs import PairRule


@pytest.fixture(scope="module")
def floor() -> Recording:
    return simulated(0, Reading(step=1.0, local_map=0.0))


def rule_of(recording: Recording, distance: float) -> PairRule:
    return PairRule(distance, 20.0, math.radians(45.0))


def whole(report: Report) -> None:
    for table in report.tables:
        assert table.rows, table.title
        assert all(len(row) == len(table.columns) for row in table.rows)


def test_error_falls_with_rounds_and_ratios_are_given(floor: Recording, tmp_path: Path) -> None:
    report, options = Report("loops"), RunOptions(tmp_path, quick=True)
    training_rounds(options, report, {"intel": floor}, rule_of)
    repetitive_structure(options, report, {"intel": floor}, rule_of)
    whole(report)
    errors = [row[2] for row in report.tables[0].rows]
    assert errors[-1] < 0.7 * errors[0]


def test_a_floor_is_judged_by_what_was_learned_on_another(
    floor: Recording, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    # A few trees are enough to see the tables whole.
    monkeypatch.setattr(loops_across, "GradientBoosting", lambda rounds, depth: GradientBoosting(5, 2))
    other = simulated(3, Reading(step=1.0, local_map=0.0))
    recordings = {
        "a": Recording("a", "a", floor.places, floor.poses, floor.path),
        "b": Recording("b", "b", other.places, other.poses, other.path),
    }
    report = Report("loops")
    across_places(RunOptions(tmp_path), report, recordings, rule_of)
    whole(report)
    rates = [row[5:] for row in report.tables[-1].rows]
    assert all(0.0 <= zero <= tenth <= one <= 100.0 for zero, tenth, one in rates)
    positives = {row[1]: row[4] for row in report.tables[-1].rows if row[0] == "a" and row[2] == "2 m"}
    assert positives["45°, loose"] > positives["45°"]
    assert positives["all headings"] > positives["45°"]
    single = Report("loops")
    across_places(RunOptions(tmp_path, quick=True), single, {"a": recordings["a"]}, rule_of)
    assert not single.tables
    assert single.notes


def test_one_data_set_is_judged_by_cross_validation_and_drawn(floor: Recording, tmp_path: Path) -> None:
    report = Report("loops")
    within_recordings(RunOptions(tmp_path, quick=True), report, {"intel": floor})
    whole(report)
    assert [row[4:6] for row in report.tables[0].rows] == [list(THEIRS["intel", d]) for d in (1.0, 2.0, 3.0)]
    assert report.pictures[0].stat().st_size > 1000


def test_movers_lower_the_likelihood_and_cards_are_listed(tmp_path: Path) -> None:
    report = Report("loops")
    dynamic_objects(RunOptions(tmp_path, quick=True), report)
    shipped_models(report)
    whole(report)
    likelihoods = [row[2] for row in report.tables[0].rows]
    assert likelihoods[0] > likelihoods[-1]


def test_every_second_beam_keeps_its_bearing() -> None:
    import numpy as np

    from whereabouts.simulation import Lidar, random_room

    rng = np.random.default_rng(0)
    scan = Lidar(beams=181).scan(random_room(rng), np.zeros(3), rng).scan
    half = every(scan, 2)
    np.testing.assert_array_equal(half.ranges, scan.ranges[::2])
    np.testing.assert_allclose(half.bearings, scan.bearings[::2])


def test_pairs_left_out_of_training_are_judged_all_the_same(floor: Recording) -> None:
    model = train_plain([floor], PairRule(1.0, 20.0), rounds=3)
    rules = [PairRule(2.5, 20.0), PairRule(2.5, 20.0, apart=6.0)]
    strict, loose = (_curves(model, floor, CascadeConfig(rule=rule), math.pi) for rule in rules)
    for a, b in zip(strict, loose, strict=True):
        assert (a.positives, a.negatives) == (b.positives, b.negatives)
        assert a.area == b.area
