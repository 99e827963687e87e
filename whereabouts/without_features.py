"""What stands in for kiss_matcher where it is not installed: it finds no features.

The libraries import kiss_matcher where a cloud is to be placed without a guess. It is optional: the
extra `[clouds]` brings it, and no wheels exist from Python 3.13 on. With the stand-in such a cloud is not placed, which
both callers know how to report; what has a guess, as odometry and most closures, does not need it.
"""

from __future__ import annotations

import importlib.util
import sys
from types import ModuleType, SimpleNamespace
from typing import Any

import numpy as np

NAME = "kiss_matcher"


class _NoMatcher:
    """The part of `kiss_matcher.KISSMatcher` that is used, with nothing found."""

    def __init__(self, config: Any) -> None:
        pass

    def estimate(self, source: Any, target: Any) -> SimpleNamespace:
        """No motion, of no worth."""
        return SimpleNamespace(rotation=np.eye(3), translation=np.zeros(3))

    def get_num_final_inliers(self) -> int:
        """None at all."""
        return 0


def stand_in() -> bool:
    """Put it in place where the library is missing; whether it was."""
    if NAME in sys.modules or importlib.util.find_spec(NAME) is not None:
        return False
    module: Any = ModuleType(NAME)
    module.KISSMatcher = _NoMatcher
    module.KISSMatcherConfig = lambda **settings: None
    sys.modules[NAME] = module
    return True
