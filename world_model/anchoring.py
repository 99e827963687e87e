"""Probabilistic multiple hypothesis anchoring: section 2.5, on clusters of track trees with shared leaves.

Whether a detection that no known object explains is a new object or clutter is not branched over: a new anchor
keeps the probability that there is no such object (`NONE`), which is the sum over both. Every other association
is a hypothesis of its own.
"""

from __future__ import annotations

from collections import Counter
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt
from scipy.special import gammaln

from estimation.checks import FloatArray
from world_model.behaviors import motion_table
from world_model.branching import begin, join, presence, realise, same_worlds, settle, sweep
from world_model.clusters import Cluster, Track, best_sums, combined, lonely
from world_model.config import WorldModelConfig
from world_model.evidence import Measurements
from world_model.expansion import components, expand, unify
from world_model.kernels import copy_leaf, learn_attributes, touch, weigh
from world_model.leaves import AWAY, MOVING, NONE, REST, IntArray, Pool
from world_model.recognition import alternatives, candidates, odds
from world_model.single import SingleObjects
from world_model.state import WorldObject
from world_model.unseen import Unseen, sensor_array
from world_model.vocabulary import Vocabulary

THRESHOLD = 11.5
"""Hypotheses less probable than the best of their cluster by e to this are dropped."""
LEAST_PRESENCE = 1e-6
"""An anchor less probably there, never believed in, is dropped."""
DEPENDENCE = 1e-4
"""Total variation from which two tracks are dependent."""
BELIEVED = 0.5
NAMED = 0.95
"""Probability from which an anchor gets a symbol and is believed in for the first time."""
OUT_OF_VIEW_SECONDS = 0.3
"""A mover that nobody looks at is shown for this long; after that it is only remembered."""
LOST_SIGMA = 1.5
"""m: a mover that is looked for, but hidden, is shown until its position is known less well than this."""
FORGOTTEN_SIGMA = 3.0
"""m: a mover known less well than this says no more than that some object is somewhere; its anchor goes."""
TOUCHING = 3.0
"""Two movers nearer than this, in standard deviations of a detection, may be detected as one."""
BURST = 1e-3
"""Probability that a look finds new objects in company: a cupboard was opened, a room entered."""
COMPANY = 10.0
"""How many they are then, mean."""


@dataclass
class Look:
    """One look in arrays: M detections, n touched leaves."""

    stamp: float
    lag: float
    positions: FloatArray
    covariances: FloatArray
    likelihood: FloatArray
    log_new: FloatArray
    existence: FloatArray
    born: FloatArray
    gap: FloatArray
    reach: FloatArray
    chosen: IntArray
    clear: FloatArray
    matrix: FloatArray
    missing: FloatArray


