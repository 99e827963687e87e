"""The errors of one moving sensor: watched until there is evidence that it has any, then held against every look.

Two models predict every detection of a resting object before they take it in: `sensor_filter`, with errors that are not
known yet, and one filter per object, of a sensor whose detections are off independently. Log odds of the two are a
Bayes factor: a sensor without errors loses with every detection what the first spends on errors that might be.
Densities have the tails of Student's t, so that single detections decide nothing, and the scale that detections so far
had under either model, so that stated covariances that are too small or too large do not either. Several objects must
say so, each by itself: one that was moved does not decide.
"""

from __future__ import annotations

import numpy as np

from estimation.checks import FloatArray
from world_model.anchoring.loops.kernels import MEMORY
from world_model.calibration.sensor_bias import CONSTANT, LATEST, PARALLAX, PRIOR, QUICKEST, rates
from world_model.calibration.sensor_filter import SHARED, error_basis
from world_model.calibration.sensor_worlds import SensorWorlds

SIGNIFICANT = 28.0
"""Squared length of the constant errors' estimate, in its standard deviations, from which they are
significant; 8 are usual for a sensor without errors, 28 are exceeded in one of 2,000."""
OUTLIER = 16.0
"""Squared Mahalanobis distance from which a detection is no witness, while objects are given their detections without
regard to the sensor's errors."""
MOVED = 0.3  # m: what is seen this far from where it was expected was carried, or is another
BASELINE = 0.1  # s: poses this far apart say how fast the sensor moves, if there are any
MOST = 100  # Places that are kept; of more, those not seen for longest go back to being independent
TAKEN = 0.1
"""Standard deviations of constant errors, of those before anything is known, once all that was seen was explained."""
PATIENCE = 300  # Looks after which a sensor that has shown no errors is watched less
SELDOM = 5  # Looks of which one is watched then
SETTLED = 0.02  # m: the same of the places of objects
TAILS = 4.0  # Degrees of freedom of a detection's density
CLEARLY = 1.5  # Log odds from which an object is a witness
WITNESSES = 2  # Fewest of them that are enough, where the constant errors are significant; else one more
SHARE = 0.3  # The same, of all objects that said something
SAYS = 6.0  # Most that one object counts, log odds
ENOUGH = 10.0  # Log odds of all objects together from which there are errors, whichever they are
USUAL = 20.0  # Detections that the stated covariances count when the scale is found
FARTHEST = 12.0  # Squared Mahalanobis distance beyond which one is no farther off, for the scale


class Scaled:
    """Densities of displacements (2,) under one model, up to a constant; their scale follows them."""

    def __init__(self) -> None:
        self._count, self._sum = USUAL, 2.0 * USUAL

    def log_density(self, off: FloatArray, S: FloatArray) -> float:
        """Under Student's t with S (2, 2), scaled by what came before."""
        a, b, c = S[0, 0], S[0, 1], S[1, 1]
        determinant = a * c - b * b
        square = (c * off[0] ** 2 - 2.0 * b * off[0] * off[1] + a * off[1] ** 2) / determinant
        scale = 0.5 * self._sum / self._count
        self._count += 1.0
        self._sum += min(square, FARTHEST)
        tails = -0.5 * (TAILS + 2.0) * np.log1p(square / (TAILS * scale))
        return float(tails - 0.5 * np.log(determinant) - np.log(scale))


