"""Makes `bags/home.mcap`: evidence of a morning in the example home, for `whereabouts world` and the README.

`python bags/home.py`. A robot's camera turns in the middle of the home and detects, in nine of ten looks, what is in
view within 6 m. A red cup stands on the kitchen table until nine o'clock and is then carried to the desk.
"""

from __future__ import annotations

import math
import sys
from datetime import UTC, datetime
from pathlib import Path

sys.path.insert(0, str(Path(__file__).resolve().parents[1]))

import numpy as np

from whereabouts.simulation.world_bag import EvidenceWriter
from world_model import ObjectEvidence, WorldEvidence

NINE = datetime(2026, 5, 4, 9, 0, tzinfo=UTC).timestamp()
BEFORE, AFTER, RATE = 120.0, 180.0, 5.0
CAMERA = np.array([3.7, 4.2, 1.3])
RANGE, ANGLE, SIGMA, DETECTED = 6.5, 1.2, 0.03, 0.9
THINGS = [
    ("bowl", "green", (0.3, 2.0, 1.0)),
    ("book", "blue", (8.0, 2.0, 0.5)),
    ("cup", "white", (2.4, 1.5, 0.8)),
    ("shoe", "black", (1.0, 4.0, 0.05)),
]
CUP_BEFORE, CUP_AFTER = (1.8, 1.7, 0.8), (1.0, 8.0, 0.8)
CLASSES = ("bowl", "book", "cup", "shoe")
COLORS = ("green", "blue", "white", "black", "red")


def main() -> None:
    rng = np.random.default_rng(9)
    target = Path(__file__).with_name("home.mcap")
    with EvidenceWriter(target) as writer:
        for k in range(round((BEFORE + AFTER) * RATE)):
            since = k / RATE - BEFORE
            yaw = math.remainder(0.5 * since, 2.0 * math.pi)
            # Nobody sees it being carried.
            cup = CUP_BEFORE if since < 0.0 else CUP_AFTER if since > 20.0 else None
            things = [*THINGS, *([] if cup is None else [("cup", "red", cup)])]
            found = [
                seen(rng, *thing) for thing in things if visible(thing[2], yaw) and rng.random() < DETECTED
            ]
            sensor = {"pose": (*CAMERA.tolist(), yaw), "range": RANGE, "angle": ANGLE}
            writer.write(WorldEvidence(found, sensor), NINE + since)
    print(f"wrote {target}")


def visible(position: tuple[float, ...], yaw: float) -> bool:
    """Whether a position is in the camera's field of view; walls are of glass in this home."""
    x, y, z = np.array(position) - CAMERA
    turn = math.remainder(math.atan2(y, x) - yaw, 2.0 * math.pi)
    return math.hypot(x, y, z) < RANGE and abs(turn) < 0.5 * ANGLE


def seen(rng: np.random.Generator, kind: str, color: str, position: tuple[float, ...]) -> ObjectEvidence:
    """A detection: position with noise, class and colour as uncertain as usual."""
    attributes = {"class": over(CLASSES, kind, 0.85), "color": over(COLORS, color, 0.8)}
    return ObjectEvidence(rng.normal(position, SIGMA), SIGMA**2 * np.eye(3), attributes)


def over(names: tuple[str, ...], name: str, sure: float) -> dict[str, float]:
    """A detector's distribution."""
    return {other: sure if other == name else (1.0 - sure) / (len(names) - 1) for other in names}


if __name__ == "__main__":
    main()
