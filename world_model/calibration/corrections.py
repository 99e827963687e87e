"""What a moving sensor gets wrong, learned while anchoring: detections corrected, and earlier conclusions."""

from __future__ import annotations

from collections import deque
from dataclasses import replace

import numpy as np

from estimation.checks import FloatArray
from world_model.anchoring.anchors import THRESHOLD, Anchors
from world_model.anchoring.beliefs import Beliefs
from world_model.anchoring.loops.kernels import attribute_factor
from world_model.anchoring.loops.leaves import REST
from world_model.anchoring.loops.look import Look
from world_model.anchoring.single import SingleObjects
from world_model.calibration.revision import KeptLook, explained
from world_model.calibration.sensor_bias import CONSTANT
from world_model.calibration.sensor_errors import SensorErrors
from world_model.calibration.sensor_filter import error_basis
from world_model.calibration.sensor_worlds import NEAR, SensorDetections
from world_model.evidence import Measurements

FIRST_LOOKS = 100  # Looks of a sensor that has not moved; as many as are needed where nobody looks back
MOST_LOOKS = 4000  # Older looks are forgotten: what they said is in the places of objects
TWINS = 0.03  # m: no two objects rest as near each other, nor nearer than a detection's standard deviation
Symbols = tuple[str | None, ...]
Looks = list[tuple[float, Symbols]]  # Stamp, s, and object of each detection, per look


