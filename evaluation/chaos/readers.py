"""Damaged files for every reader: `python -m evaluation.chaos.readers SEED SECONDS PROGRESS RESULT`.

Each reader gets what it would write or be given, with bytes changed, parts cut out, doubled or put elsewhere. It may
refuse with an error of the project's own, or read what is left. Anything else is a defect.
"""

from __future__ import annotations

import contextlib
import faulthandler
import json
import mmap
import os
import resource
import shutil
import struct
import sys
import tempfile
import time
import traceback
from collections import Counter
from collections.abc import Callable
from pathlib import Path

import numpy as np

from estimation.errors import WhereaboutsError
from estimation.geometry.grid import OccupancyGrid
from estimation.geometry.places import Places
from evaluation.chaos.worker import ROOM, resident
from loop_closure.maps.map_file import read_map, write_map
from loop_closure.slam.trajectory import Slam
from registration.laser.scan import Scan
from tracking.intentions import IntentionModel
from whereabouts.logs import McapWriter, open_log
from whereabouts.logs.formats.tum import read_tum
from whereabouts.messages.records import OdometryRecord, ScanRecord
from whereabouts.suite_config import read_config
from world_model import ObjectEvidence, Relations, WorldEvidence, WorldModel
from world_model.memory.store import Store
from world_model.symbols import Symbols

Make = Callable[[Path], object]
Read = Callable[[Path], object]
BEAMS = 181
RECORDS = 200
SUITE = "nodes:\n  scan_registration: {parameters: {segment_scans: false}}\n  world_model: {}\nnamespace: /robot1\n"
DEFAULTS = Path(__file__).resolve().parents[2] / "world_model" / "defaults"


def scan(stamp: float) -> Scan:
    """One of a plain room."""
    bearings = np.linspace(-np.pi / 2, np.pi / 2, BEAMS)
    ranges = np.minimum(
        3.0 / np.maximum(np.cos(bearings), 1e-3), 2.0 / np.maximum(np.abs(np.sin(bearings)), 1e-3)
    )
    return Scan(ranges, -np.pi / 2, np.pi / (BEAMS - 1), 0.05, 30.0, stamp)


def _carmen(path: Path) -> None:
    numbers = " ".join(f"{value:.3f}" for value in scan(0.0).ranges[:180])
    lines = [
        f"FLASER 180 {numbers} {k} 0 0 {k} 0 0 {k}.0 host {k}.0\nODOM {k} 0 0 0.5 0.1 0 {k}.0 host {k}.0\n"
        for k in range(9)
    ]
    path.write_text("".join(lines))


def _g2o(path: Path) -> None:
    lines = [f"VERTEX_SE2 {k} {k} 0 0\n" for k in range(9)]
    lines += [f"EDGE_SE2 {k} {k + 1} 1 0 0 100 0 0 100 0 100\n" for k in range(8)]
    lines += ["ROBOTLASER1 0 -1.57 3.14 0.0175 30 0.01 0 3 1 2 3 0 0 0 0 0 0 0 0 0 0 0 0 0 1.0 host 1.0\n"]
    path.write_text("".join(lines))


def _tum(path: Path) -> None:
    path.write_text("".join(f"{k}.0 {k} 0 0 0 0 0 1\n" for k in range(20)))


def _mcap(path: Path) -> None:
    with McapWriter(path) as writer:
        for k in range(9):
            writer.write_scan(ScanRecord(scan(float(k)), float(k), "scan", "laser"))
            pose = np.array([0.1 * k, 0.0, 0.0])
            writer.write_odometry(
                OdometryRecord(pose, float(k), "odom", "odom", "base_link", np.zeros(3), None, None)
            )


def _grid(path: Path) -> None:
    made = OccupancyGrid.from_values(np.random.default_rng(0).choice([-1, 0, 100], (40, 30)), 0.1)
    made.save(path.with_suffix(""))


def _image(path: Path) -> None:
    """The image of a map; what describes it stays whole."""
    _grid(path.with_suffix(".yaml"))


def _map(path: Path) -> None:
    slam = Slam()
    for k in range(6):
        slam.process(scan(float(k)), np.array([0.5 * k, 0.0, 0.0]), 1e-4 * np.eye(3), float(k))
    with path.open("wb") as file:
        write_map(slam, file)


def _store(path: Path) -> None:
    store = Store(path)
    model = WorldModel(store=store)
    for k in range(20):
        seen = ObjectEvidence(np.array([0.1, 0.2, 0.5]), 1e-3 * np.eye(3), {"class": {"cup": 1.0}})
        model.update(WorldEvidence([seen], blocked=True), float(k))
    store.close()


def _remember(path: Path) -> None:
    model = WorldModel(store=Store(path))
    if model.store is not None:
        model.store.close()


def _log(path: Path) -> None:
    with open_log(path) as log:
        for count, _ in enumerate(log):
            if count == RECORDS:
                break


def _copy(source: Path) -> Make:
    return lambda path: shutil.copyfile(source, path)


