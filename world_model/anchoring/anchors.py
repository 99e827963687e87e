"""The state of anchoring: leaves, tracks, clusters of hypotheses, and what is shown of them (Θ of section 2.5).

Parts act on it: `associate` (which detection is of which anchor), `beliefs` (what is believed in and how it is called),
`recognition` (what was known and was carried), `guidance` (where movers go), `single` (what is said about one object)
and `present` (what others get to see). None of them keeps anything of its own about an anchor.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable, Mapping, Sequence

import numpy as np
import numpy.typing as npt

from estimation.checks import FloatArray
from estimation.errors import InputError
from world_model.anchoring.attributes import CLASS, Gaussian, Quantities, Vocabulary
from world_model.anchoring.loops.branching import presence, same_worlds
from world_model.anchoring.loops.clusters import Cluster, Track, combined
from world_model.anchoring.loops.expansion import components, unify
from world_model.anchoring.loops.kernels import class_of
from world_model.anchoring.loops.leaves import AWAY, MOVING, REST, IntArray, Leaves, Pool, leaves_in
from world_model.anchoring.touching import Rounds
from world_model.anchoring.unseen import Unseen
from world_model.config import WorldModelConfig, detector_table, motion_table
from world_model.evidence import Distribution
from world_model.predictions import Course
from world_model.state import WorldObject

THRESHOLD = 11.5  # Hypotheses less probable than the best of their cluster by e to this are dropped
DEPENDENCE = 1e-4  # Total variation from which two tracks are dependent
LEAST_PRESENCE = 1e-6  # An anchor less probably there, never believed in, is dropped
FORGOTTEN_SIGMA = 3.0
"""m: a mover known less well than this says no more than that some object is somewhere; its anchor goes."""


class Anchors:
    """pool : leaves. tracks, clusters : by number. shown : believed objects of the most probable world, by number of
    track. expected : number of objects by cluster. courses : where movers are expected to go, by track. open : clusters
    with more than one hypothesis. fresh : tracks believed in for the first time in this look. names : the highest
    number in use by class. stamp : of the newest look, s."""

    def __init__(self, config: WorldModelConfig) -> None:
        self.config = config
        known = {"class": config.classes, "color": config.colors}
        known |= {name: () for name in config.attributes if name not in known}
        self.vocabulary = Vocabulary(known, config.class_accuracy)
        self.quantities = Quantities(config.quantities)
        self.motion = motion_table(self.vocabulary.values["class"], config.motion)
        self.detector = detector_table(config)
        self.persistence = np.maximum(self.detector[:, 2], 0.0)
        self.unseen = Unseen(config)
        self.reset()

    def reset(self) -> None:
        """Forget all anchors; the vocabulary stays."""
        self.pool = Pool(self.vocabulary.width, len(self.quantities.names))
        self.tracks: dict[int, Track] = {}
        self.clusters: dict[int, Cluster] = {}
        self.shown: dict[int, WorldObject] = {}
        self.expected: dict[int, float] = {}
        self.courses: dict[int, Course] = {}
        self.open: set[int] = set()
        self.fresh: list[int] = []
        self.names: Counter[str] = Counter()
        self.stamp = 0.0
        self._next = 0
        self.unseen.reset()
        self.rounds = Rounds()

    @property
    def leaves(self) -> Leaves:
        return self.pool.leaves

    def learn_value(self, name: str, value: str) -> None:
        """A new value of an attribute whose values are not fixed."""
        column = self.vocabulary.add(name, value)
        self.pool.widen(column, None if name == CLASS else column + 1 - len(self.vocabulary.values[name]))
        if name == "class":
            self.motion = motion_table(self.vocabulary.values["class"], self.config.motion)

    def refused(
        self, told: Sequence[tuple[Mapping[str, Distribution], Mapping[str, Gaussian]]]
    ) -> dict[int, str]:
        """Which of these attributes and quantities speak of what nobody knows, and why, by index."""
        out = {}
        for index, (attributes, quantities) in enumerate(told):
            try:
                self.vocabulary.check_one(f"objects[{index}]", attributes)
                self.quantities.check(f"objects[{index}]", quantities)
            except InputError as error:
                out[index] = str(error)
        return out

    def numbers(self, count: int) -> IntArray:
        """Numbers of new tracks (count,)."""
        self._next += count
        return np.arange(self._next - count, self._next)

    def find(self, object_id: str) -> Track:
        """The track with this symbol; InputError where there is none."""
        for track in self.tracks.values():
            if track.id == object_id:
                return track
        raise InputError(f"object_id: no object {object_id!r} is known")

    def named(self) -> dict[str, Track]:
        """Tracks by their symbols."""
        return {track.id: track for track in self.tracks.values() if track.id is not None}

    def leaves_of(self, track: Track) -> IntArray:
        """Its leaves in all hypotheses."""
        cluster = self.clusters[track.cluster]
        return leaves_in(cluster.rows[:, cluster.tracks.index(track.number)])

    def best_leaf(self, track: Track) -> int:
        """Its leaf in the most probable hypothesis, -1 for none."""
        cluster = self.clusters[track.cluster]
        return int(cluster.rows[0, cluster.tracks.index(track.number)])

    def motion_row(self, slot: int) -> int:
        """Row of `motion` for a leaf."""
        return int(class_of(self.leaves.attributes[slot], len(self.motion) - 1))

    def moves(self, slot: int) -> bool:
        """Whether a leaf is of a class that moves by itself."""
        return bool(self.motion[self.motion_row(slot), 0] > 0.5)

    def class_name(self, slot: int) -> str:
        """The most probable class of a leaf, "" where there is none."""
        names, row = self.vocabulary.values["class"], self.motion_row(slot)
        return names[row] if row < len(names) else ""

    def resting(self, numbers: Iterable[int]) -> dict[int, int]:
        """Those of these objects that rest, and their leaves in the most probable world."""
        out, behavior = {}, self.leaves.behavior
        for number in numbers:
            track = self.tracks.get(number)
            if track is None or track.lost:
                continue
            slot = self.best_leaf(track)
            if slot >= 0 and behavior[slot, REST] > 0.0 and not self.moves(slot):
                out[number] = slot
        return out

    def dispersed(self, slot: int) -> bool:
        """Whether a leaf is of a mover that may be anywhere."""
        leaves = self.leaves
        moves = leaves.behavior[slot, MOVING] > leaves.behavior[slot, REST] + leaves.behavior[slot, AWAY]
        return bool(moves and leaves.moving_cov[slot].diagonal()[:3].max() > FORGOTTEN_SIGMA**2)

    def joined(self, members: list[int]) -> Cluster:
        """Take clusters out as one, with the best combinations of their hypotheses; it is to be filed again."""
        parts = [self.clusters.pop(number) for number in members]
        whole = combined(parts, self.config.hypotheses, THRESHOLD)
        if len(members) > 1:
            mine = np.flatnonzero(np.isin(self.leaves.track, np.array(whole.tracks)))
            for slot in np.setdiff1d(mine, whole.rows).tolist():
                self.pool.give(slot)
        return whole

    def restrict(
        self, number: int, keep: npt.NDArray[np.bool_], gained: FloatArray | None = None
    ) -> list[int]:
        """Hypotheses of a cluster that turned out to be impossible go; returns the clusters that are left.

        gained (H,) : log weights that the hypotheses gain, none by default.
        """
        cluster = self.clusters.pop(number)
        weights = cluster.weights if gained is None else cluster.weights + gained
        rows, weights = unify(np.ascontiguousarray(cluster.rows[keep]), weights[keep])
        self.sweep(cluster.rows, rows)
        return self.divide(list(cluster.tracks), rows, weights)

    def without_names(self, rows: IntArray, weights: FloatArray) -> tuple[IntArray, FloatArray]:
        """Join hypotheses that differ only in which anchor is called what: no later evidence could tell."""
        kept, own = same_worlds(self.leaves, rows, weights, self.persistence, self.vocabulary.width)
        if len(own) < len(weights):
            self.sweep(rows, kept)
        return kept, own

    def divide(self, tracks: list[int], rows: IntArray, weights: FloatArray) -> list[int]:
        """File clusters of what is left dependent (section 2.5.3); anchors that are not worth keeping go."""
        there = presence(self.leaves, rows, weights)
        names = [self.tracks[t].id for t in tracks]
        keep = [
            c
            for c, name in enumerate(names)
            if (there[c] > LEAST_PRESENCE or (name is not None and (rows[:, c] >= 0).any()))
            and not (rows[0, c] >= 0 and self.dispersed(rows[0, c]))
        ]
        if len(keep) < len(tracks):
            before = rows
            rows = np.ascontiguousarray(rows[:, keep])
            self.sweep(before, rows)
            for c in set(range(len(tracks))) - set(keep):
                self.forget_track(tracks[c])
            tracks = [tracks[c] for c in keep]
            if not tracks:
                return []
            rows, weights = unify(rows, weights)
        labels = np.arange(len(tracks)) if len(weights) == 1 else components(rows, weights, DEPENDENCE)
        made = []
        for label in sorted(set(labels.tolist())):
            columns = np.flatnonzero(labels == label)
            part, own = unify(np.ascontiguousarray(rows[:, columns]), weights)
            number = tracks[columns[0]]
            self._file(number, Cluster([tracks[c] for c in columns], part, own))
            made.append(number)
        return made

    def drop(self, number: int) -> None:
        """Take out a cluster of one track and one hypothesis."""
        cluster = self.clusters.pop(number)
        self.pool.give(int(cluster.rows[0, 0]))
        self.forget_track(number)

    def forget_track(self, number: int) -> None:
        """A track whose leaves are gone."""
        del self.tracks[number]
        self.courses.pop(number, None)
        self.shown.pop(number, None)
        self.expected.pop(number, None)
        self.open.discard(number)

    def tidy(self) -> None:
        """Drop anchors that never were believed in and are not looked at any more."""
        leaves = self.leaves
        for number, cluster in list(self.clusters.items()):
            track = self.tracks[cluster.tracks[0]]
            if not cluster.lonely:
                continue
            slot = int(cluster.rows[0, 0])
            old = self.stamp - leaves.last[slot]
            if (track.id is None and old > 10.0) or (
                leaves.here(slot) < 0.1 and not track.lost and old > 600.0
            ):
                self.drop(number)

    def symbol(self, number: int) -> str | None:
        """The symbol of a track that is believed in."""
        track = self.tracks.get(number)
        return track.id if track is not None and number in self.shown else None

    def _file(self, number: int, cluster: Cluster) -> None:
        """File a cluster under the number of its first track."""
        self.clusters[number] = cluster
        for track in cluster.tracks:
            self.tracks[track].cluster = number
            if track != number:
                self.expected.pop(track, None)
                self.open.discard(track)
        if len(cluster.weights) > 1:
            self.open.add(number)
        else:
            self.open.discard(number)

    def sweep(self, before: IntArray, after: IntArray) -> None:
        """Give back leaves of hypotheses `before` that those `after` do not use."""
        keep = {-1, *after.ravel().tolist()}
        for slot in dict.fromkeys(before.ravel().tolist()):
            if slot not in keep:
                self.pool.give(slot)
