"""How detections are missed: one at a time, and in runs, while something stands before an object."""

from __future__ import annotations

import numpy as np

from estimation.checks import FloatArray
from world_model.config import WorldModelConfig

SINGLE = 0.5  # Share of the misses of movers that come one at a time
SHORTEST, LONGEST = 5.0, 20.0
"""Looks that hide a mover in one run, mean: what passes before it decides, and a setting only within these bounds."""


def detector_table(config: WorldModelConfig) -> FloatArray:
    """(2, 5) as `world_model.anchoring.loops.gating.weigh` takes it: for what rests, and for what moves by itself.

    Columns: share of looks outside of runs of misses, p_D there, eigenvalue per look of the chain of the two states,
    looks per second, rate of removal, 1/s. In the long run p_D is `config.detection_probability`.
    """
    detection = config.detection_probability
    run = max(config.missed_run_frames, 1.0 / detection)
    hidden = max(min(max(run, SHORTEST), LONGEST), 1.0 / detection)
    rows = []
    for length, single in ((run, 0.0), (hidden, SINGLE)):
        apart = 1.0 - (1.0 - detection) * single
        share = detection / apart
        fade = 1.0 - 1.0 / length - (1.0 - share) / (share * length)
        rows.append([share, apart, fade, config.rate_hz, config.removed_per_second])
    return np.array(rows)
