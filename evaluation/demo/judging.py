"""How well the suite did in the apartment: every figure of the demo's report, against ground truth."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from evaluation.demo.belief_judging import SAME, apart, known, matched
from evaluation.demo.reading import Said, Truth
from evaluation.demo.screen import NOBODY
from evaluation.people.people_judging import Expected, SceneJudgement, judge_people
from world_model import WorldObject

Array = NDArray[np.float64]


@dataclass
class Trajectories:
    """Poses (N, 3) in the map at `stamps`, and the distance (N,) m of each from the truth."""

    stamps: Array
    truth: Array
    named: dict[str, Array] = field(default_factory=dict)
    errors: dict[str, Array] = field(default_factory=dict)


@dataclass
class Identities:
    """What became of each thing.

    ids : (stamp, id) whenever the id by which a thing is known changed. missing, extra : at the end, of things that lie
    about, and of objects that are believed in and are nothing. wrong : class at the end.
    """

    ids: dict[str, list[tuple[float, str]]] = field(default_factory=dict)
    present: int = 0
    right: int = 0
    missing: list[str] = field(default_factory=list)
    extra: list[str] = field(default_factory=list)
    lost: list[str] = field(default_factory=list)
    errors: list[float] = field(default_factory=list)

    @property
    def switches(self) -> int:
        """Changes of a thing's id."""
        return sum(max(len(known) - 1, 0) for known in self.ids.values())

    @property
    def kept(self) -> int:
        """Things that are known at the end by the id they were first known by."""
        return sum(bool(known) and known[0][1] == known[-1][1] for known in self.ids.values())


def judge_trajectories(truth: Truth, said: Said) -> Trajectories:
    """Wheels, odometry, the map as it was said at the time, and with all loops closed."""
    replayed = said.replayed
    both = [k for k, stamp in enumerate(replayed.stamps) if round(float(stamp), 4) in truth.poses]
    stamps = replayed.stamps[both]
    true = np.array([truth.poses[round(float(stamp), 4)] for stamp in stamps]).reshape(-1, 3)
    found = Trajectories(stamps, true)
    keys = [round(float(stamp), 4) for stamp in stamps]
    if keys and all(key in truth.wheels for key in keys):
        found.named["wheels"] = np.array([truth.wheels[key] for key in keys])
    found.named["scan registration"] = replayed.poses[both]
    found.named["in the map, at the time"] = replayed.live()[both]
    if len(replayed.corrected):
        found.named["loops closed"] = replayed.corrected[both]
    for name, poses in found.named.items():
        found.errors[name] = np.linalg.norm(poses[:, :2] - true[:, :2], axis=1)
    return found


def rmse(errors: Array) -> float:
    """Root mean square, nan of nothing."""
    return float(np.sqrt(np.mean(np.square(errors)))) if len(errors) else float("nan")


def judge_tracks(truth: Truth, said: Said) -> tuple[SceneJudgement, Array]:
    """People as `whereabouts experiment people` judges them, and the stamps of the scans that count.

    Expected are those who were in plain view for 1.5 s, until they have been hidden for 3 s.
    """
    judged, stamps = SceneJudgement(), []
    expecting: Expected | None = None
    before: float | None = None
    for stamp, (spots, returns) in sorted(truth.people.items()):
        expecting = expecting or Expected(len(spots))
        expected = expecting.look(returns, stamp, 0.0 if before is None else stamp - before)
        before = stamp
        if stamp not in said.people:
            continue
        tracked = said.people[stamp]
        labels = np.array([person.label for person in tracked], dtype=np.int64)
        places = np.array([person.position for person in tracked]).reshape(-1, 2)
        counted = len(judged.ospa)
        judge_people(judged, spots, returns, labels, places, expected)
        stamps += [stamp] * (len(judged.ospa) - counted)
    return judged, np.array(stamps)


def judge_things(truth: Truth, said: Mapping[float, Sequence[WorldObject]]) -> Identities:
    """Ids of all things over time, and the account at the end. said : worlds by stamp."""
    found = Identities()
    worlds = sorted(said)
    if not worlds or not truth.things:
        return found
    for stamp, things in sorted(truth.things.items()):
        index = int(np.searchsorted(worlds, stamp + 0.02)) - 1
        if index < 0:
            continue
        believed = known(said[worlds[index]])
        for name, spot in things.items():
            thing = _nearest(believed, truth.kinds[name][0], spot)
            ids = found.ids.setdefault(name, [])
            if thing is not None and (not ids or ids[-1][1] != thing.id):
                ids.append((stamp, thing.id))
    last = truth.things[max(truth.things)]
    final = said[worlds[-1]]
    believed = known(final)
    used = matched(last, lambda name: truth.kinds[name][0], believed)
    found.present, found.right = len(last), len(used)
    found.missing = sorted(set(last) - set(used))
    taken = {thing.id for thing in used.values()}
    found.extra = [thing.id for thing in believed if thing.id not in taken]
    found.lost = [item.id for item in final if item.lost and item.most_probable("class") not in NOBODY]
    found.errors = [
        float(np.linalg.norm(thing.position[:2] - last[name][:2])) for name, thing in used.items()
    ]
    return found


def _nearest(objects: Iterable[WorldObject], kind: str, spot: Array) -> WorldObject | None:
    near = [item for item in objects if item.most_probable("class") == kind and apart(item, spot) < SAME]
    return min(near, key=lambda item: apart(item, spot), default=None)