class Anchoring(SingleObjects):
    """All anchors and hypotheses. `shown` : believed objects of the most probable world, by track number."""

    def __init__(self, config: WorldModelConfig) -> None:
        self.config = config
        known = {"class": config.classes, "color": config.colors}
        known |= {name: () for name in config.attributes if name not in known}
        self.vocabulary = Vocabulary(known, config.class_accuracy)
        self.motion = motion_table(self.vocabulary.values["class"], config.motion)
        detection = config.detection_probability
        run = max(config.missed_run_frames, 1.0 / detection)
        self.persistence = 1.0 - 1.0 / run - (1.0 - detection) / (detection * run)
        self._detector = np.array([detection, self.persistence, config.rate_hz, config.removed_per_second])
        self.unseen = Unseen(config)
        self.reset()

    def reset(self) -> None:
        """Forget all anchors; the vocabulary stays."""
        self.pool = Pool(self.vocabulary.width)
        self.tracks: dict[int, Track] = {}
        self.clusters: dict[int, Cluster] = {}
        self.shown: dict[int, WorldObject] = {}
        self.expected: dict[int, float] = {}
        self._open: set[int] = set()
        self._next = 0
        self._names: Counter[str] = Counter()
        self._looks = 0
        self._fresh: list[int] = []
        self._stamp = 0.0
        self.unseen.reset()

    def learn_value(self, name: str, value: str) -> None:
        """A new value of an attribute whose values are not fixed."""
        column = self.vocabulary.add(name, value)
        self.pool.widen(column)
        if name == "class":
            self.motion = motion_table(self.vocabulary.values["class"], self.config.motion)

    # One look.

    def look(self, measured: Measurements, stamp: float, lag: float) -> tuple[str | None, ...]:
        """Take a look in that was made `lag` seconds before `stamp`; returns the id per detection."""
        self._stamp = stamp
        measured, verified = self._verified(measured, stamp, lag)
        look = self._weighed(measured, stamp, lag, set(verified.values()))
        touched, owners = self._associate(look)
        for number in touched:
            self._show(number, stamp)
        for number in self._fresh:
            self._recognise(number, stamp)
        self._fresh.clear()
        self._looks += 1
        if self._looks % 64 == 0:
            self._tidy(stamp)
        for index, number in verified.items():
            owners.insert(index, number)
        return tuple(self._symbol(track) for track in owners)

    def _verified(
        self, measured: Measurements, stamp: float, lag: float
    ) -> tuple[Measurements, dict[int, int]]:
        """Detections that name a known object are its own; returns the others, and the track by index of these."""
        if not any(measured.object_ids):
            return measured, {}
        named = {track.id: track for track in self.tracks.values() if track.id is not None}
        verified: dict[int, int] = {}
        for index, object_id in enumerate(measured.object_ids):
            track = None if object_id is None else named.get(object_id)
            if track is None or track.number in verified.values():
                continue
            likelihood = self.vocabulary.likelihoods(measured.attributes[index : index + 1])[0]
            self.verify(track, measured.positions[index], measured.covariances[index], likelihood, stamp, lag)
            verified[index] = track.number
        others = [index for index in range(len(measured.positions)) if index not in verified]
        return measured.only(others), verified

    def _keep_rows(self, number: int, keep: npt.NDArray[np.bool_]) -> None:
        """Hypotheses of a cluster that turned out to be impossible go."""
        cluster = self.clusters[number]
        rows, weights = unify(np.ascontiguousarray(cluster.rows[keep]), cluster.weights[keep])
        sweep(self.pool.leaves, self.pool.free, self.pool.top, cluster.rows, rows)
        del self.clusters[number]
        for made in self._divide(list(cluster.tracks), rows, weights):
            self._show(made, self._stamp)

    def _weighed(self, measured: Measurements, stamp: float, lag: float, verified: set[int]) -> Look:
        leaves = self.pool.leaves
        M = len(measured.positions)
        variances = measured.covariances.diagonal(axis1=1, axis2=2)
        spread = np.sqrt(variances.max(1)) if M else np.zeros(0)
        sensor, known = sensor_array(measured.sensor), measured.sensor is not None
        silent = measured.silent or lag > 0.0
        born, gap, clutter = self.unseen.look(
            measured.positions, np.sqrt(variances[:, 2]), sensor, known, silent, stamp
        )
        found = born * self.config.detection_probability
        both = np.maximum(found + clutter, 1e-300)
        active = np.flatnonzero(leaves.track >= 0)
        if verified:
            active = active[~np.isin(leaves.track[active], sorted(verified))]
        chosen, clear = np.empty(len(active), np.int64), np.empty(len(active))
        count = touch(
            leaves,
            active,
            stamp,
            measured.positions,
            spread,
            sensor,
            known,
            silent,
            self.motion,
            chosen,
            clear,
        )
        matrix, missing = np.empty((count, M)), np.empty((count, 2))
        likelihood = self.vocabulary.likelihoods(measured.attributes)
        weigh(
            leaves,
            chosen,
            clear,
            count,
            stamp,
            measured.positions,
            measured.covariances,
            likelihood,
            self.vocabulary.blocks,
            lag,
            self.motion,
            self._detector,
            matrix,
            missing,
        )
        return Look(
            stamp,
            lag,
            measured.positions,
            measured.covariances,
            likelihood,
            np.log(both),
            found / both,
            born,
            gap,
            TOUCHING * spread,
            chosen[:count],
            clear[:count],
            matrix,
            missing,
        )

    def _associate(self, look: Look) -> tuple[list[int], list[int]]:
        """Decide what is plain, branch over the rest; returns touched clusters and a track per detection."""
        M = len(look.log_new)
        ratio = look.matrix - look.missing[:, :1] - look.log_new
        gated = ratio > -THRESHOLD
        look.matrix[~gated] = -np.inf
        per_leaf, per_detection = gated.sum(1).tolist(), gated.sum(0)
        tracks = self.pool.leaves.track[look.chosen].tolist()
        owners = [self.tracks[t].cluster for t in tracks]
        first = gated.argmax(1).tolist() if M else [0] * len(tracks)
        alone = per_detection == 1
        plain: list[int] = []
        detection: list[int] = []
        hard: set[int] = set()
        of = [-1] * M
        for k, number in enumerate(owners):
            if not self.clusters[number].lonely:
                hard.add(number)
            elif per_leaf[k] == 0:
                plain.append(k)
                detection.append(-1)
            elif per_leaf[k] == 1 and alone[first[k]] and ratio[k, first[k]] > THRESHOLD:
                plain.append(k)
                detection.append(first[k])
                of[first[k]] = tracks[k]
            else:
                hard.add(number)
        self._settle(look, plain, detection)
        touched = [owners[k] for k in plain]
        lone = np.flatnonzero(per_detection == 0)
        touched += self._begin(look, lone, of)
        for members, detections in self._linked(hard, owners, gated):
            touched += self._branch(look, members, detections, of)
        return touched, of

    def _settle(self, look: Look, plain: list[int], detection: list[int]) -> None:
        if not plain:
            return
        k = np.array(plain)
        settle(
            self.pool.leaves,
            look.chosen[k],
            np.array(detection),
            look.positions,
            look.covariances,
            look.likelihood,
            self.vocabulary.blocks,
            look.lag,
            look.stamp - look.lag,
            look.missing[k, 1],
            look.clear[k],
        )

    def _begin(self, look: Look, which: IntArray, of: list[int]) -> list[int]:
        """New lonely clusters for detections that no leaf explains; returns their numbers."""
        if len(which) == 0:
            return []
        self._expect_company(look, which)
        self.pool.reserve(len(which))
        numbers = np.arange(self._next, self._next + len(which))
        self._next += len(which)
        slots = begin(
            self.pool.leaves,
            self.pool.free,
            self.pool.top,
            numbers,
            which,
            look.positions,
            look.covariances,
            look.likelihood,
            self.vocabulary.blocks,
            self.vocabulary.prior(),
            look.stamp,
            look.existence,
            self.motion,
        )
        for number, slot, j in zip(numbers.tolist(), slots.tolist(), which.tolist(), strict=True):
            self.tracks[number] = self._track(number, look, j)
            self.clusters[number] = lonely(number, slot)
            of[j] = number
        return numbers.tolist()

    @staticmethod
    def _track(number: int, look: Look, j: int) -> Track:
        return Track(number, number, born=float(look.born[j]), unwatched=float(look.gap[j]))

    def _expect_company(self, look: Look, which: IntArray) -> None:
        """Far more unexplained detections than clutter ever makes are new objects that came together."""
        n, clutter = len(which), self.config.clutter_per_frame
        usual = clutter + self.unseen.awaited
        log_usual = n * np.log(max(usual, 1e-9)) - usual - gammaln(n + 1)
        log_burst = np.log(BURST / COMPANY) - n / COMPANY
        share = 1.0 / (1.0 + np.exp(min(log_usual - log_burst, 700.0)))
        together = share * n / (n + clutter)
        look.existence[which] = np.maximum(look.existence[which], together)

    def _linked(
        self, hard: set[int], owners: list[int], gated: npt.NDArray[np.bool_]
    ) -> list[tuple[list[int], list[int]]]:
        """Clusters joined where they compete for a detection, with their detections."""
        root = {number: number for number in hard}

        def find(number: int) -> int:
            while root[number] != number:
                root[number] = root[root[number]]
                number = root[number]
            return number

        claimed: dict[int, int] = {}
        for k, j in zip(*(index.tolist() for index in np.nonzero(gated)), strict=True):
            if owners[k] not in root:
                continue
            mine = find(owners[k])
            other = find(claimed.setdefault(j, mine))
            root[max(mine, other)] = min(mine, other)
        groups: dict[int, tuple[list[int], list[int]]] = {}
        for number in sorted(hard):
            groups.setdefault(find(number), ([], []))[0].append(number)
        for j, number in sorted(claimed.items()):
            groups[find(number)][1].append(j)
        return list(groups.values())

    def _branch(self, look: Look, members: list[int], detections: list[int], of: list[int]) -> list[int]:
        """Expand the hypotheses of these clusters together; returns the clusters they fall apart into."""
        keep = self.config.hypotheses
        whole = combined([self.clusters.pop(number) for number in members], keep, THRESHOLD)
        if len(members) > 1:
            self._drop_unused(members, whole)
        slots = np.unique(whole.rows)
        slots = slots[slots >= 0]
        js = np.array(detections, np.int64)
        at = np.full(self.pool.size, -1)
        at[look.chosen] = np.arange(len(look.chosen))
        k = at[slots]
        here = k >= 0
        matrix = np.full((len(slots), len(js)), -np.inf)
        missing = np.zeros((len(slots), 2))
        clear = np.zeros(len(slots))
        matrix[here] = look.matrix[k[here]][:, js]
        missing[here] = look.missing[k[here]]
        clear[here] = look.clear[k[here]]
        local = np.searchsorted(slots, whole.rows)
        local[whole.rows < 0] = -1
        leaves = self.pool.leaves
        parents, choice, weights = expand(
            local,
            whole.weights,
            matrix,
            missing[:, 0].copy(),
            look.log_new[js],
            keep,
            THRESHOLD,
            self._sharing(slots, here),
            leaves.moving[slots, :3],
            leaves.moving_cov[slots, :3, :3],
            look.positions[js],
            look.covariances[js],
            look.reach[js],
        )
        self.pool.reserve((len(slots) + 1) * len(js) + 1)
        fresh = np.arange(self._next, self._next + len(js))
        self._next += len(js)
        rows = realise(
            self.pool.leaves,
            self.pool.free,
            self.pool.top,
            slots,
            local,
            parents,
            choice,
            missing[:, 1].copy(),
            clear,
            look.positions[js],
            look.covariances[js],
            look.likelihood[js],
            self.vocabulary.blocks,
            look.lag,
            look.stamp - look.lag,
            look.existence[js],
            fresh,
            self.vocabulary.prior(),
            self.motion,
        )
        for column in range(len(whole.tracks)):
            j = choice[0, column]
            if j >= 0:
                j %= len(js)
                of[detections[j]] = whole.tracks[column]
        for j, number in zip(detections, fresh.tolist(), strict=True):
            self.tracks[number] = self._track(number, look, j)
            if of[j] < 0:
                of[j] = number
        join(
            self.pool.leaves,
            self.pool.free,
            self.pool.top,
            rows,
            weights,
            self.persistence,
            self.vocabulary.width,
        )
        rows, weights = unify(rows, weights)
        if len(weights) > 1:
            rows, weights = self._same_worlds(rows, weights)
        return self._divide([*whole.tracks, *fresh.tolist()], rows, weights)

    def _sharing(self, slots: IntArray, touched: npt.NDArray[np.bool_]) -> FloatArray:
        """Probability of being there of leaves that may share a detection with another: movers, where allowed."""
        pi = self.pool.leaves.behavior[slots]
        if not self.config.merged_detections:
            return np.zeros(len(slots))
        result: FloatArray = np.where(touched & (pi[:, MOVING] > pi[:, REST]), pi[:, MOVING], 0.0)
        return result

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

    def _forget_track(self, number: int) -> None:
        del self.tracks[number]
        self.shown.pop(number, None)
        self.expected.pop(number, None)
        self._open.discard(number)

    # What is believed.

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

    def _show_track(self, track: Track, slot: int, stamp: float) -> None:
        if slot < 0 or not self._believed(track, slot):
            self.shown.pop(track.number, None)
            return
        if not track.recognised:
            track.recognised = True
            self.unseen.found += 1.0
            self._fresh.append(track.number)
            return
        if track.id is None:
            track.id = self._name(slot)
        self.shown[track.number] = self._object(track, slot)

    def _believed(self, track: Track, slot: int) -> bool:
        """Whether an anchor is part of the most probable world.

        One that nobody looked for stays; one that was looked for and not seen must still be there probably.
        """
        leaves = self.pool.leaves
        pi = leaves.behavior[slot]
        here = pi[REST] + pi[MOVING]
        if pi[MOVING] > pi[REST] and not self._followed(slot):
            return False
        if here > (BELIEVED if track.id is not None else NAMED):
            return True
        if track.id is None:
            return False
        return bool(
            (track.lost and pi[AWAY] > here)
            or (leaves.missed[slot] < BELIEVED and pi[MOVING] <= pi[REST] + pi[AWAY])
        )

    def _followed(self, slot: int) -> bool:
        """Whether a mover was seen lately enough to say where it is."""
        leaves = self.pool.leaves
        looked_for = leaves.missed[slot] > BELIEVED
        if not looked_for and self._stamp - leaves.last[slot] > OUT_OF_VIEW_SECONDS:
            return False
        return bool(leaves.moving_cov[slot].diagonal()[:3].max() < LOST_SIGMA**2)

    def _dispersed(self, slot: int) -> bool:
        """Whether a leaf is of a mover that may be anywhere."""
        leaves = self.pool.leaves
        moves = leaves.behavior[slot, MOVING] > leaves.behavior[slot, REST] + leaves.behavior[slot, AWAY]
        return bool(moves and leaves.moving_cov[slot].diagonal()[:3].max() > FORGOTTEN_SIGMA**2)

    def _recognise(self, number: int, stamp: float) -> None:
        """Hypotheses in which a new anchor is a known object that was carried; then it is shown."""
        track = self.tracks[number]
        cluster = self.clusters[track.cluster]
        new = int(cluster.rows[0, cluster.tracks.index(number)])
        named = [other for other in self.tracks.values() if other.id is not None]
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

    def _best_leaf(self, track: Track) -> int:
        cluster = self.clusters[track.cluster]
        return int(cluster.rows[0, cluster.tracks.index(track.number)])

    def _odds(self, slots: IntArray, new: int, track: Track) -> FloatArray:
        leaves, classes = self.pool.leaves, self.vocabulary.classes
        rows = leaves.attributes[slots, :classes].argmax(1) if classes else np.full(len(slots), -1)
        volume = self.unseen.volume
        return odds(leaves, slots, new, track, self.motion[rows, 2], self.vocabulary.blocks, volume)

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

    def _name(self, slot: int) -> str:
        classes = self.vocabulary.classes
        name = "object"
        if classes:
            name = self.vocabulary.values["class"][int(self.pool.leaves.attributes[slot, :classes].argmax())]
        taken = {track.id for track in self.tracks.values()} if self._names[name] == 0 else ()
        while True:
            self._names[name] += 1
            if f"{name}-{self._names[name]}" not in taken:
                return f"{name}-{self._names[name]}"

    def _object(self, track: Track, slot: int) -> WorldObject:
        leaves = self.pool.leaves
        rest, moving, away, none = leaves.behavior[slot].tolist()
        lost = away > rest + moving
        if moving > rest:
            position, velocity = leaves.moving[slot, :3].copy(), leaves.moving[slot, 3:].copy()
            covariance = leaves.moving_cov[slot, :3, :3].copy()
        else:
            position, velocity = leaves.rest[slot].copy(), np.zeros(3)
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
            1.0 - none if leaves.missed[slot] < BELIEVED or lost else rest + moving,
            lost,
            float(leaves.last[slot]),
            float(leaves.first[slot]),
            {"constant_position": rest, "constant_velocity": moving, "uniform": away},
            region,
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

    def health(self) -> dict[str, float]:
        """Figures for diagnostics."""
        return {
            "objects": len(self.shown),
            "anchors": len(self.tracks),
            "hypotheses": max((len(self.clusters[n].weights) for n in self._open), default=1),
            "leaves": self.pool.used,
        }
