"""How good an estimate is: RMSE, NEES, relative and absolute trajectory error, relations, OSPA and GOSPA."""

from estimation.metrics.statistics import (
    GospaParts,
    PoseErrors,
    RelationErrors,
    TrajectoryErrors,
    absolute_trajectory_error,
    align_points,
    anees_bounds,
    associate,
    gospa,
    gospa_parts,
    nees,
    ospa,
    relations_error,
    relative_pose_error,
    rmse,
)

__all__ = [
    "GospaParts",
    "PoseErrors",
    "RelationErrors",
    "TrajectoryErrors",
    "absolute_trajectory_error",
    "align_points",
    "anees_bounds",
    "associate",
    "gospa",
    "gospa_parts",
    "nees",
    "ospa",
    "relations_error",
    "relative_pose_error",
    "rmse",
]
