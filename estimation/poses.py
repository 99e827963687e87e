"""The name by which users import `estimation.geometry.poses`."""

from estimation.geometry.poses import *  # noqa: F403
from estimation.geometry.poses import __all__ as __all__
