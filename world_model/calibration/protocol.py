"""What anchoring asks of whoever knows the errors of the sensor, and the answer of who only knows the settings."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from estimation.checks import FloatArray
from world_model.anchoring.loops.look import Look
from world_model.calibration.sensor_bias import CONSTANT
from world_model.calibration.sensor_filter import error_basis
from world_model.evidence import Measurements

Symbols = tuple[str | None, ...]
Looks = list[tuple[float, Symbols]]  # Stamp, s, and object of each detection, per look


class Calibration:
    """Constant errors that a deployment states, and nothing is learned; `Corrections` learns.

    One look after the other: `corrected`, `weigh`, `learn`, `keep`.
    """

    def __init__(self, sensor_bias: Sequence[float]) -> None:
        self.stated = constant_errors(sensor_bias)

    @property
    def values(self) -> FloatArray:
        """Constant errors (8,), see `sensor_bias`."""
        return self.stated

    def reset(self) -> None:
        """Nothing is known but what the settings say."""

    def corrected(self, measured: Measurements, stamp: float) -> Measurements:
        """Detections of a look at a stamp, s, without the errors that the sensor is known to have."""
        if measured.sensor is None or not self.stated.any():
            return measured
        return without(measured, np.concatenate([self.stated, np.zeros(2)]))

    def weigh(self, raw: Measurements, look: Look) -> None:
        """Have a say in which detection is of which object, by the weights of a look of detections `raw`."""

    def learn(self, raw: Measurements, owners: list[int]) -> None:
        """Take in whose detections (M,) those of the look were, by number of track; may correct that."""

    def keep(
        self, raw: Measurements, likelihood: FloatArray, stamp: float, owners: list[int], symbols: Symbols
    ) -> None:
        """Keep a look with the likelihood (M, A) of its words, its tracks and their symbols."""

    def look_back(self) -> Looks:
        """Correct earlier conclusions; whose the detections of the looks that were kept are taken to be now."""
        return []


def constant_errors(sensor_bias: Sequence[float]) -> FloatArray:
    """All constant errors (8,) of those that are stated, or the first of them."""
    values = np.zeros(CONSTANT)
    values[: len(sensor_bias)] = sensor_bias
    return values


def without(measured: Measurements, errors: FloatArray, rate: FloatArray | None = None) -> Measurements:
    """Detections without constant errors and those that the look shares (10,); rate (3,) of the sensor."""
    assert measured.sensor is not None
    positions = measured.positions.copy()
    positions[:, :2] -= error_basis(positions, measured.sensor.pose, rate) @ errors
    return replace(measured, positions=positions)
