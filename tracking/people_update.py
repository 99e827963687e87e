"""What one scan says about each potential person: where it is, whether it is there, and whether it is a person."""

from __future__ import annotations

import math
from dataclasses import dataclass, field

import numpy as np

from estimation.checks import FloatArray
from tracking.occlusion import WEIGHTS
from tracking.people_association import WIDE, Seen
from tracking.people_config import PeopleConfig
from tracking.people_middle import learn_body, middle
from tracking.people_tracks import SURE, TRAIL, WALKS, IntArray, Tracks

FULL = 8  # returns with which a cluster shows its shape
LAG = 1.5  # seconds over which walking shows
COASTING = 0.35  # seconds after which somebody not seen is taken to be hidden
STEPS, SWING = 0.8, 0.6  # seconds over which a walk is known, and m/s by which a leg swings off it
STRAIGHT, SHORTEST, FEWEST = 0.025, 0.35, 5  # metres off a straight way, and seconds and places that make one
STEADY = 0.15  # m/s, how well several steps tell the velocity
PARTLY, SWAYS = 0.8, 0.5  # s partly hidden, and m, up to which where he was when seen wholly tells more
SURPRISE, TURNED = (
    6.0,
    1.0,
)  # square of standard deviations, and m/s by which who is that far off changed his way
FIRST = 0.5  # seconds in which it shows whether something stands where it was empty before
SLIDING = 0.25  # m/s, slower than that is not walking


@dataclass(frozen=True)
class Moment:
    """stamp : of the scan, s. dt : since the last one, s. steady : whether the frame has held.

    times : stamps of the places in the trails of tracks, s, nan for none.
    """

    stamp: float
    dt: float
    steady: bool = True
    times: FloatArray = field(default_factory=lambda: np.full(TRAIL, np.nan))


def update(
    tracks: Tracks,
    seen: Seen,
    owners: IntArray,
    scores: FloatArray,
    shares: FloatArray,
    places: FloatArray,
    moment: Moment,
    config: PeopleConfig,
) -> None:
    """All potential people after a scan: corrected by their clusters, or missed.

    owners, scores (K,) : of the clusters. shares (T, S) : of each that the scan could show, at places (T, S, 2).
    """
    dt = moment.dt
    keeps = -math.log1p(-config.detection_probability) * min(dt / 0.1, 3.0)
    for t in range(len(tracks)):
        mine = np.flatnonzero(owners == t)
        if not len(mine):
            # The next thing to show of somebody who was hidden is a part of a leg: easily missed.
            rate = keeps if tracks.hidden[t] < COASTING else 0.3 * keeps
            if tracks.hidden[t] == 0.0 and float(WEIGHTS @ shares[t]) < 0.5:
                _go_on(tracks, t, moment)
            _miss(tracks, t, shares[t], places[t], 1.0 - math.exp(-rate))
            tracks.hidden[t] += dt
            continue
        _correct(tracks, t, seen, mine, config, moment)
        tracks.hidden[t] = 0.0
        tracks.spots[t] = tracks.means[t, :2]
        tracks.last_seen[t] = moment.stamp
        gain = min(max(float(scores[mine].sum()), 0.2), 2.0)
        tracks.existence[t] = min(tracks.existence[t] + gain, SURE)
        learn(tracks, t, seen, mine, moment)


def steady_velocity(trail: FloatArray, times: FloatArray) -> FloatArray | None:
    """Velocity (2,) m/s of the longest straight way that ends a trail (H, 2) m at times (H,) s; None without."""
    known = np.isfinite(times) & np.isfinite(trail[:, 0])
    trail, times = trail[known], times[known]
    for first in range(len(times) - FEWEST + 1):
        when = times[first:] - times[first:].mean()
        if times[-1] - times[first] < SHORTEST:
            return None
        velocity = when @ trail[first:] / (when @ when)
        off = trail[first:] - trail[first:].mean(0) - when[:, None] * velocity
        if np.mean(off**2) < STRAIGHT**2:
            return np.asarray(velocity)
    return None


def _go_on(tracks: Tracks, t: int, moment: Moment) -> None:
    """Out of sight people go on as they did over the last steps.

    The last scans saw a leg swing, or half a body, and not where he was: that is known from when he was seen wholly.
    """
    known = None
    if tracks.motion[t] > WALKS:
        wholly = moment.times <= moment.stamp - tracks.part[t]
        known = steady_velocity(tracks.trails[t, wholly], moment.times[wholly])
    cruise = tracks.cruises[t] if known is None else known
    change = cruise - tracks.means[t, 2:]
    if known is None and (tracks.looks[t] <= STEPS or math.hypot(change[0], change[1]) >= SWING):
        return
    tracks.means[t, 2:] = cruise
    if known is None:
        return
    place = tracks.wholes[t] + tracks.part[t] * cruise
    off = place - tracks.means[t, :2]
    if tracks.part[t] < PARTLY and math.hypot(off[0], off[1]) < SWAYS:
        tracks.means[t, :2] = place
    # Several steps tell the velocity better than the last one does.
    P = tracks.covariances[t]
    speed = math.sqrt(max(0.5 * (P[2, 2] + P[3, 3]), 1e-12))
    scale = np.array([1.0, 1.0, *2 * [min(1.0, STEADY / speed)]])
    tracks.covariances[t] = scale[:, None] * P * scale


