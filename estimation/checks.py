"""Argument checks shared by the library: an `InputError` names the argument and says what is allowed."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from estimation.errors import InputError

FloatArray = npt.NDArray[np.float64]


def as_floats(name: str, value: npt.ArrayLike) -> FloatArray:
    """`value` as a float64 array; InputError where it is not numeric."""
    try:
        return np.asarray(value, dtype=np.float64)
    except (TypeError, ValueError) as error:
        raise InputError(f"{name} must be an array of numbers, not {type(value).__name__}") from error


def require_finite(name: str, value: FloatArray) -> FloatArray:
    """`value` unchanged; InputError where it holds NaN or infinity."""
    if not np.isfinite(value).all():
        raise InputError(f"{name} must be finite; it holds NaN or infinity")
    return value


def as_finite(name: str, value: npt.ArrayLike) -> FloatArray:
    """`value` as a finite float64 array."""
    return require_finite(name, as_floats(name, value))


def as_vectors(name: str, value: npt.ArrayLike, *sizes: int) -> FloatArray:
    """Finite array (..., d) with d one of `sizes` (any where none is given)."""
    array = as_finite(name, value)
    if array.ndim == 0 or (sizes and array.shape[-1] not in sizes):
        allowed = " or ".join(f"(..., {size})" for size in sizes) or "(..., d)"
        raise InputError(f"{name} must have shape {allowed}, not {array.shape}")
    return array


def as_points(name: str, value: npt.ArrayLike, *sizes: int) -> FloatArray:
    """Finite array (N, d) with d one of `sizes` (any where none is given); N may be zero."""
    array = as_finite(name, value)
    if array.ndim != 2 or (sizes and array.shape[1] not in sizes):
        allowed = " or ".join(f"(N, {size})" for size in sizes) or "(N, d)"
        raise InputError(f"{name} must have shape {allowed}, not {array.shape}")
    return array


def as_square(name: str, value: npt.ArrayLike, *sizes: int) -> FloatArray:
    """Finite array (..., d, d) with d one of `sizes` (any where none is given)."""
    array = as_finite(name, value)
    if array.ndim < 2 or array.shape[-1] != array.shape[-2] or (sizes and array.shape[-1] not in sizes):
        allowed = " or ".join(f"(..., {size}, {size})" for size in sizes) or "(..., d, d)"
        raise InputError(f"{name} must have shape {allowed}, not {array.shape}")
    return array


def require_positive(name: str, value: float) -> float:
    """`value` as a float; InputError unless it is finite and above zero."""
    number = float(value)
    if not 0.0 < number < np.inf:
        raise InputError(f"{name} must be a finite number above 0, not {value!r}")
    return number


def require_count(name: str, value: int, minimum: int = 1) -> int:
    """`value` as an int; InputError where it is below `minimum` or not whole."""
    if int(value) != value or value < minimum:
        raise InputError(f"{name} must be a whole number of at least {minimum}, not {value!r}")
    return int(value)


def as_shape(name: str, value: npt.ArrayLike, shape: tuple[int, ...]) -> FloatArray:
    """`value` as a contiguous float64 array of exactly this shape; its contents are not checked."""
    array = np.ascontiguousarray(as_floats(name, value))
    if array.shape != shape:
        raise InputError(f"{name} must have shape {shape}, not {array.shape}")
    return array
