"""Movers that go where they are predicted to go: the person behaviour of section 2.4.2, fed by chapter 4.

A mover has no use for the constant-position filter, so its place is taken by the predicted path: position and
covariance step along with it, and what is measured decides between it and constant velocity.
"""

from __future__ import annotations

from collections.abc import Mapping

import numba
import numpy as np

from estimation.checks import FloatArray
from world_model.anchoring.anchors import Anchors
from world_model.anchoring.loops.clusters import Track
from world_model.anchoring.loops.kernels import class_of, start_moving
from world_model.anchoring.loops.leaves import MOVING, NONE, REST
from world_model.anchoring.loops.walking import walk
from world_model.predictions import Behavior, Course

DOUBT_SECONDS = 5.0  # What was found out about who keeps to the predicted path is forgotten in this time


@numba.njit(cache=True)
def lead(leaves, i, stamp, motion, removed, step, growth, velocity):  # type: ignore[no-untyped-def]
    """Propagate a mover's leaf to `stamp`: one filter along the path, the other straight on, in place."""
    dt = stamp - leaves.stamp[i]
    row = class_of(leaves.attributes[i], motion.shape[0] - 1)
    share = motion[row, 4]
    if dt <= 0.0 or motion[row, 0] < 0.5 or share <= 0.0:
        return
    leaves.stamp[i] = stamp
    pi = leaves.behavior[i]
    if pi[REST] <= 0.0:
        leaves.rest[i] = leaves.moving[i, :3]
        leaves.rest_cov[i] = leaves.moving_cov[i, :3, :3]
        pi[REST] = share * pi[MOVING]
        pi[MOVING] -= pi[REST]
    elif pi[MOVING] <= 0.0:
        start_moving(leaves, i, motion[row, 3], 0.0)
    here = pi[REST] + pi[MOVING]
    fade = 1.0 - np.exp(-dt / DOUBT_SECONDS)
    pi[REST] += fade * (share * here - pi[REST])
    pi[MOVING] = here - pi[REST]
    walk(leaves, i, dt, motion[row, 1] ** 2, motion[row, 5])
    leaves.rest[i] += step
    leaves.rest_cov[i] += growth
    leaves.led[i] = velocity
    gone = 1.0 - np.exp(-removed * dt)
    pi[NONE] += gone * pi[:NONE].sum()
    pi[:NONE] *= 1.0 - gone


class Guidance:
    """Courses that movers are expected to take, by number of track; `behaviors` : by class, for all of that class."""

    def __init__(self, anchors: Anchors, behaviors: Mapping[str, Behavior]) -> None:
        self.anchors = anchors
        self.behaviors = behaviors

    def guide(self, predictions: Mapping[str, Course | None]) -> None:
        """Take predictions in; those of objects that are not known say nothing."""
        if not predictions:
            return
        courses, named = self.anchors.courses, self.anchors.named()
        for name, course in predictions.items():
            track = named.get(name)
            if track is None:
                continue
            if course is not None:
                courses[track.number] = course
            elif courses.pop(track.number, None) is not None:
                self._withdraw(track)

    def _withdraw(self, track: Track) -> None:
        """Straight on, as if nothing had been predicted."""
        behavior = self.anchors.leaves.behavior
        for slot in self.anchors.leaves_of(track).tolist():
            if behavior[slot, MOVING] > 0.0:
                behavior[slot, MOVING] += behavior[slot, REST]
                behavior[slot, REST] = 0.0

    def lead(self, stamp: float) -> None:
        """All that are predicted go along their courses; one that has ended says nothing any more."""
        anchors = self.anchors
        if self.behaviors:
            self._set_out(stamp)
        for number, course in list(anchors.courses.items()):
            track = anchors.tracks.get(number)
            if track is None or course.end < stamp:
                del anchors.courses[number]
                continue
            for slot in anchors.leaves_of(track).tolist():
                self._lead_leaf(slot, course, stamp)

    def _set_out(self, stamp: float) -> None:
        """Those of a class with a behaviour of its own that nobody predicts."""
        for number, item in self.anchors.shown.items():
            behavior = self.behaviors.get(item.most_probable("class"))
            if behavior is not None and number not in self.anchors.courses:
                course = behavior(item, stamp)
                if course is not None:
                    self.anchors.courses[number] = course

    def _lead_leaf(self, slot: int, course: Course, stamp: float) -> None:
        leaves = self.anchors.leaves
        begin = float(leaves.stamp[slot])
        if stamp > begin:
            removed = self.anchors.config.removed_per_second
            lead(leaves, slot, stamp, self.anchors.motion, removed, *course.step(begin, stamp))

    def lead_copy(self, track: Track, slot: int, stamp: float) -> None:
        """A copy of a leaf, as far along its course as that reaches."""
        course = self.anchors.courses.get(track.number)
        if course is not None:
            self._lead_leaf(slot, course, min(stamp, course.end))

    def led(self, track: Track, slot: int) -> bool:
        """Whether a mover is most probably on its predicted course."""
        pi = self.anchors.leaves.behavior[slot]
        return track.number in self.anchors.courses and bool(pi[REST] > pi[MOVING])

    def growth(self, track: Track, slot: int) -> FloatArray:
        """(3, 3) m² by which the covariance of what is shown grows in the next second without a look."""
        leaves = self.anchors.leaves
        pi = leaves.behavior[slot]
        course = self.anchors.courses.get(track.number)
        if course is not None and pi[REST] > pi[MOVING]:
            now = float(leaves.stamp[slot])
            return course.step(now, min(now + 1.0, max(course.end, now)))[1]
        if pi[MOVING] <= pi[REST]:
            return np.zeros((3, 3))
        P = leaves.moving_cov[slot]
        density = self.anchors.motion[self.anchors.motion_row(slot), 1] ** 2
        noise: FloatArray = P[:3, 3:] + P[3:, :3] + P[3:, 3:] + density / 3.0 * np.eye(3)
        return noise
