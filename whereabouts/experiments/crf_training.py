"""How the shipped weights of the joint CRF are trained: simulated pairs of streets, halls, offices and crowds."""

from __future__ import annotations

import numpy as np

from registration.crf.model import JointModel
from registration.crf.training import train
from whereabouts.simulation.labelled_pairs import SICK, LabelledPair, protocol, random_labelled_pairs
from whereabouts.simulation.lidar import Lidar

SEED = 2026
PAIRS = {"street": 12, "hall": 16, "office": 16, "crowd": 24}
ROUND = Lidar(361, 2.0 * np.pi * 360 / 361)


def training_pairs(seed: int = SEED) -> list[LabelledPair]:
    """Labelled pairs of other seeds than the experiment's and the tests'; half of those indoors seen all round."""
    pairs = protocol(seed)
    for number, (scene, count) in enumerate(PAIRS.items()):
        lidars = [SICK] if scene == "street" else [SICK, ROUND]
        for half, lidar in enumerate(lidars):
            rng = np.random.default_rng([seed, number, half])
            pairs += random_labelled_pairs(rng, scene, count // len(lidars), lidar=lidar)
    return pairs


def train_shipped(seed: int = SEED) -> JointModel:
    """The model in `registration/crf/models/joint.json`."""
    pairs = training_pairs(seed)
    card = {
        "trained by": "whereabouts segment --train --out registration/crf/models/joint.json",
        "pairs": len(pairs),
        "seed": seed,
        "data": "simulated streets, halls, offices and crowds (whereabouts.experiments.crf_training); no recordings",
        "learning": "AdaBoost of 50 stumps each; weights by pseudo-likelihood, then by exact likelihood",
    }
    return train(pairs, card)
