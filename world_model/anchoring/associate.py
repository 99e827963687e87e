"""Which detection is of which anchor: the plain cases decided, the rest branched over (sections 2.5.1 to 2.5.3).

Whether a detection that no known object explains is a new object or clutter is not branched over: a new anchor
keeps the probability that there is no such object (`NONE`), which is the sum over both. Every other association
is a hypothesis of its own.
"""

from __future__ import annotations

import numpy as np
import numpy.typing as npt
from scipy.special import gammaln

from estimation.checks import FloatArray
from world_model.anchoring.anchors import THRESHOLD, Anchors
from world_model.anchoring.bodies import Bodies
from world_model.anchoring.loops.branching import begin, join, realise, settle
from world_model.anchoring.loops.clusters import Track, lonely
from world_model.anchoring.loops.contacts import Movers
from world_model.anchoring.loops.expansion import expand, unify
from world_model.anchoring.loops.gating import touch, weigh
from world_model.anchoring.loops.leaves import IntArray, leaves_in
from world_model.anchoring.loops.look import Classes, Detections, Look
from world_model.anchoring.occlusion import free, hide, restrict
from world_model.anchoring.touching import TOUCHING, sharing, touched_by
from world_model.anchoring.unseen import sensor_array
from world_model.evidence import Measurements
from world_model.state import BELIEVED

BURST = 1e-3  # Probability that a look finds new objects in company: a cupboard was opened, a room entered
COMPANY = 10.0  # How many they are then, mean
NOBODY = Movers(np.zeros(0), np.zeros((0, 3)), np.zeros((0, 3, 3)), np.zeros(0, np.int64), 0.0)


