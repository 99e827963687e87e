"""What is believed: objects of the most probable world, and of all others, from clusters and leaves."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from estimation.checks import FloatArray
from world_model.anchoring.branching import GONE, other_names, presence, same_spot
from world_model.anchoring.clusters import Cluster, Track, best_sums
from world_model.anchoring.guidance import Guidance
from world_model.anchoring.leaves import AWAY, MOVING, NONE, REST
from world_model.anchoring.rounds import Rounds
from world_model.anchoring.unseen import Unseen
from world_model.state import WorldObject

LEAST_ALTERNATIVE = 0.01
"""Probability from which another symbol for an object is worth mentioning."""
LEAST_PRESENCE = 1e-6
"""An anchor less probably there, never believed in, is dropped."""
BELIEVED = 0.5
NAMED = 0.95
"""Probability from which an anchor gets a symbol and is believed in for the first time."""
LATELY = 1.0
"""s after its first detection that it may turn out that an object began otherwise."""
LOST_SIGMA = 1.5
"""m: a mover that is looked for, but hidden, is shown until its position is known less well than this."""
FORGOTTEN_SIGMA = 3.0
"""m: a mover known less well than this says no more than that some object is somewhere; its anchor goes."""


class Beliefs(Guidance):
    """Part of `Anchoring`: `shown`, expected counts and worlds."""

    unseen: Unseen
    rounds: Rounds
    expected: dict[int, float]
    _open: set[int]
    _fresh: list[int]

    def _show(self, number: int, stamp: float) -> None:
        """Bring `shown` and the expected count of a cluster up to date."""
        cluster = self.clusters.get(number)
        if cluster is None:
            return
        leaves = self.pool.leaves
        if cluster.lonely:
            slot = int(cluster.rows[0, 0])
            there = 1.0 - float(leaves.behavior[slot, NONE])
            here = float(leaves.behavior[slot, REST] + leaves.behavior[slot, MOVING])
            track = self.tracks[cluster.tracks[0]]
            if self._dispersed(slot) or (track.id is None and here < LEAST_PRESENCE):
                self.pool.give(slot)
                del self.clusters[number]
                self._forget_track(number)
                return
            if track.id is None and here <= NAMED:
                self.expected[number] = here
                return
            self.expected[number] = here if leaves.missed[slot] > 0.5 else there
            self._show_track(track, slot, stamp)
            return
        here = presence(leaves, cluster.rows, cluster.weights)
        self.expected[number] = float(here.sum())
        for track_number, slot in zip(list(cluster.tracks), cluster.rows[0].tolist(), strict=True):
            self._show_track(self.tracks[track_number], slot, stamp)
        if len(cluster.weights) > 1 and len(cluster.tracks) > 1:
            self._name_alternatives(cluster)

    def _name_alternatives(self, cluster: Cluster) -> None:
        """Say of shown objects by which symbols they go in other hypotheses."""
        shares = other_names(self.pool.leaves, cluster.rows, cluster.weights)
        for column in np.flatnonzero((shares > LEAST_ALTERNATIVE).any(1)).tolist():
            item = self.shown.get(cluster.tracks[column])
            if item is None:
                continue
            order = np.argsort(-shares[column], kind="stable")
            order = order[shares[column, order] > LEAST_ALTERNATIVE]
            names = (self.tracks[cluster.tracks[other]].id for other in order.tolist())
            self.shown[cluster.tracks[column]] = replace(item, alternatives=tuple(n for n in names if n))

    def _show_track(self, track: Track, slot: int, stamp: float) -> None:
        if slot < 0 or not self._believed(track, slot):
            self.shown.pop(track.number, None)
            return
        if not track.recognised:
            track.recognised = True
            self.unseen.count_found(track.late)
            self._fresh.append(track.number)
            return
        if track.id is None:
            track.id = self._taken_over(track, slot) or self._name(slot)
        self.shown[track.number] = self._object(track, slot)

    def _taken_over(self, track: Track, slot: int) -> str | None:
        """The symbol of what was believed to be here lately, if the most probable world now knows nothing of that.

        So an object whose beginning is seen otherwise, without a false detection say, keeps its symbol.
        """
        cluster, leaves = self.clusters[track.cluster], self.pool.leaves
        for column, number in enumerate(cluster.tracks):
            other = self.tracks[number]
            now = int(cluster.rows[0, column])
            if other.id is None or (now >= 0 and leaves.behavior[now, [REST, MOVING]].sum() >= GONE):
                continue
            rows = np.unique(cluster.rows[:, column])
            lately = [row for row in rows[rows >= 0].tolist() if self._stamp - leaves.first[row] < LATELY]
            if any(same_spot(leaves, row, slot) for row in lately):
                name, other.id = other.id, None
                return name
        return None

    def _believed(self, track: Track, slot: int) -> bool:
        """Whether an anchor is part of the most probable world.

        One that nobody looked for stays; one that was looked for and not seen must still be there probably.
        """
        leaves = self.pool.leaves
        pi = leaves.behavior[slot]
        here = pi[REST] + pi[MOVING]
        if (pi[MOVING] > pi[REST] or track.number in self.paths) and not self._followed(track, slot):
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
        """Whether a mover was seen lately enough, or its path is known well enough, to say where it is."""
        leaves = self.pool.leaves
        if self._led(track, slot):
            return bool(leaves.rest_cov[slot].diagonal()[:2].max() < LOST_SIGMA**2)
        looked_for = leaves.missed[slot] > BELIEVED
        if not looked_for and self._stamp - leaves.last[slot] > self.rounds.patience:
            return False
        return bool(leaves.moving_cov[slot].diagonal()[:3].max() < LOST_SIGMA**2)

    def _dispersed(self, slot: int) -> bool:
        """Whether a leaf is of a mover that may be anywhere."""
        leaves = self.pool.leaves
        moves = leaves.behavior[slot, MOVING] > leaves.behavior[slot, REST] + leaves.behavior[slot, AWAY]
        return bool(moves and leaves.moving_cov[slot].diagonal()[:3].max() > FORGOTTEN_SIGMA**2)

    def _forget_track(self, number: int) -> None:
        del self.tracks[number]
        self.paths.pop(number, None)
        self.shown.pop(number, None)
        self.expected.pop(number, None)
        self._open.discard(number)

    def _best_leaf(self, track: Track) -> int:
        cluster = self.clusters[track.cluster]
        return int(cluster.rows[0, cluster.tracks.index(track.number)])

    def _name(self, slot: int) -> str:
        classes = self.vocabulary.classes
        name = self._class_name(slot) if classes else "object"
        taken = {track.id for track in self.tracks.values()} if self._names[name] == 0 else ()
        while True:
            self._names[name] += 1
            if f"{name}-{self._names[name]}" not in taken:
                return f"{name}-{self._names[name]}"

    def _class_name(self, slot: int) -> str:
        classes = self.vocabulary.classes
        if not classes:
            return ""
        return self.vocabulary.values["class"][int(self.pool.leaves.attributes[slot, :classes].argmax())]

    def _object(self, track: Track, slot: int) -> WorldObject:
        leaves = self.pool.leaves
        rest, moving, away, none = leaves.behavior[slot].tolist()
        # Time alone makes nothing lost: it was looked for in vain, or somebody has said so.
        sought = leaves.missed[slot] >= BELIEVED
        lost = away > rest + moving and (track.lost or sought)
        if moving > rest:
            position, velocity = leaves.moving[slot, :3].copy(), leaves.moving[slot, 3:].copy()
            covariance = leaves.moving_cov[slot, :3, :3].copy()
        else:
            position, velocity = leaves.rest[slot].copy(), leaves.led[slot].copy()
            covariance = leaves.rest_cov[slot].copy()
        region = None
        if lost:
            region = (track.region if track.lost else None) or self.config.region
            low, high = np.array(region).T
            position, covariance = 0.5 * (low + high), np.diag((high - low) ** 2 / 12.0)
        return WorldObject(
            track.id or "",
            position,
            velocity,
            covariance,
            self.vocabulary.distributions(leaves.attributes[slot]),
            rest + moving if sought and not lost else 1.0 - none,
            lost,
            float(leaves.last[slot]),
            float(leaves.first[slot]),
            {
                "predicted" if self._moves(slot) else "constant_position": rest,
                "constant_velocity": moving,
                "uniform": away,
            },
            region,
            process_noise=self._growth(track, slot),
            quantities=self.quantities.described(leaves, slot),
        )

    def _symbol(self, number: int) -> str | None:
        track = self.tracks.get(number)
        return track.id if track is not None and number in self.shown else None

    @property
    def expected_count(self) -> float:
        """Expected number of objects over all hypotheses."""
        return float(sum(self.expected.values()))

    def probabilities(self) -> FloatArray:
        """Of the best combinations of hypotheses over all clusters (K,), normalised."""
        weights = [self.clusters[number].weights for number in sorted(self._open)]
        sums, _ = best_sums(weights, self.config.hypotheses)
        shares = np.exp(sums - sums[0])
        result: FloatArray = shares / shares.sum()
        return result

    def worlds(self) -> list[tuple[list[WorldObject], float]]:
        """Objects and probability of every combination of hypotheses that is kept."""
        numbers = sorted(self._open)
        sums, picks = best_sums([self.clusters[n].weights for n in numbers], self.config.hypotheses)
        shares = np.exp(sums - sums[0])
        shares /= shares.sum()
        out = []
        for pick, share in zip(picks, shares, strict=True):
            shown = dict(self.shown)
            for number, h in zip(numbers, pick, strict=True):
                cluster = self.clusters[number]
                for track_number, slot in zip(cluster.tracks, cluster.rows[h].tolist(), strict=True):
                    track = self.tracks[track_number]
                    shown.pop(track_number, None)
                    if slot >= 0 and self._believed(track, slot):
                        shown[track_number] = self._object(track, slot)
            out.append((list(shown.values()), float(share)))
        return out

    def health(self) -> dict[str, float]:
        """Figures for diagnostics."""
        return {
            "objects": len(self.shown),
            "anchors": len(self.tracks),
            "hypotheses": max((len(self.clusters[n].weights) for n in self._open), default=1),
            "leaves": self.pool.used,
            "predicted paths": len(self.paths),
        }
