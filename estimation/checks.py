"""Argument checks shared by the library: an `InputError` names the argument and says what is allowed."""

from __future__ import annotations

import math
from numbers import Real

import numpy as np
import numpy.typing as npt

from estimation.errors import InputError

FloatArray = npt.NDArray[np.float64]
# Asymmetry this small beside the largest number of a covariance is rounding, that of single precision included.
ASYMMETRY = 1e-6
LATEST = 1e10  # s


def as_floats(name: str, value: npt.ArrayLike) -> FloatArray:
    """`value` as a float64 array, NaN where it is masked; InputError where it is not numeric.

    Words, dates and complex numbers are none, though numpy would make some of them floats.
    """
    if type(value) is np.ndarray and value.dtype == np.float64:
        return value
    try:
        given = np.asanyarray(value)
        words = given.dtype.kind == "O" and any(isinstance(item, (str, bytes)) for item in given.flat)
        if given.dtype.kind in "biufO" and not words:
            plain = given.astype(np.float64, copy=False)
            return np.asarray(plain.filled(np.nan) if isinstance(plain, np.ma.MaskedArray) else plain)
    except (TypeError, ValueError, OverflowError):
        pass
    raise InputError(f"{name} must be an array of numbers, not {_kind(value)}")


def _kind(value: object) -> str:
    """What something that is no array of numbers is."""
    dtype = getattr(value, "dtype", None)
    return type(value).__name__ if dtype is None else f"one of {dtype}"


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


def as_number(name: str, value: float) -> float:
    """`value` as a float; InputError unless it is one finite number. True, "1" and arrays of several are none."""
    scalar = value[()] if isinstance(value, np.ndarray) and value.ndim == 0 else value
    if isinstance(scalar, Real) and not isinstance(scalar, bool):
        try:
            number = float(scalar)
        except OverflowError:
            number = math.inf
        if math.isfinite(number):
            return number
    raise InputError(f"{name} must be a finite number, not {value!r}")


def require_within(name: str, value: float, low: float, high: float) -> float:
    """`value` as a float; InputError unless it is a finite number from `low` to `high`, both included."""
    number = as_number(name, value)
    if not low <= number <= high:
        raise InputError(f"{name} must be {low:g} to {high:g}, not {value!r}")
    return number


def as_stamp(name: str, value: float) -> float:
    """`value` as seconds; InputError where it is beyond the year 2286, as milliseconds taken for seconds are."""
    return require_within(name, value, -LATEST, LATEST)


def require_positive(name: str, value: float) -> float:
    """`value` as a float; InputError unless it is finite and above zero."""
    number = as_number(name, value)
    if not number > 0.0:
        raise InputError(f"{name} must be a finite number above 0, not {value!r}")
    return number


def require_count(name: str, value: int, minimum: int = 1) -> int:
    """`value` as an int; InputError where it is below `minimum` or not whole."""
    number = as_number(name, value)
    if not number.is_integer() or number < minimum:
        raise InputError(f"{name} must be a whole number of at least {minimum}, not {value!r}")
    return int(value)


def require_fitting(**arrays: FloatArray) -> tuple[int, ...]:
    """The shape that arrays of these names have together; InputError where they do not broadcast."""
    shapes = [array.shape for array in arrays.values()]
    try:
        return np.broadcast_shapes(*shapes)
    except ValueError:
        found = ", ".join(map(str, shapes))
        raise InputError(f"{', '.join(arrays)} must be as many or one, not of shapes {found}") from None


def require_symmetric(name: str, value: FloatArray) -> FloatArray:
    """`value` (..., d, d) unchanged; InputError where it differs from its transpose by more than rounding."""
    largest = np.abs(value).max(axis=(-1, -2), initial=0.0)
    apart = np.abs(value - np.swapaxes(value, -1, -2)).max(axis=(-1, -2), initial=0.0)
    if (apart > ASYMMETRY * largest).any():
        raise InputError(f"{name} must be symmetric")
    return value


def require_word(name: str, value: str) -> str:
    """`value` unchanged; InputError where it is no text."""
    if not isinstance(value, str):
        raise InputError(f"{name} must be a word, not {value!r}")
    return value


def require_kind(name: str, value: object, *kinds: type) -> None:
    """InputError where `value` is of none of the kinds."""
    if not isinstance(value, kinds):
        wanted = " or ".join(kind.__name__ for kind in kinds)
        raise InputError(f"{name} must be a {wanted}, not {type(value).__name__}")


def as_own(name: str, value: npt.ArrayLike, *shapes: tuple[int, ...]) -> FloatArray:
    """A finite copy of `value`, of one of `shapes`: what is kept must not change with the caller's array."""
    array = as_floats(name, value)
    if array.shape not in shapes:
        raise InputError(f"{name} must have shape {' or '.join(map(str, shapes))}, not {array.shape}")
    return require_finite(name, array.copy())


def as_shape(name: str, value: npt.ArrayLike, shape: tuple[int, ...]) -> FloatArray:
    """`value` as a contiguous float64 array of exactly this shape; its contents are not checked."""
    array = np.ascontiguousarray(as_floats(name, value))
    if array.shape != shape:
        raise InputError(f"{name} must have shape {shape}, not {array.shape}")
    return array
