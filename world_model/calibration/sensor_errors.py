"""The errors of one moving sensor: watched until they are significant, then held against every look."""

from __future__ import annotations

import numpy as np

from estimation.checks import FloatArray
from world_model.calibration.sensor_bias import CONSTANT, LATEST, PARALLAX, PRIOR, rates
from world_model.calibration.sensor_evidence import SensorEvidence
from world_model.calibration.sensor_filter import SHARED, error_basis
from world_model.calibration.sensor_worlds import SensorWorlds

SIGNIFICANT = 28.0
"""Squared length of the constant errors' estimate, in its standard deviations, from which they are
significant; 8 are usual for a sensor without errors, 28 are exceeded in one of 2,000."""
OUTLIER = 16.0
"""Squared Mahalanobis distance from which a detection is no witness, while objects are given their detections without
regard to the sensor's errors."""
FASTEST = 5.0  # m/s: no sensor moves faster
MOVED = 0.3  # m: what is seen this far from where it was expected was carried, or is another
BASELINE = 0.1  # s: poses this far apart say how fast the sensor moves, if there are any
MOST = 100  # Places that are kept; of more, those not seen for longest go back to being independent
TAKEN = 0.1
"""Standard deviations of constant errors, of those before anything is known, once all that was seen was explained."""
PATIENCE = 300  # Looks after which a sensor that has shown no errors is watched less
SELDOM = 5  # Looks of which one is watched then
SETTLED = 0.02  # m: the same of the places of objects


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
            if far > PARALLAX + FASTEST * elapsed:
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
