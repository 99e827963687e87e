"""`whereabouts merge` on files that `slam` would have written."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from typer.testing import CliRunner

from estimation.errors import InputError
from estimation.geometry.poses import compound
from loop_closure.maps.map_file import read_map, write_map
from loop_closure.slam.trajectory import Slam
from whereabouts.cli.main import app
from whereabouts.simulation import Drive, Lidar, box, joined

PIECES = [
    box(1.2, 0.6, (-4.0, 2.8, 0.2)), box(0.8, 0.8, (1.0, 3.0, 0.5)), box(2.0, 0.4, (4.2, -2.6, 0.0)),
    box(0.5, 0.5, (-0.5, 0.1, 0.7)), box(0.6, 1.4, (4.5, 1.0, 0.1)),
]  # fmt: skip


def session(path: Path, corners: list[tuple[float, float]], origin: np.ndarray) -> int:
    """Write the map of a drive through one room; the number of its keyframes. origin : of its odometry frame."""
    world, lidar, rng = joined([box(10.0, 7.0), *PIECES]), Lidar(181), np.random.default_rng(4)
    drive, slam = Drive(corners, speed=0.8, turn_rate=1.0), Slam()
    for k in range(int(drive.duration / 0.3)):
        pose = drive(0.3 * k)
        slam.process(lidar.scan(world, pose, rng, 0.3 * k).scan, compound(origin, pose))
    with path.open("wb") as file:
        write_map(slam, file)
    return len(slam.keyframes)


def test_two_files_become_one_that_can_be_read(tmp_path: Path) -> None:
    counts = [
        session(tmp_path / "a.npz", [(-3.0, -1.5), (2.5, -1.5), (2.5, 1.5)], np.zeros(3)),
        session(tmp_path / "b.npz", [(2.5, -1.0), (2.5, 1.5), (-3.0, 1.5)], np.array([20.0, 3.0, 1.0])),
    ]
    out = tmp_path / "both.png"
    arguments = ["merge", str(tmp_path / "a.npz"), str(tmp_path / "b.npz"), "--map", str(out)]
    answer = CliRunner().invoke(app, arguments)
    assert answer.exit_code == 0, answer.output
    both = read_map(out.with_suffix(".npz"))
    assert len(both.keyframes) >= sum(counts)
    # Everything lies in the one room, in the frame of the first session.
    assert np.abs(both.graph.poses[:, :2]).max() < 5.0
    assert out.exists()
    assert out.with_suffix(".yaml").exists()


def test_what_is_no_map_is_named(tmp_path: Path) -> None:
    path = tmp_path / "no.npz"
    path.write_text("no map")
    answer = CliRunner().invoke(app, ["merge", str(path), str(path), "--map", str(tmp_path / "m.png")])
    assert answer.exit_code != 0
    assert isinstance(answer.exception, InputError)
    with pytest.raises(InputError, match=r"no\.npz"):
        raise answer.exception
