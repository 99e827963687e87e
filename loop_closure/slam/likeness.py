"""Which earlier keyframes look like the newest: the classifier's say in where a loop may close.

Where the estimate is good, place alone leads to candidates. Where it is not, too many keyframes lie within its
uncertainty, and `PlaceRecognizer` says which of them are worth laying on each other. Features are made when they are
first asked for, from the kept scans: a run that never loses its place never pays for them.
"""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from loop_closure.keyframes import Keyframes
from loop_closure.places.features import PlaceFeatures, features_2d
from loop_closure.places.outlines import LocalMap
from loop_closure.places.place_model import TRAINED_RANGE
from loop_closure.places.recognizer import PlaceRecognizer
from loop_closure.work import Steps, at_once

BEST = 60  # keyframes that are handed on
LEAST = 0.3  # likelihood
AT_ONCE = 100  # earlier keyframes that are taken in with one question, so that no answer waits long
TAKING_IN = 4.0  # ms that takes for each


class PlaceLikeness:
    """Likelihoods of earlier keyframes, remembered as features."""

    def __init__(self) -> None:
        self._recognizer: PlaceRecognizer | None = None
        self._around = LocalMap()
        self._next = 0
        self._found: dict[int, dict[int, float]] = {}

    def of(self, k: int, keyframes: Keyframes, apart: float) -> dict[int, float]:
        """`asking`, with all steps at once."""
        return at_once(self.asking(k, keyframes, apart))

    def asking(self, k: int, keyframes: Keyframes, apart: float) -> Steps[dict[int, float]]:
        """Likelihood that keyframe `k` shows the place of others, `apart` metres of path before it; in steps.

        What was found for an earlier keyframe is remembered. Empty for one that nobody asked about when it was its
        turn, or that brings no scan, and until all earlier ones are taken in.
        """
        if k < self._next or keyframes[k].scan is None:
            return self._found.get(k, {})
        if self._recognizer is None:
            self._recognizer = PlaceRecognizer()
        for n in range(self._next, min(k, self._next + AT_ONCE)):
            yield TAKING_IN
            self._recognizer.add(self._features(n, keyframes), keyframes[n].stamp)
            self._next = n + 1
        if self._next < k:
            return {}
        yield TAKING_IN
        place = self._features(k, keyframes)
        found = (yield from self._recognizer.querying(place, BEST)) if k else []
        self._recognizer.add(place, keyframes[k].stamp)
        self._next = k + 1
        farthest = keyframes.paths[k] - apart
        self._found[k] = {j: v for j, v in found if v >= LEAST and keyframes[j].path <= farthest}
        return self._found[k]

    def take_out(self, number: npt.NDArray[np.int64]) -> None:
        """Forget what has no new number (N,), below 0; the others keep what is known of them."""
        if self._recognizer is not None:
            self._recognizer.keep(number[: self._next] >= 0)
        self._next = int((number[: self._next] >= 0).sum())
        self._found = {
            int(number[k]): {int(number[j]): v for j, v in found.items() if number[j] >= 0}
            for k, found in self._found.items()
            if number[k] >= 0
        }

    def _features(self, k: int, keyframes: Keyframes) -> PlaceFeatures:
        frame = keyframes[k]
        assert frame.scan is not None
        if k in keyframes.breaks:
            self._around.clear()
        self._around.add(frame.scan, frame.odometry)
        return features_2d(frame.scan, TRAINED_RANGE, self._around.outline())
