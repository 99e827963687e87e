"""The joint CRF's experiment: its techniques on a pair, its stages on a run, and scans that a mover fills."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from evaluation.crf.crf_filled import filled
from evaluation.crf.crf_pictures import busiest, draw_associations, draw_clusters
from evaluation.crf.crf_stages import LENGTH, STAGES, judged_run
from evaluation.experiments.crf import BLIND, PRINTED, SAME, judged, techniques
from evaluation.report import Report, RunOptions
from evaluation.scenes.labelled_pairs import protocol, random_labelled_pairs
from whereabouts.simulation.lidar import Lidar


def test_every_technique_is_judged_in_the_same_form() -> None:
    # Of a third of the beams: the printed methods, which try all M states, take the third power of them.
    lidar = Lidar(121, np.pi, range_max=40.0)
    (pair,) = random_labelled_pairs(np.random.default_rng(22), "street", 1, lidar=lidar)
    found = judged(pair)
    assert list(found) == list(techniques())
    for name in PRINTED:
        assert found[name, SAME].clustering >= found[name, BLIND].clustering, name
    for each in found.values():
        assert 0.0 <= each.association <= 1.0
        assert np.isfinite(each.background).all()


def test_stages_are_added_to_the_same_start(tmp_path: Path) -> None:
    pairs = random_labelled_pairs(np.random.default_rng(4), "hall", 1, LENGTH)
    found = judged_run(pairs)
    assert list(found) == list(STAGES)
    assert {len(every) for every in found.values()} == {LENGTH}
    for stage in ("start", "+ trees"):
        assert np.mean([each.clustering for each in found[stage]]) > 0.8


def test_a_scan_half_filled_by_a_mover_is_told_right_or_refused(tmp_path: Path) -> None:
    report = Report("crf")
    filled(RunOptions(tmp_path, seed=3, quick=True), report)
    figures = report.every_figure()
    rows = [f"{share}-percent-of-the-beams" for share in ("0-to-20", "20-to-35", "35-to-50")]
    right, wrong = (
        sum(figures[f"filled/{row}/{answer}"].value for row in rows) for answer in ("right", "wrong")
    )
    assert right >= 50
    assert wrong <= 0.08 * right


def test_pictures_show_the_run_with_the_largest_object(tmp_path: Path) -> None:
    pairs = protocol(0)
    run = busiest(pairs, 3)
    assert len({pair.sequence for pair in run}) == 1
    least = min(pair.moving.sum() for pair in run)
    for k in range(len(pairs) - 2):
        if len({pair.sequence for pair in pairs[k : k + 3]}) == 1:
            assert min(pair.moving.sum() for pair in pairs[k : k + 3]) <= least
    draw_associations(tmp_path, run, {"truth": [pair.associations for pair in run], "none": []})
    draw_clusters(tmp_path, run[0], {"truth": run[0].clusters, "again": run[0].clusters})
    assert {path.name for path in tmp_path.iterdir()} == {
        "figure-3-associations.png",
        "figure-4-clusters.png",
    }
