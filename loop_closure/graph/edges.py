"""A measured motion between two nodes of a trajectory."""

from __future__ import annotations

from dataclasses import dataclass

from estimation.checks import FloatArray


@dataclass(frozen=True, eq=False)
class Edge:
    """A measured motion between two nodes.

    a, b : nodes, a < b. motion : pose of b in the frame of a, (3,) or (4, 4). covariance : (3, 3) or (6, 6) of it, in
    the frame of a. closure : whether it closes a loop, and may be wrong.
    """

    a: int
    b: int
    motion: FloatArray
    covariance: FloatArray
    closure: bool = False
