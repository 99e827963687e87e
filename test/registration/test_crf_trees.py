"""Trees that say what moves: against the truth of simulations, and that what they change stays of a piece."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal

from estimation.errors import InputError
from estimation.geometry.sight import AGREES, THROUGH
from evaluation.crf.crf_learning import learned_trees
from evaluation.crf.crf_metrics import f1_of, scores
from evaluation.scenes.labelled_pairs import LabelledPair, labelled, random_labelled_pairs
from evaluation.scenes.scan_pairs import free_pose
from registration import Scan
from registration.crf import JointModel
from registration.crf.beam_evidence import AROUND, FAR, LONG, NAMES, evidence
from registration.crf.beams import parts_of
from registration.crf.estimate import JointEstimate
from registration.crf.labels import groups_as_labels
from registration.crf.setup import start
from registration.crf.trees import with_movers
from registration.crf.window import decide, mean_probability
from registration.laser.outline import CLEAR
from whereabouts.simulation import Lidar, random_room
from whereabouts.simulation.movers import crowd, outlines
from whereabouts.simulation.shapes import joined

LIDAR = Lidar(361, 2.0 * np.pi * 360 / 361)


@pytest.fixture(scope="module")
def model() -> JointModel:
    return JointModel.load()


@pytest.fixture(scope="module")
def pairs() -> list[LabelledPair]:
    return random_labelled_pairs(np.random.default_rng(78), "crowd", 12, lidar=LIDAR)


def test_in_a_crowd_they_find_what_the_groups_miss(model: JointModel, pairs: list[LabelledPair]) -> None:
    groups = JointModel()
    with_it, without = (
        f1_of([scores(pair, each.infer(pair.scan_a, pair.scan_b)).counts for pair in pairs])
        for each in (model, groups)
    )
    assert with_it[0] > without[0] + 0.01
    assert with_it[2] > without[2] + 0.03
    assert with_it[1] > 0.9


def test_people_and_boxes_that_stand_do_not_move(model: JointModel) -> None:
    rng = np.random.default_rng(5)
    said = []
    for _ in range(6):
        room = random_room(rng)
        pose = free_pose(room, rng, 2.0)
        place = joined([room, outlines(crowd(rng, pose[:2], 5, (1.0, 3.0)), 0.0).owned_by(0)])
        pair = labelled(place, [], (pose, pose + np.array([0.1, 0.05, 0.05])), (0.0, 0.5), LIDAR, rng)
        said.append(np.mean(model.infer(pair.scan_a, pair.scan_b).moving[pair.valid]))
    assert np.mean(said) < 0.01


def test_every_cluster_has_beams_a_motion_and_a_covariance(
    model: JointModel, pairs: list[LabelledPair]
) -> None:
    for pair in pairs:
        estimate = model.infer(pair.scan_a, pair.scan_b)
        assert_array_equal(
            np.unique(estimate.clusters[estimate.clusters > 0]), np.arange(1, len(estimate.motions))
        )
        assert estimate.covariances.shape == (len(estimate.motions), 3, 3)
        assert (estimate.clusters[~pair.valid] == -1).all()
        assert (estimate.clusters[estimate.associations >= 0] >= 0).all()
        partners = estimate.associations[estimate.associations >= 0]
        assert pair.scan_b.valid[partners].all()
        assert (estimate.probabilities[estimate.clusters > 0] >= 0.5).all()


def test_it_does_not_matter_how_the_scanner_is_mounted(model: JointModel, pairs: list[LabelledPair]) -> None:
    def turned(scan: Scan) -> Scan:
        return replace(scan, angle_min=scan.angle_min + 0.7)

    agreeing = []
    for pair in pairs[:6]:
        straight = model.infer(pair.scan_a, pair.scan_b)
        askew = model.infer(turned(pair.scan_a), turned(pair.scan_b))
        agreeing.append(np.mean((straight.moving == askew.moving)[pair.valid]))
    assert np.mean(agreeing) > 0.97


def test_decisions_join_the_object_beside_or_become_one(model: JointModel, pairs: list[LabelledPair]) -> None:
    pair = pairs[0]
    begun = start(pair.scan_a, pair.scan_b)
    said = groups_as_labels(begun)
    assert (said > 0).any()
    assert_array_equal(with_movers(begun, said, said > 0), said)
    assert with_movers(begun, said, np.zeros(len(said), dtype=bool)).max() == 0
    everything = with_movers(begun, said, np.ones(len(said), dtype=bool))
    assert (everything > 0).all()
    assert_array_equal(everything[said > 0], said[said > 0])
    for piece in np.unique(begun.a.pieces):
        of_piece = said[begun.a.pieces == piece]
        if len(np.unique(of_piece[of_piece > 0])) == 1:
            assert (everything[begun.a.pieces == piece] == of_piece.max()).all()
    rows = evidence(begun, said)
    assert rows.shape == (len(begun.a), len(NAMES))
    assert np.isfinite(rows).all()


def test_what_the_trees_are_told_is_what_its_name_says(pairs: list[LabelledPair]) -> None:
    for pair in pairs[:3]:
        begun = start(pair.scan_a, pair.scan_b)
        said, a = groups_as_labels(begun), begun.a
        told = dict(zip(NAMES, evidence(begun, said).T, strict=True))
        agrees, moving = begun.sight == AGREES, said > 0
        for prefix, numbers in (("", a.pieces), ("part ", a.parts)):
            for k, number in enumerate(numbers):
                same = numbers == number
                assert told[f"{prefix}agreeing"][k] == pytest.approx(agrees[same].mean())
                assert told[f"{prefix}in groups"][k] == pytest.approx(moving[same].mean())
                away = np.linalg.norm(a.points[same][:, None] - a.points[moving][None], axis=2).min(
                    initial=FAR
                )
                assert told[f"{prefix or 'piece '}to mover"][k] == pytest.approx(away)
        for k in range(len(a)):
            inside = np.flatnonzero(a.pieces == a.pieces[k])
            near = np.arange(max(k - AROUND, inside[0]), min(k + AROUND, inside[-1]) + 1)
            assert told["agreeing near"][k] == pytest.approx(agrees[near].mean())
            of_cluster = said == said[k]
            expected = agrees[of_cluster].mean() if said[k] > 0 else -1.0
            assert told["cluster agreeing"][k] == pytest.approx(expected)
            kind = agrees + 2 * np.isin(begun.sight, (THROUGH, CLEAR))
            first = last = k
            while first > 0 and (kind[first - 1], a.pieces[first - 1]) == (kind[k], a.pieces[k]):
                first -= 1
            while last < len(a) - 1 and (kind[last + 1], a.pieces[last + 1]) == (kind[k], a.pieces[k]):
                last += 1
            run = np.linalg.norm(np.diff(a.points[first : last + 1], axis=0), axis=1).sum()
            assert told["run"][k] == pytest.approx(min(run, LONG))


def test_a_piece_is_cut_where_one_thing_stands_before_another() -> None:
    """A box against a wall makes two hollow corners, its own corners make none."""
    wall = [np.column_stack((np.linspace(a, b, 30), np.full(30, 3.0))) for a, b in ((2.0, 0.5), (-0.5, -2.0))]
    front = np.column_stack((np.linspace(0.5, -0.5, 30), np.full(30, 2.5)))
    sides = [np.column_stack((np.full(10, x), np.linspace(*ends, 10))) for x, ends in
             ((0.5, (2.95, 2.55)), (-0.5, (2.55, 2.95)))]  # fmt: skip
    points = np.concatenate((wall[0], sides[0], front, sides[1], wall[1]))
    one = np.zeros(len(points), dtype=np.int64)
    parts = parts_of(points, one, 1.0)
    assert parts.max() == 2
    assert abs(np.flatnonzero(parts == 1)[0] - 30) <= 1
    assert abs(np.flatnonzero(parts == 2)[0] - 80) <= 1
    assert parts_of(points[::-1].copy(), one, -1.0).max() == 2
    apart = (np.arange(len(points)) > 49).astype(np.int64)
    assert parts_of(points, apart, 1.0)[50] == parts_of(points, apart, 1.0)[49] + 1


def test_a_saved_model_says_the_same(model: JointModel, pairs: list[LabelledPair], tmp_path: Path) -> None:
    model.save(tmp_path / "model.json")
    again = JointModel.load(tmp_path / "model.json")
    assert again.card == model.card
    first, second = (each.infer(pairs[1].scan_a, pairs[1].scan_b) for each in (model, again))
    assert_array_equal(first.clusters, second.clusters)
    assert_array_equal(first.probabilities, second.probabilities)


def test_what_is_no_model_is_refused(tmp_path: Path) -> None:
    path = tmp_path / "model.json"
    for text in (
        "{",
        "{}",
        '{"format": "whereabouts.moving_beams", "version": 1}',
        '{"format": "other", "version": 1}',
    ):
        path.write_text(text)
        with pytest.raises(InputError, match=r"model\.json"):
            JointModel.load(path)
    with pytest.raises(InputError, match="not trained"):
        JointModel().save(path)


def test_probabilities_mean_what_they_say(model: JointModel) -> None:
    """Of what is said to move with 80 % and more, at least that much does; of 20 % and less, as little."""
    said, true = [], []
    for scene in ("office", "hall", "crowd"):
        for pair in random_labelled_pairs(np.random.default_rng(90), scene, 12, lidar=LIDAR):
            estimate = model.infer(pair.scan_a, pair.scan_b)
            told = np.isfinite(estimate.probabilities)
            said.append(estimate.probabilities[told])
            true.append(pair.moving[told])
    probability, moves = np.concatenate(said), np.concatenate(true)
    assert moves[probability > 0.8].mean() > 0.8
    assert moves[probability < 0.2].mean() < 0.2


def test_training_learns_what_the_evidence_tells(pairs: list[LabelledPair]) -> None:
    trees = learned_trees(pairs[:8], trees=40)
    groups, learned = (
        f1_of([scores(pair, each.infer(pair.scan_a, pair.scan_b)).counts for pair in pairs[:8]])
        for each in (JointModel(), JointModel(trees))
    )
    assert learned[2] > groups[2]


def test_pairs_say_together_what_moves() -> None:
    def says(*probabilities: float) -> JointEstimate:
        labels = np.zeros(len(probabilities), dtype=np.int64)
        return JointEstimate(
            labels, labels, np.zeros((1, 3)), 0.0, np.zeros((1, 3, 3)), np.array(probabilities)
        )

    refused = replace(says(1.0, 1.0, 1.0), converged=False)
    mean = mean_probability([says(0.9, 0.2, np.nan), says(0.5, np.nan, np.nan), refused], 3)
    assert_allclose(mean, [0.7, 0.2, np.nan])
    assert np.isnan(mean_probability([refused], 3)).all()


def test_a_piece_moves_as_a_whole_and_a_wall_beam_by_beam() -> None:
    ranges = np.full(60, 5.0)
    ranges[20:30] = 2.0
    scan = Scan(ranges, -0.5, 1.0 / 59, 0.05, 30.0)
    near = ranges < 3.0
    probability = np.where(near, np.where(np.arange(60) < 24, 0.1, 0.9), 0.2)
    probability[40:45], probability[50] = 0.8, np.nan
    labels = decide(scan, probability)
    assert (labels[near] == 1).all()
    assert (labels[40:45] > 1).all()
    assert labels[50] == -1
    assert (np.delete(labels, np.r_[20:30, 40:45, 50]) == 0).all()
