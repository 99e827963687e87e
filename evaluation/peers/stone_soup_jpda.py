"""Stone Soup's PDA and JPDA on the centroids of DBSCAN clusters: the single-return association of LC, section 5.2."""

from __future__ import annotations

from collections.abc import Sequence
from datetime import datetime, timedelta
from typing import Any

import numpy as np

from evaluation.peers.stone_soup_phd import StoneSoupPhd
from tracking import PhdConfig

# A track is told of from so many scans with a detection on, and dropped after so many without.
CONFIRMED, FORGOTTEN = 3, 3
# Probability that a detection beside the others belongs to a track, below which it starts one of its own.
TAKEN = 0.1
GATE = 0.9999


class StoneSoupJpda:
    """`step` returns positions (N, 2). joint : JPDA; False: PDA for each track by itself (5.4)."""

    def __init__(self, config: PhdConfig, joint: bool = True) -> None:
        from stonesoup.dataassociator.probability import JPDA, PDA
        from stonesoup.hypothesiser.probability import PDAHypothesiser

        # The same clusters and motion as the other peer's, so that the association alone differs.
        peer = StoneSoupPhd(config)
        self.config, self.model, self.updater = config, peer.model, peer.kalman
        self._clusters = peer._clusters
        # Clutter of clusters, not of returns: few of three and more close together.
        hypothesiser = PDAHypothesiser(
            peer.predictor, self.updater, 0.1 / config.area, config.detection_probability, GATE
        )
        self.associator = JPDA(hypothesiser) if joint else PDA(hypothesiser)
        self.start = datetime(2020, 1, 1)
        self.tracks: dict[Any, list[int]] = {}

    @property
    def expected_count(self) -> float:
        """Tracks that are told of."""
        return float(sum(hits >= CONFIRMED for hits, _ in self.tracks.values()))

    def step(self, points: np.ndarray, stamp: float) -> np.ndarray:
        """Positions (N, 2) after the scan."""
        from stonesoup.types.detection import Detection

        now = self.start + timedelta(seconds=stamp)
        detections = [
            Detection(centre.reshape(2, 1), timestamp=now, measurement_model=self.model)
            for centre in self._clusters(points)
        ]
        self._update(detections, now)
        self.tracks = {track: about for track, about in self.tracks.items() if about[1] <= FORGOTTEN}
        told = [
            track.state_vector[[0, 2], 0] for track, (hits, _) in self.tracks.items() if hits >= CONFIRMED
        ]
        return np.array(told, dtype=float).reshape(-1, 2)

    def _update(self, detections: Sequence[Any], now: datetime) -> None:
        """Every track by the mixture of what may be its detection; what belongs to none begins one."""
        from stonesoup.functions import gm_reduce_single
        from stonesoup.types.array import StateVectors
        from stonesoup.types.update import GaussianStateUpdate

        share = dict.fromkeys(detections, 0.0)
        found = self.associator.associate(set(self.tracks), set(detections), now) if self.tracks else {}
        for track, hypotheses in found.items():
            states, weights = [], []
            for hypothesis in hypotheses:
                weights.append(float(hypothesis.probability))
                if hypothesis:
                    share[hypothesis.measurement] += weights[-1]
                    states.append(self.updater.update(hypothesis))
                else:
                    states.append(hypothesis.prediction)
            mean, covariance = gm_reduce_single(
                StateVectors([state.state_vector for state in states]),
                np.stack([state.covar for state in states], axis=2),
                np.asarray(weights),
            )
            missed = sum(w for w, h in zip(weights, hypotheses, strict=True) if not h)
            track.append(GaussianStateUpdate(mean, covariance, hypotheses, now))
            about = self.tracks[track]
            about[0], about[1] = (about[0] + 1, 0) if missed < 0.5 else (about[0], about[1] + 1)
        for detection, taken in share.items():
            if taken < TAKEN:
                self._begin(detection, now)

    def _begin(self, detection: Any, now: datetime) -> None:
        """A track where a detection is, with the velocities of a birth."""
        from stonesoup.types.state import GaussianState
        from stonesoup.types.track import Track

        noise = self.config.measurement_noise**2 / max(self.config.measurement_rate, 1.0)
        x, y = np.asarray(detection.state_vector, dtype=float).ravel()
        velocity = max((float(P[2, 2]) for _, _, P in self.config.births), default=25.0)
        state = GaussianState([[x], [0.0], [y], [0.0]], np.diag([noise, velocity, noise, velocity]), now)
        self.tracks[Track([state])] = [1, 0]
