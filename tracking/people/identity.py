"""Who somebody is that comes into view: one who was out of sight, or somebody new, by place and time.

The mixture keeps a label as long as it knows where its target is. Who was away for longer is a new target there, and
may be anybody who went out of sight before and could have walked here since. Each such person, and a stranger, has an
intensity of coming into view here and now; their shares are the probabilities of who it is.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from types import MappingProxyType

import numpy as np

from estimation.checks import FloatArray
from estimation.geometry.poses import transform_points
from tracking.mixture.target import PublicLabels, Target

FORGOTTEN = 3.0  # times the mean after which somebody does not come back


def _log_density(gaps: FloatArray, variances: FloatArray) -> FloatArray:
    """Log of Gaussians of a variance per axis (A,) at (A, 2)."""
    return np.asarray(-0.5 * (gaps**2).sum(1) / variances - np.log(2.0 * math.pi * variances))


@dataclass(frozen=True)
class Walking:
    """How people go on while nobody sees them: they stay, or their velocity is an Ornstein-Uhlenbeck process.

    stays : share who are where they were, within `near`, m. speed : deviation of the velocity per axis, m/s, of the
    others. turning : s in which it is forgotten. gone : mean time, s, after which somebody does not come back.
    strangers, unseen : how much less often per m² and s a stranger comes into view than somebody does who is away,
    1/m², where somebody has looked before, and where nobody has.
    Learned by `evaluation.people.people_identity`.
    """

    stays: float = 0.07
    near: float = 0.3
    speed: float = 0.6
    turning: float = 1.3
    gone: float = 800.0
    strangers: float = 0.004
    unseen: float = 0.02

    def log_strangers(self, unseen: float) -> float:
        """Log of the density, 1/m², that a stranger does so; `unseen` of the place nobody has looked at."""
        return math.log((1.0 - unseen) * self.strangers + unseen * self.unseen)

    def log_intensities(self, away: Sequence[AwayPerson], place: FloatArray, stamp: float) -> FloatArray:
        """Log of the densities (A,), 1/m², that those who are away come into view at a place (2,) at a stamp, s."""
        means = np.array([one.mean for one in away]).reshape(-1, 4)
        known = np.array([(one.variance, one.drift, one.stamp) for one in away]).reshape(-1, 3)
        variances, drifts, stamps = known.T
        seconds = stamp - stamps
        left = np.exp(-seconds / self.turning)
        kept = self.turning * (1.0 - left)
        walked = self.speed**2 * self.turning**2 * (2.0 * seconds / self.turning - 3.0 + 4.0 * left - left**2)
        walked += kept**2 * drifts
        gaps = place - means[:, :2]
        stays = math.log(self.stays) + _log_density(gaps, variances + self.near**2)
        walks = _log_density(gaps - kept[:, None] * means[:, 2:], variances + walked)
        return np.asarray(np.logaddexp(stays, math.log1p(-self.stays) + walks) - seconds / self.gone)


@dataclass(frozen=True)
class AwayPerson:
    """Somebody when he was seen last: mean (4,) m and m/s, variance of his place, m², and velocity, m²/s², per axis,
    stamp, s; person : probability that it was one."""

    mean: FloatArray
    variance: float
    drift: float
    stamp: float
    person: float = 1.0


def _seen(target: Target, stamp: float, person: float) -> AwayPerson:
    """A target as it is now."""
    xx, yy, uu, vv = target.covariance.diagonal().tolist()
    return AwayPerson(target.mean, 0.5 * (xx + yy), 0.5 * (uu + vv), stamp, person)


@dataclass(frozen=True)
class Name:
    """The label somebody is told of by, and the probability that it is who had it before."""

    label: int
    probability: float = 1.0


@dataclass(frozen=True)
class Origin:
    """Whom a target may be that came up.

    known : by told label, the density, 1/m², of who was told of coming into view there, and how probably he is a
    person. strangers, things : the densities of people and of things that nobody knew, 1/m².
    """

    known: dict[int, tuple[float, float]]
    strangers: float
    things: float

    def log_odds(self, others: set[int]) -> float:
        """How much more probably it is a person than without history, nat, if it is none of the `others`.

        Who is known is again what he was.
        """
        back = [item for label, item in self.known.items() if label not in others]
        persons = sum(density * person for density, person in back)
        things = sum(density * (1.0 - person) for density, person in back)
        return math.log1p(persons / self.strangers) - math.log1p(things / max(self.things, 1e-12))


class ReturningPeople:
    """Labels of people over the targets of a tracker, which are lost where somebody is out of sight for long."""

    def __init__(self, walking: Walking | None = None) -> None:
        self.walking = walking or Walking()
        self.names: dict[int, Name] = {}  # by label of the target
        self.people: dict[int, AwayPerson] = {}  # by told label, whoever was told of as a person

    def shift(self, motion: FloatArray) -> None:
        """Takes everybody along with the frame, which moved by (3,) x, y, yaw."""
        for label, away in self.people.items():
            place = transform_points(motion, away.mean[:2])
            velocity = transform_points([0.0, 0.0, motion[2]], away.mean[2:])
            self.people[label] = replace(away, mean=np.concatenate([place, velocity]))

    def name(self, target: int) -> Name:
        """What a target is told of by."""
        return self.names.get(target, Name(target))

    def update(
        self,
        people: Sequence[Target],
        seen: set[int],
        unseen: Mapping[int, float],
        living: set[int],
        stamp: float,
        labels: PublicLabels,
        known: Mapping[int, float] = MappingProxyType({}),
    ) -> set[int]:
        """Gives everybody a label of whom nothing was told yet.

        people : the targets that are people now; seen : labels of targets that the scan shows; unseen : by label, the
        share of the place where a target came up that nobody had looked at; living : labels of all targets; labels :
        gives new numbers; known : by label, how probably it is a person by its own looks, else surely.
        Returns the targets whose label went over to somebody else.
        """
        self.names = {target: name for target, name in self.names.items() if target in living}
        oldest = stamp - FORGOTTEN * self.walking.gone
        self.people = {label: away for label, away in self.people.items() if away.stamp >= oldest}
        told = {self.names[person.label].label for person in people if person.label in self.names}
        left: set[int] = set()
        for person in people:
            if person.label not in self.names:
                name = self._who(person, told, unseen[person.label], stamp)
                for target in [t for t in living if t != person.label and self.name(t).label == name.label]:
                    self.names[target] = Name(labels.fresh())
                    left.add(target)
                self.names[person.label] = name
                told.add(name.label)
        for person in people:
            label = self.name(person.label).label
            if person.label in seen or label not in self.people:
                self.people[label] = _seen(person, stamp, known.get(person.label, 1.0))
        return left

    def origin(self, place: FloatArray, unseen: float, birth_class: float, stamp: float) -> Origin | None:
        """Whom one new at a place (2,) may be; of strangers, `birth_class` are people. None for nobody known."""
        if not self.people or birth_class <= 0.0:
            return None
        back = np.exp(self.walking.log_intensities(list(self.people.values()), place, stamp)).tolist()
        known = {
            label: (density, one.person)
            for (label, one), density in zip(self.people.items(), back, strict=True)
        }
        strangers = math.exp(self.walking.log_strangers(unseen))
        return Origin(known, strangers, strangers * (1.0 - birth_class) / birth_class)

    def _who(self, person: Target, told: set[int], unseen: float, stamp: float) -> Name:
        """The likeliest of those who are away and a stranger."""
        away = [label for label in self.people if label not in told]
        back = self.walking.log_intensities([self.people[label] for label in away], person.mean[:2], stamp)
        scores = np.array([self.walking.log_strangers(unseen), *back])
        share = np.exp(scores - scores.max())
        share /= share.sum()
        best = int(share.argmax())
        return Name([person.label, *away][best], float(share[best]))
