"""Extended targets in clutter, as in Section 5 of Paper B: where they are, and the returns a sensor has of them."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

Array = npt.NDArray[np.float64]


@dataclass(frozen=True)
class TargetScene:
    """Targets over K scans, one a second.

    positions : K arrays (n, 2), m, of the targets there at each scan; identities : K arrays (n,) of their numbers.
    """

    positions: list[Array]
    identities: list[npt.NDArray[np.int64]]

    def __len__(self) -> int:
        return len(self.positions)


@dataclass(frozen=True)
class TargetSensor:
    """A detected target gives Poisson(`rate`) returns of standard deviation `noise`, m; clutter is uniform.

    `side` is half the edge of the square under surveillance, m; `clutter` the expected number of clutter returns.
    """

    rate: float = 10.0
    noise: float = 20.0
    detection_probability: float = 0.99
    clutter: float = 10.0
    side: float = 1000.0

    def returns(self, targets: Array, rng: np.random.Generator) -> Array:
        """Returns (N, 2) of targets at (n, 2), in random order."""
        counts = rng.poisson(self.rate, len(targets)) * (
            rng.random(len(targets)) < self.detection_probability
        )
        seen = np.repeat(targets, counts, axis=0)
        seen = seen + self.noise * rng.standard_normal(seen.shape)
        noise = rng.uniform(-self.side, self.side, (rng.poisson(self.clutter), 2))
        return rng.permutation(np.vstack([seen, noise]))


def joined_tracks(tracks: list[tuple[int, Array]], scans: int) -> TargetScene:
    """A scene of tracks, each (first scan, positions (T, 2)), over `scans` scans."""
    positions, identities = [], []
    for k in range(scans):
        there = [i for i, (first, path) in enumerate(tracks) if first <= k < first + len(path)]
        positions.append(np.array([tracks[i][1][k - tracks[i][0]] for i in there]).reshape(-1, 2))
        identities.append(np.array(there, dtype=np.int64))
    return TargetScene(positions, identities)


def straight(start: npt.ArrayLike, velocity: npt.ArrayLike, scans: int) -> Array:
    """Positions (scans, 2) at constant velocity, m per scan."""
    return np.asarray(start, dtype=float) + np.arange(scans)[:, None] * np.asarray(velocity, dtype=float)


def cross_and_spawn(scans: int = 100) -> TargetScene:
    """Figure 3a: two targets from the birth places cross at k = 56; at k = 66 a third splits off the first."""
    meeting = np.array([150.0, -150.0])
    starts = np.array([[250.0, 250.0], [-250.0, -250.0]])
    velocities = (meeting - starts) / 55.0
    child = starts[0] + 65 * velocities[0]
    tracks = [(0, straight(s, v, scans)) for s, v in zip(starts, velocities, strict=True)]
    return joined_tracks([*tracks, (65, straight(child, [-11.0, 3.0], scans - 65))], scans)


def side_by_side(scans: int = 100, distance: float = 50.0) -> TargetScene:
    """Two targets from the birth places come together, go `distance` m apart for a third of the time, and part."""
    k = np.arange(scans)
    ease = np.clip((k - 0.35 * scans) / (0.35 * scans), -1.0, 0.0) + np.clip(
        (k - 0.7 * scans) / (0.3 * scans), 0, 1
    )
    apart = distance / 2 + (250.0 - distance / 2) * np.abs(ease) ** 1.5
    x = np.concatenate([np.linspace(250.0, 0.0, scans // 3), np.linspace(0.0, -400.0, scans - scans // 3)])
    mirrored = np.concatenate([np.linspace(-250.0, 0.0, scans // 3), x[scans // 3 :]])
    return joined_tracks([(0, np.column_stack([x, apart])), (0, np.column_stack([mirrored, -apart]))], scans)


def crossing(
    rng: np.random.Generator,
    scans: int = 40,
    distance: float = 250.0,
    angle: tuple[float, float] = (30.0, 150.0),
) -> TargetScene:
    """Two targets whose straight paths cross at `angle` degrees (from, to), at the same time, half way."""
    heading = rng.uniform(-np.pi, np.pi)
    turn = np.deg2rad(rng.uniform(*angle))
    middle = (scans - 1) / 2
    tracks = []
    for direction in (heading, heading + turn):
        step = distance / middle * np.array([np.cos(direction), np.sin(direction)])
        tracks.append((0, straight(-middle * step, step, scans)))
    return joined_tracks(tracks, scans)
