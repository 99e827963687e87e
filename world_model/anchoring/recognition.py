"""What was known comes back: carried objects recognised in new anchors (section 2.6.2), and objects of a store.

That a detection far from everything known is a known object, carried there, is as likely at the first detection as
at any later one, because both this object and a new one may be anywhere. So it is weighed once, when the new
anchor is first believed in, and kept as a hypothesis beside the other until evidence decides: whether the old
place is found empty or the known object is found there after all.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Protocol

import numpy as np

from estimation.checks import FloatArray
from world_model.anchoring.anchors import Anchors
from world_model.anchoring.bodies import Bodies
from world_model.anchoring.loops.clusters import Track, lonely
from world_model.anchoring.loops.expansion import unify
from world_model.anchoring.loops.kernels import copy_leaf, learn_attributes
from world_model.anchoring.loops.leaves import AWAY, NONE, IntArray, leaves_in
from world_model.anchoring.single import SingleObjects
from world_model.config import motion_of
from world_model.state import WorldObject
from world_model.symbols import parse_symbol

LEAST_ODDS = 1e-3
MOST_CANDIDATES = 3


class Usual(Protocol):
    """What is known of where things go; see `world_model.memory.household`. smallest : m², area of the least place."""

    smallest: float

    def odds(
        self, object_id: str, class_name: str, spot: FloatArray, stamp: float, trust: float, area: float
    ) -> float: ...


class Recognition:
    """usual : where things go, if that is learned."""

    def __init__(self, anchors: Anchors, objects: SingleObjects, bodies: Bodies) -> None:
        self.anchors = anchors
        self.objects = objects
        self.beliefs = objects.beliefs
        self.bodies = bodies
        self.usual: Usual | None = None

    def recognise(self) -> None:
        """Hypotheses in which an anchor that is new in this look is a known object, which was carried; it is shown."""
        anchors = self.anchors
        if not anchors.fresh:
            return
        fresh = set(anchors.fresh)
        known = [t for t in anchors.tracks.values() if t.id is not None and t.number not in fresh]
        # More may turn out to be new while these are taken in.
        for number in anchors.fresh:
            if number in anchors.tracks:
                self._recognise(anchors.tracks[number], known)
        anchors.fresh.clear()

    def _recognise(self, track: Track, known: Sequence[Track]) -> None:
        anchors, number = self.anchors, track.number
        if self.bodies.filled(number):
            # However often it is detected: it is a part of what is known to be there.
            self.objects.remove(track)
            return
        new, carried = anchors.best_leaf(track), 0.0
        named = [other for other in known if other.number in anchors.tracks]
        if named and new >= 0:
            slots = np.array([anchors.best_leaf(other) for other in named])
            named = [other for other, slot in zip(named, slots, strict=True) if slot >= 0]
            slots = slots[slots >= 0]
            odds = self.odds(slots, new, track)
            carried = float(odds.sum())
            likeliest = np.argsort(-odds, kind="stable")[:MOST_CANDIDATES]
            for index in likeliest[odds[likeliest] > LEAST_ODDS]:
                if number in anchors.tracks:
                    self._add_alternatives(track, named[index])
        # What was carried here is no new object.
        anchors.unseen.found += track.born / max(track.born.sum(), 1e-300) / (1.0 + carried)
        if number in anchors.tracks:
            self.beliefs.show([anchors.tracks[number].cluster])

    def odds(self, slots: IntArray, new: int, track: Track) -> FloatArray:
        """Odds (n,) of the leaf `new` of a track being each of the known objects (n,) against its being new."""
        anchors, leaves = self.anchors, self.anchors.leaves
        rows = np.array([anchors.motion_row(slot) for slot in slots.tolist()], dtype=int)
        gone = self._away(slots, anchors.motion[rows, 2], float(leaves.first[new]))
        alike = agreement(leaves.attributes[slots], leaves.attributes[new], anchors.vocabulary.blocks)
        values: FloatArray = (
            gone * track.returned / anchors.unseen.volume / max(track.born.sum(), 1e-300) * alike
        )
        values[leaves.last[slots] >= leaves.first[new]] = 0.0
        own = leaves.values[new : new + 1], leaves.variances[new : new + 1]
        values *= np.exp(anchors.quantities.log_factors(leaves, slots, *own)[:, 0])
        if self.usual is not None:
            self._weigh(self.usual, values, slots, new)
        return values

    def _away(self, slots: IntArray, carried: FloatArray, stamp: float) -> FloatArray:
        """Probability (n,) of each leaf's object having been carried away by `stamp`; carried (n,) rates, 1/s."""
        leaves = self.anchors.leaves
        taken = 1.0 - np.exp(-carried * np.maximum(stamp - leaves.stamp[slots], 0.0))
        result: FloatArray = leaves.behavior[slots, AWAY] + taken * leaves.here(slots)
        return result

    def _weigh(self, usual: Usual, values: FloatArray, slots: IntArray, new: int) -> None:
        """Multiply odds (n,) by how much likelier the known objects are put down where the new one is than anywhere."""
        anchors = self.anchors
        (x0, x1), (y0, y1), _ = anchors.config.region
        area = (x1 - x0) * (y1 - y0)
        leaves = anchors.leaves
        spot, stamp = leaves.rest[new], float(leaves.first[new])
        # What is hopeless even at its own place is not asked about.
        for index in np.flatnonzero(values * max(area / usual.smallest, 1.0) > LEAST_ODDS).tolist():
            slot = int(slots[index])
            name = anchors.class_name(slot)
            trust = motion_of(name, anchors.config.motion).usual_place
            known = anchors.tracks[int(leaves.track[slot])].id or ""
            values[index] *= usual.odds(known, name, spot, stamp, trust, area)

    def _add_alternatives(self, new: Track, known: Track) -> None:
        anchors, leaves = self.anchors, self.anchors.leaves
        whole = anchors.joined(sorted({new.cluster, known.cluster}))
        a, b = whole.tracks.index(new.number), whole.tracks.index(known.number)
        used = whole.rows[whole.rows[:, a] >= 0, a]
        if not len(used):
            # No hypothesis that is worth keeping has the new anchor any more.
            anchors.divide(list(whole.tracks), whole.rows, whole.weights)
            return
        slots = leaves_in(whole.rows[:, b])
        values = dict(zip(slots.tolist(), self.odds(slots, int(used[0]), new).tolist(), strict=True))
        made: dict[tuple[int, int], int] = {}
        rows, weights = [whole.rows], [whole.weights]
        for h, (leaf, old) in enumerate(whole.rows[:, [a, b]].tolist()):
            if leaf < 0 or not values.get(old, 0.0) > 0.0:
                continue
            if (leaf, old) not in made:
                slot = anchors.pool.take()
                leaves = anchors.leaves
                copy_leaf(leaves, leaf, slot)
                leaves.track[slot] = known.number
                learn_attributes(leaves.attributes[slot], leaves.attributes[old], anchors.vocabulary.blocks)
                leaves.first[slot] = leaves.first[old]
                made[leaf, old] = slot
            row = whole.rows[h].copy()
            row[a], row[b] = -1, made[leaf, old]
            rows.append(row[None])
            weights.append(whole.weights[h : h + 1] + np.log(values[old]))
        joint = unify(np.concatenate(rows), np.concatenate(weights))
        anchors.divide(whole.tracks, *self.bodies.possible(*joint))
        self.beliefs.show([known.cluster])

    def remember(self, item: WorldObject, stamp: float) -> None:
        """An object as a store had it."""
        anchors = self.anchors
        for name, distribution in item.attributes.items():
            for value in distribution:
                if name in anchors.vocabulary.values and value not in anchors.vocabulary.values[name]:
                    anchors.learn_value(name, value)
        slot, leaves = anchors.pool.take(), anchors.leaves
        number = int(anchors.numbers(1)[0])
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
        leaves.behavior[slot, NONE] = max(1.0 - leaves.behavior[slot].sum(), 0.0)
        leaves.led[slot] = 0.0
        leaves.visible[slot] = 1.0
        leaves.stamp[slot], leaves.last[slot] = stamp, item.last_seen
        leaves.first[slot], leaves.hits[slot], leaves.missed[slot] = item.first_seen, 3, 0.0
        self._attribute(item, slot)
        anchors.tracks[number] = Track(
            number, number, item.id, item.lost, recognised=True, region=item.region
        )
        anchors.clusters[number] = lonely(number, slot)
        if (counted := parse_symbol(item.id)) is not None:
            self.objects.reserve(dict([counted]))
        self.beliefs.show([number])

    def _attribute(self, item: WorldObject, slot: int) -> None:
        """Its attributes and quantities, into a leaf."""
        anchors, leaves = self.anchors, self.anchors.leaves
        leaves.variances[slot] = -1.0
        taken = {name: value for name, value in item.quantities.items() if name in anchors.quantities.names}
        anchors.quantities.learn(leaves, np.array([slot]), *anchors.quantities.arrays([taken]))
        leaves.attributes[slot] = anchors.vocabulary.prior()
        for (start, end), name in zip(anchors.vocabulary.blocks, anchors.vocabulary.names, strict=True):
            known = item.attributes.get(name)
            if known:
                leaves.attributes[slot, start:end] = anchors.vocabulary.columns(name, known)


def agreement(a: FloatArray, b: FloatArray, blocks: IntArray) -> FloatArray:
    """How much likelier equal attributes (n, A) and (A,) are of one object than of two."""
    out = np.ones(len(a))
    for start, end in blocks:
        if end > start:
            out *= (end - start) * (a[:, start:end] * b[start:end]).sum(1)
    return out
