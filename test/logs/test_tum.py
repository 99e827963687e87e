"""TUM trajectories in and out."""

from __future__ import annotations

import gzip

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from estimation.errors import InputError
from whereabouts.logs import EmptyLogError, TrajectoryError, WriteError, read_tum, write_tum
from whereabouts.messages.message_rotations import rotation_of

FINITE = st.floats(-1e6, 1e6)


@settings(max_examples=50)
@given(
    rows=st.lists(st.tuples(st.floats(0, 4e9), FINITE, FINITE, st.floats(-10, 10)), min_size=1, max_size=8)
)
def test_planar_trajectories_come_back(tmp_path_factory, rows):
    path = tmp_path_factory.mktemp("tum") / "a.tum"
    stamps, poses = [row[0] for row in rows], np.array([row[1:] for row in rows])
    write_tum(path, stamps, poses)
    back = read_tum(path)
    assert back.stamps.tolist() == stamps  # to the last bit
    np.testing.assert_allclose(back.se2()[:, :2], poses[:, :2], atol=1e-8)
    turned = np.angle(np.exp(1j * (back.se2()[:, 2] - poses[:, 2])))
    np.testing.assert_allclose(turned, 0, atol=1e-8)


def test_spatial_trajectories_come_back(tmp_path):
    generator = np.random.default_rng(5)
    matrices = np.tile(np.eye(4), (50, 1, 1))
    matrices[:, :3, :3] = Rotation.random(50, random_state=5).as_matrix()
    matrices[:, :3, 3] = generator.normal(size=(50, 3))
    matrices[0, :3, :3] = np.diag([1.0, -1.0, -1.0])  # half a turn, where w is zero
    write_tum(tmp_path / "a.tum", np.arange(50) + 1.7e9, matrices)
    np.testing.assert_allclose(read_tum(tmp_path / "a.tum").se3(), matrices, atol=1e-8)


def test_quaternions_agree_with_scipy():
    for rotation in Rotation.random(200, random_state=1):
        np.testing.assert_allclose(
            rotation_of(tuple(3 * rotation.as_quat())), rotation.as_matrix(), atol=1e-9
        )


def test_a_line_reads_as_the_format_says(tmp_path):
    write_tum(tmp_path / "a.tum", [976052857.337284], [[1.5, -2, np.pi / 2]])
    header, line = (tmp_path / "a.tum").read_text().splitlines()
    assert header.startswith("#")
    values = line.split()
    assert values[:7] == ["976052857.337284", "1.500000000", "-2.000000000", "0.000000000"] + [
        "0.000000000000"
    ] * 2 + ["0.707106781187"]


@pytest.mark.parametrize(
    ("line", "place"),
    [
        ("1 2 3", "line 3"),
        ("1 2 3 0 0 0 0 x", "line 3"),
        ("1 2 3 0 0 0 nan 1", "line 3"),
        ("1 2 3 0 0 0 0 0", "line 3"),
        ("1 2 3 0 0 0 0 1 9", "line 3"),
    ],
)
def test_a_wrong_line_is_named(tmp_path, line, place):
    path = tmp_path / "a.tum"
    path.write_text(f"# comment\n0 0 0 0 0 0 0 1\n{line}\n")
    with pytest.raises(TrajectoryError, match=place) as caught:
        read_tum(path)
    assert caught.value.where == place
    assert "a.tum" in str(caught.value)


def test_commas_gzip_and_unnormalised_quaternions_are_read(tmp_path):
    path = tmp_path / "a.tum.gz"
    path.write_bytes(gzip.compress(b"1, 2, 3, 0, 0, 0, 0, 0.9999\n"))
    assert read_tum(path).quaternions.tolist() == [[0, 0, 0, 1]]


def test_an_empty_trajectory_is_an_error(tmp_path):
    write_tum(tmp_path / "a.tum", [], np.zeros((0, 3)))
    with pytest.raises(EmptyLogError):
        read_tum(tmp_path / "a.tum")


def test_after_an_error_the_old_file_is_unchanged_and_nothing_is_left(tmp_path):
    path = tmp_path / "a.tum"
    path.write_text("old")
    with pytest.raises(InputError, match="finite"):
        write_tum(path, [1.0, 2.0], [[0, 0, 0], [np.nan, 0, 0]])
    assert path.read_text() == "old"
    assert [entry.name for entry in tmp_path.iterdir()] == ["a.tum"]


def test_wrong_shapes_and_lengths_are_refused(tmp_path):
    with pytest.raises(InputError, match="shape"):
        write_tum(tmp_path / "a.tum", [1.0], [[1, 2]])
    with pytest.raises(InputError, match="one for each"):
        write_tum(tmp_path / "a.tum", [1.0, 2.0], [[1, 2, 3]])
    assert not list(tmp_path.iterdir())


def test_a_missing_directory_is_named(tmp_path):
    with pytest.raises(WriteError, match="does not exist"):
        write_tum(tmp_path / "no" / "a.tum", [1.0], [[1, 2, 3]])
