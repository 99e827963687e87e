"""`odometry`, `slam` and `track` with the parameter file of a robot: its frame, its topics, its settings."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest
from typer.testing import CliRunner

from estimation.geometry.poses import between, pose_to_matrix
from evaluation.scenes.small_robot import record
from registration import Scan
from whereabouts.cli.main import app
from whereabouts.logs import McapWriter, OdometryRecord, ScanRecord, TransformRecord, open_log, read_tum
from whereabouts.parameter_file import ParameterFileError, parameters_for, settings_for
from whereabouts.robot.robot_log import RobotLog

runner = CliRunner()


def run(*command: object) -> str:
    result = runner.invoke(app, [str(part) for part in command])
    assert result.exit_code == 0, f"{result.output}{result.exception}"
    return str(result.output)


@pytest.fixture(scope="module")
def driven(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, Path, np.ndarray]:
    """A bag, the parameter file that `setup` writes for it, and the truth."""
    folder = tmp_path_factory.mktemp("robot")
    bag, settings = folder / "tb3.mcap", folder / "robot.yaml"
    truth = record(bag, duration=40.0)
    run("setup", bag, "--out", settings)
    return bag, settings, truth


@pytest.mark.parametrize("command", ["odometry", "slam"])
def test_the_trajectory_is_that_of_the_robots_frame(
    command: str, driven: tuple[Path, Path, np.ndarray], tmp_path: Path
) -> None:
    bag, settings, truth = driven
    with_params, without = tmp_path / "robot.tum", tmp_path / "scanner.tum"
    run(command, bag, "--params", settings, "--out", with_params)
    run(command, bag, "--out", without)
    expected = np.array([between(truth[0, 1:], row[1:]) for row in truth])

    def worst(path: Path) -> float:
        return float(np.abs(read_tum(path).se2()[:, :2] - expected[:, :2]).max())

    assert worst(with_params) < 0.03
    # The scanner is 3.2 cm behind the robot's middle and goes another way in turns.
    assert worst(without) > 0.032


def test_only_the_named_topics_count(driven: tuple[Path, Path, np.ndarray], tmp_path: Path) -> None:
    bag, settings, _ = driven
    bags = [tmp_path / "copied.mcap", tmp_path / "spoilt.mcap"]
    for path in bags:
        with McapWriter(path) as writer, open_log(bag) as log:
            for item in log:
                if hasattr(item, "scan"):
                    writer.write_scan(item)
                elif isinstance(item, OdometryRecord):
                    writer.write_odometry(item)
                    wrong = np.array([50.0 * np.sin(item.stamp), 0.0, 0.0])
                    if path.stem == "spoilt":
                        writer.write_odometry(OdometryRecord(wrong, item.stamp, "wheel_odom"))
                else:
                    writer.write_transforms([item])
    paths = [tmp_path / "a.tum", tmp_path / "b.tum"]
    for path, out in zip(bags, paths, strict=True):
        run("odometry", path, "--params", settings, "--out", out)
    first, second = (read_tum(path).se2() for path in paths)
    np.testing.assert_array_equal(first, second)


def test_track_takes_its_settings(driven: tuple[Path, Path, np.ndarray], tmp_path: Path) -> None:
    bag, settings, _ = driven
    out = tmp_path / "tracks.csv"
    run("track", bag, "--params", settings, "--targets", "all", "--out", out)
    assert len(out.read_text().splitlines()) > 1


def written(path: Path, text: str) -> Path:
    path.write_text(text)
    return path


def test_sections_with_wildcards_and_namespaces(tmp_path: Path) -> None:
    path = written(
        tmp_path / "p.yaml",
        """
/**:
  ros__parameters: {base_frame: a, map_frame: m}
robot1:
  loop_closure:
    ros__parameters: {base_frame: b}
/*/scan_registration:
  ros__parameters: {qos_overrides: {/scan: {subscription: {depth: 3}}}}
