"""How a person moves now: position and velocity from its latest observations, and how sure that is ahead."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.special import chdtri

from estimation.checks import FloatArray

# What lies further back says nothing of the present motion, s.
LONGEST = 4.0
# Noise where nothing is known, m.
TYPICAL = 0.03
# Standard deviation of the velocity of people, along each axis, of whom nothing is known yet, m/s.
UNKNOWN = 1.0
# Faster than this somebody gets on, m/s; slower is standing about.
WALKING = 0.3
# Recordings are often smoothed or interpolated: less noise than this is none of the sensor's.
LEAST = 0.02


@dataclass(frozen=True)
class WalkingMotion:
    """`state` (4,) x, y, vx, vy at the last observation of `rows` (N, 3).

    variance : (m/s)², of the velocity along each axis, as far as noise and few observations leave it open.
    """

    state: FloatArray
    rows: FloatArray
    variance: float = UNKNOWN**2

    @property
    def speed(self) -> float:
        """m/s, now."""
        return float(np.hypot(self.state[2], self.state[3]))

    @property
    def pace(self) -> float:
        """m/s, mean over the parts of the track, one second each, in which the person got on; 0 without any."""
        if len(self.rows) < 2:
            return 0.0
        t = self.rows[:, 2]
        marks = np.searchsorted(t, np.arange(t[0], t[-1], 1.0))
        marks = np.unique(np.append(marks, len(t) - 1))
        steps = np.diff(self.rows[marks], axis=0)
        speed = np.hypot(steps[:, 0], steps[:, 1]) / steps[:, 2]
        walking = speed > WALKING
        return float(np.average(speed[walking], weights=steps[walking, 2])) if walking.any() else 0.0


def estimate(rows: FloatArray, memory: float, manoeuvre: float) -> WalkingMotion:
    """Motion from rows (N, 3) x, y, t: a straight line by least squares whose weights fade with age.

    The noise of the observations is judged by how far each is off the line between its neighbours. The time over which
    weights fade balances noise, which a longer line averages, against people who turn: `memory` s at 2 cm of noise and
    2.5 observations a second, and with the root of the noise. The position is the line's as far as the noise is above
    `manoeuvre` m, what a walking person is off it anyway, and the last observation's otherwise. A velocity that the
    noise leaves open is drawn to zero: two observations of a fast sensor say nearly nothing.
    """
    last = rows[-1]
    if len(rows) < 2:
        return WalkingMotion(np.array([last[0], last[1], 0.0, 0.0]), rows)
    recent = rows[rows[:, 2] >= last[2] - LONGEST]
    if len(recent) < 2:
        recent = rows[-2:]
    measured, rate = _noise(recent), (len(recent) - 1) / (last[2] - recent[0, 2])
    noise = max(measured, LEAST)
    fade = memory * np.sqrt(noise / LEAST) * (2.5 / rate) ** 0.25
    t = recent[:, 2] - last[2]
    weights = np.exp(2.0 * t / fade)
    weights /= weights.sum()
    mean_t = float(weights @ t)
    mean = weights @ recent[:, :2]
    spread = float(weights @ (t - mean_t) ** 2)
    if spread < 1e-12:
        passed = float(last[2] - recent[-2, 2])
        velocity = (last[:2] - recent[-2, :2]) / passed
        return WalkingMotion(np.concatenate((last[:2], velocity)), rows, 2.0 * (measured / passed) ** 2)
    lever = weights * (t - mean_t) / spread
    open_ = measured**2 * float(lever @ lever)
    known = UNKNOWN**2 / (UNKNOWN**2 + open_)
    velocity = known * (lever @ (recent[:, :2] - mean))
    trust = noise**2 / (noise**2 + manoeuvre**2)
    position = trust * (mean - velocity * mean_t) + (1.0 - trust) * last[:2]
    return WalkingMotion(np.concatenate((position, velocity)), rows, known * open_)


def _noise(rows: FloatArray) -> float:
    """Standard deviation of an observation, m, robustly from the second differences; TYPICAL where these are few."""
    if len(rows) < 5:
        return TYPICAL
    before, at, after = rows[:-2], rows[1:-1], rows[2:]
    share = ((at[:, 2] - before[:, 2]) / (after[:, 2] - before[:, 2]))[:, None]
    off = at[:, :2] - (before[:, :2] + share * (after - before)[:, :2])
    scaled = off / np.sqrt(1.0 + share**2 + (1.0 - share) ** 2)
    # The median of a squared standard normal is that of χ² with one degree of freedom.
    return float(np.sqrt(np.median(scaled**2) / chdtri(1, 0.5)))
