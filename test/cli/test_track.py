"""`whereabouts track` as a user types it."""

from __future__ import annotations

import csv
import json
from pathlib import Path

import numpy as np
import pytest
from typer.testing import CliRunner

from estimation.geometry.poses import between, compound
from whereabouts.cli.main import app
from whereabouts.logs import McapWriter, OdometryRecord, ScanRecord
from whereabouts.simulation import Drive, Lidar, box, joined
from whereabouts.simulation.movers import outlines
from whereabouts.simulation.walkers import SimulatedWalker

runner = CliRunner()
DRIVE = Drive([(-3.0, -1.5), (2.5, -1.5)], speed=0.3)
PERSON = SimulatedWalker(np.array([(2.5, 1.5), (0.0, -0.5)]), 0.7)
STAMPS = 1_400_000_000.123 + 0.1 * np.arange(50)


@pytest.fixture(scope="module")
def bag(tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("bag") / "people.mcap"
    world = joined([box(10.0, 7.0), box(1.0, 0.5, (1.0, 2.9, 0.4)), box(0.6, 0.6, (-4.0, 1.0, 0.2))])
    rng = np.random.default_rng(5)
    with McapWriter(path) as writer:
        for k, stamp in enumerate(STAMPS):
            time = 0.1 * k
            scan = Lidar().scan(joined([world, outlines([PERSON], time)]), DRIVE(time), rng, stamp).scan
            writer.write_odometry(OdometryRecord(DRIVE(time), stamp))
            writer.write_scan(ScanRecord(scan, stamp))
    return path


@pytest.mark.parametrize("frame", ["odom", "laser"])
def test_rows_carry_the_stamps_of_the_scans_and_the_frame_asked_for(
    bag: Path, tmp_path: Path, frame: str
) -> None:
    out, figures = tmp_path / "tracks.csv", tmp_path / "f.json"
    result = runner.invoke(
        app, ["track", str(bag), "--out", str(out), "--frame", frame, "--json", str(figures)]
    )
    assert result.exit_code == 0, result.output
    with out.open(newline="") as file:
        rows = list(csv.DictReader(file))
    assert list(rows[0]) == ["time", "label", "x", "y", "vx", "vy", "weight"]
    times = np.array([float(row["time"]) for row in rows])
    index = np.abs(times[:, None] - STAMPS).argmin(1)
    assert np.allclose(times, STAMPS[index], atol=1e-6)
    assert len(rows) > 20
    for row, k in zip(rows, index, strict=True):
        origin = DRIVE(0.0) if frame == "odom" else DRIVE(0.1 * k)
        truth = compound(between(origin, np.zeros(3)), np.array([*PERSON.position(0.1 * k), 0.0]))
        assert np.hypot(float(row["x"]) - truth[0], float(row["y"]) - truth[1]) < 0.3
    assert json.loads(figures.read_text())["scans"] == 50


def test_a_log_without_scans_says_so_and_leaves_no_file(tmp_path: Path) -> None:
    empty, out = tmp_path / "wheels.mcap", tmp_path / "tracks.csv"
    with McapWriter(empty) as writer:
        writer.write_odometry(OdometryRecord(np.zeros(3), 1.0))
    result = runner.invoke(app, ["track", str(empty), "--out", str(out)])
    assert result.exit_code != 0
    assert not out.exists()


@pytest.mark.parametrize("name", ["mixture", "phd", "gmphd"])
def test_every_filter_follows_the_walker_and_all_targets_carry_their_class(
    bag: Path, tmp_path: Path, name: str
) -> None:
    out = tmp_path / "tracks.csv"
    result = runner.invoke(
        app, ["track", str(bag), "--out", str(out), "--filter", name, "--targets", "all", "--frame", "laser"]
    )
    assert result.exit_code == 0, result.output
    with out.open(newline="") as file:
        rows = list(csv.DictReader(file))
    assert list(rows[0])[-2:] == ["person", "label_probability"]
    assert all(0.0 <= float(row["person"]) <= 1.0 for row in rows)
    assert all(0.0 < float(row["label_probability"]) <= 1.0 for row in rows)
    # In the last scans there is a target where the walker is.
    for k in (45, 49):
        truth = compound(between(DRIVE(0.1 * k), np.zeros(3)), np.array([*PERSON.position(0.1 * k), 0.0]))
        spots = [
            (float(row["x"]), float(row["y"])) for row in rows if abs(float(row["time"]) - STAMPS[k]) < 0.01
        ]
        assert min(np.hypot(x - truth[0], y - truth[1]) for x, y in spots) < 0.5
