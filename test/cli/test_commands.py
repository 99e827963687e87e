"""The command line as a user types it."""

from __future__ import annotations

import json
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
from typer.testing import CliRunner

from evaluation.demo.recorded import dropped
from registration import Scan
from whereabouts.cli import main
from whereabouts.cli.main import app
from whereabouts.logs import McapWriter, OdometryRecord, ScanRecord, read_tum
from whereabouts.logs.bags.encode import scan_message
from whereabouts.simulation import Drive, Lidar, box, joined

runner = CliRunner()


@pytest.fixture(scope="module")
def bag(tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("bag") / "drive.mcap"
    world = joined([box(10.0, 7.0), box(1.0, 0.5, (1.0, 2.5, 0.4)), box(0.6, 0.6, (-2.0, 1.0, 0.2))])
    drive, lidar, rng = (
        Drive([(-3.0, -1.5), (2.5, -1.5), (2.5, 1.5)], speed=0.5),
        Lidar(),
        np.random.default_rng(5),
    )
    with McapWriter(path) as writer:
        for k in range(40):
            stamp = 100.0 + 0.1 * k
            writer.write_odometry(OdometryRecord(drive(0.1 * k), stamp))
            writer.write_scan(ScanRecord(lidar.scan(world, drive(0.1 * k), rng, stamp).scan, stamp))
    return path


def test_odometry_writes_one_line_per_scan_with_its_stamp(bag: Path, tmp_path: Path) -> None:
    out, figures = tmp_path / "t.tum", tmp_path / "f.json"
    result = runner.invoke(app, ["odometry", str(bag), "--out", str(out), "--json", str(figures)])
    assert result.exit_code == 0, result.output
    trajectory = read_tum(out)
    assert np.allclose(trajectory.stamps, 100.0 + 0.1 * np.arange(40), atol=1e-6)
    assert np.hypot(*trajectory.se2()[-1, :2]) == pytest.approx(1.95, abs=0.06)
    assert json.loads(figures.read_text())["scans"] == 40


def test_odometry_repeats_exactly(bag: Path, tmp_path: Path) -> None:
    outputs = []
    for name in ("a.tum", "b.tum"):
        result = runner.invoke(app, ["odometry", str(bag), "--out", str(tmp_path / name)])
        assert result.exit_code == 0
        outputs.append((tmp_path / name).read_bytes())
    assert outputs[0] == outputs[1]


def test_odometry_of_a_log_without_scans_says_so_and_leaves_no_file(tmp_path: Path) -> None:
    empty = tmp_path / "wheels.mcap"
    with McapWriter(empty) as writer:
        writer.write_odometry(OdometryRecord(np.zeros(3), 1.0))
    out = tmp_path / "t.tum"
    command = [sys.executable, "-m", "whereabouts.cli.main", "odometry", str(empty), "--out", str(out)]
    answer = subprocess.run(command, capture_output=True, text=True)
    assert answer.returncode == 1
    assert "no scans or clouds in it that can be used; it has /wheel_odom" in answer.stderr
    assert "Traceback" not in answer.stderr
    assert not out.exists()


def test_odometry_says_why_it_is_unsure_and_why_scans_were_left_out(tmp_path: Path) -> None:
    bag = tmp_path / "blind.mcap"
    with McapWriter(bag) as writer:
        for k in range(5):
            writer.write_scan(ScanRecord(Scan(np.full(40, 2000.0), -1.0, 0.05, 0.1, 8.0, 1.0 + k), 1.0 + k))
    result = runner.invoke(app, ["odometry", str(bag)])
    assert "note: 5 × only 0 points on lines; at least 15 are needed (first at time 1.000)" in result.stderr
    assert "5 unsure" in result.stdout
    with McapWriter(bag) as writer:
        empty = scan_message(ScanRecord(Scan(np.zeros(0), -1.0, 0.05, 0.1, 8.0, 1.0), 1.0))
        writer.write_message("scan", "sensor_msgs/msg/LaserScan", empty, 10**9)
    result = runner.invoke(app, ["odometry", str(bag)])
    assert result.exit_code == 1
    assert "skipped 1 × /scan: scan without readings" in result.stderr


@pytest.mark.parametrize(
    ("arguments", "sentence"),
    [
        (["odometry", "does-not-exist.bag"], "does not exist"),
        (["run", "no_such_node"], "there are: scan_registration"),
        (["run", "--rate", "2"], "need --bag"),
        (["run", "--namespace", "robot"], "must start with a slash"),
        (["run", "--record", "odometry:nav_msgs/msg/Odometry"], "go together"),
        (["experiment", "no_such_experiment"], "no experiment is called"),
    ],
)
def test_mistakes_get_one_sentence(arguments: list[str], sentence: str) -> None:
    answer = subprocess.run(
        [sys.executable, "-m", "whereabouts.cli.main", *arguments], capture_output=True, text=True
    )
    assert answer.returncode == 1
    assert sentence in answer.stderr
    assert "Traceback" not in answer.stderr


@pytest.mark.parametrize("command", ["demo", "run", "convert", "odometry", "experiment"])
def test_every_command_explains_itself(command: str) -> None:
    result = runner.invoke(app, [command, "--help"])
    assert result.exit_code == 0
    assert len(result.output.splitlines()) > 8


def test_experiments_are_listed_with_what_they_show() -> None:
    result = runner.invoke(app, ["experiment", "list"])
    assert result.exit_code == 0
    for line in result.output.splitlines():
        assert len(line.split(maxsplit=1)[1]) > 10


def test_the_demo_counts_what_any_node_dropped() -> None:
    said = {
        "scan_registration": {"/scan dropped": "1", "/scan dropped, refused": "1"},
        "loop_closure": {"/scan dropped": "2", "/scan dropped, no transform": "2", "/odometry dropped": "0"},
    }
    assert dropped(said) == 3


def test_what_ros_says_itself_is_a_sentence(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    class RCLError(RuntimeError):
        """As rclpy's, whose place in rclpy is no public one."""

    def fails() -> None:
        raise RCLError("error creating node: no security libraries\nat node.c:252")

    monkeypatch.setattr(main, "app", fails)
    monkeypatch.setattr(main, "listen_to_interrupts", lambda: None)
    with pytest.raises(SystemExit, match="1"):
        main.main()
    assert capsys.readouterr().err == (
        "whereabouts: ROS says: error creating node: no security libraries at node.c:252\n"
    )
