"""Settings of `loop_closure.slam.trajectory`."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

from estimation.settings import check_settings, setting

Proposals = Literal["both", "path", "places"]
"""What says where a loop may close; see `loop_closure.slam.trajectory.Slam`."""


@dataclass(frozen=True)
class SlamConfig:
    """Settings of `Slam`; each field's metadata has its unit, meaning and allowed range."""

    key_distance: float = setting(0.5, "m", "travel after which a scan becomes a keyframe", 0.05, 20.0)
    key_turn: float = setting(0.5, "rad", "turn after which a scan becomes a keyframe", 0.05, 3.2)
    max_range: float = setting(25.0, "m", "points farther away are not used", 1.0, 500.0)
    loop_path: float = setting(10.0, "m", "shortest path between a place and its revisit", 5.0, 1000.0)
    odometry_drift: float = setting(
        0.02, "m/m", "standard deviation of odometry per metre of travel", 0.0001, 1.0
    )
    odometry_turn_drift: float = setting(
        0.003, "rad", "standard deviation of the heading per keyframe", 0.0001, 1.0
    )
    certain: float = setting(
        0.4,
        "m",
        "a single closure is enough while the standard deviation of the position is below this",
        0.05,
        5.0,
    )
    farthest: float = setting(
        25.0,
        "m",
        "no closures are searched while the standard deviation of the position is above this",
        1.0,
        1000.0,
    )

    def __post_init__(self) -> None:
        check_settings(self)
