"""`odometry`, `slam` and `track` with the parameter file of a robot: its frame, its topics, its settings."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest
from typer.testing import CliRunner

from estimation.poses import between
from whereabouts.cli.main import app
from whereabouts.logs import McapWriter, OdometryRecord, open_log, read_tum
from whereabouts.parameter_file import ParameterFileError, parameters_for, settings_for
from whereabouts.simulation.small_robot import record

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
    assert worst(without) > 0.04


def test_only_the_named_topics_count(driven: tuple[Path, Path, np.ndarray], tmp_path: Path) -> None:
    bag, settings, _ = driven
    spoilt = tmp_path / "spoilt.mcap"
    with McapWriter(spoilt) as writer, open_log(bag) as log:
        for item in log:
            if hasattr(item, "scan"):
                writer.write_scan(item)
            elif isinstance(item, OdometryRecord):
                writer.write_odometry(item)
                wrong = OdometryRecord(
                    np.array([50.0 * np.sin(item.stamp), 0.0, 0.0]), item.stamp, "wheel_odom"
                )
                writer.write_odometry(wrong)
            else:
                writer.write_transforms([item])
    paths = [tmp_path / "a.tum", tmp_path / "b.tum"]
    run("odometry", bag, "--params", settings, "--out", paths[0])
    run("odometry", spoilt, "--params", settings, "--out", paths[1])
    # Log times differ, and with them which readings of the wheels a scan already knows.
    first, second = (read_tum(path).se2() for path in paths)
    assert np.abs(first - second).max() < 0.001


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
