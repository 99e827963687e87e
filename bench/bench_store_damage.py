"""How soon a large store that was damaged in one place is open again, and the node that has it.

    python bench/bench_store_damage.py [--facts 100000] [--each 2]

A store of so many rows of history, closed and with a write-ahead log beside it, is damaged in every way that
`evaluation.store_damage` knows, so many times each, and opened; then the real node is started with some of them, until
it is active. Opening is measured in processor time, as it hardly waits; the start of the node by the clock on the wall.
Results go to the .txt beside.
"""

from __future__ import annotations

import argparse
import os
import platform
import sys
import tempfile
import time
from pathlib import Path

sys.path.insert(0, str(Path(__file__).resolve().parents[1]))

import numpy as np

from evaluation.store_damage import KINDS, SUFFIXES, Fact, damage, facts_of
from whereabouts.nodes.runtime.suite_run import prepare_environment
from whereabouts.nodes.runtime.supervisor import NodeSpec, Supervisor
from world_model.memory.store import Store
from world_model.memory.store_file import StoreError
from world_model.state import WorldObject, WorldState

RESULT = Path(__file__).with_suffix(".txt")
OBJECTS = 50
LOGGED = 20  # states that only the write-ahead log has
STARTS = 4
Files = dict[str, bytes]


def written(path: Path, facts: int) -> tuple[Files, Files, set[Fact]]:
    """Files of a store of things that move all the time: closed, and with a log; facts of the first."""
    store = Store(path, 10 * facts)
    steps = facts // OBJECTS
    closed: Files = {}
    known: set[Fact] = set()
    for step in range(steps + LOGGED):
        if step == steps:
            known = facts_of(store)
            store.close()
            closed = read(path)
            store = Store(path, 10 * facts)
        store.record(state(step))
    logged = read(path)
    store.close()
    return closed, logged, known


def state(step: int) -> WorldState:
    stamp = 10.0 * step
    seen = [
        WorldObject(
            f"cup-{number}", np.array([0.2 * (step % 500), 0.5 * number, 0.8]), np.zeros(3), 0.01 * np.eye(3),
            {"class": {"cup": 0.9, "bowl": 0.1}}, 0.98, False, stamp, 0.0, {"constant_position": 1.0},
        )
        for number in range(OBJECTS)
    ]  # fmt: skip
    return WorldState(tuple(seen), 1.0, float(OBJECTS), stamp, 0)


def read(path: Path) -> Files:
    return {s: Path(f"{path}{s}").read_bytes() for s in SUFFIXES if Path(f"{path}{s}").exists()}


def put(folder: Path, files: Files) -> Path:
    folder.mkdir(parents=True)
    path = folder / "world.sqlite"
    for suffix, content in files.items():
        Path(f"{path}{suffix}").write_bytes(content)
    return path


def opened(path: Path) -> tuple[float, set[Fact] | None]:
    """Processor seconds until a store is open, and what it knows; None where it does not open."""
    begun = time.process_time()
    try:
        store = Store(path)
    except StoreError:
        return time.process_time() - begun, None
    seconds = time.process_time() - begun
    with store:
        return seconds, facts_of(store)


def started(path: Path, folder: Path) -> float:
    """Seconds until the node is active that has this store."""
    # Else what was just copied would have to reach the disk first.
    os.sync()
    with Supervisor(folder) as supervisor:
        begun = time.monotonic()
        node = supervisor.start(NodeSpec("world_model", parameters={"store_path": str(path)}))
        while not node.was_active:
            supervisor.check()
            time.sleep(0.005)
        return time.monotonic() - begun


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawTextHelpFormatter)
    parser.add_argument("--facts", type=int, default=100_000)
    parser.add_argument("--each", type=int, default=2)
    given = parser.parse_args()
    prepare_environment(private=True)
    rng = np.random.default_rng(0)
    lines = [f"{platform.machine()}, Python {platform.python_version()}, load {os.getloadavg()[0]:.1f}"]
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        closed, logged, known = written(put(folder / "made", {}), given.facts)
        size = len(closed[""]) / 2**20
        lines.append(f"{len(known)} facts, {size:.1f} MiB, log {len(logged['-wal']) / 2**20:.1f} MiB")
        whole, _ = opened(put(folder / "whole", closed))
        lines.append(f"undamaged: open after {whole:.2f} s of processor time, and so below")
        kept, slowest, examples = [], [], []
        wanted = dict.fromkeys(KINDS, given.each)
        while any(wanted.values()):
            what, files, _ = damage(closed if rng.random() < 0.5 else logged, rng)
            kind = next(kind for kind in KINDS if what.startswith(kind))
            if not wanted[kind]:
                continue
            wanted[kind] -= 1
            seconds, facts = opened(put(folder / f"{len(slowest)}", files))
            share = 0.0 if facts is None else len(known & facts) / len(known)
            slowest.append(seconds)
            examples.append((seconds, files))
            if kind != "cut off":
                kept.append(share)
            lines.append(f"{what:50} open after {seconds:5.2f} s, {share:8.3%} of all facts kept")
            print(lines[-1], flush=True)
        lines.append(
            f"open after {max(slowest):.2f} s at most; at least {min(kept):.3%} of all facts kept, unless cut off"
        )
        lines.append(
            f"node active after {started(put(folder / 'start', closed), folder / 'log'):.2f} s, undamaged"
        )
        examples.sort(key=lambda item: -item[0])
        for number, (seconds, files) in enumerate(examples[:STARTS]):
            path = put(folder / f"start-{number}", files)
            lines.append(
                f"node active after {started(path, folder / f'log-{number}'):.2f} s, damaged ({seconds:.2f} s)"
            )
            print(lines[-1], flush=True)
    text = "\n".join(lines) + "\n"
    print(text)
    RESULT.write_text(text, encoding="utf-8")


if __name__ == "__main__":
    main()
