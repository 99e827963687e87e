"""How people go on while nobody sees them, learned from simulated homes, rooms and floors.

    python -m evaluation.people.people_identity

prints the numbers of `tracking.people.identity.Walking` and how well they tell who somebody is on other seeds.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass, field, fields

import numpy as np
import numpy.typing as npt
from scipy.optimize import minimize

from estimation.checks import FloatArray
from estimation.geometry.poses import compound
from evaluation.report import Report, RunOptions
from evaluation.scenes.occlusion_scenes import LAYOUTS, MOTIONS, OcclusionKind, occlusions
from evaluation.scenes.people_scenes import crowded_room, peopled_floor
from registration.laser.scan import Scan
from tracking.mixture.target import Target
from tracking.people.identity import AwayPerson, Name, ReturningPeople, Walking
from tracking.people.people_tracker import PeopleTracker
from whereabouts.simulation.home.apartment_day import LASER_MOUNT, ApartmentDay

NEAR = 0.6  # m from a true person within which a target is that one
SEED = 1600  # register of seeds to learn from; those to judge on begin at JUDGED
JUDGED = 1700
SURE = 0.8  # probability from which a label is taken for sure
HOME = 240.0  # s of each day at home

Moment = tuple[Scan, FloatArray, FloatArray]


@dataclass
class Return:
    """Somebody comes into view: place (2,), share of it nobody had looked at, stamp, who is away, and which it is."""

    place: FloatArray
    unseen: float
    stamp: float
    away: list[AwayPerson]
    right: list[bool]


@dataclass
class RecordedReturns(ReturningPeople):
    """Labels of people, with what was asked of them and the truth."""

    found: list[Return] = field(default_factory=list)
    true: FloatArray = field(default_factory=lambda: np.zeros((0, 2)))
    whose: dict[int, int] = field(default_factory=dict)

    def __post_init__(self) -> None:
        super().__init__()

    def nearest(self, place: FloatArray) -> int:
        """The true person there, -1 for nobody."""
        gaps = np.linalg.norm(self.true - place, axis=1)
        return int(gaps.argmin()) if gaps.min(initial=np.inf) < NEAR else -1

    def _who(self, person: Target, told: set[int], unseen: float, stamp: float) -> Name:
        one = self.nearest(person.mean[:2])
        labels = [label for label in self.people if label not in told]
        right = [one >= 0 and self.whose.get(label, -1) == one for label in labels]
        self.found.append(
            Return(person.mean[:2], unseen, stamp, [self.people[label] for label in labels], right)
        )
        return super()._who(person, told, unseen, stamp)

    def look(self, people: Iterable[Target]) -> None:
        """Who has which label by now."""
        now = {person.label: self.nearest(person.mean[:2]) for person in people}
        self.whose |= {label: one for label, one in now.items() if one >= 0}


def home(seed: int, k: int) -> Iterator[Moment]:
    """A day in the apartment: scans, poses of the scanner, true people."""
    for moment in ApartmentDay(seed=seed + k).moments(HOME):
        if moment.scan is not None:
            yield moment.scan, compound(moment.pose, LASER_MOUNT), moment.people


def scene(number: int) -> Callable[[int, int], Iterator[Moment]]:
    """A room, a floor, or pillars and screens, in which the robot drives every other time."""

    def moments(seed: int, k: int) -> Iterator[Moment]:
        rng = np.random.default_rng([seed, number, k])
        drives = bool(k % 2)
        if number == 1:
            drawn = crowded_room(rng, 4, drives)
        elif number == 2:
            drawn = peopled_floor(rng)
        else:
            kind = OcclusionKind(str(rng.choice(LAYOUTS)), str(rng.choice(MOTIONS)), "legs", drives)
            drawn = occlusions(rng, kind)
        for moment in drawn.scans(rng):
            yield moment.scan, moment.pose, moment.people

    return moments


# What to learn from and judge on, and how many of each.
KINDS: dict[str, tuple[Callable[[int, int], Iterator[Moment]], int]] = {
    "home": (home, 10),
    "rooms": (scene(1), 4),
    "floors, robot drives": (scene(2), 6),
    "pillars and screens": (scene(3), 8),
}


def returns(seed: int, counts: list[int] | None = None) -> list[list[Return]]:
    """All comings into view, by kind of scene; counts : scenes of each kind."""
    found: list[list[Return]] = []
    for kind, (draw, usual) in enumerate(KINDS.values()):
        found.append([])
        for k in range(counts[kind] if counts else usual):
            tracker, kept = PeopleTracker(), RecordedReturns()
            tracker.identities = kept
            for scan, pose, true in draw(seed, k):
                kept.true = true
                kept.look(tracker.step(scan, pose, scan.stamp))
            found[-1] += kept.found
    return found


def probabilities(walking: Walking, item: Return) -> npt.NDArray[np.float64]:
    """Of a stranger and of each who is away (1 + A,)."""
    back = walking.log_intensities(item.away, item.place, item.stamp)
    scores = np.array([walking.log_strangers(item.unseen), *back])
    share = np.exp(scores - scores.max())
    return np.asarray(share / share.sum())


def right(item: Return) -> npt.NDArray[np.bool_]:
    """Which of `probabilities` are right (1 + A,)."""
    return np.array([not any(item.right), *item.right])


def loss(walking: Walking, found: list[list[Return]]) -> float:
    """Mean log loss, each kind of scene as much as the others."""
    kinds = [[item for item in kind if item.away] for kind in found]
    return float(
        np.mean(
            [
                np.mean(
                    [-np.log(max(probabilities(walking, item)[right(item)].sum(), 1e-9)) for item in kind]
                )
                for kind in kinds
                if kind
            ]
        )
    )


def fitted(found: list[list[Return]]) -> Walking:
    """The numbers of the least loss."""
    names = [item.name for item in fields(Walking)]
    start = np.array([getattr(Walking(), name) for name in names])

    def walking(log_values: FloatArray) -> Walking:
        values = dict(zip(names, (start * np.exp(log_values)).tolist(), strict=True))
        return Walking(**values | {"stays": min(values["stays"], 0.95)})

    best = minimize(
        lambda x: loss(walking(x), found) + 0.002 * float(x @ x),
        np.zeros(len(names)),
        method="Nelder-Mead",
        options={"maxiter": 600},
    )
    return walking(best.x)


def reliability(walking: Walking, found: list[Return]) -> list[float]:
    """How many came into view with somebody away; % named right, mean probability told in %, % right of over 0.8."""
    told, hits = [], []
    for item in found:
        if item.away:
            share = probabilities(walking, item)
            told.append(share.max())
            hits.append(right(item)[share.argmax()])
    p, hit = np.array(told), np.array(hits, dtype=float)
    sure = hit[p > SURE]
    percent = [float(100.0 * part.mean()) if len(part) else float("nan") for part in (hit, p, sure)]
    return [len(p), *percent]


def who_comes_back(options: RunOptions, report: Report) -> None:
    """Part of `experiment people`: whether the labels of who comes into view are right, and as often as they say."""
    found = returns(JUDGED + 100 * options.seed, [1, 1, 1, 2] if options.quick else None)
    rows = [[name, *reliability(Walking(), kind)] for name, kind in zip(KINDS, found, strict=True)]
    columns = ["place", "comings", "right label, % ↑", "probability told, %", f"right where over {SURE}, % ↑"]
    note = (
        "Comings into view while somebody is away who was there before. Right: the label that the true person had, or "
        "a new one for who had none or is nobody. Other seeds than those the numbers were learned on."
    )
    report.add("Who comes back", columns, rows, note, "comings", data="simulated", samples=len(found[0]))


def main() -> None:
    """The command of the module."""
    learned = fitted(returns(SEED))
    print(learned)
    for name, kind in zip(KINDS, returns(JUDGED), strict=True):
        print(name, *(f"{value:.1f}" for value in reliability(learned, kind)))


if __name__ == "__main__":
    main()
