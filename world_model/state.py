"""What the world model believes: objects, and one consistent explanation of all evidence (Θ of section 2.5)."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field

import numpy as np

from estimation.checks import FloatArray

Box = tuple[tuple[float, float], tuple[float, float], tuple[float, float]]

DAY, HOUR = 86400.0, 3600.0  # s
PERSON = "person"  # A class that moves by itself: it has no usual place
OUTCOMES = ("found", "occluded", "not_found")  # Of a verification
BELIEVED = 0.5  # Existence below which something is not told of as being there
SURE = 0.9  # Probability from which on something is taken for certain, and said without it
MOVED_ON = "moved_on"
"""Predicate of what nobody has seen for a while and has probably gone its way since: `place` says where it is now."""


@dataclass(frozen=True)
class WorldObject:
    """One object: the signature (2.3) of an anchor in one hypothesis.

    id : symbol, unique and stable ("cup-3"). position (3,) m, velocity (3,) m/s, covariance (3, 3) m² of the
    position, world frame; those of the uniform distribution over `region` where it is lost. attributes :
    {"class": {"cup": 0.97, ...}, "color": {...}}, each sums to one, less the share of values that nobody has named
    yet; what was never measured is not among them. existence : probability that it is there.
    lost : not where it was, anywhere in `region`. last_seen, first_seen : stamps of measurements, s.
    behaviors : probability of each behaviour model (2.2): constant_position, constant_velocity, uniform.
    alternatives : ids that other hypotheses give to the same object. process_noise : (3, 3) m²/s by which the
    covariance grows while nobody looks. quantities : {"size": (mean, variance)}, continuous attributes, SI units.
    usual : probability by place of a lost object, where it is known where it usually is at this time of day, and of one
    that nobody has seen for a while and that has probably gone its way since; its position is where it was seen.
    """

    id: str
    position: FloatArray
    velocity: FloatArray
    covariance: FloatArray
    attributes: Mapping[str, Mapping[str, float]]
    existence: float
    lost: bool
    last_seen: float
    first_seen: float = 0.0
    behaviors: Mapping[str, float] = field(default_factory=dict)
    region: Box | None = None
    place: str = ""
    place_probability: float = 0.0
    predicates: tuple[str, ...] = ()
    alternatives: tuple[str, ...] = ()
    process_noise: FloatArray = field(default_factory=lambda: np.zeros((3, 3)))
    quantities: Mapping[str, tuple[float, float]] = field(default_factory=dict)
    usual: Mapping[str, float] = field(default_factory=dict)

    def most_probable(self, attribute: str) -> str:
        """The most probable value of an attribute, "" where nothing is known about it."""
        return most_probable(self.attributes.get(attribute))


def most_probable(distribution: Mapping[str, float] | None) -> str:
    """The most probable value, "" where nothing is known."""
    return max(distribution, key=distribution.__getitem__) if distribution else ""


@dataclass(frozen=True)
class WorldState:
    """One hypothesis at a stamp.

    objects : what exists in it, ordered by first appearance. probability : of the hypothesis, normalised over all
    that are kept. expected_count : expected number of objects over all hypotheses. stamp : s. epoch : counts
    up when time jumped back and a new run began. associations : per detection of the evidence the id of its
    object, None for clutter or an object not believed in yet.
    """

    objects: tuple[WorldObject, ...]
    probability: float
    expected_count: float
    stamp: float
    epoch: int = 0
    hypothesis: int = 0
    associations: tuple[str | None, ...] = ()

    def find(self, object_id: str) -> WorldObject | None:
        """The object with this id, None where the hypothesis has none."""
        return next((item for item in self.objects if item.id == object_id), None)
