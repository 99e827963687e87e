"""`whereabouts slam` on a simulated round, judged by where the robot was."""

from __future__ import annotations

import csv
import json
from pathlib import Path

import numpy as np
import pytest
from typer.testing import CliRunner

from estimation.geometry.poses import between, compound
from estimation.metrics.statistics import absolute_trajectory_error
from whereabouts.cli.main import app
from whereabouts.logs import McapWriter, OdometryRecord, ScanRecord, open_log, read_tum
from whereabouts.simulation import Drive, Lidar, box, joined

runner = CliRunner()
CORNERS = [(-4.3, -3.3), (4.3, -3.3), (4.3, 3.3), (-4.3, 3.3)]
PERIOD = 0.4


@pytest.fixture(scope="module")
def recorded(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, np.ndarray]:
    """A bag of a round and a third through a furnished ring with wheels that drift, and the true poses."""
    rng = np.random.default_rng(4)
    spots = [(-2.0, 4.1), (1.5, 4.2), (5.1, 1.0), (4.9, -1.8), (0.6, -4.1), (-2.8, -4.2), (-5.0, 0.4)]
    furniture = [
        box(rng.uniform(0.3, 0.9), rng.uniform(0.2, 0.4), (x, y, rng.uniform(0, 3))) for x, y in spots
    ]
    world, lidar = joined([box(11.0, 9.0), box(6.4, 4.4), *furniture]), Lidar(181)
    drive = Drive([*CORNERS, *CORNERS[:3]], speed=0.7, turn_rate=0.8)
    path, truth, wheels = tmp_path_factory.mktemp("slam") / "round.mcap", [], np.zeros(3)
    with McapWriter(path) as writer:
        for k in range(int(drive.duration / PERIOD)):
            stamp = 50.0 + PERIOD * k
            truth.append(drive(PERIOD * k))
            if k:
                step = between(truth[-2], truth[-1])
                wheels = compound(wheels, step * 1.01 + [0.0, 0.0, 0.01 * np.hypot(*step[:2])])
            writer.write_odometry(OdometryRecord(wheels, stamp))
            writer.write_scan(ScanRecord(lidar.scan(world, truth[-1], rng, stamp).scan, stamp))
    return path, np.array(truth)


def test_slam_writes_trajectory_closures_and_map(recorded: tuple[Path, np.ndarray], tmp_path: Path) -> None:
    bag, truth = recorded
    out, closures, picture, figures = (tmp_path / name for name in ("t.tum", "c.csv", "m.png", "f.json"))
    command = ["slam", str(bag), "--out", str(out), "--closures", str(closures), "--map", str(picture)]
    result = runner.invoke(app, [*command, "--json", str(figures)])
    assert result.exit_code == 0, result.output

    trajectory = read_tum(out)
    stamps = 50.0 + PERIOD * np.arange(len(truth))
    np.testing.assert_allclose(trajectory.stamps, stamps, atol=1e-6)
    np.testing.assert_allclose(trajectory.se2()[0], 0.0, atol=1e-6)
    assert absolute_trajectory_error(trajectory.se2()[:, :2], truth[:, :2]).rmse < 0.1

    with closures.open(encoding="ascii") as lines:
        rows = list(csv.DictReader(lines))
    assert rows
    assert list(rows[0]) == ["stamp_a", "stamp_b", "x", "y", "yaw"]
    for row in rows:
        a, b = (round((float(row[name]) - 50.0) / PERIOD) for name in ("stamp_a", "stamp_b"))
        assert a < b
        miss = between(
            between(truth[a], truth[b]), np.array([float(row[name]) for name in ("x", "y", "yaw")])
        )
        assert np.hypot(*miss[:2]) < 0.2
        assert abs(miss[2]) < 0.05

    assert picture.read_bytes().startswith(b"\x89PNG")
    assert (tmp_path / "m.pgm").read_bytes().startswith(b"P5")
    assert "image: m.pgm" in (tmp_path / "m.yaml").read_text()
    found = json.loads(figures.read_text())
    assert found["scans"] == len(truth)
    assert found["closures"] == len(rows)

    # The same drive, begun later, in the map that was written: with a pose and without one.
    begun = 30
    later, places = tmp_path / "later.mcap", tmp_path / "located.tum"
    with open_log(bag) as log, McapWriter(later) as writer:
        for record in log:
            if isinstance(record, ScanRecord) and record.stamp >= 50.0 + PERIOD * (begun - 0.5):
                writer.write_scan(record)
    start = between(truth[0], truth[begun]) + np.array([0.3, -0.2, 0.1])
    said = ["--initial", ",".join(str(value) for value in start)]
    for more, most in ((said, begun + 3), ([], begun + 45)):
        command = ["slam", str(later), "--in-map", str(tmp_path / "m.npz"), "--out", str(places)]
        result = runner.invoke(app, [*command, "--json", str(figures), *more])
        assert result.exit_code == 0, result.output
        found = json.loads(figures.read_text())
        assert 0 < found["confirmed"] <= found["located"] <= found["scans"] == len(truth) - begun
        inside = read_tum(places)
        at = np.round((inside.stamps - 50.0) / PERIOD).astype(int)
        assert len(at) == found["located"]
        assert at[0] <= most
        misses = between(np.array([between(truth[0], truth[k]) for k in at]), inside.se2())
        settled = misses[3:] if more else misses
        assert np.hypot(settled[:, 0], settled[:, 1]).max() < 0.25
        assert np.abs(settled[:, 2]).max() < 0.06


@pytest.mark.parametrize(
    ("options", "word"),
    [
        (["--initial", "0,0,0"], "--in-map"),
        (["--in-map", "m.npz", "--map", "n.png"], "--map"),
        (["--in-map", "m.npz", "--initial", "0,0"], "X,Y,YAW"),
    ],
)
def test_options_that_contradict_each_other_are_refused(
    recorded: tuple[Path, np.ndarray], options: list[str], word: str
) -> None:
    result = runner.invoke(app, ["slam", str(recorded[0]), *options])
    assert result.exit_code != 0
    assert word in result.output


def test_slam_of_a_log_without_scans_says_so(tmp_path: Path) -> None:
    empty, out = tmp_path / "wheels.mcap", tmp_path / "t.tum"
    with McapWriter(empty) as writer:
        writer.write_odometry(OdometryRecord(np.zeros(3), 1.0))
    result = runner.invoke(app, ["slam", str(empty), "--out", str(out)])
    assert result.exit_code != 0
    assert not out.exists()