def _miss(tracks: Tracks, t: int, shares: FloatArray, places: FloatArray, detection: float) -> None:
    """Not being seen says that nobody is there, or that he is where the scan could not show him."""
    stays = WEIGHTS * (1.0 - detection * shares)
    total = float(stays.sum())
    tracks.existence[t] = max(tracks.existence[t] + math.log(total), -SURE)
    stays /= total
    shift = stays @ places
    spread = (places.T * stays) @ places - np.outer(shift, shift)
    before = (places.T * WEIGHTS) @ places
    P = tracks.covariances[t]
    gain = np.linalg.solve(P[:2, :2], P[:2, :]).T
    # Where he is changes what is believed of his speed but little: he may as well have turned.
    slow = gain * np.array([1.0, 1.0, 0.3, 0.3])[:, None]
    tracks.means[t] += slow @ shift
    # A tenth is kept; believing less of the speed can still make it indefinite, the whole gain cannot.
    change = 0.9 * (spread - before)
    after = P + slow @ change @ slow.T
    if np.linalg.eigvalsh(after)[0] <= 1e-9:
        after = P + gain @ change @ gain.T
    tracks.covariances[t] = 0.5 * (after + after.T)


def _correct(
    tracks: Tracks, t: int, seen: Seen, mine: IntArray, config: PeopleConfig, moment: Moment
) -> None:
    """Kalman update with the middle of both legs, a trunk, or one leg that is off the middle."""
    known = middle(tracks, t, seen, mine)
    place = seen.places[mine].mean(0) if known is None else known
    whole = len(mine) == 2 or seen.widths[mine[0]] > WIDE or known is not None
    sigma = config.body_noise if whole else config.leg_noise
    noise = sigma**2 + (0.01 * seen.ranges[mine[0]]) ** 2
    P = tracks.covariances[t]
    S = P[:2, :2] + noise * np.eye(2)
    off = place - tracks.means[t, :2]
    turned = moment.steady and off @ np.linalg.solve(S, off) > SURPRISE
    if turned:
        # He turned, or stopped: the velocity was another one since the last scan.
        dt = moment.dt
        P = P + TURNED**2 * np.kron([[dt * dt, dt], [dt, 1.0]], np.eye(2))
        S = P[:2, :2] + noise * np.eye(2)
    K = np.linalg.solve(S, P[:2, :]).T
    tracks.means[t] = tracks.means[t] + K @ off
    if turned:
        tracks.cruises[t] = tracks.means[t, 2:]
    P = P - K @ S @ K.T
    tracks.covariances[t] = 0.5 * (P + P.T)


def learn(tracks: Tracks, t: int, seen: Seen, mine: IntArray, moment: Moment) -> None:
    """What this scan says about being a person."""
    dt = moment.dt
    # A splinter of three returns says little about its shape.
    weights = np.minimum(seen.counts[mine], FULL) / FULL
    evidence = float(weights @ np.clip(seen.shape[mine], -4.0, 3.5) / weights.sum())
    if len(mine) == 2:
        evidence += 0.5
    share = max(dt / (min(tracks.looks[t], 3.0) + dt), 0.02) * min(1.0, float(weights.sum()))
    tracks.shape[t] += share * (evidence - tracks.shape[t])
    if tracks.looks[t] < FIRST:
        fresh = float(seen.fresh[mine].mean()) if moment.steady else 0.0
        tracks.arrived[t] += dt / (tracks.looks[t] + dt) * (fresh - tracks.arrived[t])
    if _whole(seen, mine):
        share_of_steps = dt / (min(tracks.looks[t], STEPS) + dt)
        tracks.cruises[t] += share_of_steps * (tracks.means[t, 2:] - tracks.cruises[t])
        tracks.wholes[t], tracks.part[t] = tracks.means[t, :2], 0.0
    tracks.looks[t] += dt
    tracks.oldness[t] += min(1.0, dt / 1.0) * (float(seen.old[mine].mean()) - tracks.oldness[t])
    learn_body(tracks, t, seen, mine, dt)
    _learn_motion(tracks, t, float(seen.fresh[mine].mean()), float(seen.old[mine].mean()), moment)
    count = float(seen.counts[mine].sum())
    tracks.rates[t] += 0.2 * (count - tracks.rates[t]) if tracks.rates[t] else count
    off = seen.places[mine] - tracks.means[t, :2]
    spread = off.T @ off / len(mine) + np.eye(2) * 0.06**2
    tracks.extents[t] += (0.2 if tracks.extents[t, 0, 0] else 1.0) * (spread - tracks.extents[t])


def _whole(seen: Seen, mine: IntArray) -> bool:
    """Whether nothing nearer hides what is next to somebody, to either side."""
    first, last = mine[seen.index[mine].argmin()], mine[seen.index[mine].argmax()]
    return not (seen.cut[first, 0] or seen.cut[last, 1])


def _learn_motion(tracks: Tracks, t: int, fresh: float, old: float, moment: Moment) -> None:
    """People walk; what slides along furniture as the robot drives by is slower, and is where something stood."""
    dt = moment.dt
    behind = tracks.means[t, :2] - tracks.origins[t]
    moved = float(np.hypot(behind[0], behind[1]))
    tracks.moved[t] = max(tracks.moved[t], moved)
    tracks.origins[t] += (1.0 - math.exp(-dt / LAG)) * behind
    walking = min(2.5, max(0.0, (moved / LAG - SLIDING) / SLIDING))
    tracks.motion[t] = min(tracks.motion[t] + walking * (4.0 * fresh + 1.0 - old) * dt, SURE)
