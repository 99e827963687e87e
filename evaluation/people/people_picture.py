"""People tracked through a recording of a scanner that stands still: who was hidden and found again, and a picture."""

from __future__ import annotations

from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
from matplotlib.figure import Figure
from numpy.typing import NDArray

from evaluation.drawing import saved
from tracking.people.people_tracker import PeopleTracker
from whereabouts.logs import open_log

Array = NDArray[np.float64]
HIDDEN = 0.2  # seconds
LEAST = 2.0  # seconds a label must last to be drawn
SHOWN = (40.0, 58.0)  # seconds that are drawn


@dataclass
class RecordedTracks:
    """paths : by label, rows (t, x, y, occluded). surroundings (N, 2) : returns of some scans, m. survived : how often
    somebody was hidden for at least `HIDDEN` and found again; longest : of these times, s."""

    paths: dict[int, list[tuple[float, float, float, bool]]] = field(default_factory=dict)
    surroundings: Array = field(default_factory=lambda: np.zeros((0, 2)))
    survived: int = 0
    longest: float = 0.0

    @property
    def labels(self) -> int:
        """How many labels were given."""
        return len(self.paths)


def hidden_episodes(path: Path, tracker: PeopleTracker) -> RecordedTracks:
    """Tracks of a recording whose scanner stands still."""
    tracks = RecordedTracks()
    scans = []
    with open_log(path) as log:
        for record in log.scans():
            scans.append(record.scan)
            for person in tracker.step(record.scan, np.zeros(3), record.stamp):
                row = (record.stamp, float(person.mean[0]), float(person.mean[1]), person.occluded)
                tracks.paths.setdefault(person.label, []).append(row)
    for rows in tracks.paths.values():
        gone: float | None = None
        for stamp, _, _, occluded in rows:
            if occluded:
                gone = stamp if gone is None else gone
            elif gone is not None:
                if stamp - gone >= HIDDEN:
                    tracks.survived += 1
                    tracks.longest = max(tracks.longest, stamp - gone)
                gone = None
    tracks.surroundings = np.concatenate([scan.points() for scan in scans[:: max(1, len(scans) // 15)]])
    return tracks


def picture(tracks: RecordedTracks, path: Path) -> Path:
    """Paths of `SHOWN` by label over the returns of some scans; dotted where hidden, a dot at the end."""
    figure = Figure(figsize=(7.5, 5.5), layout="constrained")
    axes = figure.subplots()
    axes.plot(*tracks.surroundings.T, ".", color="0.75", markersize=1.5, zorder=0)
    start = min((rows[0][0] for rows in tracks.paths.values()), default=0.0)
    for label, every in sorted(tracks.paths.items()):
        rows = [row for row in every if SHOWN[0] <= row[0] - start <= SHOWN[1]]
        if not rows or rows[-1][0] - rows[0][0] < LEAST:
            continue
        line = np.array([row[:3] for row in rows])
        occluded = np.array([row[3] for row in rows])
        (drawn,) = axes.plot(
            np.where(occluded, np.nan, line[:, 1]), np.where(occluded, np.nan, line[:, 2]), lw=1.4
        )
        colour = drawn.get_color()
        axes.plot(
            np.where(occluded, line[:, 1], np.nan),
            np.where(occluded, line[:, 2], np.nan),
            ":",
            color=colour,
            lw=1.0,
        )
        axes.plot(*line[-1, 1:], "o", color=colour, markersize=5)
        axes.annotate(
            str(label), (line[-1, 1], line[-1, 2]), textcoords="offset points", xytext=(5, 4), color=colour
        )
    axes.plot(0.0, 0.0, "k^", markersize=9)
    axes.set_xlim(-0.3, 5.7)
    axes.set_aspect("equal")
    axes.set_xlabel("x, m")
    axes.set_ylabel("y, m")
    return saved(figure, path, 110)
