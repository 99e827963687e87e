"""The name by which users import `loop_closure.places.pairs`."""

from loop_closure.places.pairs import (
    IntArray,
    PairRule,
    Pairs,
    compare_pairs,
    path_lengths,
    sample_pairs,
)

__all__ = [
    "IntArray",
    "PairRule",
    "Pairs",
    "compare_pairs",
    "path_lengths",
    "sample_pairs",
]
