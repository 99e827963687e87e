"""How good an estimate is: RMSE, NEES, trajectory error, relations, OSPA and GOSPA."""

from estimation.metrics.statistics import *  # noqa: F403
from estimation.metrics.statistics import __all__ as __all__
