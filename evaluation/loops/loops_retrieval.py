"""How much of what the exhaustive search finds the index of a long history finds too."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from evaluation.loops.place_training import Recording
from evaluation.report import Report, RunOptions
from loop_closure import shipped_model
from loop_closure.places.retrieval import NearestPlaces

COUNTS = (250, 500, 1000, 2000)


def retrieval(options: RunOptions, report: Report, recordings: Mapping[str, Recording]) -> None:
    """Recall of the candidates, all planar recordings being one history: of the nearest in the metric, and of revisits.

    A revisit is a place within 2 m and 45°, more than 20 m of path away; it counts as found where one of them is
    among the candidates, as one closes the loop.
    """
    model = shipped_model("best_2d")
    scans = [recording for recording in recordings.values() if recording.dimension == 2]
    if not scans or model.embedding is None:
        return
    vectors = np.concatenate(
        [model.embedding(np.array([place.signature for place in recording.places])) for recording in scans]
    )
    index = NearestPlaces(model.embedding.dimension)
    for vector in vectors:
        index.add(vector)
    rng = np.random.default_rng(options.seed)
    queries = np.sort(
        rng.choice(len(vectors), min(200 if options.quick else 1000, len(vectors)), replace=False)
    )
    known = {int(query): _revisits(scans, int(query)) for query in queries}
    rows = []
    for count in COUNTS:
        shared, found, possible = 0, 0, 0
        for query in queries.tolist():
            near = index.query(vectors[query], count)
            exact = np.argsort(np.sum((vectors - vectors[query]) ** 2, axis=1), kind="stable")[:count]
            shared += len(np.intersect1d(near, exact))
            if len(known[query]):
                possible += 1
                found += bool(len(np.intersect1d(near, known[query])))
        rows.append(
            [
                f"{count} candidates",
                100.0 * shared / (count * len(queries)),
                100.0 * found / max(possible, 1),
                possible,
            ]
        )
    report.add(
        "Candidates from a long history",
        [
            "asked for",
            "of the nearest by brute force, % ↑",
            "queries with a revisit among them, % ↑",
            "queries",
        ],
        rows,
        f"{len(vectors)} places. Beyond the text, which compares all. The metric has seen all recordings but "
        "csail.",
        "retrieval",
        data="tuned on",
        samples=len(queries),
    )


def _revisits(scans: list[Recording], query: int) -> np.ndarray:
    """Ids of the places that are the query's place again."""
    start = 0
    for recording in scans:
        if query < start + len(recording.places):
            k = query - start
            apart = np.linalg.norm(recording.poses[:, :2] - recording.poses[k, :2], axis=1)
            turn = np.abs(np.mod(recording.poses[:, 2] - recording.poses[k, 2] + np.pi, 2 * np.pi) - np.pi)
            again = (apart < 2.0) & (turn < np.pi / 4) & (np.abs(recording.path - recording.path[k]) > 20.0)
            return start + np.flatnonzero(again)
        start += len(recording.places)
    return np.zeros(0, dtype=np.int64)