""",
    )
    assert settings_for(path, "loop_closure").base_frame == "b"
    assert settings_for(path, "scan_registration").base_frame == "a"
    assert parameters_for(path, "scan_registration") == {
        "base_frame": "a", "qos_overrides./scan.subscription.depth": 3
    }  # fmt: skip


@pytest.mark.parametrize(
    ("text", "sentence"),
    [
        ("a: [", "is no YAML"),
        ("nodes: {verifier: }", "is no ROS parameter file"),
        ("/**:\n  ros__parameters: 3\n", "parameters with values expected, got 3"),
        ("/**:\n  ros__parameters: {}\nloop_closure: 3\n", "`ros__parameters:` expected below it, got 3"),
        ("loop_closure:\n  ros__parameters: {resolution: 7}\n", "float from 0.01 to 1 m expected, got 7"),
    ],
)
def test_files_that_cannot_be_used(text: str, sentence: str, tmp_path: Path) -> None:
    path: Any = written(tmp_path / "p.yaml", text)
    with pytest.raises(ParameterFileError, match=r"p\.yaml") as error:
        settings_for(path, "loop_closure")
    assert sentence in str(error.value)


@pytest.fixture
def tilted(tmp_path: Path) -> tuple[Path, Path]:
    """A scanner that looks 20° down at a wall 2 m in front of the robot, and the robot's parameter file."""
    mounting = pose_to_matrix(np.array([0.0, 0.0, 1.0, 0.0, np.radians(20.0), 0.0]))
    bearings = -0.5 + 0.01 * np.arange(101)
    forwards = mounting[0, :2] @ [np.cos(bearings), np.sin(bearings)]
    bag, settings = tmp_path / "tilted.mcap", tmp_path / "tilted.yaml"
    with McapWriter(bag) as writer:
        writer.write_transforms([TransformRecord(mounting, 1.0, "base_link", "laser", "tf_static")])
        for stamp in (1.0, 1.1, 1.2):
            scan = Scan(2.0 / forwards, -0.5, 0.01, 0.1, 8.0, stamp)
            writer.write_scan(ScanRecord(scan, stamp, "scan", "laser"))
    run("setup", bag, "--out", settings)
    return bag, settings


def test_scans_of_a_tilted_scanner_are_projected_to_the_floor(tilted: tuple[Path, Path]) -> None:
    bag, settings = tilted
    with open_log(bag) as log:
        robot = RobotLog(log, settings)
        scans = [item.scan for item in robot if isinstance(item, ScanRecord)]
    assert len(scans) == 3
    assert all(scan.valid.sum() > 50 for scan in scans)
    assert all(np.allclose(scan.points()[:, 0], 2.0, atol=0.01) for scan in scans)
    assert robot.lines() == [
        "'laser' is tilted: its scans are projected to the floor (3 of 3 messages on scan)"
    ]


def test_nobody_is_looked_for_in_tilted_scans(tilted: tuple[Path, Path]) -> None:
    bag, settings = tilted
    result = runner.invoke(app, ["track", str(bag), "--params", str(settings)])
    assert "people are only found in a level plane" in str(result.exception)


def test_a_scanner_that_tf_does_not_place_is_told_of(
    driven: tuple[Path, Path, np.ndarray], tmp_path: Path
) -> None:
    _, settings, _ = driven
    bag = tmp_path / "alone.mcap"
    with McapWriter(bag) as writer:
        for stamp in (1.0, 1.1):
            nothing = Scan(np.full(40, np.nan), -1.0, 0.05, 0.1, 8.0, stamp)
            writer.write_scan(ScanRecord(nothing, stamp, "scan", "base_scan"))
    said = run("odometry", bag, "--params", settings)
    assert "tf does not say how 'base_scan' is mounted" in said
    assert "no reading lies between the scanner's range_min and range_max (2 of 2 messages on scan)" in said


def test_a_log_without_tf_that_says_how_its_scanner_is_mounted_is_believed(tmp_path: Path) -> None:
    log, settings = tmp_path / "drive.clf", tmp_path / "robot.yaml"
    line = f"FLASER 9 {' '.join(['2.0'] * 9)} 0.0 0.0 0.0 0.0 0.0 0.0 %.1f host %.1f"
    log.write_text("".join(f"{line % (stamp, stamp)}\n" for stamp in (1.0, 1.2)), encoding="ascii")
    assert runner.invoke(app, ["setup", str(log), "--out", str(settings)]).exit_code == 0
    assert "tf does not say" not in run("odometry", log, "--params", settings)


def test_a_file_of_run_is_told_from_one_of_parameters(tmp_path: Path) -> None:
    config = tmp_path / "suite.yaml"
    config.write_text("nodes:\n  world_model:\n    parameters: {classes: [cup]}\n", encoding="ascii")
    with pytest.raises(ParameterFileError, match="is for `run --config`"):
        settings_for(config, "world_model")
