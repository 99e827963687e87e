"""Runs experiments part by part and seed by seed, and writes what they find; what is done survives an interrupt."""

from __future__ import annotations

import importlib
import json
import math
import pkgutil
import tempfile
import time
from collections.abc import Iterator, Mapping, Sequence
from concurrent.futures import ProcessPoolExecutor, as_completed
from dataclasses import dataclass
from datetime import UTC, datetime
from multiprocessing import get_context
from pathlib import Path
from types import ModuleType
from typing import Any

from estimation.errors import InputError
from evaluation import results
from evaluation.digest import data_digest, file_digest, source_digest
from evaluation.report import SEEDS, Part, Report, RunOptions
from whereabouts.system.atomic import atomic_path
from whereabouts.system.progress import progress_bar, silence

UNFINISHED = ".unfinished"
"""Folder below the output with the reports of parts that are done, until the experiment is."""


@dataclass
class Run:
    """One run of an experiment, as asked for."""

    name: str
    out: Path
    quick: bool = False
    resume: bool = False
    jobs: int = 1
    seed: int = 0
    data: Path | None = None

    @property
    def command(self) -> str:
        """What to type to get these results."""
        seed = f" --seed {self.seed}" if self.seed else ""
        return f"whereabouts experiment {self.name}{' --quick' if self.quick else ''}{seed} --out results/"

    @property
    def expected_seconds(self) -> float:
        """What an earlier run of the same length took, here or as committed; infinite where there is none."""
        for folder in (self.out, results.FOLDER):
            try:
                before = results.read(folder / f"{self.name}.json").content
            except InputError:
                continue
            if before["quick"] == self.quick:
                return float(before["seconds"])
        return math.inf

    def finished(self) -> bool:
        """Whether the output holds what this run would write: the same sources, as long, with its pictures."""
        path = self.out / f"{self.name}.json"
        if not path.exists():
            return False
        before = results.read(path)
        return before.content["quick"] == self.quick and not before.stale(self.data)


def experiments() -> dict[str, ModuleType]:
    """Experiment modules by name: those with `PARTS`."""
    import evaluation.experiments as package

    modules = {}
    for info in pkgutil.iter_modules(package.__path__):
        if "_" not in info.name:
            module = importlib.import_module(f"{package.__name__}.{info.name}")
            if hasattr(module, "PARTS"):
                modules[info.name] = module
    return modules


def parts_of(name: str) -> Mapping[str, Part]:
    """The parts of an experiment.

    Raises
    ------
    InputError : there is no such experiment.
    """
    known = experiments()
    if name not in known:
        raise InputError(f"no experiment is called {name}; there are: {', '.join(known)}, all")
    return known[name].PARTS


def run(asked: Run) -> results.Result:
    """Run an experiment and write `NAME.json` and its pictures, `NAME/*.png`, to the output folder.

    With `resume`, parts that an interrupted run of the same sources has done are not done again.
    """
    chosen = parts_of(asked.name)
    digest = source_digest(results.module_of(asked.name))
    content = _described(asked, chosen, digest)
    calls = [(key, seed) for key, part in chosen.items() for seed in _seeds(part, asked)]
    found: dict[str, list[dict[str, Any]]] = {}
    with progress_bar() as bar:
        task = bar.add_task(asked.name, total=len(calls))
        for key, seed in calls:
            bar.update(task, description=f"{asked.name}: {key}, seed {seed}")
            if _absent(chosen[key], asked.data):
                content["notes"].append(f"left out, for want of recordings: {', '.join(chosen[key].needs)}")
            else:
                kept = _kept_or_run(asked, key, chosen[key], seed, digest)
                found.setdefault(key, []).append(kept)
                content["seconds"] = round(content["seconds"] + kept["seconds"], 1)
            bar.advance(task)
    for records in found.values():
        part = results.merged(records)
        content["figures"] |= part["figures"]
        content["tables"] += part["tables"]
        content["notes"] += part["notes"]
        for path in map(Path, records[0]["pictures"]):
            content["pictures"][path.relative_to(asked.out).as_posix()] = file_digest(path)
    content["notes"] = list(dict.fromkeys(content["notes"]))
    target = asked.out / f"{asked.name}.json"
    with atomic_path(target) as temporary:
        temporary.write_text(json.dumps(content, indent=1, ensure_ascii=False) + "\n", encoding="utf-8")
    _forget(asked)
    return results.read(target)


