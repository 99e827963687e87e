"""The name by which users import `estimation.filters.assignment`."""

from estimation.filters.assignment import DEAREST, IntArray, cheapest, k_best

__all__ = ["DEAREST", "IntArray", "cheapest", "k_best"]
