"""Measurements converted through uncertain transformations, and the switching filter (chapter 6)."""

from estimation.conversion.polar import (
    METHODS,
    Method,
    absolute_bias,
    bias_significance,
    condition_ratio,
    convert,
    convert_samples,
    mardia_statistics,
    mardia_test,
    rotate_local,
)

__all__ = [
    "METHODS",
    "Method",
    "absolute_bias",
    "bias_significance",
    "condition_ratio",
    "convert",
    "convert_samples",
    "mardia_statistics",
    "mardia_test",
    "rotate_local",
]