def run_each(asked: Sequence[Run], workers: int) -> Iterator[results.Result]:
    """Run several experiments and give each result as it comes; with several workers, each in a process of its own.

    Several workers begin with the longest, so that none is idle while another ends a long one.
    """
    if workers == 1:
        yield from map(run, asked)
        return
    longest_first = sorted(asked, key=lambda each: each.expected_seconds, reverse=True)
    with ProcessPoolExecutor(workers, mp_context=get_context("spawn"), initializer=silence) as pool:
        running = [pool.submit(run, each) for each in longest_first]
        try:
            for done in as_completed(running):
                yield done.result()
        except BaseException:
            pool.shutdown(wait=False, cancel_futures=True)
            raise


def _described(asked: Run, chosen: Mapping[str, Part], digest: str) -> dict[str, Any]:
    """What is known before anything is measured."""
    commit, changed = results.commit()
    needs = [pattern for part in chosen.values() for pattern in part.needs]
    return {
        "schema": results.SCHEMA,
        "experiment": asked.name,
        "command": asked.command,
        "commit": commit,
        "changed": changed,
        "quick": asked.quick,
        "seeds": [asked.seed + k for k in range(SEEDS)],
        "seconds": 0,
        "finished": datetime.now(UTC).date().isoformat(),
        "processor": results.processor(),
        "versions": results.versions(),
        "digest": digest,
        "recordings": {} if asked.data is None else data_digest(asked.data, needs),
        "pictures": {},
        "notes": [],
        "figures": {},
        "tables": [],
    }


def _seeds(part: Part, asked: Run) -> range:
    count = 1 if not part.random else part.quick_seeds if asked.quick else SEEDS
    return range(asked.seed, asked.seed + count)


def _absent(part: Part, data: Path | None) -> bool:
    """Whether recordings that a part reads are not there."""
    return bool(part.needs) and (data is None or not all(any(data.glob(need)) for need in part.needs))


def _kept_or_run(asked: Run, key: str, part: Part, seed: int, digest: str) -> dict[str, Any]:
    """The record of one part at one seed with the `seconds` it took, then or now."""
    kept = asked.out / UNFINISHED / f"{asked.name}-{key}-{seed}.json"
    mark = {"digest": digest, "quick": asked.quick, "seed": seed}
    if asked.resume and kept.exists():
        before: dict[str, Any] = json.loads(kept.read_text(encoding="utf-8"))
        if before["mark"] == mark and all(Path(path).exists() for path in before["pictures"]):
            return before
    begun = time.perf_counter()
    with tempfile.TemporaryDirectory() as aside:
        # Pictures are of the first seed.
        folder = asked.out / asked.name if seed == asked.seed else Path(aside)
        folder.mkdir(parents=True, exist_ok=True)
        report = Report(asked.name)
        seeds = len(_seeds(part, asked))
        options = RunOptions(folder, seed, asked.jobs, asked.quick, asked.data, seeds, kept.parent)
        part.run(options, report)
    if seed != asked.seed:
        report.pictures = []
    record = results.record(report) | {"mark": mark, "seconds": round(time.perf_counter() - begun, 1)}
    kept.parent.mkdir(parents=True, exist_ok=True)
    with atomic_path(kept) as temporary:
        temporary.write_text(json.dumps(record), encoding="utf-8")
    return record


def _forget(asked: Run) -> None:
    """The experiment is written: what was kept to resume it goes."""
    folder = asked.out / UNFINISHED
    for path in folder.glob(f"{asked.name}-*.json"):
        path.unlink()
    if folder.exists() and not any(folder.iterdir()):
        folder.rmdir()
