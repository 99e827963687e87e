"""Planar pose graphs in g2o's text format, with laser scans: a solved graph as a log.

A ROBOTLASER1 line belongs to the VERTEX_SE2 before it. The file is read twice: vertices and edges first (they
are small and the edges may stand last), then the scans as a stream.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from dataclasses import dataclass, field, replace
from functools import cached_property
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from estimation.errors import InputError
from estimation.geometry.poses import between, compound, inverse
from whereabouts.logs.bags.unpacking import UNPACKED_LIMIT
from whereabouts.logs.formats.carmen_laser import BadLineError, numbers, parse_robotlaser
from whereabouts.logs.formats.text import TextSource
from whereabouts.logs.log import Log
from whereabouts.logs.summary import Summary
from whereabouts.messages.records import Array, Record, ScanRecord
from whereabouts.system.atomic import atomic_path
from whereabouts.system.log_errors import NothingRecognisedError

# Scans per second where the file has no stamps. Any rate will do as long as stamps grow; a note says so.
SYNTHETIC_RATE = 1.0
UPPER_TRIANGLE = np.triu_indices(3)


@dataclass(frozen=True, eq=False)
class G2oEdge:
    """A constraint between two vertices.

    motion : (3,) [x, y, yaw] of vertex `target` in the frame of vertex `source`.
    information : (3, 3) inverse of its covariance, in metres and radians.
    """

    source: int
    target: int
    motion: Array
    information: Array


@dataclass(frozen=True, eq=False)
class G2oGraph:
    """A planar pose graph.

    ids : (N,) vertices in file order.
    poses : (N, 3) [x, y, yaw] of each, as solved when the file was written.
    edges : all constraints in file order.
    stamps : (N,) seconds of each vertex's scan, NaN for a vertex without one.
    """

    ids: NDArray[np.int64]
    poses: Array
    edges: list[G2oEdge]
    stamps: Array = field(default_factory=lambda: np.zeros(0))

    @property
    def unstamped(self) -> bool:
        """Whether all scans have the same stamp, so that it says nothing."""
        known = self.stamps[np.isfinite(self.stamps)]
        return len(known) > 1 and bool((known == known[0]).all())

    def chain(self) -> tuple[Array, int]:
        """Poses (N, 3) by the sequential constraints alone, from the first vertex's pose on.

        Also returned is the number of vertices that no constraint ties to the one before them; there the
        solved poses give the motion.
        """
        ranks = {int(vertex): rank for rank, vertex in enumerate(self.ids)}
        sequential: dict[int, G2oEdge] = {}
        for edge in self.edges:
            first, second = ranks.get(edge.source, -9), ranks.get(edge.target, -9)
            if abs(first - second) == 1:
                sequential.setdefault(max(first, second), edge)
        poses: list[Array] = []
        gaps = 0
        for rank, solved in enumerate(self.poses):
            if not rank:
                poses.append(solved)
                continue
            tie = sequential.get(rank)
            if tie is None:
                gaps += 1
                motion = between(self.poses[rank - 1], solved)
            else:
                motion = tie.motion if tie.target == self.ids[rank] else inverse(tie.motion)
            poses.append(compound(poses[-1], motion))
        return np.array(poses, dtype=np.float64).reshape(-1, 3), gaps


class G2oLog(Log):
    """A g2o file with ROBOTLASER1 lines as a stream of ScanRecord.

    Every scan carries `odometry`, the chain of sequential constraints, so its drift is theirs, and `pose`,
    the solved pose of its vertex. `graph` has all constraints.

    path : the file (.g2o, plain or compressed, or a zip archive holding one).
    topics : hand out only these (`scan`); None for all.
    max_range : metres from which a reading is a no-return, instead of what the lines say.
    member : name inside a zip archive.
    """

    format = "g2o"

    def __init__(
        self,
        path: Path,
        topics: Iterable[str] | None = None,
        max_range: float | None = None,
        member: str | None = None,
        unpacked_limit: int = UNPACKED_LIMIT,
    ) -> None:
        super().__init__(path, topics)
        self._source = TextSource(path, member, unpacked_limit)
        self._max_range = max_range

    @property
    def progress(self) -> float:
        return self._source.progress

    @cached_property
    def graph(self) -> G2oGraph:
        """Vertices and constraints; lines that cannot be read are left out, and counted when iterating."""
        graph = _read_graph(self._source, Summary())
        return replace(graph, stamps=_paced(graph)) if graph.unstamped else graph

    def _records(self) -> Iterator[Record]:
        graph = self.graph
        if not len(graph.ids):
            raise NothingRecognisedError(self.path, "no VERTEX_SE2 line; only planar graphs can be read")
        odometry, gaps = graph.chain()
        if gaps:
            reason = "vertex not tied to the one before it: solved poses give its odometry"
            self.summary.note(reason, "the edges", gaps)
        if np.array_equal(graph.stamps, _paced(graph), equal_nan=True):
            self.summary.note(
                f"no stamps in the file: {SYNTHETIC_RATE:g} scans per second assumed", "its lasers"
            )
        rank, free, lasers = -1, False, 0
        for number, fields in _fields(self._source, self.summary):
            try:
                if fields[0] == b"ROBOTLASER1":
                    record = self._scan(fields, graph, odometry, rank if free else None)
                    free = False
                    lasers += 1
                    if self.wants(record.topic):
                        self._place = f"line {number}"
                        yield record
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
            problem = "a graph without laser scans (ROBOTLASER1 lines); read_g2o reads the graph alone"
            raise NothingRecognisedError(self.path, problem)

    def _scan(self, fields: list[bytes], graph: G2oGraph, odometry: Array, rank: int | None) -> ScanRecord:
        if rank is None:
            raise BadLineError("ROBOTLASER1 without a vertex of its own before it")
        stamp = float(graph.stamps[rank])
        line = parse_robotlaser(fields, self._max_range, stamp)
        mount = between(line.robot, line.laser)
        return ScanRecord(
            line.scan, stamp, odometry=odometry[rank], pose=graph.poses[rank], sensor_pose=mount
        )


def read_g2o(path: Path | str) -> G2oGraph:
    """Read vertices and edges of a planar graph; scans are what open_log gives.

    Raises LogError: the file cannot be read, or has no VERTEX_SE2 line.
    """
    from whereabouts.logs.opening import detect

    source = Path(path)
    _, member = detect(source)
    graph = _read_graph(TextSource(source, member), Summary())
    if not len(graph.ids):
        raise NothingRecognisedError(source, "no VERTEX_SE2 line; only planar graphs can be read")
    return graph


def write_g2o(path: Path | str, graph: G2oGraph) -> None:
    """Write vertices and edges; the file appears whole or not at all.

    Raises WriteError: the directory is missing or not writable.
    """
    with atomic_path(Path(path)) as temporary, temporary.open("w", encoding="ascii", newline="\n") as file:
        for vertex, pose in zip(graph.ids, graph.poses, strict=True):
            file.write(f"VERTEX_SE2 {vertex} {_text(pose)}\n")
        for edge in graph.edges:
            triangle = edge.information[UPPER_TRIANGLE]
            file.write(f"EDGE_SE2 {edge.source} {edge.target} {_text(edge.motion)} {_text(triangle)}\n")


def _text(values: Array) -> str:
    return " ".join(repr(float(value)) for value in values)


def _fields(source: TextSource, summary: Summary) -> Iterator[tuple[int, list[bytes]]]:
    for number, line in source.lines(summary):
        fields = line.split()
        if fields and not fields[0].startswith(b"#"):
            yield number, fields


def _read_graph(source: TextSource, summary: Summary) -> G2oGraph:
    ids: list[int] = []
    poses: list[list[float]] = []
    edges: list[G2oEdge] = []
    stamps: list[float] = []
    for number, fields in _fields(source, summary):
        try:
            if fields[0] == b"VERTEX_SE2":
                vertex, pose = _vertex(fields)
                ids.append(vertex)
                poses.append(pose)
                stamps.append(np.nan)
            elif fields[0] == b"EDGE_SE2":
                edges.append(_edge(fields))
            elif fields[0] == b"ROBOTLASER1" and stamps and len(fields) > 3:
                stamps[-1] = numbers(fields[-3:-2], "a stamp")[0]
        except BadLineError as error:
            summary.skip(str(error), f"line {number}")
    array = np.array(poses, dtype=np.float64).reshape(-1, 3)
    return G2oGraph(np.array(ids, dtype=np.int64), array, edges, np.array(stamps, dtype=np.float64))


def _paced(graph: G2oGraph) -> Array:
    """Stamps at an even pace for the vertices that have a scan."""
    stamps = np.full(len(graph.ids), np.nan)
    seen = np.isfinite(graph.stamps)
    stamps[seen] = np.arange(np.count_nonzero(seen)) / SYNTHETIC_RATE
    return stamps


def _id(text: bytes) -> int:
    if not text.isdigit() or len(text) > 18:
        raise BadLineError("id of a vertex is not a number")
    return int(text)


def _vertex(fields: list[bytes]) -> tuple[int, list[float]]:
    """`VERTEX_SE2 id x y yaw`."""
    if len(fields) != 5:
        raise BadLineError("VERTEX_SE2: five fields expected")
    return _id(fields[1]), numbers(fields[2:], "VERTEX_SE2: a field")


def _edge(fields: list[bytes]) -> G2oEdge:
    """`EDGE_SE2 from to x y yaw` and the upper triangle of the information matrix, row by row."""
    if len(fields) != 12:
        raise BadLineError("EDGE_SE2: twelve fields expected")
    values = numbers(fields[3:], "EDGE_SE2: a field")
    information = np.zeros((3, 3))
    information[UPPER_TRIANGLE] = values[3:]
    information = information + np.triu(information, 1).T
    return G2oEdge(_id(fields[1]), _id(fields[2]), np.array(values[:3]), information)
