"""Wheels that fail: they stall, catch up, jump or slip, where good ones reported a drive."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from estimation.geometry.poses import between, compound
from whereabouts.logs import ScanRecord

Array = NDArray[np.float64]
FAULTS = ("good", "stall", "stall and catch up", "jump", "slip")
STALLS, STALLED = 10, 5  # how often on a floor, and for how many scans
JUMPS, FARTHEST, WIDEST = 5, 1.0, np.deg2rad(60.0)  # metres and radians
SLIPS, SLIPPED, SLIPPING = 10, 10, 2.0  # times, scans, and how many times too far


def with_faults(records: list[ScanRecord], fault: str, rng: np.random.Generator) -> list[ScanRecord]:
    """The same scans, with the odometry of wheels with one of FAULTS."""
    poses = np.array([record.odometry for record in records])
    steps = [between(poses[k], poses[k + 1]) for k in range(len(poses) - 1)]
    made = [np.zeros(3)]
    for step in _failed(steps, fault, rng):
        made.append(compound(made[-1], step))
    return [replace(record, odometry=pose) for record, pose in zip(records, made, strict=True)]


def _failed(steps: list[Array], fault: str, rng: np.random.Generator) -> list[Array]:
    failed = [step.copy() for step in steps]
    if fault in ("stall", "stall and catch up"):
        for start in _starts(rng, len(steps), STALLS, STALLED + 1):
            lost = np.zeros(3)
            for k in range(start, start + STALLED):
                lost = compound(lost, failed[k])
                failed[k] = np.zeros(3)
            if fault != "stall":
                failed[start + STALLED] = compound(lost, failed[start + STALLED])
    elif fault == "jump":
        for k in _starts(rng, len(steps), JUMPS, 1):
            away, course = rng.uniform(0.2, FARTHEST), rng.uniform(-np.pi, np.pi)
            turn = rng.uniform(-WIDEST, WIDEST)
            failed[k] = compound(failed[k], np.array([away * np.cos(course), away * np.sin(course), turn]))
    elif fault == "slip":
        for start in _starts(rng, len(steps), SLIPS, SLIPPED):
            for k in range(start, start + SLIPPED):
                failed[k] = SLIPPING * failed[k]
    return failed


def _starts(rng: np.random.Generator, length: int, count: int, lasting: int) -> list[int]:
    """Where faults begin, one in each of `count` equal parts of the way."""
    part = length // count
    return [k * part + int(rng.integers(0, part - lasting)) for k in range(count)]
