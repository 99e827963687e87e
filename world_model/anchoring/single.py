"""What is said about single objects: verified, lost, renamed, removed (section 3.4, and services of the node)."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from estimation.checks import FloatArray
from estimation.errors import InputError
from world_model.anchoring.anchors import Anchors
from world_model.anchoring.beliefs import Beliefs
from world_model.anchoring.loops.clusters import Track
from world_model.anchoring.loops.kernels import correct, predict, start_moving
from world_model.anchoring.loops.leaves import AWAY, MOVING, NONE, REST
from world_model.evidence import Measurements
from world_model.state import Box

GATE = 25.0  # Squared Mahalanobis distance from which a verified object was moved rather than measured badly


class SingleObjects:
    """Acts on all leaves of one track, in every hypothesis."""

    def __init__(self, anchors: Anchors, beliefs: Beliefs) -> None:
        self.anchors = anchors
        self.beliefs = beliefs

    def _predict(self, track: Track, stamp: float) -> list[int]:
        """Its leaves, at `stamp`."""
        anchors = self.anchors
        slots: list[int] = anchors.leaves_of(track).tolist()
        for slot in slots:
            predict(anchors.leaves, slot, stamp, anchors.motion, anchors.config.removed_per_second)
        return slots

    def lose(self, track: Track, stamp: float, region: Box | None = None) -> None:
        """It is not where it was: anywhere in a region (of all objects by default), in all hypotheses."""
        for slot in self._predict(track, stamp):
            pi = self.anchors.leaves.behavior[slot]
            pi[AWAY] = 1.0 - pi[NONE]
            pi[REST] = pi[MOVING] = 0.0
        track.lost, track.region = True, region
        self.beliefs.show([track.cluster])

    def told(self, measured: Measurements, stamp: float, lag: float) -> tuple[Measurements, dict[int, int]]:
        """Detections that name a known object are its own; returns the others, and the track by index of these."""
        if not any(measured.object_ids):
            return measured, {}
        anchors = self.anchors
        named = anchors.named()
        verified: dict[int, int] = {}
        for index, object_id in enumerate(measured.object_ids):
            track = None if object_id is None else named.get(object_id)
            # One that was named before it may have taken this one along.
            if track is None or track.number in verified.values() or track.number not in anchors.tracks:
                continue
            likelihood = anchors.vocabulary.likelihoods(measured.attributes[index : index + 1])[0]
            self.verify(track, measured.positions[index], measured.covariances[index], likelihood, stamp, lag)
            if track.number not in anchors.tracks:
                continue  # so uncertain a measurement that it may be anywhere: it is nobody's any more
            slots = anchors.leaves_of(track)
            told, spreads = anchors.quantities.arrays([measured.quantities[index]] * len(slots))
            anchors.quantities.learn(anchors.leaves, slots, told, spreads)
            verified[index] = track.number
        others = [index for index in range(len(measured.positions)) if index not in verified]
        return measured.only(others), verified

    def verify(
        self, track: Track, z: FloatArray, R: FloatArray, likelihood: FloatArray, stamp: float, lag: float
    ) -> None:
        """A measurement known to be of this object: it exists, and is here in every hypothesis."""
        anchors = self.anchors
        cluster = anchors.clusters[track.cluster]
        with_it = cluster.rows[:, cluster.tracks.index(track.number)] >= 0
        if with_it.any() and not with_it.all():
            self.beliefs.show(anchors.restrict(track.cluster, with_it))
            if track.number not in anchors.tracks:
                return
        leaves = anchors.leaves
        for slot in self._predict(track, stamp):
            (mean,), (spread,) = leaves.spots(np.array([slot]))
            far = (z - mean) @ np.linalg.solve(spread + R, z - mean) > GATE
            if far or leaves.here(slot) < 0.1:
                leaves.rest[slot] = z
                leaves.rest_cov[slot] = R
                start_moving(leaves, slot, anchors.motion[-1, 3], 0.0)
                leaves.behavior[slot] = [1.0, 0.0, 0.0, 0.0]
            correct(leaves, slot, z, R, lag, likelihood, anchors.vocabulary.blocks, stamp - lag)
        track.lost, track.region = False, None
        self.beliefs.show([track.cluster])

    def remove(self, track: Track) -> None:
        """Take it out of every hypothesis."""
        anchors = self.anchors
        cluster = anchors.clusters[track.cluster]
        rows = cluster.rows.copy()
        rows[:, cluster.tracks.index(track.number)] = -1
        for slot in anchors.leaves_of(track):
            anchors.pool.give(slot)
        track.id = None
        del anchors.clusters[track.cluster]
        self.beliefs.show(anchors.divide(list(cluster.tracks), rows, cluster.weights))

    def set_class(self, track: Track, name: str) -> None:
        """Its class is known from now on. Raises InputError for an unknown class."""
        names = self.anchors.vocabulary.values["class"]
        if name not in names:
            raise InputError(f"class_name: unknown class {name!r}; known are {', '.join(names)}")
        for slot in self.anchors.leaves_of(track):
            row = self.anchors.leaves.attributes[slot, : len(names)]
            row[:] = 1e-6
            row[names.index(name)] = 1.0 - 1e-6 * (len(names) - 1)
        self.beliefs.show([track.cluster])

    def rename(self, track: Track, name: str) -> None:
        """Its symbol. Raises InputError where another object has it."""
        if any(other.id == name for other in self.anchors.tracks.values() if other is not track):
            raise InputError(f"new_object_id: {name!r} is the id of another object")
        track.id = name
        self.beliefs.show([track.cluster])

    def reserve(self, names: Mapping[str, int]) -> None:
        """Symbols up to these numbers, by class, are taken."""
        for name, number in names.items():
            self.anchors.names[name] = max(self.anchors.names[name], number)
