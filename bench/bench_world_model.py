"""Time and memory of the world model against objects, hypotheses and run length.

`python bench/bench_world_model.py` prints the table and writes it to `bench/bench_world_model.txt`. Times are processor
time per update, without the first 20; memory is that of the leaves in use. Nothing here is a test.
"""

from __future__ import annotations

import os
import platform
import resource
import sys
from dataclasses import replace
from pathlib import Path
from time import process_time

# Before numpy starts its threads: one core is what is measured.
os.environ.setdefault("OMP_NUM_THREADS", "1")
os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
sys.path.insert(0, str(Path(__file__).resolve().parents[1]))

import numpy as np

from evaluation.anchoring.anchoring_scenes import ALL_ROUND, FLOOR, HALL, HARD, ROOM, known, turning
from whereabouts.simulation.objects import ObjectScene, scattered
from world_model import WorldModel, WorldModelConfig


def measure(scene: ObjectScene, config: WorldModelConfig, looks: int) -> tuple[float, float, int, float]:
    """Mean and 99th percentile of an update, ms; leaves at the end; MB of the process at most."""
    model = WorldModel(config)
    times = []
    for seen in scene.looks(looks):
        begin = process_time()
        model.update(seen.evidence, seen.stamp)
        times.append(1e3 * (process_time() - begin))
    late = times[20:]
    memory = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024.0
    return float(np.mean(late)), float(np.percentile(late, 99)), int(model.health["leaves"]), memory


def room(count: int, **detector: float) -> ObjectScene:
    return ObjectScene(scattered(count, np.random.default_rng(0), ROOM), ROOM, sensor=ALL_ROUND, **detector)


def main() -> None:
    lines = [
        f"{platform.processor() or platform.machine()}, Python {platform.python_version()}, one core",
        "",
    ]
    lines.append(f"{'':46}{'mean ms':>9}{'p99 ms':>9}{'leaves':>9}{'MB':>7}")

    def row(name: str, scene: ObjectScene, config: WorldModelConfig | None = None, looks: int = 600) -> None:
        mean, worst, leaves, memory = measure(scene, config or known(scene), looks)
        lines.append(f"{name:46}{mean:9.2f}{worst:9.2f}{leaves:9d}{memory:7.0f}")
        print(lines[-1], flush=True)

    print("\n".join(lines))
    row("warm-up", room(5), looks=60)
    for count in (10, 20, 30, 100):
        row(f"{count} objects in view", room(count))
    row("100 objects, 20 in view", turning(100, 20, HALL, 5.0, 0))
    row("1,000 objects, 20 in view", turning(1000, 20, FLOOR, 20.0, 0))
    for count in (10, 20, 30):
        row(f"{count} objects, p_D 0.6, 3 false", room(count, **HARD))
    hard = room(20, **HARD)
    for kept in (1, 10, 100, 300):
        row(f"20 objects, p_D 0.6, 3 false, {kept} hypotheses", hard, replace(known(hard), hypotheses=kept))
    for looks in (1000, 5000, 20000):
        row(f"20 objects, {looks} updates", room(20), looks=looks)
    Path(__file__).with_suffix(".txt").write_text("\n".join(lines) + "\n", encoding="utf-8")


if __name__ == "__main__":
    main()
