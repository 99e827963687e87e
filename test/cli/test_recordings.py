"""Recordings that are read in place, where they are present."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from typer.testing import CliRunner

from evaluation.datasets import recording
from whereabouts.cli.main import app
from whereabouts.logs import read_tum

runner = CliRunner()


def followed(name: str, out: Path) -> np.ndarray:
    path = recording(name)
    if path is None:
        pytest.skip(f"{name} is not here: set WHEREABOUTS_DATA to the folder of recordings")
    result = runner.invoke(app, ["odometry", str(path), "--out", str(out)])
    assert result.exit_code == 0, result.output
    return read_tum(out).se2()


def test_stationary_robot_among_walking_people_stays_where_it_is(tmp_path: Path) -> None:
    poses = followed("people/demo_stationary_simple_environment.bag", tmp_path / "t.tum")
    assert len(poses) == 1265
    assert np.hypot(poses[:, 0], poses[:, 1]).max() < 0.3


def test_moving_lidar_on_a_car(tmp_path: Path) -> None:
    poses = followed("moving_objects/parallel.bag", tmp_path / "t.tum")
    assert len(poses) == 219
    assert np.isfinite(poses).all()