class SensorEvidence:
    """Objects go by numbers; `odds` : log odds of errors by object."""

    def __init__(self) -> None:
        self.places: dict[int, tuple[FloatArray, FloatArray]] = {}
        self.odds: dict[int, float] = {}
        self._with, self._without = Scaled(), Scaled()

    def enough(self, significant: bool) -> bool:
        """Whether several objects, and not a few of many, say that the sensor has errors.

        significant : whether the constant errors are, by their estimate.
        """
        witnesses = sum(said > CLEARLY for said in self.odds.values())
        total = sum(min(said, SAYS) for said in self.odds.values())
        least = max(WITNESSES + (not significant), SHARE * len(self.odds))
        return witnesses >= least and (significant or total > ENOUGH)

    def begin(self, number: int, place: FloatArray, spread: FloatArray) -> None:
        """An object at a place (2,), m, with covariance spread (2, 2)."""
        self.places[number] = place, spread

    def weigh(self, number: int, z: FloatArray, R: FloatArray, off: FloatArray, S: FloatArray) -> None:
        """A detection (2,) with R (2, 2) of a known object, off (2,), S (2, 2) from where the joint filter had it."""
        place, spread = self.places[number]
        least = np.trace(R) / MEMORY
        if np.trace(spread) < least:
            spread = spread + 0.5 * (least - np.trace(spread)) * np.eye(2)
        own = spread + R
        gained = self._with.log_density(off, S) - self._without.log_density(z - place, own)
        self.odds[number] = self.odds.get(number, 0.0) + gained
        gain = np.linalg.solve(own, spread).T
        self.places[number] = place + gain @ (z - place), spread - gain @ spread

    def keep_only(self, numbers: set[int]) -> None:
        """Places of others are forgotten; what they said is not."""
        self.places = {number: place for number, place in self.places.items() if number in numbers}


