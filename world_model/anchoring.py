"""Probabilistic multiple hypothesis anchoring: section 2.5, on clusters of track trees with shared leaves.

Whether a detection that no known object explains is a new object or clutter is not branched over: a new anchor
keeps the probability that there is no such object (`NONE`), which is the sum over both. Every other association
is a hypothesis of its own.
"""

from __future__ import annotations

from collections import Counter

import numpy as np
import numpy.typing as npt
from scipy.special import gammaln

from world_model.behaviors import motion_table
from world_model.branching import begin, join, realise, settle
from world_model.clusters import Cluster, Track, combined, lonely
from world_model.config import WorldModelConfig
from world_model.corrections import Corrections
from world_model.evidence import Measurements
from world_model.expansion import expand, unify
from world_model.gating import touch, weigh
from world_model.grouping import THRESHOLD
from world_model.hindsight import MOST_LOOKS, Hindsight
from world_model.leaves import MOVING, REST, IntArray, Pool
from world_model.look import Look
from world_model.misses import detector_table
from world_model.occlusion import free, hide, restrict
from world_model.predictions import Path
from world_model.quantities import Quantities
from world_model.rounds import Rounds
from world_model.sensor_bias import CONSTANT
from world_model.sensor_errors import SensorErrors
from world_model.state import WorldObject
from world_model.touching import Touching, sharing, touched_by
from world_model.unseen import Unseen, sensor_array
from world_model.vocabulary import Vocabulary

BURST = 1e-3
"""Probability that a look finds new objects in company: a cupboard was opened, a room entered."""
COVERED = 0.5
"""Probability of being hidden within the view from which on a mover counts as hidden."""
COMPANY = 10.0
"""How many they are then, mean."""


