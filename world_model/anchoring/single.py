"""What is said about single objects: verified, lost, renamed, remembered (section 3.4, and services of the node)."""

from __future__ import annotations

import re
from abc import ABC, abstractmethod
from collections import Counter
from collections.abc import Mapping
from dataclasses import replace

import numpy as np
import numpy.typing as npt

from estimation.checks import FloatArray
from estimation.errors import InputError
from world_model.anchoring.clusters import Cluster, Track, lonely
from world_model.anchoring.kernels import copy_leaf, correct, predict, start_moving
from world_model.anchoring.leaves import AWAY, MOVING, NONE, REST, IntArray, Pool
from world_model.anchoring.quantities import Quantities
from world_model.anchoring.vocabulary import Vocabulary
from world_model.config import WorldModelConfig
from world_model.state import Box, WorldObject

GATE = 25.0
"""Squared Mahalanobis distance from which a verified object was moved rather than measured badly."""


class SingleObjects(ABC):
    """Part of `Anchoring`: acts on all leaves of one track in every hypothesis."""

    config: WorldModelConfig
    vocabulary: Vocabulary
    quantities: Quantities
    motion: FloatArray
    pool: Pool
    tracks: dict[int, Track]
    clusters: dict[int, Cluster]
    shown: dict[int, WorldObject]
    _names: Counter[str]
    _next: int
    _stamp: float

    @abstractmethod
    def learn_value(self, name: str, value: str) -> None: ...

    @abstractmethod
    def _show(self, number: int, stamp: float) -> None: ...

    @abstractmethod
    def _object(self, track: Track, slot: int) -> WorldObject: ...

    @abstractmethod
    def _lead_copy(self, track: Track, slot: int, stamp: float) -> None: ...

    @abstractmethod
    def _divide(self, tracks: list[int], rows: IntArray, weights: FloatArray) -> list[int]: ...

    @abstractmethod
    def _keep_rows(self, number: int, keep: npt.NDArray[np.bool_]) -> None: ...

    def find(self, object_id: str) -> Track:
        """The track with this symbol; InputError where there is none."""
        for track in self.tracks.values():
            if track.id == object_id:
                return track
        raise InputError(f"object_id: no object {object_id!r} is known")

    def _leaves_of(self, track: Track) -> IntArray:
        cluster = self.clusters[track.cluster]
        column = np.unique(cluster.rows[:, cluster.tracks.index(track.number)])
        return column[column >= 0]

    def lose(self, track: Track, stamp: float, region: Box | None = None) -> None:
        """It is not where it was: anywhere in a region (of all objects by default), in all hypotheses."""
        leaves = self.pool.leaves
        for slot in self._leaves_of(track):
            predict(leaves, slot, stamp, self.motion, self.config.removed_per_second)
            pi = leaves.behavior[slot]
            pi[AWAY] = 1.0 - pi[NONE]
            pi[REST] = pi[MOVING] = 0.0
        track.lost, track.region = True, region
        self._show(track.cluster, stamp)

    def verify(
        self, track: Track, z: FloatArray, R: FloatArray, likelihood: FloatArray, stamp: float, lag: float
    ) -> None:
        """A measurement known to be of this object: it exists, and is here in every hypothesis."""
        leaves = self.pool.leaves
        cluster = self.clusters[track.cluster]
        column = cluster.tracks.index(track.number)
        with_it = cluster.rows[:, column] >= 0
        if with_it.any() and not with_it.all():
            self._keep_rows(track.cluster, with_it)
            if track.number not in self.tracks:
                return
        for slot in self._leaves_of(track):
            predict(leaves, slot, stamp, self.motion, self.config.removed_per_second)
            moving = leaves.behavior[slot, MOVING] > leaves.behavior[slot, REST]
            mean = leaves.moving[slot, :3] if moving else leaves.rest[slot]
            spread = leaves.moving_cov[slot, :3, :3] if moving else leaves.rest_cov[slot]
            apart = z - mean
            far = apart @ np.linalg.solve(spread + R, apart) > GATE
            if far or leaves.behavior[slot, REST] + leaves.behavior[slot, MOVING] < 0.1:
                leaves.rest[slot] = z
                leaves.rest_cov[slot] = R
                start_moving(leaves, slot, self.motion[-1, 3], 0.0)
                leaves.behavior[slot] = [1.0, 0.0, 0.0, 0.0]
            correct(leaves, slot, z, R, lag, likelihood, self.vocabulary.blocks, stamp - lag)
        track.lost, track.region = False, None
        self._show(track.cluster, stamp)

    def remove(self, track: Track) -> None:
        """Take it out of every hypothesis."""
        number = track.cluster
        cluster = self.clusters[number]
        column = cluster.tracks.index(track.number)
        rows = cluster.rows.copy()
        rows[:, column] = -1
        for slot in self._leaves_of(track):
            self.pool.give(slot)
        track.id = None
        del self.clusters[number]
        for made in self._divide(list(cluster.tracks), rows, cluster.weights):
            self._show(made, self._stamp)

    def set_class(self, track: Track, name: str) -> None:
        """Its class is known from now on. Raises InputError for an unknown class."""
        names = self.vocabulary.values["class"]
        if name not in names:
            raise InputError(f"class_name: unknown class {name!r}; known are {', '.join(names)}")
        for slot in self._leaves_of(track):
            row = self.pool.leaves.attributes[slot, : len(names)]
            row[:] = 1e-6
            row[names.index(name)] = 1.0 - 1e-6 * (len(names) - 1)
        self._show(track.cluster, self._stamp)

    def rename(self, track: Track, name: str) -> None:
        """Its symbol. Raises InputError where another object has it."""
        if any(other.id == name for other in self.tracks.values() if other is not track):
            raise InputError(f"new_object_id: {name!r} is the id of another object")
        track.id = name
        self._show(track.cluster, self._stamp)

    def remember(self, item: WorldObject, stamp: float) -> None:
        """An object as a store had it."""
        for name, distribution in item.attributes.items():
            for value in distribution:
                if name in self.vocabulary.values and value not in self.vocabulary.values[name]:
                    self.learn_value(name, value)
        slot, leaves = self.pool.take(), self.pool.leaves
        number = self._next
        self._next += 1
        leaves.track[slot] = number
        leaves.rest[slot] = item.position
        leaves.rest_cov[slot] = item.covariance
        leaves.moving[slot] = [*item.position, *item.velocity]
        leaves.moving_cov[slot] = np.diag([*np.diag(item.covariance), 0.5, 0.5, 0.5])
        share = item.behaviors or {"constant_position": item.existence}
        leaves.behavior[slot] = [
            share.get("constant_position", 0.0),
            share.get("constant_velocity", 0.0) + share.get("predicted", 0.0),
            share.get("uniform", 0.0),
            0.0,
        ]
        leaves.led[slot] = 0.0
        leaves.variances[slot] = -1.0
        taken = {name: value for name, value in item.quantities.items() if name in self.quantities.names}
        self.quantities.learn(leaves, np.array([slot]), *self.quantities.arrays([taken]))
        leaves.behavior[slot, NONE] = max(1.0 - leaves.behavior[slot].sum(), 0.0)
        leaves.visible[slot] = 1.0
        leaves.attributes[slot] = self.vocabulary.prior()
        for (start, end), name in zip(self.vocabulary.blocks, self.vocabulary.names, strict=True):
            known = item.attributes.get(name)
            if known:
                given = np.array([known.get(value, 0.0) for value in self.vocabulary.values[name]])
                leaves.attributes[slot, start:end] = (given + 1e-4 / len(given)) / (given.sum() + 1e-4)
        leaves.stamp[slot], leaves.last[slot] = stamp, item.last_seen
        leaves.first[slot], leaves.hits[slot], leaves.missed[slot] = item.first_seen, 3, 0.0
        self.tracks[number] = Track(number, number, item.id, item.lost, recognised=True, region=item.region)
        self.clusters[number] = lonely(number, slot)
        counted = re.fullmatch(r"(.+)-(\d+)", item.id)
        if counted:
            self._names[counted[1]] = max(self._names[counted[1]], int(counted[2]))
        self._show(number, stamp)

    def reserve(self, names: Mapping[str, int]) -> None:
        """Symbols up to these numbers, by class, are taken."""
        for name, number in names.items():
            self._names[name] = max(self._names[name], number)

    def predicted(self, stamp: float) -> list[WorldObject]:
        """What is shown, propagated to `stamp` on copies."""
        out = []
        self.pool.reserve(1)
        for number in self.shown:
            track = self.tracks[number]
            cluster = self.clusters[track.cluster]
            slot = int(cluster.rows[0, cluster.tracks.index(number)])
            scratch = self.pool.take()
            leaves = self.pool.leaves
            copy_leaf(leaves, slot, scratch)
            self._lead_copy(track, scratch, stamp)
            predict(leaves, scratch, stamp, self.motion, self.config.removed_per_second)
            made = self._object(track, scratch)
            out.append(replace(made, alternatives=self.shown[number].alternatives))
            self.pool.give(scratch)
        return out
