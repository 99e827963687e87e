"""What remembering costs: time per message, size, restart and questions of the world model's store.

`python bench/bench_store.py` prints the table and writes it to `bench/bench_store.txt`. Scenes are simulated: objects
in a room, 20 looks a second, class and colour distributions; of more than 20 objects 20 are in view. Times are of
processor time on one core, with the file in the folder for temporary files. Nothing here is a test.
"""

from __future__ import annotations

import os
import platform
import sys
import tempfile
from pathlib import Path
from time import perf_counter, process_time

# Before numpy starts its threads: one core is what is measured.
os.environ.setdefault("OMP_NUM_THREADS", "1")
os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
sys.path.insert(0, str(Path(__file__).resolve().parents[1]))

from importlib.resources import files

import numpy as np

from estimation.geometry.places import Places
from world_model import ObjectEvidence, WorldEvidence, WorldModel, WorldModelConfig
from world_model.memory.store import Store

CLASSES = ["cup", "bowl", "plate", "shoe", "chair", "table", "book", "box", "can", "key"]
COLORS = ["red", "green", "blue", "white", "black"]
VIEW = 20
LOOKS = 300
DENSITY = 0.5  # objects per m²


def main() -> None:
    lines = [f"{platform.machine()}, Python {platform.python_version()}, one core", ""]
    lines.append(
        "objects  in view  update, ms  store, ms   p99, ms  history rows  file, kB  restart, ms  queries, ms"
    )
    for objects in (10, 20, 100, 1000):
        lines.append(row(objects, min(objects, VIEW)))
        print(lines[-1], flush=True)
    lines += ["", long_run()]
    text = "\n".join(lines) + "\n"
    print(text)
    Path(__file__).with_suffix(".txt").write_text(text, encoding="utf-8")


def row(count: int, in_view: int) -> str:
    places = Places.load(str(files("world_model").joinpath("defaults/home.yaml")))
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "world.sqlite"
        side = float(np.sqrt(count / DENSITY))
        region = ((0.0, side), (0.0, side), (0.0, 2.5))
        config = WorldModelConfig(classes=CLASSES, colors=COLORS, region=region)
        model, store = WorldModel(config, places), Store(path)
        update, record = np.zeros(LOOKS), np.zeros(LOOKS)
        scene = StoreScene(count, in_view)
        # All objects have been seen once before it is measured.
        for k in range(-scene.groups * 8, LOOKS):
            evidence = scene.look(k)
            begun = process_time()
            state = model.update(evidence, 100.0 + 0.05 * k)
            between = process_time()
            store.record(state)
            if k >= 0:
                update[k], record[k] = between - begun, process_time() - between
        rows, size = store.rows, path.stat().st_size + Path(f"{path}-wal").stat().st_size
        store.close()
        begun = perf_counter()
        again = WorldModel(config, places, path)
        restart = perf_counter() - begun
        times = []
        for question in ({"class_name": "cup"}, {"region": "kitchen"}, {"class_name": "cup", "stamp": 110.0}):
            begun = perf_counter()
            again.query(**question)
            times.append(f"{1e3 * (perf_counter() - begun):.0f}")
        assert again.store is not None
        again.store.close()
    return (
        f"{count:7d} {in_view:8d} {1e3 * update.mean():11.2f} {1e3 * record.mean():10.2f} "
        f"{1e3 * np.percentile(record, 99):9.2f} {rows:13d} {size / 1e3:9.0f} {1e3 * restart:12.0f}  {', '.join(times)}"
    )


def long_run() -> str:
    """Time and size when the limit of history has long been reached."""
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "world.sqlite"
        side = float(np.sqrt(20 / DENSITY))
        region = ((-1.0, side + 1.0), (-1.0, side + 1.0), (0.0, 2.5))
        config = WorldModelConfig(classes=CLASSES, colors=COLORS, region=region)
        model, scene = WorldModel(config), StoreScene(20, 20, moving=True)
        parts = []
        with Store(path, limit=1000) as store:
            for part in range(3):
                spent = 0.0
                for k in range(part * 1000, (part + 1) * 1000):
                    state = model.update(scene.look(k), 0.05 * k)
                    begun = process_time()
                    store.record(state)
                    spent += process_time() - begun
                size = path.stat().st_size / 1e3
                parts.append(f"{(part + 1) * 1000}: {spent:.2f} ms, {store.rows} rows, {size:.0f} kB")
    return "20 moving objects, history limited to 1000 rows, after looks " + "; ".join(parts)


class StoreScene:
    """Objects spread over a square and a camera that sees all around it; `moving`: they walk in circles.

    At negative numbers the camera goes round, eight looks a stop; from zero on it stays.
    """

    def __init__(self, count: int, in_view: int, moving: bool = False) -> None:
        self._rng = np.random.default_rng(0)
        self.side = float(np.sqrt(count / DENSITY))
        self._range = float(np.sqrt(in_view / DENSITY / np.pi)) if in_view < count else self.side
        self._places = self._rng.uniform((0.0, 0.0, 0.5), (self.side, self.side, 1.5), (count, 3))
        self._kinds = self._rng.integers(0, len(CLASSES), count), self._rng.integers(0, len(COLORS), count)
        self._moving = moving
        stops = np.arange(0.5, max(self.side / self._range, 1.0)) * self._range
        self._stops = [(float(x), float(y)) for x in stops for y in stops]
        self.groups = len(self._stops)

    def look(self, number: int) -> WorldEvidence:
        x, y = self._stops[(-number // 8) % self.groups if number < 0 else self.groups // 2]
        found = [
            self._seen(index, number)
            for index in range(len(self._places))
            if np.hypot(*(self._places[index, :2] - (x, y))) < self._range and self._rng.random() < 0.95
        ]
        return WorldEvidence(found, {"pose": (x, y, 1.0, 0.0), "range": self._range, "angle": 2.0 * np.pi})

    def _seen(self, index: int, number: int) -> ObjectEvidence:
        angle = 0.01 * number + index if self._moving else 0.0
        shift = 0.3 * np.array([np.cos(angle), np.sin(angle), 0.0])
        position = self._rng.normal(self._places[index] + shift, 0.03)
        kind, color = self._kinds[0][index], self._kinds[1][index]
        return ObjectEvidence(position, None, {"class": over(CLASSES, kind), "color": over(COLORS, color)})


def over(names: list[str], chosen: int) -> dict[str, float]:
    """A detector's distribution."""
    return {name: 0.9 if i == chosen else 0.1 / (len(names) - 1) for i, name in enumerate(names)}


if __name__ == "__main__":
    main()
