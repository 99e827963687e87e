"""Which closure a person means by a point of the map."""

from __future__ import annotations

import numpy as np
import pytest

from loop_closure.graph.edges import Edge
from loop_closure.slam.editing import nearest_closure


def edge(a: int, b: int, closure: bool = True) -> Edge:
    return Edge(a, b, np.zeros(3), np.eye(3), closure)


def test_the_nearest_closure_is_that_of_the_line_nearest_to_the_point() -> None:
    poses = np.array([[0.0, 0.0, 0.0], [4.0, 0.0, 0.0], [4.0, 3.0, 0.0], [0.0, 3.0, 0.0]])
    edges = [edge(0, 1, False), edge(1, 2, False), edge(0, 3), edge(1, 3)]
    assert nearest_closure(edges[:2], poses, [0.0, 0.0]) is None
    assert nearest_closure(edges, poses, [-1.0, 1.5]) == (edges[2], pytest.approx(1.0))
    # Beside the middle of the line from (4, 0) to (0, 3).
    assert nearest_closure(edges, poses, [2.0 + 0.6, 1.5 + 0.8]) == (edges[3], pytest.approx(1.0))
    # Beyond an end the end counts.
    assert nearest_closure(edges, poses, [7.0, -4.0]) == (edges[3], pytest.approx(5.0))
