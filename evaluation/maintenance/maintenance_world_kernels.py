"""A whole run of maintenance, compiled: the rule of `world_model.Maintenance` for things that do not move on a floor.

Covariances are circular here, a variance per object, which is all that the text's simulation has. A test drives
`Maintenance` itself through the same rooms and compares. The rule as printed and the fixed path go through them, too.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from numba import njit

from evaluation.maintenance.printed_kernels import best_as_printed
from world_model.tasks.maintenance_kernels import shortest_way, straight_stop
from world_model.tasks.maintenance_options import NEARER, TOUR

# mypy: disable-error-code="no-untyped-def"
SECOND_LOOK = math.log(2.0)  # nat: what the second of two looks in a row brings at most
HERE = 1e-6  # m


class SimulatedRoom(NamedTuple):
    """positions : (N, 2) m. growth : (N,) m² per step. noise : (K, S, N, 2) standard normal. sensors : (S, 3)
    range_min, range_max, variance. costs : (S,) m. stride : m in a step of `step` s. start : (3,) x, y, yaw."""

    positions: np.ndarray
    growth: np.ndarray
    noise: np.ndarray
    sensors: np.ndarray
    costs: np.ndarray
    stride: float
    step: float
    start: np.ndarray


class Belief(NamedTuple):
    """means : (N, 2) m. variances : (N,) m². misses : (N,) looks in a row that were in vain."""

    means: np.ndarray
    variances: np.ndarray
    misses: np.ndarray


class RunRule(NamedTuple):
    """Who decides: `order`, objects to drive to over and over; else `printed`, the numbers of a `PrintedRule`; where
    both are empty maintenance, by `config`: threshold, weight, norm, cost scale, company, stand-off, anticipation, tour
    and retry, s. idle : whether objects are looked at, too, while there is nothing to go for."""

    config: np.ndarray
    order: np.ndarray
    printed: np.ndarray
    idle: bool


@njit(cache=True)
def look_around(room, belief, pose, noise, updates, looking):
    """Time goes on by a step: beliefs blur, what is in range of a sensor is measured; sum and largest of entropies.

    noise : (S, N, 2). updates : (N,) looks so far. looking : whether anything is measured.
    """
    total, worst = 0.0, -np.inf
    means, variances = belief.means, belief.variances
    for i in range(len(variances)):
        variances[i] += room.growth[i]
        away = math.hypot(room.positions[i, 0] - pose[0], room.positions[i, 1] - pose[1])
        seen = False
        for s in range(len(room.sensors)):
            low, high, variance = room.sensors[s, 0], room.sensors[s, 1], room.sensors[s, 2]
            if not looking or not low <= away <= high:
                continue
            seen = True
            gain = variances[i] / (variances[i] + variance)
            for c in range(2):
                measured = room.positions[i, c] + math.sqrt(variance) * noise[s, i, c]
                means[i, c] += gain * (measured - means[i, c])
            variances[i] *= 1.0 - gain
        updates[i] += seen
        entropy = 1.0 + math.log(2.0 * math.pi) + math.log(variances[i])
        total += entropy
        worst = max(worst, entropy)
    return total, worst


@njit(cache=True)
def drive(pose, goal, stride):
    """One step of the robot towards a goal (2,), in place; the metres it took."""
    dx, dy = goal[0] - pose[0], goal[1] - pose[1]
    away = math.hypot(dx, dy)
    taken = min(away, stride)
    if away > 1e-9:
        pose[0] += dx * taken / away
        pose[1] += dy * taken / away
        pose[2] = math.atan2(dy, dx)
    return taken


@njit(cache=True)
def _expected(item, pose, goal, length, belief, room, sensor, anticipation):
    """Gain of the object gone for and of all together, nat: `world_model.tasks.maintenance_kernels.path_gain`."""
    count = max(math.ceil(length / room.stride - 1e-9), 1)
    low, high, variance = sensor[0], sensor[1], sensor[2]
    own = gain = 0.0
    for i in range(len(belief.variances)):
        now, before = belief.variances[i], 0
        for k in range(1, count + 1):
            x, y = pose[0] + (goal[0] - pose[0]) * k / count, pose[1] + (goal[1] - pose[1]) * k / count
            if low <= math.hypot(belief.means[i, 0] - x, belief.means[i, 1] - y) <= high:
                now += room.growth[i] * (k - before)
                now *= variance / (now + variance)
                before = k
        if before == 0:
            continue
        now += room.growth[i] * (count - before)
        unseen = math.log(belief.variances[i] + room.growth[i] * count)
        share = anticipation * unseen + (1.0 - anticipation) * math.log(belief.variances[i]) - math.log(now)
        gain += share
        if i == item:
            own = share
    return own, gain


@njit(cache=True)
def _best(able, above, pose, belief, room, config):
    """Object of the largest utility with a gain above `above`, -1 where none has; and where to look from."""
    chosen, most = -1, -np.inf
    goal, place = np.empty(2), np.empty(2)
    for i in range(len(able)):
        if not able[i]:
            continue
        x, y = belief.means[i, 0], belief.means[i, 1]
        share, aside = NEARER ** belief.misses[i] * config[5], belief.misses[i] > 0
        for s in range(len(room.sensors)):
            low, high = room.sensors[s, 0], room.sensors[s, 1]
            goal[0], goal[1], _, length = straight_stop(pose, x, y, low, high, share, aside)
            own, gain = _expected(i, pose, goal, length, belief, room, room.sensors[s], config[6])
            if own <= 0.0 or gain <= above:
                continue
            utility = (own + config[4] * (gain - own)) / config[2]
            utility -= config[1] * (length + room.costs[s]) / config[3]
            if utility > most:
                chosen, most = i, utility
                place[:] = goal
    return chosen, place


@njit(cache=True)
def _next(able, touring, pose, belief, room, config):
    """What to do: object or -1, place. `touring` (N,) is what is left of the tour; changed in place."""
    count, means = len(able), belief.means
    threshold, share = config[0], config[7]
    now = np.zeros(count)
    for i in range(count):
        for s in range(len(room.sensors)):
            variance = room.sensors[s, 2]
            now[i] = max(now[i], math.log((belief.variances[i] + variance) / variance))
    for attempt in range(2):
        for i in range(count):
            touring[i] = touring[i] and able[i] and now[i] > max(0.5 * share * threshold, SECOND_LOOK)
        left = np.flatnonzero(touring)
        one = np.zeros(count, np.bool_)
        for k in shortest_way(pose[0], pose[1], means[left]):
            touring[left[k]] = False
            one[:] = False
            one[left[k]] = True
            chosen, place = _best(one, -np.inf, pose, belief, room, config)
            if chosen >= 0:
                return chosen, place
        if attempt == 1:
            break
        chosen, place = _best(able, threshold, pose, belief, room, config)
        if chosen < 0 or share <= 0.0:
            return chosen, place
        worth = np.full(count, -np.inf)
        for i in range(count):
            if able[i] and now[i] > max(share * threshold, SECOND_LOOK):
                far = math.hypot(means[i, 0] - pose[0], means[i, 1] - pose[1]) / config[3]
                worth[i] = now[i] / config[2] - config[1] * far
        along = np.argsort(-worth)[: min(TOUR, np.sum(worth > -np.inf))]
        if len(along) < 2:
            return chosen, place
        for i in along:
            touring[i] = True
        touring[chosen] = True
    return chosen, place


@njit(cache=True)
def run(room, belief, rule):
    """One run; sums over steps of the largest and of all entropies, metres, looks (N,), goals (N,), path (K + 1, 2).

    belief is changed in place.
    """
    count, steps = len(room.growth), len(room.noise)
    fixed, printed = len(rule.order) > 0, len(rule.printed) > 0
    pose = room.start.copy()
    updates, goals = np.zeros(count, np.int64), np.zeros(count, np.int64)
    rests, misses = np.full(count, -np.inf), belief.misses
    touring, able = np.zeros(count, np.bool_), np.ones(count, np.bool_)
    path = np.empty((steps + 1, 2))
    path[0] = pose[:2]
    worst = total = distance = now = 0.0
    task, index = -1, 0
    goal = np.empty(2)
    for k in range(steps):
        if task < 0 and (fixed or printed):
            task = rule.order[index] if fixed else best_as_printed(pose, room, belief.variances, rule.printed)
            goal[:] = room.positions[task]
        elif task < 0:
            for i in range(count):
                able[i] = not now - rests[i] < rule.config[8]
            task, place = _next(able, touring, pose, belief, room, rule.config)
            goal[:] = place
            if task >= 0:
                goals[task] += 1
        if task >= 0:
            distance += drive(pose, goal, room.stride)
        now += room.step
        before = updates[task]
        looking = task >= 0 or rule.idle
        summed, largest = look_around(room, belief, pose, room.noise[k], updates, looking)
        total, worst = total + summed, worst + largest
        path[k + 1] = pose[:2]
        if task < 0 or math.hypot(goal[0] - pose[0], goal[1] - pose[1]) > HERE:
            continue
        if fixed or printed:
            goals[task] += 1
            index = (index + 1) % len(rule.order) if fixed else 0
        elif updates[task] > before:
            misses[task], rests[task] = 0, -np.inf
        else:
            misses[task], rests[task] = misses[task] + 1, now
        task = -1
    return worst, total, distance, updates, goals, path
