"""What is believed: objects of the most probable world and of all others, their symbols, and how many there are."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import replace

import numpy as np

from estimation.checks import FloatArray
from world_model.anchoring.anchors import LEAST_PRESENCE, Anchors
from world_model.anchoring.loops.branching import GONE, other_names, presence, same_spot
from world_model.anchoring.loops.clusters import Cluster, Track, best_sums
from world_model.anchoring.loops.leaves import AWAY, MOVING, NONE, REST, IntArray, leaves_in
from world_model.anchoring.present import Presentation
from world_model.state import BELIEVED, WorldObject

LEAST_ALTERNATIVE = 0.01  # Probability from which another symbol for an object is worth mentioning
NAMED = 0.95  # Probability from which an anchor gets a symbol and is believed in for the first time
LATELY = 1.0  # s after its first detection that it may turn out that an object began otherwise
LOST_SIGMA = 1.5
"""m: a mover that is looked for, but hidden, is shown until its position is known less well than this."""


class Beliefs:
    """Keeps `anchors.shown` and `anchors.expected` up to date."""

    def __init__(self, anchors: Anchors, presentation: Presentation) -> None:
        self.anchors = anchors
        self.presentation = presentation
        self.guidance = presentation.guidance

    def show(self, numbers: Iterable[int]) -> None:
        """Bring what is shown and expected of clusters up to date."""
        for number in numbers:
            cluster = self.anchors.clusters.get(number)
            if cluster is None:
                continue
            if cluster.lonely:
                self._show_lonely(number, cluster)
                continue
            here = presence(self.anchors.leaves, cluster.rows, cluster.weights)
            self.anchors.expected[number] = float(here.sum())
            for track_number, slot in zip(list(cluster.tracks), cluster.rows[0].tolist(), strict=True):
                self._show_track(self.anchors.tracks[track_number], slot)
            if len(cluster.weights) > 1 and len(cluster.tracks) > 1:
                self._name_alternatives(cluster)

    def _show_lonely(self, number: int, cluster: Cluster) -> None:
        anchors, leaves = self.anchors, self.anchors.leaves
        slot = int(cluster.rows[0, 0])
        there = 1.0 - float(leaves.behavior[slot, NONE])
        here = float(leaves.here(slot))
        track = anchors.tracks[cluster.tracks[0]]
        if anchors.dispersed(slot) or (track.id is None and here < LEAST_PRESENCE):
            anchors.drop(number)
            return
        if track.id is None and here <= NAMED:
            anchors.expected[number] = here
            return
        anchors.expected[number] = here if leaves.missed[slot] > 0.5 else there
        self._show_track(track, slot)

    def _name_alternatives(self, cluster: Cluster) -> None:
        """Say of shown objects by which symbols they go in other hypotheses."""
        anchors = self.anchors
        shares = other_names(anchors.leaves, cluster.rows, cluster.weights)
        for column in np.flatnonzero((shares > LEAST_ALTERNATIVE).any(1)).tolist():
            item = anchors.shown.get(cluster.tracks[column])
            if item is None:
                continue
            order = np.argsort(-shares[column], kind="stable")
            order = order[shares[column, order] > LEAST_ALTERNATIVE]
            names = (anchors.tracks[cluster.tracks[other]].id for other in order.tolist())
            anchors.shown[cluster.tracks[column]] = replace(item, alternatives=tuple(n for n in names if n))

    def _show_track(self, track: Track, slot: int) -> None:
        anchors = self.anchors
        if slot < 0 or not self.believed(track, slot):
            anchors.shown.pop(track.number, None)
            return
        if not track.recognised:
            track.recognised = True
            anchors.fresh.append(track.number)
            return
        if track.id is None:
            track.id = self._taken_over(track, slot) or self._name(slot)
        anchors.shown[track.number] = self.presentation.made(track, slot)

    def _taken_over(self, track: Track, slot: int) -> str | None:
        """The symbol of what was believed to be here lately, if the most probable world now knows nothing of that.

        So an object whose beginning is seen otherwise, without a false detection say, keeps its symbol.
        """
        anchors, leaves = self.anchors, self.anchors.leaves
        cluster = anchors.clusters[track.cluster]
        for column, number in enumerate(cluster.tracks):
            other = anchors.tracks[number]
            now = int(cluster.rows[0, column])
            if other.id is None or (now >= 0 and leaves.behavior[now, [REST, MOVING]].sum() >= GONE):
                continue
            rows = leaves_in(cluster.rows[:, column])
            lately = rows[anchors.stamp - leaves.first[rows] < LATELY]
            if any(same_spot(leaves, row, slot) for row in lately):
                name, other.id = other.id, None
                return name
        return None

    def believed(self, track: Track, slot: int) -> bool:
        """Whether an anchor is part of the world that a leaf of it is of.

        One that nobody looked for stays; one that was looked for and not seen must still be there probably.
        """
        leaves = self.anchors.leaves
        pi = leaves.behavior[slot]
        here = pi[REST] + pi[MOVING]
        led = track.number in self.anchors.courses
        if (pi[MOVING] > pi[REST] or led) and not self._followed(track, slot):
            return False
        if here > (BELIEVED if track.id is not None else NAMED):
            return True
        if track.id is None:
            return False
        return bool(
            (track.lost and pi[AWAY] > here)
            or (leaves.missed[slot] < BELIEVED and pi[MOVING] <= pi[REST] + pi[AWAY])
        )

    def _followed(self, track: Track, slot: int) -> bool:
        """Whether a mover was seen lately enough, or its course is known well enough, to say where it is."""
        leaves = self.anchors.leaves
        if self.guidance.led(track, slot):
            return bool(leaves.rest_cov[slot].diagonal()[:2].max() < LOST_SIGMA**2)
        looked_for = leaves.missed[slot] > BELIEVED
        if not looked_for and self.anchors.stamp - leaves.last[slot] > self.anchors.rounds.patience:
            return False
        return bool(leaves.moving_cov[slot].diagonal()[:3].max() < LOST_SIGMA**2)

    def _name(self, slot: int) -> str:
        anchors = self.anchors
        name = anchors.class_name(slot) or "object"
        taken = {track.id for track in anchors.tracks.values()} if anchors.names[name] == 0 else ()
        while True:
            anchors.names[name] += 1
            if f"{name}-{anchors.names[name]}" not in taken:
                return f"{name}-{anchors.names[name]}"

    @property
    def expected_count(self) -> float:
        """Expected number of objects over all hypotheses."""
        return float(sum(self.anchors.expected.values()))

    def probabilities(self) -> FloatArray:
        """Of the best combinations of hypotheses over all clusters (K,), normalised."""
        return self._combined()[0]

    def worlds(self) -> list[tuple[list[WorldObject], float]]:
        """Objects and probability of every combination of hypotheses that is kept."""
        anchors = self.anchors
        numbers = sorted(anchors.open)
        shares, picks = self._combined()
        out = []
        for pick, share in zip(picks, shares, strict=True):
            shown = dict(anchors.shown)
            for number, h in zip(numbers, pick, strict=True):
                cluster = anchors.clusters[number]
                for track_number, slot in zip(cluster.tracks, cluster.rows[h].tolist(), strict=True):
                    track = anchors.tracks[track_number]
                    shown.pop(track_number, None)
                    if slot >= 0 and self.believed(track, slot):
                        shown[track_number] = self.presentation.made(track, slot)
            out.append((list(shown.values()), float(share)))
        return out

    def _combined(self) -> tuple[FloatArray, IntArray]:
        """Probabilities (K,) of combinations of hypotheses of open clusters, and which of each (K, clusters)."""
        anchors = self.anchors
        weights = [anchors.clusters[number].weights for number in sorted(anchors.open)]
        sums, picks = best_sums(weights, anchors.config.hypotheses)
        shares = np.exp(sums - sums[0])
        return shares / shares.sum(), picks
