"""The joint CRF's experiment: its protocol on a few pairs, and the baselines it compares with."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from evaluation.experiments.crf import FREE, MODELS, leave_one_out
from evaluation.experiments.crf_filled import filled
from evaluation.experiments.crf_metrics import scores
from evaluation.report import Options, Report
from registration.crf.baselines import free_space, icp_kmeans
from whereabouts.simulation.labelled_pairs import protocol


def test_the_joint_model_is_best_on_pairs_left_out() -> None:
    pairs = protocol(21)[16:20]
    found = leave_one_out(pairs, [0, 2])
    assert set(found) == {*MODELS, FREE}
    means = {
        name: np.mean(
            [(x.association, x.clustering, -x.association_sed, -x.clustering_sed) for x in every], axis=0
        )
        for name, every in found.items()
    }
    for name in MODELS[:3]:
        assert (means[MODELS[3]] > means[name]).all(), name


def test_baselines_answer_in_the_same_form() -> None:
    pair = protocol(22)[0]
    for infer in (icp_kmeans, free_space):
        estimate = infer(pair.scan_a, pair.scan_b)
        assert estimate.associations.shape == estimate.clusters.shape == (len(pair.scan_a),)
        assert estimate.clusters.max() < len(estimate.motions)
        found = scores(pair, estimate)
        assert 0.2 < found.association <= 1.0
        assert np.isfinite(found.background).all()


def test_a_scan_half_filled_by_a_mover_is_told_right_or_refused(tmp_path: Path) -> None:
    report = Report("crf")
    filled(Options(tmp_path, seed=3, quick=True), report)
    figures = report.every_figure()
    rows = [f"{share}-percent-of-the-beams" for share in ("0-to-20", "20-to-35", "35-to-50")]
    right, wrong = (
        sum(figures[f"filled/{row}/{answer}"].value for row in rows) for answer in ("right", "wrong")
    )
    assert right >= 50
    assert wrong <= 0.08 * right
