"""What single damages do to the world model's memory: `python -m evaluation.store_damage --damages 10000`.

Stores of several kinds are written, damaged in one place (a bit, a byte, a sector, a page, two pages exchanged, the
file cut off; in the file or in its write-ahead log) and opened again. Counted are damages that changed or lost a fact
without a report, facts that were never true, the share of facts kept among those that do not lie on a page that was
touched, and the seconds until the store is open. Facts are the rows of history with their names, the present objects
and the runs.
"""

from __future__ import annotations

import argparse
import shutil
import sys
import tempfile
from collections.abc import Iterable
from dataclasses import dataclass, field
from pathlib import Path
from time import perf_counter
from typing import Any

import numpy as np

from world_model.memory.store import Store
from world_model.memory.store_file import StoreError
from world_model.memory.store_format import CURRENT, HISTORY, PAGE
from world_model.memory.store_pages import FRAME, LOG_HEAD, Pages, rows_of
from world_model.memory.store_rows import encode
from world_model.state import WorldObject, WorldState

# What is damaged, and how many bytes each damage takes.
KINDS = {
    "bit": 1, "byte": 1, "sector of zeros": 512, "sector of noise": 512, "page of zeros": PAGE, "page of noise": PAGE,
    "pages exchanged": PAGE, "cut off": 1,
}  # fmt: skip
SUFFIXES = ("", "-wal", ".lock")
Fact = tuple[Any, ...]


@dataclass
class Sample:
    """A whole store: its files, its facts, the pages that each lies on, and what objects were like at any time."""

    name: str
    files: dict[str, bytes]
    facts: set[Fact]
    pages: dict[Fact, set[int]]
    ever: set[Fact]


@dataclass
class DamageTally:
    """What a number of damages did."""

    damages: int = 0
    reported: int = 0
    without_effect: int = 0
    silent: int = 0
    untrue: int = 0
    refused: int = 0
    kept: list[float] = field(default_factory=list)
    seconds: list[float] = field(default_factory=list)
    examples: list[str] = field(default_factory=list)


