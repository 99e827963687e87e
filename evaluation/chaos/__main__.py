"""`python -m evaluation.chaos --minutes 10 --seed 1`: all that may arrive, until the time is over; a table at the end.

Exit status 0 if nothing died, no fact was lost and no exception was one that nobody expected; 1 otherwise.
"""

from __future__ import annotations

import argparse
import io
import json
import os
import re
import subprocess
import sys
import tempfile
import time
from concurrent.futures import ThreadPoolExecutor
from contextlib import redirect_stdout
from dataclasses import dataclass, field
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

from evaluation.chaos.day import days
from evaluation.chaos.faults import Faults
from evaluation.chaos.times import FAULTS
from evaluation.chaos.worker import OPEN_VARIABLE
from evaluation.results import commit
from whereabouts.node_names import NODES
from whereabouts.nodes.runtime.suite_run import prepare_environment

ROOT = Path(__file__).resolve().parents[2]
# s one process runs at most before the next begins with another seed, and beyond its time before it counts as hung.
TURN, GRACE = 120.0, 300.0
# Of the time, the part for the simulated day of real nodes over DDS.
FAULTS_SHARE = 0.2
SIGNAL_TAIL = 25
# In the last line of a run.
TOTAL = re.compile(r"^(\d+) inputs, \d+ process deaths, ", re.MULTILINE)
DEATHS = re.compile(r"^\d+ inputs, (\d+) process deaths, ", re.MULTILINE)


@dataclass
class ChaosResult:
    """What one process has said."""

    name: str
    seed: int
    inputs: int = 0
    death: str = ""
    said: dict[str, Any] = field(default_factory=dict)


def feed(name: str, seed: int, seconds: float, folder: Path) -> ChaosResult:
    """One process of one node, or of the readers, to its end."""
    home = folder / f"{name}-{seed}"
    home.mkdir(parents=True)
    progress, result, log = home / "progress", home / "result", home / "log"
    tail = [str(seed), str(seconds), str(progress), str(result)]
    command = (
        ["evaluation.chaos.readers", *tail] if name == "readers" else ["evaluation.chaos.worker", name, *tail]
    )
    environment = {**os.environ, "PYTHONPATH": str(ROOT), "HOME": str(home)}
    with log.open("wb") as out:
        process = subprocess.Popen(
            [sys.executable, "-m", *command], cwd=home, stdout=out, stderr=subprocess.STDOUT, env=environment
        )
        try:
            code: int | None = process.wait(seconds + GRACE)
        except subprocess.TimeoutExpired:
            process.kill()
            process.wait()
            code = None
    count = int.from_bytes(progress.read_bytes()[:8], "little") if progress.exists() else 0
    if code == 0 and result.exists():
        said = json.loads(result.read_text())
        return ChaosResult(name, seed, said["inputs"], "", said)
    lines = log.read_text(errors="replace").splitlines()
    first = next(
        (k for k, line in enumerate(lines) if line.startswith("Fatal")), max(len(lines) - SIGNAL_TAIL, 0)
    )
    how = "hung" if code is None else f"exit status {code}"
    return ChaosResult(
        name, seed, count, "\n".join([f"{how} at input {count}", *lines[first : first + SIGNAL_TAIL]])
    )


def feed_all(minutes: float, seed: int, jobs: int, folder: Path, names: list[str]) -> list[ChaosResult]:
    """All nodes and the readers in turn, again and again with other seeds, until the time is over."""
    end = time.monotonic() + 60.0 * minutes
    found: list[ChaosResult] = []
    turn = min(max(60.0 * minutes * jobs / len(names) - 5.0, 2.0), TURN)
    with ThreadPoolExecutor(jobs) as pool:
        while time.monotonic() < end:
            found += pool.map(lambda name, now=seed: feed(name, now, turn, folder), names)
            seed += 1
    return found


