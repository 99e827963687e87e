"""Recorded trajectories: each format from hand-written text, wrong content, and the recordings where they are."""

from __future__ import annotations

import gzip
from pathlib import Path

import numpy as np
import pytest

from evaluation.datasets import recording
from evaluation.intentions.trajectories import read_trajectories
from whereabouts.system.log_errors import EmptyLogError, LogNotFoundError, TrajectoryError, UnknownFormatError

EDINBURGH = """% Total number of trajectories in file are  2

Properties.R1=[3 10 12 1.0 ];
 TRACK.R1=[[100 20 9];[110 20 18];[120 30 27]];
Properties.R7=[1 10 12 1.0 ];
 TRACK.R7=[[1 2 3]];
"""


def test_edinburgh_in_metres_and_seconds(tmp_path: Path) -> None:
    path = tmp_path / "day.txt.gz"
    path.write_bytes(gzip.compress(EDINBURGH.encode()))
    recorded = read_trajectories(path)
    assert recorded.kind == "edinburgh"
    assert list(recorded.trajectories) == [1, 7]
    expected = np.array([[100, 20], [110, 20], [120, 30]]) * 0.0247
    np.testing.assert_allclose(recorded.trajectories[1][:, :2], expected)
    np.testing.assert_allclose(recorded.trajectories[1][:, 2], [1.0, 2.0, 3.0])


def test_obsmat_and_table_say_the_same(tmp_path: Path) -> None:
    (tmp_path / "obsmat.txt").write_text(
        "   1.0e+00 3.0 0.5 0.0 -1.5 0 0 0\n  11 4 2 0 3 0 0 0\n 11 3 0.75 0 -1.25 0 0 0\n"
    )
    (tmp_path / "tracks.csv").write_text(
        "time,label,x,y,weight\n0.04,3,0.5,-1.5,1\n0.44,4,2,3,1\n0.44,3,0.75,-1.25,1\n"
    )
    one, two = read_trajectories(tmp_path / "obsmat.txt"), read_trajectories(tmp_path / "tracks.csv")
    assert (one.kind, two.kind) == ("eth", "csv")
    for label in (3, 4):
        np.testing.assert_allclose(one.trajectories[label], two.trajectories[label])
    np.testing.assert_allclose(one.trajectories[3], [[0.5, -1.5, 0.04], [0.75, -1.25, 0.44]])


def test_wrong_content_is_named(tmp_path: Path) -> None:
    with pytest.raises(LogNotFoundError, match="absent"):
        read_trajectories(tmp_path / "absent.txt")
    cases = {
        "empty.txt": ("\n\n", EmptyLogError, "nothing"),
        "prose.txt": ("once upon a time\n", UnknownFormatError, "line 1"),
        "short.txt": ("1 2 3 4 5 6 7 8\n1 2 3\n", TrajectoryError, "line 2"),
        "text.csv": ("time,label,x,y\n0,1,2,nan\n", TrajectoryError, "line 2"),
    }
    for name, (content, error, expected) in cases.items():
        (tmp_path / name).write_text(content)
        with pytest.raises(error, match=expected):
            read_trajectories(tmp_path / name)


def test_recordings() -> None:
    hall, hotel = (
        recording(f"trajectories/{name}") for name in ("edinburgh_01Aug.txt.gz", "hotel_obsmat.txt.gz")
    )
    if hall is None or hotel is None:
        pytest.skip("the recorded trajectories are absent")
    walks = read_trajectories(hall).trajectories
    assert len(walks) == 146
    assert min(np.diff(walk[:, 2]).min() for walk in walks.values()) > -0.2
    assert max(walk[:, 0].max() for walk in walks.values()) < 640 * 0.0247
    people = read_trajectories(hotel).trajectories
    assert len(people) == 390
    assert sum(len(rows) for rows in people.values()) == 6544
