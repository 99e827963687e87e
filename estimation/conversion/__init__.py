"""Measurements converted through uncertain transformations, and the switching filter (chapter 6)."""

from estimation.conversion.polar import *  # noqa: F403
from estimation.conversion.polar import __all__ as __all__
