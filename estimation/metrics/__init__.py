"""How good an estimate is: RMSE, NEES, relative and absolute trajectory error, relations, OSPA and GOSPA."""

from estimation.metrics import statistics
from estimation.metrics.relative_pose import PoseErrors, relative_pose_error
from estimation.metrics.statistics import *  # noqa: F403

__all__ = [*statistics.__all__, "PoseErrors", "relative_pose_error"]
