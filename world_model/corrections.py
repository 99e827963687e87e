"""What a moving sensor gets wrong, as part of anchoring: detections corrected, and earlier conclusions."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from world_model.evidence import Measurements
from world_model.grouping import Grouping
from world_model.hindsight import Hindsight
from world_model.kernels import SETTLED_HITS
from world_model.sensor_bias import SensorBias

NEAR = 1.0
"""m: objects this far from all detections say nothing about the errors that these share."""


class Corrections(Grouping):
    """Part of `Anchoring`: the sensor's errors, and looks explained anew."""

    bias: SensorBias
    hindsight: Hindsight

    def _unbiased(self, measured: Measurements, stamp: float) -> Measurements:
        """Detections without the errors that the sensor is known to have; those of a resting sensor as they are."""
        if measured.sensor is None or not self.bias.follow(measured.sensor.pose):
            return measured
        positions = self.bias.corrected(measured.positions, measured.sensor.pose)
        if self.bias.moved:
            known = [self._best_leaf(track) for track in self.tracks.values()]
            slots = np.array([s for s in known if s >= 0 and self._settled(s)], np.int64)
            apart = measured.positions[:, None, :2] - self.pool.leaves.rest[slots, :2]
            slots = slots[(np.abs(apart) < NEAR).all(2).any(0)]
            likelihood = self.vocabulary.likelihoods(measured.attributes)
            positions = self.bias.aligned(
                positions, measured, self.pool.leaves, slots, likelihood, self.vocabulary.blocks, stamp
            )
        return replace(measured, positions=positions)

    def _settled(self, slot: int) -> bool:
        return bool(self.pool.leaves.hits[slot] >= SETTLED_HITS and self._rests(slot))

    def _learn_bias(self, raw: Measurements, owners: list[int]) -> None:
        """Take in what settled objects say about the sensor, and move them when it turns out to be off."""
        leaves, used, slots = self.pool.leaves, [], []
        for j, number in enumerate(owners):
            slot = self._best_leaf(self.tracks[number]) if number in self.tracks else -1
            if slot >= 0 and self._settled(slot):
                used.append(j)
                slots.append(slot)
        if raw.sensor is not None and used:
            numbers = [owners[j] for j in used]
            self.bias.add(
                numbers, leaves.rest[slots], raw.positions[used], raw.covariances[used], raw.sensor.pose
            )
        self.bias.keep_only(set(self.tracks))
        solved = self.bias.solve()
        if solved is None:
            return
        for number, shift in zip(*solved, strict=True):
            of = self._leaves_of(self.tracks[number])
            leaves.rest[of, :2] += shift
            leaves.moving[of, :2] += shift

    def look_back(self) -> list[tuple[float, tuple[str | None, ...]]]:
        """Explain all looks that are kept anew; places of resting objects and the errors of the sensor follow.

        Returns stamps, s, and the symbols of the detections of each look as they are taken for now.
        """
        believed = [track for track in self.tracks.values() if track.number in self.shown and not track.lost]
        resting = [track for track in believed if not self._moves(self._best_leaf(track))]
        if not resting:
            return [(look.stamp, look.symbols) for look in self.hindsight.looks]
        slots = np.array([self._best_leaf(track) for track in resting], np.int64)
        best = {number: self._best_leaf(track) for number, track in self.tracks.items()}
        movers = {number for number, slot in best.items() if slot >= 0 and self._moves(slot)}
        leaves, numbers = self.pool.leaves, [track.number for track in resting]
        found, owners = self.hindsight.explained(
            numbers, slots, movers, leaves, self.vocabulary.blocks, self.bias.known
        )
        shifts = found.places - leaves.rest[slots, :2]
        for track, shift in zip(resting, shifts, strict=True):
            of = self._leaves_of(track)
            leaves.rest[of, :2] += shift
            leaves.moving[of, :2] += shift
        self.bias.take(found.constant, found.shared[-1])
        for track in resting:
            self._show(track.cluster, self._stamp)
        symbols = []
        for look, tracks in zip(self.hindsight.looks, owners, strict=True):
            names = [
                self.tracks[now].id if now in self.tracks and now != before else symbol
                for now, before, symbol in zip(tracks, look.owners, look.symbols, strict=True)
            ]
            symbols.append((look.stamp, tuple(names)))
            look.owners, look.symbols = tracks, tuple(names)
        return symbols
