"""Times of choosing what to look at and where to search, beside looking ahead for every action there is.

`python bench/bench_maintenance_search.py` prints the table and writes it to `bench/bench_maintenance_search.txt`.
Worlds are made here. Times are the least of several rounds on one core. Nothing here is a test.
"""

from __future__ import annotations

import os
import platform
import sys
from collections.abc import Callable
from pathlib import Path
from timeit import repeat
from unittest import mock

# Before numpy starts its threads: one core is what is measured.
os.environ.setdefault("OMP_NUM_THREADS", "1")
os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
sys.path.insert(0, str(Path(__file__).resolve().parents[1]))

import numpy as np

from world_model import (
    Maintenance,
    MaintenanceConfig,
    ObjectSearch,
    Relations,
    SearchConfig,
    Sensor,
    WorldObject,
    WorldState,
)

SENSORS = [
    Sensor("camera", 0.4, 2.0, 0.01 * np.eye(3)),
    Sensor("depth", 0.5, 4.0, 0.02 * np.eye(3)),
    Sensor("laser", 0.1, 8.0, 0.05 * np.eye(3)),
]


def least(function: Callable[[], object], rounds: int = 9) -> float:
    """Least milliseconds of several calls."""
    function()
    return 1e3 * min(repeat(function, number=1, repeat=rounds))


def world(count: int) -> WorldState:
    """Objects spread over a floor of one per square metre."""
    rng = np.random.default_rng(0)
    side = np.sqrt(count)
    objects = tuple(
        WorldObject(
            f"thing-{k}", np.array([*rng.uniform(0.0, side, 2), 0.7]), np.zeros(3),
            rng.uniform(0.01, 0.5) * np.eye(3), {"class": {"thing": 1.0}}, 1.0, False, 0.0,
            process_noise=rng.uniform(0.0, 0.01) * np.eye(3),
        )
        for k in range(count)
    )  # fmt: skip
    return WorldState(objects, 1.0, float(count), 0.0)


def next_task(count: int) -> Callable[[], object]:
    state, pose = world(count), np.array([0.5 * np.sqrt(count)] * 2 + [0.0])
    config = MaintenanceConfig(information_gain_threshold=5.0)
    return lambda: Maintenance(config).next_task(state, pose, SENSORS)


def next_goal(classes: int, method: str) -> Callable[[], object]:
    """The first goal of a search, straight after something was learned: nothing is kept from an earlier one."""
    rng = np.random.default_rng(1)
    names = [f"class {k}" for k in range(classes)]
    frames = [list(rng.choice(names, 12, replace=False)) for _ in range(5000)]
    relations = Relations.from_frames(frames)
    observed = {name: rng.uniform(0.0, 10.0, 2) for name in names[1:61]}
    config = SearchConfig(method=method)

    def first() -> object:
        relations.observe(frames[0])
        return ObjectSearch(relations, config).next_goal(observed, "class 0", [0.0, 0.0, 0.0])

    return first


def main() -> None:
    """Measure and write."""
    lines = [f"{platform.machine()}, Python {platform.python_version()}, one core, least of 9 rounds, ms", ""]
    for count in (10, 100, 1000):
        ours = least(next_task(count))
        with mock.patch("world_model.tasks.maintenance_options.EXACT", 10**9):
            every = least(next_task(count), 3)
        lines.append(
            f"next task, {count} objects, 3 sensors: {ours:8.2f}   every action looked ahead: {every:8.2f}"
            f"   x {every / ours:.1f}"
        )
    for classes in (50, 500):
        for method in ("belief", "chain"):
            first = least(next_goal(classes, method))
            lines.append(f"first goal of a search, {classes} classes, 60 in view, {method}: {first:8.2f}")
    text = "\n".join(lines)
    print(text)
    Path(__file__).with_suffix(".txt").write_text(text + "\n", encoding="utf-8")


if __name__ == "__main__":
    main()