class SensorErrors:
    """`worlds` : errors and places; `ids` : the number that each track goes by there.

    A sensor that has not moved cannot tell its errors from the places of objects. Once it has, one filter learns from
    the detections whose objects anchoring says; when there is `evidence` enough that the sensor has errors, `in_use`,
    it is the filters that say whose detections are.
    """

    def __init__(self, known: FloatArray) -> None:
        self.known = known
        self.reset()

    def reset(self) -> None:
        """Nothing is known but the calibration."""
        self.worlds = SensorWorlds(self.known)
        self.ids: dict[int, int] = {}
        self.before: set[int] = set()
        self.evidence = SensorEvidence()
        self.moved = False
        self.in_use = False
        self.looks = 0
        self.since = -np.inf
        self._start: FloatArray | None = None
        self.rate = np.zeros(3)
        self._trail: list[tuple[FloatArray, float]] = []

    @property
    def values(self) -> FloatArray:
        """Constant errors (8,) as far as they are significant."""
        return self.worlds.best.x[:CONSTANT] if self.in_use else self.known

    @property
    def shared(self) -> FloatArray:
        """Errors of range (m) and turn (rad) that the next look is expected to share."""
        return self.worlds.best.x[SHARED] if self.in_use else np.zeros(2)

    def follow(self, pose: FloatArray, stamp: float) -> bool:
        """To a new look; whether it is taken in: the sensor has moved far enough to tell its errors from the objects'
        places."""
        if self._trail:
            before, then = self._trail[-1]
            far, elapsed = float(np.hypot(*(pose - before)[:2])), max(stamp - then, 0.0)
            if far > PARALLAX + QUICKEST[0] * elapsed:
                # That is another sensor: what was learned is not its.
                self.reset()
        self._pace(pose, stamp)
        if self._start is None:
            self._start, self.since = pose[:2].copy(), stamp
        self.moved = self.moved or bool(np.hypot(*(pose[:2] - self._start)) > PARALLAX)
        self.looks += self.moved
        return self.watching

    def _pace(self, pose: FloatArray, stamp: float) -> None:
        """How fast the sensor moves, from poses far enough apart in time that their own errors do not matter."""
        self._trail = [(then, when) for then, when in self._trail if stamp - LATEST < when <= stamp]
        before = next((one for one in reversed(self._trail) if stamp - one[1] >= BASELINE), None)
        if before is None and self._trail:
            before = self._trail[0]
        self.rate = np.zeros(3) if before is None else rates(pose, before[0], np.asarray(stamp - before[1]))
        self._trail.append((pose.copy(), stamp))

    @property
    def watching(self) -> bool:
        """Whether the present look is taken in."""
        return self.moved and (self.in_use or self.looks < PATIENCE or self.looks % SELDOM == 0)

    def remember(self, number: int, place: FloatArray, spread: FloatArray) -> None:
        """An object at a place (2,), covariance spread (2, 2), known otherwise than by this sensor."""
        self.ids[number] = self.worlds.number()
        self.evidence.begin(number, place, spread)
        for hypothesis in self.worlds.hypotheses:
            hypothesis.filter.remember(self.ids[number], place, spread)

    def add(
        self,
        numbers: list[int],
        z: FloatArray,
        R: FloatArray,
        pose: FloatArray,
        rate: FloatArray | None = None,
    ) -> None:
        """Detections (n, 2) of the objects `numbers` from pose (4,), rate (3,), before the errors are in use."""
        filter = self.worlds.best
        at = {name: k for k, name in enumerate(filter.numbers)}
        known = np.array([at.get(self.ids.get(number, -1), -1) for number in numbers], np.int64)
        old = np.flatnonzero(known >= 0)
        # Errors at where objects are, not at where they are said to be, which would differ with the noise: a sensor
        # that stands would seem to tell its errors.
        at_place = z.copy()
        at_place[old] = filter.places[known[old]]
        J = error_basis(at_place, pose, rate)
        if len(old):
            y, S, _ = filter.innovation(known[old], z[old], R[old], J[old])
            blocks = S.reshape(len(old), 2, len(old), 2)[range(len(old)), :, range(len(old))]
            off = y.reshape(-1, 2)
            fits = np.einsum("ni,nij,nj->n", off, np.linalg.inv(blocks), off) < OUTLIER
            fits &= np.hypot(*off.T) < MOVED
            for k, j in enumerate(old.tolist()):
                if fits[k]:
                    self.evidence.weigh(
                        numbers[j], z[j] - J[j, :, :CONSTANT] @ self.known, R[j], off[k], blocks[k]
                    )
            old = old[fits]
        if len(old):
            filter.correct(known[old], z[old], R[old], J[old])
        for j, number in enumerate(numbers):
            if number not in self.ids:
                self.ids[number] = self.worlds.number()
                filter.begin(self.ids[number], z[j], R[j], J[j])
                self.evidence.begin(number, z[j] - J[j, :, :CONSTANT] @ self.known, R[j])
        apart = filter.x[:CONSTANT] - self.known
        significant = bool(apart @ np.linalg.solve(filter.P[:CONSTANT, :CONSTANT], apart) > SIGNIFICANT)
        self.in_use = self.evidence.enough(significant)

    def name(self, said: list[int], owners: list[int], resting: set[int]) -> None:
        """Tracks that took detections of objects `said`; those that do not rest are no objects here."""
        taken = set(self.ids.values())
        strangers = set()
        for name, number in zip(said, owners, strict=True):
            if name in taken:
                continue
            if number in resting and number not in self.ids:
                self.ids[number] = name
            else:
                strangers.add(name)
        self.worlds.drop(strangers)

    def keep_only(self, resting: set[int]) -> None:
        """Objects that are gone or do not rest any more."""
        gone = {self.ids.pop(number) for number in set(self.ids) - resting}
        self.worlds.drop(gone)
        self.evidence.keep_only(set(self.ids))

    def limit(self, owners: list[int]) -> None:
        """Those seen now were seen last; of too many the others go."""
        for number in owners:
            if number in self.ids:
                self.ids[number] = self.ids.pop(number)
        if len(self.ids) > MOST:
            self.keep_only(set(list(self.ids)[-MOST:]))

    def take(self, constant: FloatArray, shared: FloatArray, places: dict[int, FloatArray]) -> None:
        """Start anew from what explains all that was seen: errors (8,), (2,), and places (2,) by track."""
        stamp = self.worlds.best.stamp
        self.worlds.reset()
        filter = self.worlds.best
        filter.stamp = stamp
        filter.x[:] = np.concatenate([constant, shared])
        filter.P[range(CONSTANT), range(CONSTANT)] = (TAKEN * PRIOR) ** 2
        self.ids = {}
        for number, place in places.items():
            self.ids[number] = self.worlds.number()
            filter.remember(self.ids[number], place, SETTLED**2 * np.eye(2))
        self.in_use = True