class Anchoring(Corrections):
    """All anchors and hypotheses. `shown` : believed objects of the most probable world, by track number."""

    def __init__(self, config: WorldModelConfig, most_looks: int = MOST_LOOKS) -> None:
        self.config = config
        known = {"class": config.classes, "color": config.colors}
        known |= {name: () for name in config.attributes if name not in known}
        self.vocabulary = Vocabulary(known, config.class_accuracy)
        self.quantities = Quantities(config.quantities)
        self.motion = motion_table(self.vocabulary.values["class"], config.motion)
        self._detector = detector_table(config)
        self.persistence = np.maximum(self._detector[:, 2], 0.0)
        self.unseen = Unseen(config)
        self.touching = Touching(config.detection_probability)
        self.hindsight = Hindsight(most_looks)
        known_bias = np.zeros(CONSTANT)
        known_bias[: len(config.sensor_bias)] = config.sensor_bias
        self.bias = SensorErrors(known_bias)
        self.reset()

    def reset(self) -> None:
        """Forget all anchors; the vocabulary stays."""
        self.pool = Pool(self.vocabulary.width, len(self.quantities.names))
        self.tracks: dict[int, Track] = {}
        self.clusters: dict[int, Cluster] = {}
        self.shown: dict[int, WorldObject] = {}
        self.expected: dict[int, float] = {}
        self.paths: dict[int, Path] = {}
        self._open: set[int] = set()
        self._next = 0
        self._names: Counter[str] = Counter()
        self._looks = 0
        self._fresh: list[int] = []
        self._stamp = 0.0
        self.unseen.reset()
        self.rounds = Rounds()
        self.touching.reset()
        self.bias.reset()
        self.hindsight.reset()

    @property
    def highest(self) -> dict[str, int]:
        """The highest number in use by class."""
        return dict(self._names)

    def learn_value(self, name: str, value: str) -> None:
        """A new value of an attribute whose values are not fixed."""
        column = self.vocabulary.add(name, value)
        self.pool.widen(column)
        if name == "class":
            self.motion = motion_table(self.vocabulary.values["class"], self.config.motion)

    def look(self, measured: Measurements, stamp: float, lag: float) -> tuple[str | None, ...]:
        """Take a look in that was made `lag` seconds before `stamp`; returns the id per detection."""
        self._stamp = stamp
        self.rounds.look(measured.sensor, stamp - lag, measured.silent)
        self._lead(stamp)
        raw, measured = measured, self._unbiased(measured, stamp - lag)
        measured, verified = self._verified(measured, stamp, lag)
        look = self._weighed(measured, stamp, lag, set(verified.values()))
        self.pool.leaves.said[:] = -1
        told, spreads = self.quantities.arrays(measured.quantities)
        measures = bool((spreads >= 0.0).any())
        if measures:
            look.matrix += self.quantities.log_factors(self.pool.leaves, look.chosen, told, spreads)
        joint = self._joint(raw, look) if not verified else None
        near = np.unique(self.pool.leaves.track[look.chosen]).tolist()
        touched, owners = self._associate(look)
        if measures:
            slots = np.flatnonzero(self.pool.leaves.said >= 0)
            said = self.pool.leaves.said[slots]
            self.quantities.learn(self.pool.leaves, slots, told[said], spreads[said])
        if self._merging:
            best = {n: self._best_leaf(self.tracks[n]) for n in near if n in self.tracks}
            self.touching.look(self.pool.leaves, best, look)
        for number in touched:
            self._show(number, stamp)
        if self._fresh:
            fresh = set(self._fresh)
            known = [t for t in self.tracks.values() if t.id is not None and t.number not in fresh]
            for number in self._fresh:
                self._recognise(number, stamp, known)
        self._fresh.clear()
        self._looks += 1
        if self._looks % 64 == 0:
            self._tidy(stamp)
        for index, number in verified.items():
            owners.insert(index, number)
        if self.config.learn_sensor_bias:
            self._learn_bias(raw, owners, joint)
        symbols = tuple(self._symbol(track) for track in owners)
        if self.config.learn_sensor_bias and raw.sensor is not None and owners:
            likelihood = self.vocabulary.likelihoods(raw.attributes) if verified else look.likelihood
            self.hindsight.add(raw, likelihood, stamp - lag, owners, symbols, self.bias)
        return symbols

    @property
    def _merging(self) -> bool:
        """Whether there may be movers of which one detection is of several."""
        return self.config.merged_detections and bool((self.motion[:, 0] > 0.5).any())

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
            # One that was named before it may have taken this one along.
            if track is None or track.number in verified.values() or track.number not in self.tracks:
                continue
            likelihood = self.vocabulary.likelihoods(measured.attributes[index : index + 1])[0]
            self.verify(track, measured.positions[index], measured.covariances[index], likelihood, stamp, lag)
            if track.number not in self.tracks:
                continue  # so uncertain a measurement that it may be anywhere: it is nobody's any more
            slots = self._leaves_of(track)
            told, spreads = self.quantities.arrays([measured.quantities[index]] * len(slots))
            self.quantities.learn(self.pool.leaves, slots, told, spreads)
            verified[index] = track.number
        others = [index for index in range(len(measured.positions)) if index not in verified]
        return measured.only(others), verified

    def _weighed(self, measured: Measurements, stamp: float, lag: float, verified: set[int]) -> Look:
        leaves = self.pool.leaves
        M = len(measured.positions)
        variances = measured.covariances.diagonal(axis1=1, axis2=2)
        spread = np.sqrt(variances.max(1)) if M else np.zeros(0)
        sensor, known = sensor_array(measured.sensor), measured.sensor is not None
        silent = measured.silent
        born, gap, clutter = self.unseen.look(
            measured.positions, np.sqrt(variances[:, 2]), sensor, known, silent, stamp, measured.view
        )
        active = np.flatnonzero(leaves.track >= 0)
        if verified:
            active = active[~np.isin(leaves.track[active], sorted(verified))]
        chosen, clear = np.empty(len(active), np.int64), np.empty(len(active))
        count = touch(
            leaves,
            active,
            stamp,
            lag,
            measured.positions,
            spread,
            sensor,
            known,
            silent,
            self.motion,
            chosen,
            clear,
        )
        view = measured.view
        in_cone = clear[:count].copy()
        if view is not None and not silent:
            restrict(leaves, chosen[:count], clear, view, self.quantities)
        if known and not silent and not (view is not None and view.knows_hidden):
            hide(leaves, chosen, count, clear, sensor, self.quantities)
        self._cover(chosen[:count], in_cone - clear[:count] > COVERED)
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
        found = born * self.config.detection_probability
        false = None if view is None else view.density(measured.positions, measured.covariances)
        lying = np.full(M, clutter) if false is None else self.config.clutter_per_frame * false
        if M:
            bodies = np.array([k for k in chosen[:count].tolist() if self._is_shown(k)], np.int64)
            found *= free(leaves, bodies, measured.positions, measured.covariances, self.quantities)
        both = np.maximum(found + lying, 1e-300)
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
            self.touching.metres(spread, self.config.measurement_sigma) if self._merging else 0.0,
            chosen[:count],
            clear[:count],
            matrix,
            missing,
        )

    def _is_shown(self, slot: int) -> bool:
        """Whether a leaf is that of an object of the most probable world."""
        number = int(self.pool.leaves.track[slot])
        return number in self.shown and self._best_leaf(self.tracks[number]) == slot

    def _cover(self, slots: IntArray, covered: npt.NDArray[np.bool_]) -> None:
        """Movers that something else hides are looked for, and shown for as long as it is known where they are."""
        leaves, hidden = self.pool.leaves, slots[covered]
        moving = hidden[leaves.behavior[hidden, MOVING] > leaves.behavior[hidden, REST]]
        leaves.missed[moving] = np.maximum(leaves.missed[moving], 1.0)

    def _associate(self, look: Look) -> tuple[list[int], list[int]]:
        """Decide what is plain, branch over the rest; returns touched clusters and a track per detection."""
        M = len(look.log_new)
        ratio = look.matrix - look.missing[:, :1] - look.log_new
        gated = ratio > -THRESHOLD
        look.matrix[~gated] = -np.inf
        linked = gated | touched_by(self.pool.leaves, look, gated) if self._merging else gated
        per_leaf, per_detection = linked.sum(1).tolist(), linked.sum(0)
        tracks = self.pool.leaves.track[look.chosen].tolist()
        owners = [self.tracks[t].cluster for t in tracks]
        first = linked.argmax(1).tolist() if M else [0] * len(tracks)
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
            elif (
                per_leaf[k] == 1 and alone[first[k]] and gated[k, first[k]] and ratio[k, first[k]] > THRESHOLD
            ):
                plain.append(k)
                detection.append(first[k])
                of[first[k]] = tracks[k]
            else:
                hard.add(number)
        self._settle(look, plain, detection)
        touched = [owners[k] for k in plain]
        lone = np.flatnonzero(per_detection == 0)
        touched += self._begin(look, lone, of)
        at = np.full(self.pool.size, -1)
        at[look.chosen] = np.arange(len(look.chosen))
        for members, detections in self._linked(hard, owners, linked):
            touched += self._branch(look, members, detections, of, at)
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

    def _track(self, number: int, look: Look, j: int) -> Track:
        late = float(self.unseen.late[j])
        return Track(number, number, born=float(look.born[j]), late=late, unwatched=float(look.gap[j]))

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

    def _branch(
        self, look: Look, members: list[int], detections: list[int], of: list[int], at: IntArray
    ) -> list[int]:
        """Expand the hypotheses of these clusters together; returns the clusters they fall apart into.

        at : rows of `look` by leaf, -1 for leaves that it does not concern.
        """
        keep = self.config.hypotheses
        whole = combined([self.clusters.pop(number) for number in members], keep, THRESHOLD)
        if len(members) > 1:
            self._drop_unused(members, whole)
        slots = np.unique(whole.rows)
        slots = slots[slots >= 0]
        js = np.array(detections, np.int64)
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
        common = leaves.common[slots, :3, :3]
        common[leaves.together[slots] == 0] = 0.0
        parents, choice, weights, groups = expand(
            local,
            whole.weights,
            matrix,
            missing[:, 0].copy(),
            look.log_new[js],
            keep,
            THRESHOLD,
            sharing(leaves, slots, here) if self._merging else np.zeros(len(slots)),
            leaves.moving[slots, :3],
            leaves.moving_cov[slots, :3, :3],
            leaves.together[slots],
            common,
            look.positions[js],
            look.covariances[js],
            look.reach,
        )
        # A leaf has a variant per detection, and one per group that it may be in.
        self.pool.reserve((len(slots) * (1 + len(groups)) + 1) * len(js) + 1)
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
            groups,
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
            js,
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
