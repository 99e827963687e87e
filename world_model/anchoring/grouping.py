"""Clusters that fall apart, join, and take in that a new anchor may be a known object (sections 2.5.3 and 2.6.2)."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import numpy.typing as npt

from estimation.checks import FloatArray
from world_model.anchoring.beliefs import LEAST_PRESENCE, Beliefs
from world_model.anchoring.branching import presence, same_worlds, sweep
from world_model.anchoring.clusters import Cluster, Track, combined
from world_model.anchoring.expansion import components, unify
from world_model.anchoring.kernels import copy_leaf, learn_attributes
from world_model.anchoring.leaves import MOVING, REST, IntArray
from world_model.anchoring.recognition import alternatives, candidates, odds
from world_model.behaviors import motion_of
from world_model.memory.habits import Habits

THRESHOLD = 11.5
"""Hypotheses less probable than the best of their cluster by e to this are dropped."""
DEPENDENCE = 1e-4
"""Total variation from which two tracks are dependent."""


class Grouping(Beliefs):
    """Part of `Anchoring`: files tracks under clusters and drops what is not worth keeping."""

    persistence: FloatArray
    habits: Habits | None = None
    """Where things usually are, if that is learned."""

    def _keep_rows(self, number: int, keep: npt.NDArray[np.bool_]) -> None:
        """Hypotheses of a cluster that turned out to be impossible go."""
        cluster = self.clusters[number]
        rows, weights = unify(np.ascontiguousarray(cluster.rows[keep]), cluster.weights[keep])
        sweep(self.pool.leaves, self.pool.free, self.pool.top, cluster.rows, rows)
        del self.clusters[number]
        for made in self._divide(list(cluster.tracks), rows, weights):
            self._show(made, self._stamp)

    def _same_worlds(self, rows: IntArray, weights: FloatArray) -> tuple[IntArray, FloatArray]:
        """Join hypotheses that differ only in which anchor is called what: no later evidence could tell."""
        pool = self.pool
        kept, own = same_worlds(pool.leaves, rows, weights, self.persistence, self.vocabulary.width)
        if len(own) < len(weights):
            sweep(pool.leaves, pool.free, pool.top, rows, kept)
        return kept, own

    def _drop_unused(self, members: list[int], whole: Cluster) -> None:
        """Leaves of combinations that were not kept are given back."""
        leaves = self.pool.leaves
        numbers = np.array(whole.tracks)
        mine = np.flatnonzero(np.isin(leaves.track, numbers))
        for slot in np.setdiff1d(mine, whole.rows).tolist():
            self.pool.give(slot)

    def _divide(self, tracks: list[int], rows: IntArray, weights: FloatArray) -> list[int]:
        """Clusters of what is left dependent; anchors that are not worth keeping go."""
        there = presence(self.pool.leaves, rows, weights)
        names = [self.tracks[t].id for t in tracks]
        keep = [
            c
            for c, name in enumerate(names)
            if (there[c] > LEAST_PRESENCE or (name is not None and (rows[:, c] >= 0).any()))
            and not (rows[0, c] >= 0 and self._dispersed(rows[0, c]))
        ]
        if len(keep) < len(tracks):
            before = rows
            rows = np.ascontiguousarray(rows[:, keep])
            sweep(self.pool.leaves, self.pool.free, self.pool.top, before, rows)
            for c in set(range(len(tracks))) - set(keep):
                self._forget_track(tracks[c])
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
            self._place(number, Cluster([tracks[c] for c in columns], part, own))
            made.append(number)
        return made

    def _place(self, number: int, cluster: Cluster) -> None:
        """File a cluster under the number of its first track."""
        self.clusters[number] = cluster
        for track in cluster.tracks:
            self.tracks[track].cluster = number
            if track != number:
                self.expected.pop(track, None)
                self._open.discard(track)
        if len(cluster.weights) > 1:
            self._open.add(number)
        else:
            self._open.discard(number)

    def _recognise(self, number: int, stamp: float, known: Sequence[Track]) -> None:
        """Hypotheses in which a new anchor is one of the known objects, which was carried; then it is shown."""
        track = self.tracks[number]
        cluster = self.clusters[track.cluster]
        new = int(cluster.rows[0, cluster.tracks.index(number)])
        named = [other for other in known if other.number in self.tracks]
        if named and new >= 0:
            slots = np.array([self._best_leaf(other) for other in named])
            named = [other for other, slot in zip(named, slots, strict=True) if slot >= 0]
            slots = slots[slots >= 0]
            values = self._odds(slots, new, track)
            for index in candidates(values):
                if number in self.tracks:
                    self._add_alternatives(track, named[index])
        if number in self.tracks:
            self._show(self.tracks[number].cluster, stamp)

    def _odds(self, slots: IntArray, new: int, track: Track) -> FloatArray:
        leaves, classes = self.pool.leaves, self.vocabulary.classes
        rows = leaves.attributes[slots, :classes].argmax(1) if classes else np.full(len(slots), -1)
        volume = self.unseen.volume
        values = odds(leaves, slots, new, track, self.motion[rows, 2], self.vocabulary.blocks, volume)
        own = leaves.values[new][None], leaves.variances[new][None]
        values *= np.exp(self.quantities.log_factors(leaves, slots, *own)[:, 0])
        if self.habits is not None:
            values *= self._by_habit(slots, new)
        return values

    def _by_habit(self, slots: IntArray, new: int) -> FloatArray:
        """How much likelier (n,) known objects are to be put down where the new one is than anywhere."""
        assert self.habits is not None
        (x0, x1), (y0, y1), _ = self.config.region
        leaves, factors = self.pool.leaves, np.ones(len(slots))
        spot, stamp = leaves.rest[new], float(leaves.first[new])
        for index, slot in enumerate(slots.tolist()):
            name = self._class_name(slot)
            trust = motion_of(name, self.config.motion).usual_place
            known = self.tracks[int(leaves.track[slot])].id or ""
            factors[index] = self.habits.odds(known, name, spot, stamp, trust, (x1 - x0) * (y1 - y0))
        return factors

    def _add_alternatives(self, new: Track, known: Track) -> None:
        members = sorted({new.cluster, known.cluster})
        whole = combined([self.clusters.pop(n) for n in members], self.config.hypotheses, THRESHOLD)
        if len(members) > 1:
            self._drop_unused(members, whole)
        a, b = whole.tracks.index(new.number), whole.tracks.index(known.number)
        if not (whole.rows[:, a] >= 0).any():
            # No hypothesis that is worth keeping has the new anchor any more.
            self._divide(list(whole.tracks), whole.rows, whole.weights)
            return
        slots = np.unique(whole.rows[:, b])
        slots = slots[slots >= 0]
        values = dict(
            zip(slots.tolist(), self._odds(slots, self._any_leaf(whole, a), new).tolist(), strict=True)
        )
        made: dict[tuple[int, int], int] = {}
        rows, weights = [whole.rows], [whole.weights]
        for h, leaf, old, weight in alternatives(whole, a, b, values):
            if (leaf, old) not in made:
                slot = self.pool.take()
                leaves = self.pool.leaves
                copy_leaf(leaves, leaf, slot)
                leaves.track[slot] = known.number
                learn_attributes(leaves, slot, leaves.attributes[old], self.vocabulary.blocks)
                leaves.first[slot] = leaves.first[old]
                made[leaf, old] = slot
            row = whole.rows[h].copy()
            row[a], row[b] = -1, made[leaf, old]
            rows.append(row[None])
            weights.append(np.array([weight]))
        joint, own = unify(np.concatenate(rows), np.concatenate(weights))
        self._divide(whole.tracks, joint, own)
        self._show(known.cluster, self._stamp)

    @staticmethod
    def _any_leaf(cluster: Cluster, column: int) -> int:
        used = cluster.rows[:, column]
        return int(used[used >= 0][0])

    def _tidy(self, stamp: float) -> None:
        """Drop anchors that never were believed in and are not looked at any more."""
        leaves = self.pool.leaves
        for number, cluster in list(self.clusters.items()):
            track = self.tracks[cluster.tracks[0]]
            if not cluster.lonely:
                continue
            slot = int(cluster.rows[0, 0])
            here = leaves.behavior[slot, REST] + leaves.behavior[slot, MOVING]
            old = stamp - leaves.last[slot]
            if (track.id is None and old > 10.0) or (here < 0.1 and not track.lost and old > 600.0):
                self.pool.give(slot)
                del self.clusters[number]
                self._forget_track(number)
