"""`whereabouts view` on a bag."""

from __future__ import annotations

import sys
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from typer.testing import CliRunner

from whereabouts.cli.main import app
from whereabouts.logs import McapWriter, OdometryRecord, ScanRecord
from whereabouts.simulation import Drive, Lidar, box, joined
from whereabouts.viewer.rerun_sink import NoViewerError, import_rerun

runner = CliRunner()


@pytest.fixture(scope="module")
def bags(tmp_path_factory: pytest.TempPathFactory, messages: Any) -> list[Path]:
    """Two seconds of a drive through a room, and what the suite said about it."""
    folder = tmp_path_factory.mktemp("bags")
    world = joined([box(10.0, 7.0), box(1.0, 0.5, (1.0, 2.5, 0.4))])
    drive, lidar, rng = Drive([(-3.0, -1.5), (2.5, -1.5)], speed=0.5), Lidar(), np.random.default_rng(5)
    with McapWriter(folder / "drive.mcap") as drove, McapWriter(folder / "said.mcap") as said:
        for k in range(20):
            stamp, pose = 100.0 + 0.1 * k, drive(0.1 * k)
            drove.write_scan(ScanRecord(lidar.scan(world, pose, rng, stamp).scan, stamp))
            said.write_odometry(OdometryRecord(pose, stamp, "odometry"))
            thing = messages.make("whereabouts_msgs/WorldObject", id="cup-1", existence_probability=0.9)
            state = messages.make(
                "whereabouts_msgs/WorldState", header=messages.header(stamp, "map"), objects=[thing]
            )
            messages.write(said, "world_state", "whereabouts_msgs/WorldState", state, stamp)
            several = messages.make(
                "whereabouts_msgs/WorldHypotheses", header=state.header, hypotheses=[state] * (k + 1)
            )
            messages.write(said, "world_hypotheses", "whereabouts_msgs/WorldHypotheses", several, stamp)
    return [folder / "drive.mcap", folder / "said.mcap"]


def test_bags_become_a_rerun_file_that_rerun_reads(bags: list[Path], tmp_path: Path) -> None:
    pytest.importorskip("rerun", reason="rerun-sdk is optional: requirements/viewer.txt")
    out = tmp_path / "out.rrd"
    result = runner.invoke(app, ["view", *map(str, bags), "--save", str(out)], catch_exceptions=False)
    assert result.exit_code == 0, result.output
    assert "80 messages shown" in result.output
    data = out.read_bytes()
    assert data[:3] == b"RRF"
    for part in (
        b"/map/odom/base_link/laser/scan",
        b"/map/objects",
        b"/plots/hypotheses",
        b"cup-1, p = 0.90",
    ):
        assert part in data, part


def test_bags_become_a_picture_without_rerun(bags: list[Path], tmp_path: Path, monkeypatch: Any) -> None:
    monkeypatch.setitem(sys.modules, "rerun", None)
    out = tmp_path / "out.png"
    result = runner.invoke(
        app,
        ["view", *map(str, bags), "--picture", str(out), "--until", "1.0", "--hide", "/world_state"],
        catch_exceptions=False,
    )
    assert result.exit_code == 0, result.output
    assert "33 messages shown" in result.output
    assert out.read_bytes().startswith(b"\x89PNG")


def test_without_rerun_the_command_says_what_to_install(monkeypatch: Any) -> None:
    monkeypatch.setitem(sys.modules, "rerun", None)
    with pytest.raises(NoViewerError, match=r"pip install -r requirements/viewer\.txt"):
        import_rerun()


@pytest.mark.parametrize(
    ("arguments", "sentence"),
    [
        (["--save", "a.rrd", "--picture", "a.png"], "exclude each other"),
        (["--namespace", "robot1", "--picture", "a.png"], "must start with a slash"),
        (["none.mcap", "--picture", "a.png"], "does not exist"),
    ],
)
def test_mistakes_get_one_sentence(arguments: list[str], sentence: str) -> None:
    result = runner.invoke(app, ["view", *arguments])
    assert result.exit_code != 0
    assert sentence in str(result.exception)
    assert not Path("a.png").exists()


def test_a_bag_with_nothing_to_draw_says_so(tmp_path: Path, messages: Any) -> None:
    with McapWriter(tmp_path / "empty.mcap") as writer:
        messages.write(writer, "talk", "std_msgs/String", messages.make("std_msgs/String", data="hello"), 1.0)
    result = runner.invoke(app, ["view", str(tmp_path / "empty.mcap"), "--picture", str(tmp_path / "p.png")])
    assert "nothing that can be drawn" in str(result.exception)
