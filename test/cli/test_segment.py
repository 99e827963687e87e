"""`whereabouts segment` on a small bag with something in it that moves."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest
from typer.testing import CliRunner

from whereabouts.cli.main import app
from whereabouts.logs import McapWriter, ScanRecord
from whereabouts.simulation import Lidar, Mover, joined, outlines, random_room

LIDAR = Lidar(361, 2.0 * np.pi * 360 / 361)


@pytest.fixture(scope="module")
def bag(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, np.ndarray]:
    """A bag of 16 scans 0.1 s apart, and whose beams are whose, (16, 361)."""
    path = tmp_path_factory.mktemp("bag") / "box.mcap"
    room, rng = random_room(np.random.default_rng(12)), np.random.default_rng(9)
    mover = Mover("box", np.array([1.0, 0.5, 0.4]), np.array([0.5, 0.2]), size=0.8)
    owners = []
    with McapWriter(path) as writer:
        for k in range(16):
            world = joined([room, outlines([mover], 0.1 * k)])
            seen = LIDAR.scan(world, np.array([0.02 * k, 0.0, 0.3]), rng, 100.0 + 0.1 * k)
            owners.append(seen.owners)
            writer.write_scan(ScanRecord(seen.scan, seen.scan.stamp))
    return path, np.array(owners)


def test_labels_stamps_and_poses(bag: tuple[Path, np.ndarray], tmp_path: Path) -> None:
    path, owners = bag
    out, figures = tmp_path / "labels.npz", tmp_path / "figures.json"
    arguments = [
        "segment",
        str(path),
        "--out",
        str(out),
        "--json",
        str(figures),
        "--pictures",
        str(tmp_path / "p"),
    ]
    result = CliRunner().invoke(app, arguments)
    assert result.exit_code == 0, result.output
    with np.load(out) as file:
        labels, stamps, poses = file["labels"], file["stamps"], file["poses"]
    assert labels.shape == owners.shape
    assert stamps == pytest.approx(100.0 + 0.1 * np.arange(16))
    assert poses[0] == pytest.approx(np.zeros(3))
    assert np.hypot(*(poses[-1, :2] - 0.3 * np.array([np.cos(0.3), -np.sin(0.3)]))) < 0.02
    moving, truth = labels > 0, owners > 0
    hits, either = np.sum(moving & truth), np.sum(moving | truth)
    assert hits / either > 0.8
    assert (labels[owners < 0] == -1).all()
    assert json.loads(figures.read_text())["moving_beams"] == int(moving.sum())
    assert len(list((tmp_path / "p").glob("*.png"))) == 6


def test_what_is_missing_is_said() -> None:
    from estimation.errors import InputError

    for arguments in (["segment"], ["segment", "--train"]):
        result = CliRunner().invoke(app, arguments)
        assert isinstance(result.exception, InputError)


def test_the_texts_method_labels_from_pairs(tmp_path: Path) -> None:
    path, out, room = tmp_path / "bag.mcap", tmp_path / "labels.npz", random_room(np.random.default_rng(12))
    rng, lidar = np.random.default_rng(9), Lidar(90, 2.0 * np.pi * 89 / 90)
    with McapWriter(path) as writer:
        for k in range(3):
            scan = lidar.scan(room, np.array([0.02 * k, 0.0, 0.3]), rng, 100.0 + 0.3 * k).scan
            writer.write_scan(ScanRecord(scan, scan.stamp))
    result = CliRunner().invoke(app, ["segment", str(path), "--out", str(out), "--method", "as_printed"])
    assert result.exit_code == 0, result.output
    with np.load(out) as file:
        labels = file["labels"]
    assert labels.shape == (3, 90)
    # Only the first and the last are far enough apart in time.
    assert (labels[[0, 2]] >= 0).any(axis=1).all()
    assert (labels[1] == -1).all()
    wrong = CliRunner().invoke(app, ["segment", str(path), "--method", "chains"])
    assert wrong.exit_code != 0
    assert "as_printed" in (wrong.output + str(wrong.exception))