# What each reader reads, by the ending it expects; how it is made, and how read.
READERS: dict[str, tuple[str, Make, Read]] = {
    "carmen": (".clf", _carmen, _log),
    "g2o": (".g2o", _g2o, _log),
    "tum": (".txt", _tum, read_tum),
    "mcap": (".mcap", _mcap, _log),
    "map yaml": (".yaml", _grid, OccupancyGrid.load),
    "map image": (".pgm", _image, lambda path: OccupancyGrid.load(path.with_suffix(".yaml"))),
    "graph": (".npz", _map, read_map),
    "intentions": (".intentions", lambda path: IntentionModel().save(path), IntentionModel.load),
    "store": (".sqlite", _store, _remember),
    "places": (".yaml", _copy(DEFAULTS / "home.yaml"), Places.load),
    "relations": (".yaml", _copy(DEFAULTS / "relations.yaml"), Relations.load),
    "symbols": (".yaml", _copy(DEFAULTS / "predicates.yaml"), Symbols.load),
    "suite": (".yaml", lambda path: path.write_text(SUITE), lambda path: read_config(path, {})),
}


def damaged(data: bytes, rng: np.random.Generator) -> bytes:
    """With some bytes changed, left out, doubled, swapped, or the end cut off."""
    made = bytearray(data)
    for _ in range(int(rng.integers(1, 5))):
        size = max(len(made), 1)
        at, length = int(rng.integers(size)), int(rng.integers(1, 65))
        kind = int(rng.integers(7))
        if kind == 0:
            made[at : at + 1] = rng.bytes(1)
        elif kind == 1:
            made[at : at + length] = rng.bytes(length)
        elif kind == 2:
            del made[at : at + length]
        elif kind == 3:
            made[at:at] = made[at : at + length]
        elif kind == 4:
            del made[at:]
        elif kind == 5:
            made[at : at + 4] = b"\xff" * 4
        else:
            made[at : at + 1] = [b"9", b"-", b"e", b":", b"[", b"\0", b"nan", b"1e999"][int(rng.integers(8))]
    return bytes(made)


class Readers:
    """Feeds all readers in turn from a folder of its own."""

    def __init__(self, seed: int, folder: Path) -> None:
        self._rng = np.random.default_rng(seed)
        self._folder = folder
        self._originals: dict[str, dict[str, bytes]] = {}
        for name, (ending, make, _) in READERS.items():
            make(folder / f"file{ending}")
            self._originals[name] = {item.name: item.read_bytes() for item in folder.iterdir()}
            self._clear()
        self.defects: Counter[str] = Counter()
        self.done = 0
        self.read: Counter[str] = Counter()
        self.slowest = (0.0, "")

    def _clear(self) -> None:
        for item in self._folder.iterdir():
            shutil.rmtree(item) if item.is_dir() else item.unlink()

    def feed(self, name: str) -> None:
        """One damaged file for one reader."""
        ending, _, read = READERS[name]
        for item, data in self._originals[name].items():
            (self._folder / item).write_bytes(data)
        path = self._folder / f"file{ending}"
        path.write_bytes(damaged(self._originals[name][path.name], self._rng))
        begun = time.perf_counter()
        try:
            read(path)
            self.read[name] += 1
        except WhereaboutsError:
            pass
        except Exception as error:
            place = traceback.extract_tb(error.__traceback__)[-1]
            where = f"{'/'.join(Path(place.filename).parts[-3:])}:{place.name} line {place.lineno}"
            self.defects[f"{name}: {type(error).__name__} | {where}"] += 1
        self.slowest = max(self.slowest, (time.perf_counter() - begun, f"{name} #{self.done}"))
        self.done += 1
        self._clear()


def main() -> None:
    """Entry point."""
    seed, seconds, progress, result = (
        int(sys.argv[1]),
        float(sys.argv[2]),
        Path(sys.argv[3]),
        Path(sys.argv[4]),
    )
    faulthandler.enable()
    resource.setrlimit(resource.RLIMIT_AS, (ROOM, ROOM))
    with tempfile.TemporaryDirectory() as folder, contextlib.redirect_stderr(None):
        readers = Readers(seed, Path(folder))
        progress.write_bytes(bytes(8))
        with progress.open("r+b") as file:
            place = mmap.mmap(file.fileno(), 8)
        end, names, before, begun = time.monotonic() + seconds, list(READERS), 0, time.monotonic()
        while time.monotonic() < end:
            place[:] = struct.pack("<q", readers.done)
            readers.feed(names[readers.done % len(names)])
            if not before and time.monotonic() - begun > 0.5 * seconds:
                before, begun = resident(), time.monotonic()
        slope = (resident() - before) / max(time.monotonic() - begun, 1e-3) if before else 0.0
    said = {
        "node": "readers", "inputs": readers.done, "defects": dict(readers.defects), "bytes_per_s": slope,
        "used": dict(readers.read), "slowest": readers.slowest, "resident": resident(),
    }  # fmt: skip
    result.write_text(json.dumps(said))
    sys.stdout.flush()
    os._exit(0)


if __name__ == "__main__":
    main()