class Corrections:
    """One look after the other: `corrected`, `weigh`, `learn`, `keep`. With `learn_sensor_bias` errors are learned,
    else they are what the settings say. bias : the sensor's errors. most_looks : how many are kept to be explained
    anew."""

    def __init__(
        self, anchors: Anchors, beliefs: Beliefs, objects: SingleObjects, most_looks: int = MOST_LOOKS
    ) -> None:
        self.anchors, self.beliefs, self.objects = anchors, beliefs, objects
        self.learns = anchors.config.learn_sensor_bias
        self.bias = SensorErrors(np.resize([*anchors.config.sensor_bias, *np.zeros(CONSTANT)], CONSTANT))
        self.looks: deque[KeptLook] = deque(maxlen=most_looks)
        self._said: list[int] | None = None

    def reset(self) -> None:
        """Nothing is known but what the settings say."""
        self.bias.reset()
        self.looks.clear()

    def corrected(self, measured: Measurements, stamp: float) -> Measurements:
        """Detections of a look at a stamp, s, without the errors that the sensor is known to have."""
        self._said = None
        if measured.sensor is None:
            return measured
        moved = self.bias.moved
        watching = self.bias.follow(measured.sensor.pose, stamp)
        if self.bias.moved and not moved:
            self._catch_up()
        if watching and self.learns:
            self.bias.worlds.predict(stamp)
            self._introduce(measured.positions)
        if not self.bias.values.any():
            return measured
        errors = np.concatenate([self.bias.values, self.bias.shared])
        positions = measured.positions.copy()
        positions[:, :2] -= error_basis(positions, measured.sensor.pose, self.bias.rate) @ errors
        return replace(measured, positions=positions)

    def _introduce(self, positions: FloatArray) -> None:
        """Objects near detections (M, 3) come to the filter of the sensor's errors; those that are gone leave it."""
        leaves, ids = self.anchors.leaves, self.bias.ids
        self.bias.keep_only(set(self.anchors.resting(ids)))
        active = np.flatnonzero(leaves.track >= 0)
        apart = np.abs(leaves.rest[active, None, :2] - positions[:, :2])
        close = np.any(np.all(apart < NEAR, axis=2), axis=1)
        near = leaves.track[active[close]]
        # What this sensor saw, off as it is, begins with a detection.
        for number, slot in self.anchors.resting(set(near.tolist()) - set(ids) - self.bias.before).items():
            place, spread = leaves.rest[slot, :2].copy(), leaves.rest_cov[slot, :2, :2].copy()
            self.bias.remember(number, place, spread)

    def weigh(self, raw: Measurements, look: Look) -> None:
        """Give detections to resting objects as the joint filter has it, where that is in use.

        What it says goes into the weights of the look: one object for a detection and no other, or none that rests.
        """
        if raw.sensor is None or not self.bias.in_use or not len(raw.positions):
            return
        leaves, bias = self.anchors.leaves, self.bias
        tracks = leaves.track[look.chosen]
        movers = np.array([self.anchors.moves(slot) for slot in look.chosen.tolist()], bool)
        spread = 2.0 * look.seen.covariances[:, 2, 2]
        level = -0.5 * np.log(2.0 * np.pi * spread)
        ratio = look.matrix - look.missing[:, :1]
        otherwise = np.logaddexp(look.seen.log_new, ratio[movers].max(0, initial=-np.inf))
        unlike = {}
        for number, slot in self.anchors.resting(bias.ids).items():
            factor = [
                attribute_factor(leaves.attributes[slot], line, self.anchors.vocabulary.blocks)
                for line in look.seen.likelihood
            ]
            height = (look.seen.positions[:, 2] - leaves.rest[slot, 2]) ** 2 / spread
            unlike[bias.ids[number]] = height - 2.0 * np.log(np.array(factor) + 1e-12)
        z, R = raw.positions[:, :2], raw.covariances[:, :2, :2]
        J = error_basis(raw.positions, raw.sensor.pose, bias.rate)
        said = bias.worlds.look(
            SensorDetections(z, R, J, -2.0 * (otherwise - level), unlike, float(bias.rate[2]))
        )
        names = {name: number for number, name in bias.ids.items()}
        surely = ~movers & (leaves.behavior[look.chosen, REST] > 0.5)
        for j, name in enumerate(said):
            mine = np.asarray(tracks == names.get(name, -1), bool)
            if name in names and not mine.any():
                continue
            look.matrix[surely & ~mine, j] = -np.inf
            if mine.any():
                look.matrix[mine] = np.where(np.arange(len(said)) == j, look.matrix[mine], -np.inf)
                least = look.missing[mine, 0] + look.seen.log_new[j] + THRESHOLD + 1.0
                look.matrix[mine, j] = np.maximum(look.matrix[mine, j], least)
        self._said = said

    def _catch_up(self) -> None:
        """The sensor has moved for the first time: what it said before counts as well."""
        looks = [look for look in self.looks if look.stamp >= self.bias.since]
        resting = set(self.anchors.resting({number for look in looks for number in look.owners}))
        for look in looks:
            self.bias.worlds.predict(look.stamp)
            self._witness(look.measured, look.owners, resting, look.rate)

    def _witness(self, raw: Measurements, owners: list[int], resting: set[int], rate: FloatArray) -> None:
        """What resting objects say about the sensor, owners (M,) being whose detections are, at its rate (3,)."""
        assert raw.sensor is not None
        mine = [j for j, number in enumerate(owners) if number in resting]
        numbers = [owners[j] for j in mine]
        self.bias.add(numbers, raw.positions[mine, :2], raw.covariances[mine, :2, :2], raw.sensor.pose, rate)

    def learn(self, raw: Measurements, owners: list[int]) -> None:
        """Take in what resting objects say about the sensor, and move all of them accordingly.

        owners (M,) : whose each detection was, by number of track; may be corrected.
        """
        bias, leaves, said = self.bias, self.anchors.leaves, self._said
        if raw.sensor is None or not self.learns:
            return
        if not bias.moved:
            bias.before |= set(owners)
            return
        if not bias.watching:
            return
        resting = self.anchors.resting({*owners, *bias.ids})
        if said is None and not bias.in_use:
            self._witness(raw, owners, set(resting), bias.rate)
        elif said is not None:
            bias.name(said, owners, set(resting))
        bias.limit(owners)
        if not bias.in_use:
            return
        best = bias.worlds.best
        names = {name: number for number, name in bias.ids.items()}
        for name, place in zip(best.numbers, best.places, strict=True):
            number = names.get(name, -1)
            if number in resting:
                of = self.anchors.leaves_of(self.anchors.tracks[number])
                leaves.rest[of, :2] = place
        self._join_twins(raw, owners, {number: names for names, number in names.items() if number in resting})

    def keep(
        self, raw: Measurements, likelihood: FloatArray, stamp: float, owners: list[int], symbols: Symbols
    ) -> None:
        """Keep a look with the likelihood (M, A) of its words, so that later evidence can correct whose it was."""
        if raw.sensor is not None and owners and self.learns:
            # The words take many times the room of the numbers, and their likelihood says what they did.
            seen = replace(raw, attributes=(), quantities=(), object_ids=())
            look = KeptLook(stamp, seen, likelihood, list(owners), symbols, self.bias.rate)
            if not self.bias.moved and len(self.looks) >= FIRST_LOOKS:
                self.looks.popleft()
            self.looks.append(look)

    def _join_twins(self, raw: Measurements, owners: list[int], names: dict[int, int]) -> None:
        """What was taken for two objects, because the sensor was off, and is at one place now, is one: the older."""
        best = self.bias.worlds.best
        at = dict(zip(best.numbers, best.places, strict=True))
        known = {number: at[name] for number, name in names.items() if name in at}
        seen = set(owners)
        for j, number in enumerate(owners):
            if number not in known:
                continue
            near = min(TWINS, float(np.sqrt(raw.covariances[j, :2, :2].diagonal().min())))
            for other in set(known) - seen:
                if np.hypot(*(known[other] - known[number])) < near and self._like(number, other):
                    gone, kept = max(number, other), min(number, other)
                    self.objects.remove(self.anchors.tracks[gone])
                    del known[gone]
                    self.bias.keep_only(set(self.bias.ids) - {gone})
                    owners[j] = kept
                    break

    def _like(self, number: int, other: int) -> bool:
        """Whether two objects may be one by their attributes."""
        slots = [self.anchors.best_leaf(self.anchors.tracks[n]) for n in (number, other)]
        one, two = (self.anchors.leaves.attributes[slot] for slot in slots)
        return all(
            float(one[a:b] @ two[a:b]) > 0.5 * float(one[a:b].max() * two[a:b].max())
            for a, b in self.anchors.vocabulary.blocks.tolist()
            if b > a
        )

    def look_back(self) -> Looks:
        """Explain all looks that are kept anew; places of resting objects and the errors of the sensor follow.

        Returns stamps, s, and the symbols of the detections of each look as they are taken for now.
        """
        believed = [
            track
            for track in self.anchors.tracks.values()
            if track.number in self.anchors.shown and not track.lost
        ]
        resting = [track for track in believed if not self.anchors.moves(self.anchors.best_leaf(track))]
        if not resting or not self.looks:
            return [(look.stamp, look.symbols) for look in self.looks]
        slots = np.array([self.anchors.best_leaf(track) for track in resting], np.int64)
        best = {number: self.anchors.best_leaf(track) for number, track in self.anchors.tracks.items()}
        movers = {number for number, slot in best.items() if slot >= 0 and self.anchors.moves(slot)}
        leaves, numbers = self.anchors.leaves, [track.number for track in resting]
        blocks, known = self.anchors.vocabulary.blocks, self.bias.known
        found, owners = explained(self.looks, numbers, slots, movers, leaves, blocks, known)
        shifts = found.places - leaves.rest[slots, :2]
        for track, shift in zip(resting, shifts, strict=True):
            of = self.anchors.leaves_of(track)
            leaves.rest[of, :2] += shift
            leaves.moving[of, :2] += shift
        self.bias.take(found.constant, found.shared[-1], dict(zip(numbers, found.places, strict=True)))
        self.beliefs.show(track.cluster for track in resting)
        symbols = []
        for look, tracks in zip(self.looks, owners, strict=True):
            names = [
                (self.anchors.tracks[now].id if now in self.anchors.tracks else None) or symbol
                for now, symbol in zip(tracks, look.symbols, strict=True)
            ]
            symbols.append((look.stamp, tuple(names)))
            look.owners, look.symbols = tracks, tuple(names)
        return symbols
