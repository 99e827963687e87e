"""Which earlier keyframes look like the newest: the classifier's say in where a loop may close.

Where the estimate is good, place alone leads to candidates. Where it is not, too many keyframes lie within its
uncertainty, and `PlaceRecognizer` says which of them are worth laying on each other. Features are made when they are
first asked for, from the kept scans: a run that never loses its place never pays for them.
"""

from __future__ import annotations

from loop_closure.features import PlaceFeatures, features_2d
from loop_closure.keyframes import Keyframes
from loop_closure.outlines import LocalMap
from loop_closure.recognizer import PlaceRecognizer

MAX_RANGE = 50.0  # metres, as the shipped model was trained
LENGTH = 10.0  # metres of path in an outline
BEST = 60  # keyframes that are handed on
LEAST = 0.3  # likelihood
AT_ONCE = 100  # earlier keyframes that are taken in with one question, so that no scan waits long


class Likeness:
    """Likelihoods of earlier keyframes, remembered as features."""

    def __init__(self) -> None:
        self._recognizer: PlaceRecognizer | None = None
        self._around = LocalMap(LENGTH)
        self._next = 0
        self._found: dict[int, dict[int, float]] = {}

    def of(self, k: int, keyframes: Keyframes, apart: float) -> dict[int, float]:
        """Likelihood that the newest keyframe `k` shows the place of others, `apart` metres of path before it.

        What was found for an earlier keyframe is remembered. Empty for one that nobody asked about when it was the
        newest, or that brings no scan, and until all earlier ones are taken in.
        """
        if k < self._next or keyframes[k].scan is None:
            return self._found.get(k, {})
        if self._recognizer is None:
            self._recognizer = PlaceRecognizer()
        for n in range(self._next, min(k, self._next + AT_ONCE)):
            self._recognizer.add(self._features(n, keyframes), keyframes[n].stamp)
            self._next = n + 1
        if self._next < k:
            return {}
        place = self._features(k, keyframes)
        found = self._recognizer.query(place, BEST) if k else []
        self._recognizer.add(place, keyframes[k].stamp)
        self._next = k + 1
        farthest = keyframes.paths[k] - apart
        self._found[k] = {j: v for j, v in found if v >= LEAST and keyframes[j].path <= farthest}
        return self._found[k]

    def _features(self, k: int, keyframes: Keyframes) -> PlaceFeatures:
        frame = keyframes[k]
        assert frame.scan is not None
        if keyframes.broken(k):
            self._around.clear()
        self._around.add(frame.scan, frame.odometry)
        return features_2d(frame.scan, MAX_RANGE, self._around.outline())
