"""A planar laser scan as every library here sees it: ranges at equally spaced bearings."""

from __future__ import annotations

from dataclasses import dataclass, replace
from numbers import Real

import numpy as np
from numpy.typing import NDArray

from estimation.checks import as_floats, as_number, as_stamp
from estimation.errors import InputError

# Finest and widest step between beams, radians: whatever turns bearings into indices divides by it.
FINEST, TURN = 1e-6, 2.0 * np.pi
MOST_TURNS = 2.0  # of one sweep; in degrees taken for radians it would have dozens
FARTHEST = 1e6  # metres; a reading beyond is none


@dataclass(frozen=True, eq=False)
class Scan:
    """One sweep of a planar range scanner, in the sensor frame (x forward, y left).

    Parameters
    ----------
    ranges : (N,) metres; no-returns may be NaN, ±inf, zero or anything outside [range_min, range_max).
        A reading at range_max is a no-return: scanners report their maximum when nothing answers.
    angle_min, angle_increment : bearing of the first beam and step between beams, radians.
        A negative increment is a scanner mounted upside down or turning clockwise. That of a single beam means nothing:
        where it is none it becomes a full turn.
    range_min, range_max : metres, valid readings lie in [range_min, range_max) and below FARTHEST.
    stamp : seconds, time of the first beam.
    time_increment : seconds between beams, 0 when unknown.

    Raises
    ------
    InputError : ranges not one-dimensional, a bound or angle not finite, or a step that is none.
    """

    ranges: NDArray[np.float64]
    angle_min: float
    angle_increment: float
    range_min: float = 0.0
    range_max: float = np.inf
    stamp: float = 0.0
    time_increment: float = 0.0

    def __post_init__(self) -> None:
        # A copy: drivers fill the same buffer anew.
        values = as_floats("ranges", self.ranges).copy()
        if values.ndim != 1:
            raise InputError(f"ranges: one-dimensional array expected, got shape {values.shape}")
        object.__setattr__(self, "ranges", values)
        for name in ("angle_min", "angle_increment", "range_min", "range_max", "stamp", "time_increment"):
            value = getattr(self, name)
            unbounded = name == "range_max" and isinstance(value, Real) and value == np.inf
            object.__setattr__(self, name, np.inf if unbounded else as_number(name, value))
        as_stamp("stamp", self.stamp)
        if not self.range_max > self.range_min:
            raise InputError(f"range_max: must exceed range_min = {self.range_min}, got {self.range_max}")
        if not FINEST <= abs(self.angle_increment) <= TURN:
            if len(values) > 1:
                step = f"{self.angle_increment:g}"
                raise InputError(f"angle_increment: {FINEST:g} to 2 pi expected of several beams, got {step}")
            object.__setattr__(self, "angle_increment", TURN)
        turns = abs(self.angle_increment) * (len(values) - 1) / TURN
        if turns > MOST_TURNS:
            raise InputError(
                f"angle_increment: radians expected, with these its beams go round {turns:.0f} times"
            )

    def __len__(self) -> int:
        return len(self.ranges)

    @property
    def bearings(self) -> NDArray[np.float64]:
        """Bearing of each beam, (N,) radians."""
        return self.angle_min + self.angle_increment * np.arange(len(self.ranges), dtype=np.float64)

    @property
    def valid(self) -> NDArray[np.bool_]:
        """Which beams returned, (N,); no-returns are False."""
        # What is no number compares with nothing.
        returned = self.ranges < min(self.range_max, FARTHEST)
        returned &= self.ranges >= self.range_min if self.range_min > 0.0 else self.ranges > 0.0
        return returned

    def without(self, beams: NDArray[np.bool_]) -> Scan:
        """The scan as if some beams (N,) had no reading."""
        return replace(self, ranges=np.where(beams, np.nan, self.ranges))

    def points(self) -> NDArray[np.float64]:
        """Cartesian end points of the returns, (M, 2) metres in the sensor frame, no-returns dropped."""
        valid = self.valid
        ranges, bearings = self.ranges[valid], self.bearings[valid]
        return np.column_stack((ranges * np.cos(bearings), ranges * np.sin(bearings)))