def report(results: list[ChaosResult], shaken: Faults | None) -> bool:
    """Print what came of it; whether all is well."""
    print(f"{'':20}{'inputs':>10}{'deaths':>8}{'errors':>8}{'MiB/h':>8}{'slowest':>10}")
    for name in sorted({result.name for result in results}):
        mine = [result for result in results if result.name == name]
        said = [result.said for result in mine if result.said]
        slope = max((item["bytes_per_s"] for item in said), default=0.0) * 3600.0 / 2**20
        slowest, what = max((item["slowest"] for item in said), default=(0.0, ""))
        errors = sum(sum(item["defects"].values()) for item in said)
        deaths = sum(bool(result.death) for result in mine)
        print(
            f"{name:20}{sum(r.inputs for r in mine):10}{deaths:8}{errors:8}{slope:8.0f}{slowest:9.2f} s  {what}"
        )
    defects: dict[str, tuple[int, int]] = {}
    for result in results:
        if result.death:
            print(f"\n{result.name}, seed {result.seed}: {result.death}")
        for text, count in result.said.get("defects", {}).items():
            defects[f"{result.name}: {text}"] = (
                defects.get(f"{result.name}: {text}", (0, 0))[0] + count,
                result.seed,
            )
    for text, (count, seed) in sorted(defects.items()):
        print(f"{count} times, seed {seed}: {text}")
    report_runs(results)
    deaths = sum(bool(result.death) for result in results)
    total = sum(result.inputs for result in results)
    if shaken is not None:
        total, deaths = total + shaken.inputs, deaths + shaken.deaths
        print(f"\nover DDS: {shaken}")
    print(f"\n{total} inputs, {deaths} process deaths, {len(defects)} kinds of internal errors")
    return not deaths and not defects and (shaken is None or shaken.well)


def report_runs(results: list[ChaosResult]) -> None:
    """Print how many new runs nodes began where clocks were wrong and messages got lost."""
    plays = [(name, told) for result in results for name, told in result.said.get("plays", {}).items()]
    if plays:
        print(f"\n{'':26}{'played':>8}{'new runs':>10}{'expected':>10}")
    for name in FAULTS:
        mine = [told for other, told in plays if other == name]
        if mine:
            played, runs, wanted = (sum(told[key] for told in mine) for key in ("played", "runs", "wanted"))
            print(f"{name:26}{played:8}{runs:10}{wanted:10}")


def main() -> int:
    """Entry point."""
    parser = argparse.ArgumentParser(prog="chaos", description=__doc__.splitlines()[0] if __doc__ else "")
    parser.add_argument("--minutes", type=float, default=10.0)
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--jobs", type=int, default=max((os.cpu_count() or 2) - 1, 1))
    parser.add_argument(
        "--open", action="store_true", help="without envelopes: the libraries have to hold alone"
    )
    parser.add_argument("--no-faults", action="store_true", help="no real nodes that are killed")
    parser.add_argument("--append", type=Path, help="also add what is printed to this file of all runs")
    parser.add_argument("names", nargs="*", help=f"readers, {', '.join(NODES)}; all by default")
    given = parser.parse_args()
    prepare_environment(private=True)
    if given.open:
        os.environ[OPEN_VARIABLE] = "1"
    whole = not given.names and not given.no_faults
    with tempfile.TemporaryDirectory(prefix="whereabouts-chaos-") as folder:
        share = 1.0 - FAULTS_SHARE if whole else 1.0
        results = feed_all(
            share * given.minutes, given.seed, given.jobs, Path(folder), given.names or ["readers", *NODES]
        )
        shaken = days(60.0 * FAULTS_SHARE * given.minutes, given.seed, Path(folder)) if whole else None
    said = io.StringIO()
    with redirect_stdout(said):
        well = report(results, shaken)
    print(said.getvalue(), end="")
    if given.append is not None:
        keep(given.append, said.getvalue())
    return 0 if well else 1


def keep(path: Path, said: str) -> None:
    """Add what a run has printed to a file of all runs, and how many inputs there are in it so far."""
    made, changed = commit()
    before = path.read_text(encoding="utf-8") if path.exists() else ""
    said = f"{datetime.now(UTC).date()}, {made}{', changed' if changed else ''}: {' '.join(sys.argv[1:])}\n{said}"
    total = sum(int(count) for count in TOTAL.findall(before + said))
    deaths = sum(int(count) for count in DEATHS.findall(before + said))
    text = f"{before}{said}so far: {total} inputs, {deaths} process deaths\n\n"
    path.write_text(text, encoding="utf-8")
    print(f"{path}: {total} inputs in all its runs, {deaths} process deaths")


if __name__ == "__main__":
    sys.exit(main())
