"""What others get to see of anchors: world objects with their signatures (2.3)."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from world_model.anchoring.anchors import Anchors
from world_model.anchoring.guidance import Guidance
from world_model.anchoring.loops.clusters import Track
from world_model.anchoring.loops.kernels import copy_leaf, predict
from world_model.state import BELIEVED, WorldObject


class Presentation:
    """Makes objects of leaves."""

    def __init__(self, anchors: Anchors, guidance: Guidance) -> None:
        self.anchors = anchors
        self.guidance = guidance

    def made(self, track: Track, slot: int) -> WorldObject:
        """The object that a leaf of a track stands for."""
        anchors = self.anchors
        leaves = anchors.leaves
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
            region = (track.region if track.lost else None) or anchors.config.region
            low, high = np.array(region).T
            position, covariance = 0.5 * (low + high), np.diag((high - low) ** 2 / 12)
        attributes = anchors.vocabulary.distributions(leaves.attributes[slot])
        stays = "predicted" if anchors.moves(slot) else "constant_position"
        behaviors = {stays: rest, "constant_velocity": moving, "uniform": away}
        existence = rest + moving if sought and not lost else 1.0 - none
        seen = float(leaves.last[slot]), float(leaves.first[slot])
        noise, quantities = self.guidance.growth(track, slot), anchors.quantities.described(leaves, slot)
        # What is shown stays in the model until it changes; who gets to see it must not be able to change it.
        for array in (position, velocity, covariance, noise):
            array.flags.writeable = False
        signature = track.id or "", position, velocity, covariance, attributes, existence, lost, *seen
        return WorldObject(*signature, behaviors, region, process_noise=noise, quantities=quantities)

    def predicted(self, stamp: float) -> list[WorldObject]:
        """What is shown, propagated to `stamp` on copies."""
        anchors = self.anchors
        out = []
        anchors.pool.reserve(1)
        for number, shown in anchors.shown.items():
            track = anchors.tracks[number]
            slot = anchors.best_leaf(track)
            scratch = anchors.pool.take()
            leaves = anchors.leaves
            copy_leaf(leaves, slot, scratch)
            self.guidance.lead_copy(track, scratch, stamp)
            predict(leaves, scratch, stamp, anchors.motion, anchors.config.removed_per_second)
            out.append(replace(self.made(track, scratch), alternatives=shown.alternatives))
            anchors.pool.give(scratch)
        return out

    def health(self) -> dict[str, float]:
        """Figures for diagnostics."""
        anchors = self.anchors
        return {
            "objects": len(anchors.shown),
            "anchors": len(anchors.tracks),
            "hypotheses": max((len(anchors.clusters[n].weights) for n in anchors.open), default=1),
            "leaves": anchors.pool.used,
            "predicted paths": len(anchors.courses),
        }
