"""Who comes back into view: against simulated walks, and a room that somebody leaves for a while."""

from __future__ import annotations

import math

import numpy as np
import numpy.typing as npt
import pytest

from tracking.mixture.target import PublicLabels, Target
from tracking.people.identity import AwayPerson, ReturningPeople, Walking

Array = npt.NDArray[np.float64]


def person(label: int, x: float, y: float, vx: float = 0.0, vy: float = 0.0) -> Target:
    return Target(
        label, np.array([x, y, vx, vy]), np.diag([0.01, 0.01, 0.0, 0.0]), 1.0, 0.01 * np.eye(2), 1.0
    )


def step(kept: ReturningPeople, people: list[Target], stamp: float, labels: PublicLabels) -> list[int]:
    known = {one.label for one in people}
    kept.update(people, known, dict.fromkeys(known, 0.0), known, stamp, labels)
    return [kept.name(one.label).label for one in people]


def walks(rng: np.random.Generator, walking: Walking, velocity: float, seconds: float, count: int) -> Array:
    """Displacements (count, 2) of walks simulated in steps of 20 ms."""
    dt = 0.02
    place, moving = np.zeros((count, 2)), np.tile([velocity, 0.0], (count, 1))
    noise = walking.speed * math.sqrt(2.0 * dt / walking.turning)
    for _ in range(round(seconds / dt)):
        place += dt * moving
        moving += -moving * dt / walking.turning + noise * rng.normal(size=(count, 2))
    return place


@pytest.mark.parametrize("seconds", [0.5, 3.0, 15.0])
def test_the_density_is_that_of_simulated_walks(seconds: float) -> None:
    walking = Walking(stays=1e-9, near=0.1, speed=0.6, turning=2.0, gone=1e9)
    places = walks(np.random.default_rng(4), walking, 0.8, seconds, 4000)
    away = AwayPerson(np.array([0.0, 0.0, 0.8, 0.0]), 1e-6, 0.0, 0.0)
    centre = places.mean(0)
    for offset in ([0.0, 0.0], [0.0, 1.0]):
        spot = centre + np.array(offset) * places.std()
        radius = 0.4 * places.std()
        share = np.mean(np.linalg.norm(places - spot, axis=1) < radius) / (math.pi * radius**2)
        grid = radius * (np.stack(np.meshgrid(*[np.linspace(-1, 1, 21)] * 2), -1).reshape(-1, 2))
        inside = grid[np.linalg.norm(grid, axis=1) < radius]
        density = np.mean(
            [math.exp(walking.log_intensities([away], spot + one, seconds)[0]) for one in inside]
        )
        assert density == pytest.approx(share, rel=0.15)


def test_probabilities_are_right_as_often_as_they_say() -> None:
    """People who walk as the model has it, and strangers as often as it has them."""
    rng, walking = np.random.default_rng(7), Walking(strangers=0.004)
    told, right = [], []
    for _ in range(1500):
        kept, labels = ReturningPeople(walking), PublicLabels()
        labels.given = 10
        places = rng.uniform(0.0, 10.0, (3, 2))
        assert step(kept, [person(k, *spot) for k, spot in enumerate(places)], 0.0, labels) == [0, 1, 2]
        seconds = rng.exponential(10.0) + 1.0
        # Intensities: of each who is away, as far as he is not gone, and of strangers over the floor and around it.
        back = math.exp(-seconds / walking.gone)
        floor = 20.0
        who = int(
            rng.choice(
                4,
                p=np.array([back, back, back, walking.strangers * floor**2])
                / (3 * back + walking.strangers * floor**2),
            )
        )
        if who == 3:
            spot = rng.uniform(5.0 - floor / 2, 5.0 + floor / 2, 2)
        elif rng.random() < walking.stays:
            spot = places[who] + math.hypot(walking.near, 0.1) * rng.normal(size=2)
        else:
            spot = places[who] + 0.1 * rng.normal(size=2) + walks(rng, walking, 0.0, seconds, 1)[0]
        step(kept, [person(9, *spot)], seconds, labels)
        name = kept.name(9)
        told.append(name.probability)
        right.append(name.label == (9 if who == 3 else who))
    told_p, hit = np.array(told), np.array(right)
    for low, high in ((0.3, 0.6), (0.6, 0.9), (0.9, 1.01)):
        inside = (told_p >= low) & (told_p < high)
        assert inside.sum() > 100
        assert hit[inside].mean() == pytest.approx(told_p[inside].mean(), abs=0.06)


def test_nobody_has_the_label_of_another_who_is_there() -> None:
    kept, labels = ReturningPeople(), PublicLabels()
    labels.given = 10
    step(kept, [person(0, 0.0, 0.0), person(1, 5.0, 0.0)], 0.0, labels)
    assert step(kept, [person(0, 0.0, 0.0), person(2, 5.1, 0.0)], 1.0, labels) == [0, 1]
    # The target that had the label comes back and is somebody else.
    assert (
        len(set(step(kept, [person(0, 0.0, 0.0), person(2, 5.1, 0.0), person(3, 0.1, 0.0)], 1.1, labels)))
        == 3
    )


def test_a_target_whose_label_went_over_has_a_new_number() -> None:
    kept, labels = ReturningPeople(), PublicLabels()
    labels.given = 2
    step(kept, [person(0, 0.0, 0.0)], 0.0, labels)
    left = kept.update([person(1, 0.2, 0.0)], {1}, {1: 0.0}, {0, 1}, 2.0, labels)
    assert left == {0}
    assert kept.name(1).label == 0
    assert kept.name(0).label == 2


def test_the_frame_does_not_matter() -> None:
    """A frame that moved takes everybody who is away along."""
    motion = np.array([3.0, -2.0, 1.2])
    c, s = math.cos(motion[2]), math.sin(motion[2])
    turn = np.array([[c, -s], [s, c]])
    told = []
    for moved in (False, True):
        kept, labels = ReturningPeople(), PublicLabels()
        labels.given = 5
        step(kept, [person(0, 1.0, 0.5, 0.9, 0.1), person(1, 2.5, 0.5)], 0.0, labels)
        spot = np.array([2.0, 0.7])
        if moved:
            kept.shift(motion)
            spot = turn @ spot + motion[:2]
        step(kept, [person(2, *spot)], 1.5, labels)
        told.append(kept.name(2))
    assert told[0].label == told[1].label == 0
    assert told[0].probability == pytest.approx(told[1].probability)


def test_who_has_been_away_for_long_is_forgotten() -> None:
    kept, labels = ReturningPeople(Walking(gone=10.0)), PublicLabels()
    labels.given = 5
    step(kept, [person(0, 0.0, 0.0)], 0.0, labels)
    assert step(kept, [person(1, 0.0, 0.0)], 100.0, labels) == [1]
    assert 0 not in kept.people


def test_one_new_where_a_person_went_is_rather_a_person_and_where_a_thing_went_rather_a_thing() -> None:
    def odds(known: float, x: float = 0.0, told: frozenset[int] = frozenset()) -> float:
        kept = ReturningPeople()
        kept.people[3] = AwayPerson(np.array([0.0, 0.0, 0.0, 0.0]), 0.01, 0.0, 0.0, known)
        origin = kept.origin(np.array([x, 0.0]), 0.0, 0.5, 1.0)
        assert origin is not None
        return origin.log_odds(set(told))

    assert odds(0.99) > 2.0
    assert odds(0.01) < -2.0
    assert odds(0.5) == pytest.approx(0.0, abs=1e-9)
    assert odds(0.99, x=50.0) == pytest.approx(0.0, abs=1e-6)
    assert odds(0.99, told=frozenset({3})) == 0.0