def written(folder: Path, name: str, steps: int, objects: int, words: int, killed: bool) -> Sample:
    """A store of a world in which things come, go and move; killed : with its write-ahead log still beside it."""
    path = folder / name / "world.sqlite"
    store = Store(path)
    rng = np.random.default_rng(steps)
    kinds = [f"kind-of-thing-{k}" for k in range(words)]
    ever: set[Fact] = set()
    for step in range(steps):
        epoch, stamp = step // (steps // 2 + 1), float(step)
        seen = [
            WorldObject(
                f"{kinds[number % words]}-{number}",
                np.array([0.1 * (step // (1 + number)), float(number), 0.8]),
                np.zeros(3),
                np.diag(rng.uniform(0.01, 0.1, 3)),
                {
                    "class": {
                        kind: float(p) for kind, p in zip(kinds, rng.dirichlet(np.ones(words)), strict=True)
                    }
                },
                0.98,
                False,
                stamp,
                0.0,
                {"constant_position": 0.9, "uniform": 0.1},
            )
            for number in range(1, objects + 1)
            if (step + 7 * number) % 40 < 30
        ]
        ever |= {(item.id, *encode(item)) for item in seen}
        store.record(WorldState(tuple(seen), 1.0, float(len(seen)), stamp, epoch))
    if not killed:
        store.close()
    files = {s: Path(f"{path}{s}").read_bytes() for s in SUFFIXES if Path(f"{path}{s}").exists()}
    facts = facts_of(store if killed else Store(path, read_only=True))
    return Sample(name, files, facts, _places(path, facts), ever)


def facts_of(store: Store) -> set[Fact]:
    """All that a store knows."""
    ask = store._file.connection.execute
    found: set[Fact] = set(
        ask(f"SELECT o.epoch, o.id, {_named(HISTORY.columns, 'h')} FROM history h JOIN objects o USING (key)")
    )
    found |= {
        ("now", *row)
        for row in ask(
            f"SELECT o.id, {_named(CURRENT.columns, 'c')} FROM current c JOIN objects o USING (key)"
        )
    }
    found |= {("run", *row) for row in ask("SELECT epoch, first_stamp, last_stamp FROM epochs")}
    return found | {("clock", *row) for row in ask("SELECT epoch, stamp FROM clock")}


def _named(columns: str, table: str) -> str:
    return ", ".join(f"{table}.{column.strip()}" for column in columns.split(","))


class _Watched(Pages):
    """Notes which pages are read: those that rows go on in."""

    def __init__(self, path: Path) -> None:
        super().__init__(path)
        self.read: set[int] = set()

    def __getitem__(self, number: int) -> bytes:
        self.read.add(number)
        return super().__getitem__(number)


def _places(path: Path, facts: Iterable[Fact]) -> dict[Fact, set[int]]:
    """Pages that the row of each fact touches; facts of rows too small to matter lie on all of them."""
    past: dict[int, set[int]] = {}
    now: dict[int, set[int]] = {}
    pages = _Watched(path)
    for number in range(2, pages.count + 1):
        page, pages.read = pages[number], {number}
        for table, row in rows_of(pages, page):
            if table in (HISTORY, CURRENT):
                (past if table is HISTORY else now)[row[0]] = pages.read
    return {
        fact: now[fact[2]] if fact[0] == "now" else past[fact[2]]
        for fact in facts
        if fact[0] not in ("run", "clock")
    }


def damage(
    files: dict[str, bytes], rng: np.random.Generator
) -> tuple[str, dict[str, bytes], set[int] | None]:
    """One damage: what it is, the files with it, and the pages that it touches; None for an end of a log."""
    suffix = "-wal" if "-wal" in files and len(files["-wal"]) and rng.random() < 0.5 else ""
    data, kind = bytearray(files[suffix]), str(rng.choice(list(KINDS)))
    size = KINDS[kind]
    at = int(rng.integers(0, len(data))) // size * size
    places = [at]
    if kind == "bit":
        data[at] ^= 1 << int(rng.integers(8))
    elif kind == "pages exchanged":
        # Whole ones: with a short end of a file all that lies behind would be shifted.
        at, other = (int(rng.integers(0, max(len(data) // size, 1))) * size for _ in range(2))
        data[at : at + size], data[other : other + size] = data[other : other + size], data[at : at + size]
        places = [at, other]
    elif kind == "cut off":
        del data[at:]
    else:
        length = len(data[at : at + size])
        data[at : at + size] = bytes(length) if kind.endswith("zeros") else rng.bytes(length)
    what = f"{kind} at byte {at} of {suffix or 'the file'}"
    if kind == "cut off":
        touched = None if suffix else set(range(at // PAGE + 1, len(files[suffix]) // PAGE + 1))
    else:
        touched = {page for place in places for page in _touched(files[suffix], suffix, place, size)}
    return what, {**files, suffix: bytes(data)}, touched


def _touched(data: bytes, suffix: str, at: int, size: int) -> set[int]:
    if not suffix:
        return {at // PAGE + 1}
    frames = range(max(at - LOG_HEAD, 0) // FRAME, max(at + size - 1 - LOG_HEAD, 0) // FRAME + 1)
    starts = [LOG_HEAD + FRAME * frame for frame in frames]
    return {int.from_bytes(data[start : start + 4], "big") for start in starts}


def judge(sample: Sample, rng: np.random.Generator, folder: Path, tally: DamageTally) -> None:
    """Damage a copy of a store, open it, and count what came of it."""
    what, files, touched = damage(sample.files, rng)
    shutil.rmtree(folder, ignore_errors=True)
    folder.mkdir()
    path = folder / "world.sqlite"
    for suffix, content in files.items():
        Path(f"{path}{suffix}").write_bytes(content)
    tally.damages += 1
    begun = perf_counter()
    try:
        store = Store(path)
    except StoreError as error:
        tally.refused += 1
        tally.examples.append(f"{sample.name}, {what}: {error}")
        return
    tally.seconds.append(perf_counter() - begun)
    with store:
        facts, reported = facts_of(store), bool(store.damages)
    lost, more = sample.facts - facts, facts - sample.facts
    # Who is present may have been worked out from history; runs and the clock as well.
    past = {(fact[1], *fact[7:]) for fact in sample.facts if fact[0] not in ("now", "run", "clock")}
    untrue = [
        fact
        for fact in more
        if fact[0] not in ("run", "clock")
        and not (fact[0] == "now" and {(fact[1], *fact[3:])} & (past | sample.ever))
    ]
    tally.reported += reported
    tally.without_effect += not lost and not more
    if (lost or more) and not reported:
        tally.silent += 1
        tally.examples.append(
            f"{sample.name}, {what}: {len(lost)} facts lost, {len(more)} others, and no word"
        )
    if untrue:
        tally.untrue += 1
        tally.examples.append(
            f"{sample.name}, {what}: {len(untrue)} facts that were never true, as {untrue[0][:6]}"
        )
    # What is only in the part of a log that is cut off is damaged as well.
    elsewhere = [fact for fact, pages in sample.pages.items() if touched is not None and not pages & touched]
    if elsewhere:
        tally.kept.append(1.0 - sum(fact in lost for fact in elsewhere) / len(elsewhere))
        if tally.kept[-1] < 0.99:
            tally.examples.append(f"{sample.name}, {what}: {tally.kept[-1]:.1%} of the facts elsewhere kept")


def run(damages: int, seed: int = 0, told: int = 0) -> DamageTally:
    """Damage stores of all kinds in turn. told : say how far it is as often."""
    tally, rng = DamageTally(), np.random.default_rng(seed)
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        samples = [
            written(folder, "closed", 100, 6, 5, False),
            written(folder, "killed", 60, 6, 5, True),
            written(folder, "with rows over several pages", 60, 3, 250, False),
            written(folder, "small", 10, 2, 3, False),
        ]
        for number in range(damages):
            judge(samples[number % len(samples)], rng, folder / "damaged", tally)
            if told and tally.damages % told == 0:
                print(
                    f"{tally.damages}: {tally.silent} silent, {tally.untrue} untrue, {tally.refused} refused",
                    flush=True,
                )
    return tally


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--damages", type=int, default=1000)
    parser.add_argument("--seed", type=int, default=0)
    given = parser.parse_args()
    tally = run(given.damages, given.seed, told=500)
    kept = np.array(tally.kept or [1.0])
    print("\n".join(tally.examples[:20]))
    print(f"damages                    {tally.damages}")
    print(f"reported                   {tally.reported}")
    print(f"without effect on any fact {tally.without_effect}")
    print(f"silent                     {tally.silent}")
    print(f"facts never true           {tally.untrue}")
    print(f"did not start              {tally.refused}")
    print(f"kept of facts elsewhere    {kept.mean():.4%} mean, {kept.min():.2%} least")
    print(f"at least 99 % of them kept {np.mean(kept >= 0.99):.2%} of the damages")
    print(f"seconds to open            {np.median(tally.seconds):.3f} median, {max(tally.seconds):.3f} most")
    sys.exit(1 if tally.silent or tally.untrue else 0)


if __name__ == "__main__":
    main()
