"""What set-up compiles is all that nodes need when they start."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

import pytest

from whereabouts import compile as compiling
from whereabouts.compiled_cache import forget_stale

STARTS = """
import gc
from numba.core.dispatcher import Dispatcher
from whereabouts.compile import PARTS

for part in PARTS.values():
    part()
found = [item for item in gc.get_objects() if isinstance(item, Dispatcher) and item.overloads]
print(len(found), sorted(item.__name__ for item in found if sum(item.stats.cache_misses.values())))
"""


def test_a_second_start_compiles_nothing() -> None:
    assert compiling.main() == 0
    run = subprocess.run([sys.executable, "-c", STARTS], capture_output=True, text=True, check=True)
    count, missed = run.stdout.split(maxsplit=1)
    assert int(count) > 50
    assert missed.strip() == "[]"


def test_what_was_compiled_before_an_interrupt_is_kept(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def interrupted(**_: object) -> None:
        raise KeyboardInterrupt

    source = tmp_path / "estimation" / "kernel.py"
    source.parent.mkdir()
    source.touch()
    monkeypatch.setattr(compiling, "__file__", str(tmp_path / "whereabouts" / "compile.py"))
    monkeypatch.setattr(compiling, "ProcessPoolExecutor", interrupted)
    with pytest.raises(KeyboardInterrupt):
        compiling.main()
    assert forget_stale(tmp_path) == 0
    source.write_text("# edited while it compiled", encoding="utf-8")
    assert forget_stale(tmp_path) == 1


BUSY_WORLD = """
import gc
from numba.core.dispatcher import Dispatcher
import numpy as np
from evaluation.anchoring.anchoring_scenes import ALL_ROUND, HARD, ROOM, known
from whereabouts.simulation.objects import ObjectScene, scattered
from world_model import ObjectEvidence, WorldEvidence, WorldModel
from world_model.warm_up import warm_up

warm_up()
loaded = {id(item): len(item.overloads) for item in gc.get_objects() if isinstance(item, Dispatcher)}
for seed in range(2):
    things = scattered(12, np.random.default_rng(seed), ROOM)
    scene = ObjectScene(things, ROOM, sensor=ALL_ROUND, seed=seed, **HARD)
    model = WorldModel(known(scene))
    for seen in scene.looks(100):
        model.update(seen.evidence, seen.stamp)
model.update(WorldEvidence([ObjectEvidence((9.0, 9.0, 1.0), np.eye(3), object_id="cup-1")]), seen.stamp + 0.1)
found = [item for item in gc.get_objects() if isinstance(item, Dispatcher)]
print(sum(bool(count) for count in loaded.values()))
print(sorted(item.__name__ for item in found if len(item.overloads) > loaded.get(id(item), 0)))
"""


def test_the_world_model_is_warm_for_its_first_look() -> None:
    """Its warm-up is short; a scene with misses and false detections must need nothing that it left out."""
    run = subprocess.run([sys.executable, "-c", BUSY_WORLD], capture_output=True, text=True, check=True)
    count, late = run.stdout.splitlines()
    assert int(count) > 15
    assert late == "[]"


BUSY_ROOM = """
import gc
from numba.core.dispatcher import Dispatcher
import numpy as np
from tracking.people.people_warm_up import warm_up
from tracking.people.scan_filters import tracker_of
from evaluation.scenes.people_scenes import crowded_room

def tracks(item):
    return item.py_func.__module__.split(".")[0] in ("tracking", "registration", "estimation")

warm_up(name="{name}")
loaded = {{id(item): len(item.overloads) for item in gc.get_objects() if isinstance(item, Dispatcher)}}
tracker, rng = tracker_of("{name}", None), np.random.default_rng(0)
for seen in crowded_room(rng, 6, moving=False, duration=8.0).scans(rng):
    tracker.step(seen.scan, seen.pose, seen.scan.stamp)
found = [item for item in gc.get_objects() if isinstance(item, Dispatcher) and tracks(item)]
print(sum(bool(count) for count in loaded.values()))
print(sorted(item.__name__ for item in found if len(item.overloads) > loaded.get(id(item), 0)))
"""


@pytest.mark.parametrize("name", ["mixture", "phd", "gmphd"])
def test_the_tracker_is_warm_for_its_first_scan(name: str) -> None:
    """One leg alone must not be all that its warm-up knows."""
    run = subprocess.run(
        [sys.executable, "-c", BUSY_ROOM.format(name=name)], capture_output=True, text=True, check=True
    )
    count, late = run.stdout.splitlines()
    assert int(count) > 5
    assert late == "[]"
