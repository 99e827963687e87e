"""Probabilistic multiple hypothesis anchoring: section 2.5, on clusters of track trees with shared leaves."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from world_model.anchoring.anchors import Anchors
from world_model.anchoring.associate import Association
from world_model.anchoring.beliefs import Beliefs
from world_model.anchoring.bodies import Bodies
from world_model.anchoring.guidance import Guidance
from world_model.anchoring.loops.look import Look
from world_model.anchoring.present import Presentation
from world_model.anchoring.recognition import Recognition
from world_model.anchoring.single import SingleObjects
from world_model.calibration.corrections import MOST_LOOKS, Corrections
from world_model.config import WorldModelConfig
from world_model.evidence import Measurements
from world_model.predictions import Behavior

TIDY = 64  # Looks after which anchors that nobody believes in are looked for


class Anchoring:
    """The state `anchors`, and the parts that act on it: `guidance`, `association`, `beliefs`, `bodies`, `recall`,
    `objects`, `presentation`; `calibration` corrects what a sensor gets wrong. most_looks : that it keeps. behaviors :
    of classes, beside those of the settings (the set M of section 2.4.2)."""

    def __init__(
        self,
        config: WorldModelConfig,
        most_looks: int = MOST_LOOKS,
        behaviors: Mapping[str, Behavior] | None = None,
    ) -> None:
        self.anchors = Anchors(config)
        self.guidance = Guidance(self.anchors, behaviors or {})
        self.presentation = Presentation(self.anchors, self.guidance)
        self.beliefs = Beliefs(self.anchors, self.presentation)
        self.bodies = Bodies(self.anchors)
        self.association = Association(self.anchors, self.bodies)
        self.objects = SingleObjects(self.anchors, self.beliefs)
        self.recall = Recognition(self.anchors, self.objects, self.bodies)
        self.calibration = Corrections(self.anchors, self.beliefs, self.objects, most_looks)
        self._looks = 0

    def reset(self) -> None:
        """Forget all anchors; the vocabulary stays."""
        self.anchors.reset()
        self.calibration.reset()
        self._looks = 0

    def look(self, measured: Measurements, stamp: float, lag: float) -> tuple[str | None, ...]:
        """Take a look in that was made `lag` seconds before `stamp`; returns the id per detection."""
        anchors = self.anchors
        anchors.stamp = stamp
        anchors.rounds.look(measured.sensor, stamp - lag, measured.silent)
        self.guidance.lead(stamp)
        raw, measured = measured, self.calibration.corrected(measured, stamp - lag)
        measured, verified = self.objects.told(measured, stamp, lag)
        look = self.association.weighed(measured, stamp, lag, set(verified.values()))
        owners = self._taken_in(raw, measured, look, bool(verified))
        self.recall.recognise()
        self._looks += 1
        if self._looks % TIDY == 0:
            anchors.tidy()
        for index, number in verified.items():
            owners.insert(index, number)
        self.calibration.learn(raw, owners)
        symbols = tuple(anchors.symbol(number) for number in owners)
        likelihood = anchors.vocabulary.likelihoods(raw.attributes) if verified else look.seen.likelihood
        self.calibration.keep(raw, likelihood, stamp - lag, owners, symbols)
        return symbols

    def _taken_in(self, raw: Measurements, measured: Measurements, look: Look, told: bool) -> list[int]:
        """Associate, measure and believe; returns a track per detection. told : whether some named theirs."""
        anchors, leaves = self.anchors, self.anchors.leaves
        leaves.said[:] = -1
        values, spreads = anchors.quantities.arrays(measured.quantities)
        measures = bool((spreads >= 0.0).any())
        if measures:
            look.matrix += anchors.quantities.log_factors(leaves, look.chosen, values, spreads)
        if not told:
            self.calibration.weigh(raw, look)
        touched, owners = self.association.associate(look)
        if measures:
            leaves = anchors.leaves
            slots = np.flatnonzero(leaves.said >= 0)
            said = leaves.said[slots]
            anchors.quantities.learn(leaves, slots, values[said], spreads[said])
        self.beliefs.show(touched)
        return owners