class Association:
    """Acts on anchors with the detections of one look after the other."""

    def __init__(self, anchors: Anchors, bodies: Bodies) -> None:
        self.anchors = anchors
        self.bodies = bodies

    @property
    def merging(self) -> bool:
        """Whether there may be movers of which one detection is of several."""
        return self.anchors.config.merged_detections and bool((self.anchors.motion[:, 0] > 0.5).any())

    @property
    def _classes(self) -> Classes:
        vocabulary = self.anchors.vocabulary
        return Classes(self.anchors.motion, vocabulary.blocks, vocabulary.prior())

    def weighed(self, measured: Measurements, stamp: float, lag: float, verified: set[int]) -> Look:
        """How well each detection fits each anchor that a look concerns; those in `verified` were told theirs."""
        anchors, leaves = self.anchors, self.anchors.leaves
        M = len(measured.positions)
        variances = measured.covariances.diagonal(axis1=1, axis2=2)
        spread = np.sqrt(variances.max(1)) if M else np.zeros(0)
        sensor, known = sensor_array(measured.sensor), measured.sensor is not None
        born, returned, clutter = anchors.unseen.look(
            measured.positions, np.sqrt(variances), sensor, known, measured.silent, stamp, measured.view
        )
        likelihood, where = anchors.vocabulary.likelihoods(measured.attributes), measured.positions
        spreads, none = measured.covariances, np.zeros(M)
        seen = Detections(stamp, lag, np.arange(M), where, spreads, likelihood, none, none.copy())
        active = np.flatnonzero(leaves.track >= 0)
        if verified:
            active = active[~np.isin(leaves.track[active], sorted(verified))]
        chosen, clear = touch(leaves, active, seen, spread, sensor, known, measured.silent, anchors.motion)
        self._hide(measured, chosen, clear, sensor)
        matrix, missing = weigh(leaves, chosen, clear, seen, self._classes, anchors.detector)
        room = self._room(seen, measured, chosen)
        seen = self._with_origins(seen, measured, room * born.sum(0), clutter)
        usual = float(np.median(spread)) if M else anchors.config.measurement_sigma
        reach = TOUCHING * usual if self.merging else 0.0
        return Look(seen, born, returned, room, reach, chosen, clear, matrix, missing)

    def _room(self, seen: Detections, measured: Measurements, chosen: IntArray) -> FloatArray:
        """Probability (M,) that something new can be at each detection: it is not inside of a body."""
        room = np.array(measured.begins, dtype=np.float64)
        if len(room):
            bodies = np.array([slot for slot in chosen.tolist() if self._is_shown(slot)], np.int64)
            room *= free(
                self.anchors.leaves, bodies, seen.positions, seen.covariances, self.anchors.quantities
            )
        return room

    def _with_origins(
        self, seen: Detections, measured: Measurements, born: FloatArray, clutter: float
    ) -> Detections:
        """The detections with how probable it is that each is new or false, (2.6)."""
        anchors, view = self.anchors, measured.view
        found = anchors.config.detection_probability * born
        false = None if view is None else view.density(seen.positions, seen.covariances)
        lying = np.full(len(found), clutter) if false is None else anchors.config.clutter_per_frame * false
        both = np.maximum(found + lying, 1e-300)
        return seen._replace(log_new=np.log(both), existence=found / both)

    def _is_shown(self, slot: int) -> bool:
        """Whether a leaf is that of an object of the most probable world."""
        anchors, number = self.anchors, int(self.anchors.leaves.track[slot])
        return number in anchors.shown and anchors.best_leaf(anchors.tracks[number]) == slot

    def _hide(self, measured: Measurements, chosen: IntArray, clear: FloatArray, sensor: FloatArray) -> None:
        """Lower the probability of having been in view of what is out of the view, or behind something: (2.10)."""
        view, quantities = measured.view, self.anchors.quantities
        in_cone = clear.copy()
        if view is not None and not measured.silent:
            restrict(self.anchors.leaves, chosen, clear, view, quantities)
        told = view is not None and view.depth is not None
        if measured.sensor is not None and not measured.silent and not told:
            hide(self.anchors.leaves, chosen, clear, sensor, quantities)
        self._cover(chosen, in_cone - clear > BELIEVED)
        if view is not None and view.rates.unknown:
            kinds = [self.anchors.class_name(slot) for slot in chosen.tolist()]
            clear[: len(chosen)] *= view.rates.reported(view.name, kinds)

    def _cover(self, slots: IntArray, covered: npt.NDArray[np.bool_]) -> None:
        """Movers that something else hides are looked for, and shown for as long as it is known where they are."""
        leaves, hidden = self.anchors.leaves, slots[covered]
        moving = hidden[leaves.move(hidden)]
        leaves.missed[moving] = np.maximum(leaves.missed[moving], 1.0)

    def associate(self, look: Look) -> tuple[list[int], list[int]]:
        """Decide what is plain, branch over the rest; returns touched clusters and a track per detection."""
        M = len(look.seen.log_new)
        ratio = look.matrix - look.missing[:, :1] - look.seen.log_new
        gated = ratio > -THRESHOLD
        look.matrix[~gated] = -np.inf
        linked = gated | touched_by(self.anchors.leaves, look, gated) if self.merging else gated
        per_leaf, per_detection = linked.sum(1).tolist(), linked.sum(0)
        tracks = self.anchors.leaves.track[look.chosen].tolist()
        owners = [self.anchors.tracks[t].cluster for t in tracks]
        first = linked.argmax(1).tolist() if M else [0] * len(tracks)
        alone = per_detection == 1
        decided: dict[int, int] = {}
        hard: set[int] = set()
        of = [-1] * M
        for k, (number, j) in enumerate(zip(owners, first, strict=True)):
            if not self.anchors.clusters[number].lonely:
                hard.add(number)
            elif per_leaf[k] == 0:
                decided[k] = -1
            elif per_leaf[k] == 1 and alone[j] and gated[k, j] and ratio[k, j] > THRESHOLD:
                decided[k], of[j] = j, tracks[k]
            else:
                hard.add(number)
        self._settle(look, decided)
        touched = [owners[k] for k in decided]
        lone = np.flatnonzero(per_detection == 0)
        touched += self._begin(look, lone, of)
        at = np.full(self.anchors.pool.size, -1)
        at[look.chosen] = np.arange(len(look.chosen))
        for members, detections in self._linked(hard, owners, linked):
            touched += self._branch(look, members, detections, of, at)
        return touched, of

    def _settle(self, look: Look, decided: dict[int, int]) -> None:
        """Leaves of a look take in their detections, -1 for missed."""
        if not decided:
            return
        k, blocks = np.array([*decided]), self.anchors.vocabulary.blocks
        missing, clear, detection = look.missing[k, 1], look.clear[k], np.array([*decided.values()])
        settle(self.anchors.leaves, look.chosen[k], detection, look.seen, blocks, missing, clear)

    def _begin(self, look: Look, which: IntArray, of: list[int]) -> list[int]:
        """New lonely clusters for detections that no leaf explains; returns their numbers."""
        if len(which) == 0:
            return []
        self._expect_company(look, which)
        self.anchors.pool.reserve(len(which))
        numbers = self.anchors.numbers(len(which))
        slots = begin(self.anchors.pool.rows, numbers, which, look.seen, self._classes)
        for number, slot, j in zip(numbers.tolist(), slots.tolist(), which.tolist(), strict=True):
            self.anchors.tracks[number] = self._track(number, look, j)
            self.anchors.clusters[number] = lonely(number, slot)
            of[j] = number
        return numbers.tolist()

    @staticmethod
    def _track(number: int, look: Look, j: int) -> Track:
        return Track(number, number, born=look.born[:, j], returned=float(look.returned[j]))

    def _expect_company(self, look: Look, which: IntArray) -> None:
        """Far more unexplained detections than clutter ever makes are new objects that came together."""
        n, clutter = len(which), self.anchors.config.clutter_per_frame
        usual = clutter + self.anchors.unseen.awaited
        log_usual = n * np.log(max(usual, 1e-9)) - usual - gammaln(n + 1)
        log_burst = np.log(BURST / COMPANY) - n / COMPANY
        share = 1.0 / (1.0 + np.exp(min(log_usual - log_burst, 700.0)))
        together = share * n / (n + clutter)
        existence = look.seen.existence
        existence[which] = np.maximum(existence[which], together * look.room[which])

    def _linked(
        self, hard: set[int], owners: list[int], linked: npt.NDArray[np.bool_]
    ) -> list[tuple[list[int], list[int]]]:
        """Clusters joined where they compete for a detection, with their detections."""
        claims: dict[int, set[int]] = {number: set() for number in sorted(hard)}
        for k, j in zip(*(index.tolist() for index in np.nonzero(linked)), strict=True):
            if owners[k] in claims:
                claims[owners[k]].add(j)
        groups: list[tuple[list[int], set[int]]] = []
        for number, detections in claims.items():
            rivals = [group for group in groups if group[1] & detections]
            groups = [group for group in groups if not group[1] & detections]
            members = [number, *(member for others, _ in rivals for member in others)]
            groups.append((sorted(members), detections.union(*(theirs for _, theirs in rivals))))
        return [(members, sorted(detections)) for members, detections in sorted(groups)]

    def _branch(
        self, look: Look, members: list[int], detections: list[int], of: list[int], at: IntArray
    ) -> list[int]:
        """Expand the hypotheses of these clusters together; returns the clusters they fall apart into.

        at : rows of `look` by leaf, -1 for leaves that it does not concern.
        """
        whole = self.anchors.joined(members)
        slots = leaves_in(whole.rows)
        js = np.array(detections, np.int64)
        seen = look.seen.only(js)
        k = at[slots]
        here = k >= 0
        matrix, missing, clear = look.matrix[k[:, None], js], look.missing[k], look.clear[k]
        if not here.all():
            matrix[~here], missing[~here], clear[~here] = -np.inf, 0.0, 0.0
        local = np.searchsorted(slots, whole.rows)
        local[whole.rows < 0] = -1
        movers = self._movers(slots, here, look.reach)
        keep = self.anchors.config.hypotheses
        children = expand(local, whole.weights, matrix, missing[:, 0].copy(), seen, movers, keep, THRESHOLD)
        self.anchors.pool.reserve((len(slots) * (1 + len(children.groups)) + 1) * len(js) + 1)
        fresh = self.anchors.numbers(len(js))
        pool = self.anchors.pool.rows
        rows = realise(pool, slots, local, children, missing[:, 1].copy(), clear, seen, fresh, self._classes)
        choice, weights = children.choice, children.weights
        for column in range(len(whole.tracks)):
            j = choice[0, column]
            if j >= 0:
                j %= len(js)
                of[detections[j]] = whole.tracks[column]
        for j, number in zip(detections, fresh.tolist(), strict=True):
            self.anchors.tracks[number] = self._track(number, look, j)
            if of[j] < 0:
                of[j] = number
        join(pool, rows, weights, self.anchors.persistence, self.anchors.vocabulary.width)
        rows, weights = self.bodies.possible(*unify(rows, weights))
        if len(weights) > 1:
            rows, weights = self.anchors.without_names(rows, weights)
        return self.anchors.divide([*whole.tracks, *fresh.tolist()], rows, weights)

    def _movers(self, slots: IntArray, here: npt.NDArray[np.bool_], reach: float) -> Movers:
        """Which of these leaves (n,) may share a detection; here (n,) : whether the look concerns them."""
        if reach <= 0.0:
            return NOBODY
        leaves = self.anchors.leaves
        centres, spreads = leaves.moving[slots, :3], leaves.moving_cov[slots, :3, :3]
        return Movers(sharing(leaves, slots, here), centres, spreads, leaves.together[slots], reach)
