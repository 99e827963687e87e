"""Pose graphs with laser scans as logs."""

from __future__ import annotations

import zipfile

import numpy as np
import pytest

from estimation.geometry.poses import compound
from whereabouts.logs import G2oLog, NothingRecognisedError, open_log

RANGES = [1.0, 2.0, 3.0]
INFORMATION = "500 1 2 400 3 5000"


def graph_text(lines, stamps=(3.0, 4.0, 5.0, 6.0)):
    """Four vertices on a line, solved 10 % longer than their constraints say, one revisit."""
    vertices = "".join(
        f"VERTEX_SE2 {10 + i} {1.1 * i} 0 0\n" + lines.robotlaser(RANGES, stamp=stamp)
        for i, stamp in enumerate(stamps)
    )
    return (
        f"# comment\n{vertices}"
        f"EDGE_SE2 13 10 -3.2 0 0 {INFORMATION}\n"
        f"EDGE_SE2 10 11 1 0 0.1 {INFORMATION}\n"
        f"EDGE_SE2 12 11 -1 0 0 {INFORMATION}\n"
        f"EDGE_SE2 12 13 1 0 0 {INFORMATION}\n"
        f"EDGE_SE2 10 11 1.3 0 0 {INFORMATION}\n"
    )


def test_odometry_is_the_chain_of_constraints(tmp_path, lines):
    path = tmp_path / "a.g2o"
    path.write_text(graph_text(lines))
    log = open_log(path)
    records = list(log)
    assert isinstance(log, G2oLog)
    assert [record.stamp for record in records] == [3, 4, 5, 6]
    chain = [np.zeros(3)]
    for motion in ([1, 0, 0.1], [1, 0, 0], [1, 0, 0]):
        chain.append(compound(chain[-1], np.array(motion)))
    np.testing.assert_allclose([record.odometry for record in records], chain, atol=1e-9)
    np.testing.assert_allclose([record.pose for record in records], [[1.1 * i, 0, 0] for i in range(4)])
    assert [record.scan.stamp for record in records] == [3, 4, 5, 6]
    assert not log.summary.skipped
    assert not log.summary.notes


def test_a_graph_without_stamps_gets_a_stated_pace(tmp_path, lines):
    path = tmp_path / "a.g2o"
    path.write_text(graph_text(lines, stamps=(0, 0, 0, 0)))
    log = G2oLog(path)
    assert [record.stamp for record in log] == [0, 1, 2, 3]
    assert any("1 scans per second assumed" in note for note in log.summary.notes)


def test_a_gap_in_the_chain_takes_the_solved_motion(tmp_path, lines):
    path = tmp_path / "a.g2o"
    text = graph_text(lines).replace("EDGE_SE2 12 13", "EDGE_SE2 10 13")
    path.write_text(text)
    log = open_log(path)
    odometry = np.array([record.odometry for record in log])
    np.testing.assert_allclose(np.linalg.norm(odometry[3, :2] - odometry[2, :2]), 1.1)
    assert any("solved poses" in note for note in log.summary.notes)


@pytest.mark.parametrize(
    "broken",
    [
        "EDGE_SE2 10 11 1 0\n",
        "EDGE_SE2 10 11 1 0 nan 1 0 0 1 0 1\n",
        "VERTEX_SE2 x 0 0 0\n",
        "VERTEX_SE2 3 0 0\n",
        "ROBOTLASER1 0 1 2\n",
        "VERTEX_SE3:QUAT 3 0 0 0 0 0 0 1\n",
    ],
)
def test_broken_lines_are_counted(tmp_path, lines, broken):
    path = tmp_path / "a.g2o"
    path.write_text(graph_text(lines) + broken)
    log = open_log(path)
    assert len(list(log)) == 4
    (remark,) = log.summary.skipped.values()
    assert remark.first == "line 15"


def test_a_laser_without_its_vertex_is_a_skip(tmp_path, lines):
    path = tmp_path / "a.g2o"
    path.write_text(lines.robotlaser(RANGES) + graph_text(lines))
    log = open_log(path)
    assert [record.stamp for record in log] == [3, 4, 5, 6]
    assert log.summary.skipped_count == 1


def test_zipped_with_the_shadow_files_of_some_systems(tmp_path, lines):
    path = tmp_path / "a.g2o.zip"
    with zipfile.ZipFile(path, "w") as archive:
        archive.writestr("a.g2o", graph_text(lines))
        archive.writestr("__MACOSX/", "")
        archive.writestr("__MACOSX/._a.g2o", "x")
    assert len(list(open_log(path))) == 4


def test_a_graph_without_vertices_is_an_error(tmp_path):
    path = tmp_path / "a.g2o"
    path.write_text("EDGE_SE2 1 2 0 0 0 1 0 0 1 0 1\n")
    with pytest.raises(NothingRecognisedError, match="VERTEX_SE2"):
        list(open_log(path))


def test_a_graph_without_scans_is_no_log(tmp_path, lines):
    path = tmp_path / "a.g2o"
    path.write_text("".join(line for line in graph_text(lines).splitlines(True) if "LASER" not in line))
    with pytest.raises(NothingRecognisedError, match="without laser"):
        list(open_log(path))
