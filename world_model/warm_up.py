"""Compiles, or loads from the cache, what the world model runs per look, so that the first is as fast as others."""

from __future__ import annotations

from functools import cache

import numpy as np

from world_model.anchoring.anchoring import Anchoring
from world_model.config import WorldModelConfig
from world_model.evidence import ObjectEvidence, WorldEvidence, checked
from world_model.predictions import Path

LOOKS = 24
NOISE = 0.05  # m, and s between looks: any small number does
TWINS = [(0.0, 0.0, 1.0), (0.12, 0.0, 1.0), (1.0, 1.0, 1.0)]
SENSOR = {"pose": (-3.0, 0.0, 1.0, 0.0), "range": 10.0, "angle": 2.0}


@cache
def warm_up() -> None:
    """Let a throw-away model see twins, false detections and movers; once per process."""
    rng = np.random.default_rng(0)
    for model in ("static", "constant_velocity"):
        config = WorldModelConfig(
            classes=("a", "b"),
            region=((-2.0, 2.0), (-2.0, 2.0), (0.0, 2.0)),
            detection_probability=0.5,
            clutter_per_frame=2.0,
            missed_run_frames=2.0,
            motion={"*": {"model": model, "moved_per_second": 0.5}},
            merged_detections=True,
            hypotheses=10,
        )
        anchors = Anchoring(config)
        for step in range(LOOKS):
            spots = TWINS if step < LOOKS // 2 else [(0.0, 1.0, 1.0)]
            seen = [np.array(p) + rng.normal(0.0, NOISE, 3) for p in spots if rng.random() < 0.5]
            seen += list(rng.uniform([-2, -2, 0], [2, 2, 2], (rng.poisson(2.0), 3)))
            kinds, size = {"class": {"a": 0.6, "b": 0.4}}, {"size": (NOISE, NOISE**2)}
            given = [ObjectEvidence(p, NOISE**2 * np.eye(3), kinds, quantities=size) for p in seen]
            # Where it was not: what a detection knows by name has moved there.
            given += [ObjectEvidence((0.0, -1.9, 1.0), NOISE**2 * np.eye(3), kinds, "a-1")] * (
                step == LOOKS // 2
            )
            measured = checked(WorldEvidence(given, SENSOR if step % 2 else None), NOISE)
            anchors.look(measured, NOISE * step, 0.0)
            anchors.beliefs.probabilities()
            ahead = np.array([[0.0, 0.0, NOISE * step], [0.0, 1.0, NOISE * step + 1.0]])
            anchors.guidance.guide({"a-1": Path.checked("path", ahead)})
        anchors.presentation.predicted(3.0)
