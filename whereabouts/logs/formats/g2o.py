"""Planar pose graphs in g2o's text format, with laser scans: a solved graph as a log.

A ROBOTLASER1 line belongs to the VERTEX_SE2 before it. The file is read twice: vertices and edges first (they
are small and the edges may stand last), then the scans as a stream.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from estimation.errors import InputError
from estimation.geometry.poses import between, compound, inverse
from whereabouts.logs.formats.carmen_laser import BadLineError, numbers, parse_robotlaser
from whereabouts.logs.formats.text import TextLog, TextSource
from whereabouts.logs.summary import Summary
from whereabouts.messages.records import Array, Record, ScanRecord
from whereabouts.system.log_errors import NothingRecognisedError

# Scans per second where the file has no stamps. Any rate will do as long as stamps grow; a note says so.
SYNTHETIC_RATE = 1.0


@dataclass(frozen=True, eq=False)
class _Graph:
    """Vertices in file order, and constraints.

    ranks : place of each vertex in that order, by its id. poses : (N, 3) [x, y, yaw] of each, as solved when the file
    was written. edges : (source, target, (3,) [x, y, yaw] of the target in the frame of the source).
    stamps : (N,) seconds of each vertex's scan, NaN for a vertex without one.
    """

    ranks: dict[int, int]
    poses: Array
    edges: list[tuple[int, int, Array]]
    stamps: Array

    def paced(self) -> tuple[Array, bool]:
        """The stamps; at an even pace, and True, where all scans have the same one, so that it says nothing."""
        seen = np.isfinite(self.stamps)
        known = self.stamps[seen]
        if len(known) < 2 or (known != known[0]).any():
            return self.stamps, False
        stamps = np.full(len(self.stamps), np.nan)
        stamps[seen] = np.arange(len(known)) / SYNTHETIC_RATE
        return stamps, True

    def chain(self) -> tuple[Array, int]:
        """Poses (N, 3) by the sequential constraints alone, from the first vertex's pose on.

        Also returned is the number of vertices that no constraint ties to the one before them; there the
        solved poses give the motion.
        """
        steps: dict[int, Array] = {}
        for source, target, motion in self.edges:
            first, second = self.ranks.get(source, -9), self.ranks.get(target, -9)
            if abs(first - second) == 1:
                steps.setdefault(max(first, second), motion if second > first else inverse(motion))
        chain = self.poses.copy()
        for rank in range(1, len(chain)):
            step = steps.get(rank)
            step = between(self.poses[rank - 1], self.poses[rank]) if step is None else step
            chain[rank] = compound(chain[rank - 1], step)
        return chain, len(chain) - 1 - len(steps)


class G2oLog(TextLog):
    """A g2o file with ROBOTLASER1 lines as a stream of ScanRecord.

    Every scan carries `odometry`, the chain of sequential constraints, so its drift is theirs, and `pose`,
    the solved pose of its vertex. The topic is `scan`.
    """

    format = "g2o"

    @cached_property
    def _graph(self) -> _Graph:
        return _read_graph(self._source)

    def _records(self) -> Iterator[Record]:
        graph = self._graph
        if not graph.ranks:
            raise NothingRecognisedError(self.path, "no VERTEX_SE2 line; only planar graphs can be read")
        odometry, gaps = graph.chain()
        if gaps:
            reason = "vertex not tied to the one before it: solved poses give its odometry"
            self.summary.note(reason, "the edges", gaps)
        stamps, made_up = graph.paced()
        if made_up:
            reason = f"no stamps in the file: {SYNTHETIC_RATE:g} scans per second assumed"
            self.summary.note(reason, "its lasers")
        rank, free, lasers = -1, False, 0
        for number, fields in self._source.fields(self.summary):
            try:
                if fields[0] == b"ROBOTLASER1":
                    if not free:
                        raise BadLineError("ROBOTLASER1 without a vertex of its own before it")
                    free = False
                    line = parse_robotlaser(fields, self._max_range, float(stamps[rank]))
                    lasers += 1
                    if self.wants("scan"):
                        self.place = f"line {number}"
                        mount = between(line.robot, line.laser)
                        pose = graph.poses[rank]
                        yield ScanRecord(
                            line.scan, line.stamp, odometry=odometry[rank], pose=pose, sensor_pose=mount
                        )
                elif fields[0] == b"VERTEX_SE2":
                    _vertex(fields)
                    rank, free = rank + 1, True
                elif fields[0] == b"EDGE_SE2":
                    _edge(fields)
                else:
                    raise BadLineError(f"{fields[0][:20].decode(errors='replace')} lines, not used")
            except (BadLineError, InputError) as error:
                self.summary.skip(str(error), f"line {number}")
        if not lasers:
            raise NothingRecognisedError(self.path, "a graph without laser scans (ROBOTLASER1 lines)")


def _read_graph(source: TextSource) -> _Graph:
    """Vertices and constraints; lines that cannot be read are left out, and counted when iterating."""
    ranks: dict[int, int] = {}
    poses: list[list[float]] = []
    edges: list[tuple[int, int, Array]] = []
    stamps: list[float] = []
    for _, fields in source.fields(Summary()):
        try:
            if fields[0] == b"VERTEX_SE2":
                vertex, pose = _vertex(fields)
                ranks[vertex] = len(poses)
                poses.append(pose)
                stamps.append(np.nan)
            elif fields[0] == b"EDGE_SE2":
                edges.append(_edge(fields))
            elif fields[0] == b"ROBOTLASER1" and stamps and len(fields) > 3:
                stamps[-1] = numbers(fields[-3:-2], "a stamp")[0]
        except BadLineError:
            continue
    return _Graph(ranks, np.array(poses, dtype=np.float64).reshape(-1, 3), edges, np.array(stamps))


def _id(text: bytes) -> int:
    if not text.isdigit() or len(text) > 18:
        raise BadLineError("id of a vertex is not a number")
    return int(text)


def _vertex(fields: list[bytes]) -> tuple[int, list[float]]:
    """`VERTEX_SE2 id x y yaw`."""
    if len(fields) != 5:
        raise BadLineError("VERTEX_SE2: five fields expected")
    return _id(fields[1]), numbers(fields[2:], "VERTEX_SE2: a field")


def _edge(fields: list[bytes]) -> tuple[int, int, Array]:
    """`EDGE_SE2 from to x y yaw` and the upper triangle of the information matrix, row by row."""
    if len(fields) != 12:
        raise BadLineError("EDGE_SE2: twelve fields expected")
    values = numbers(fields[3:], "EDGE_SE2: a field")
    return _id(fields[1]), _id(fields[2]), np.array(values[:3])
