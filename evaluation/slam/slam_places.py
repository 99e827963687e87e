"""Place models for SLAM: each building is judged with one that was trained without it.

The recipe is that of the shipped model for scans (docs/loop_closure_models.md). csail is no part of the recipe, so its
building is judged with the shipped model itself.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from functools import cache
from hashlib import sha256
from pathlib import Path
from unittest import mock

from evaluation.digest import source_digest
from evaluation.killian import MEMBER_NAME, bag_directory
from evaluation.loops import loops_training
from evaluation.loops.place_training import CascadeConfig, Examples, fit_cascade
from evaluation.report import RunOptions, Table
from loop_closure.places import recognizer
from loop_closure.places.outlines import LENGTH
from loop_closure.places.pairs import PairRule
from loop_closure.places.place_model import PlaceModel
from whereabouts.system.atomic import atomic_path

# What the shipped model is trained on, and the building that each log is of.
TRAINED = {
    "intel-corrected.log.gz": "intel",
    "freiburg-079-corrected.log.gz": "fr079",
    "freiburg-101-corrected.log.gz": "freiburg-101",
    "belgioioso-corrected.log.gz": "belgioioso",
    "infinite-corridor-corrected.log.gz": "mit",
    "killian.g2o": "mit",
}
BUILDINGS = TRAINED | {"intel.clf.bz2": "intel", "fr079.clf.bz2": "fr079", "mit-csail.clf.bz2": "csail"}
JUDGED = {log: "left out" if building == "csail" else "model left out" for log, building in BUILDINGS.items()}
LONGEST = ("freiburg-079-corrected.log.gz", MEMBER_NAME)
FLOORS = 3  # simulated ones, of no building
PAIRS, FEW = 1200, 300  # positive pairs from each log, in a whole run and in a quick one


@contextmanager
def without(building: str, options: RunOptions) -> Iterator[None]:
    """Within this, `Slam` recognises places by a model that has not seen the building."""
    model = place_model(building, options)
    if model is None:
        yield
        return
    with mock.patch.object(recognizer, "shipped_model", return_value=model):
        yield


def place_model(building: str, options: RunOptions) -> PlaceModel | None:
    """The model that was trained on all other buildings, from the folder of the run if it is there; None: the shipped.

    Raises
    ------
    InputError : logs of which nothing can be learned.
    """
    if building not in TRAINED.values():
        return None
    logs, config = _logs(options), _config(options)
    if options.kept is None:
        return _trained(logs, config, building)
    recipe = f"{source_digest(loops_training.__name__)} {config} {[path.name for path in logs]}"
    kept = options.kept / f"slam-places-without-{building}-{sha256(recipe.encode()).hexdigest()[:12]}.json"
    if not kept.exists():
        model = _trained(logs, config, building)
        kept.parent.mkdir(parents=True, exist_ok=True)
        with atomic_path(kept) as temporary:
            model.save(temporary)
    return PlaceModel.load(kept)


def table(logs: Sequence[str], options: RunOptions) -> Table:
    """Which model each log was judged with."""
    known = list(dict.fromkeys([TRAINED[path.name.removesuffix(".zip")] for path in _logs(options)]))
    rows: list[list[object]] = []
    for log in logs:
        others = [building for building in known if building != BUILDINGS[log]]
        text = ", ".join([*others, f"{FLOORS} simulated floors"])
        rows.append([log, "the shipped model" if BUILDINGS[log] == "csail" else text])
    note = (
        "Each building is judged with a place model that was trained on the others by the recipe of the shipped one. "
        "infinite-corridor and Killian Court are one building. The shipped model has never seen csail."
    )
    return Table("Place models by what they were trained on", ["log", "trained on"], rows, note, "places")


def _config(options: RunOptions) -> CascadeConfig:
    pairs = FEW if options.quick else PAIRS
    rule = PairRule(2.5, 20.0, math.pi, 4.0)
    return CascadeConfig(rule, positives=pairs, negatives=4 * pairs, hard=2 * pairs, pool=32 * pairs)


def _logs(options: RunOptions) -> tuple[Path, ...]:
    """The logs of the recipe that are here; a quick run does without the two longest."""
    assert options.data is not None
    paths = [options.data / "carmen" / name for name in TRAINED if name.endswith(".gz")]
    paths.append(bag_directory() / "cache" / MEMBER_NAME)
    return tuple(path for path in paths if path.exists() and not (options.quick and path.name in LONGEST))


@cache
def _examples(logs: tuple[Path, ...], config: CascadeConfig) -> list[Examples]:
    return loops_training.prepare([str(path) for path in logs], config, LENGTH, FLOORS)[0]


@cache
def _trained(logs: tuple[Path, ...], config: CascadeConfig, building: str) -> PlaceModel:
    return fit_cascade([each for each in _examples(logs, config) if each.environment != building], config)
