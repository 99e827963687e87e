"""A whole run of maintenance, compiled: the rule of `world_model.Maintenance` for things that do not move on a floor.

Covariances are circular here, a variance per object, which is all that the text's simulation has. A test drives
`Maintenance` itself through the same rooms and compares.
"""

from __future__ import annotations

import math

import numpy as np
from numba import njit

from world_model.tasks.maintenance_kernels import shortest_way, straight_stop
from world_model.tasks.maintenance_options import NEARER, TOUR, TWO_LOOKS

# mypy: disable-error-code="no-untyped-def"
SECOND_LOOK = math.log(2.0) + TWO_LOOKS  # nat
HERE = 1e-6  # m


@njit(cache=True)
def look_around(room, variances, means, pose, sensors, noise, updates):
    """Time goes on by a step: beliefs blur, what is in range of a sensor is measured; sum and largest of entropies.

    room : positions (N, 2) and growth (N,) per step, m². sensors : (S, 3) range_min, range_max, variance. noise :
    (S, N, 2).
    """
    positions, growth = room
    total, worst = 0.0, -np.inf
    for i in range(len(variances)):
        variances[i] += growth[i]
        away = math.hypot(positions[i, 0] - pose[0], positions[i, 1] - pose[1])
        seen = False
        for s in range(len(sensors)):
            if not sensors[s, 0] <= away <= sensors[s, 1]:
                continue
            seen = True
            gain = variances[i] / (variances[i] + sensors[s, 2])
            for c in range(2):
                measured = positions[i, c] + math.sqrt(sensors[s, 2]) * noise[s, i, c]
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
def _expected(item, pose, goal, length, means, variances, growth, sensor, stride, anticipation):
    """Gain of the object gone for and of all together, nat: `world_model.tasks.maintenance_kernels.path_gain`."""
    count = max(math.ceil(length / stride - 1e-9), 1)
    own = gain = 0.0
    for i in range(len(variances)):
        value, before = variances[i], 0
        for k in range(1, count + 1):
            x, y = pose[0] + (goal[0] - pose[0]) * k / count, pose[1] + (goal[1] - pose[1]) * k / count
            if sensor[0] <= math.hypot(means[i, 0] - x, means[i, 1] - y) <= sensor[1]:
                value += growth[i] * (k - before)
                value *= sensor[2] / (value + sensor[2])
                before = k
        if before == 0:
            continue
        value += growth[i] * (count - before)
        unseen = math.log(variances[i] + growth[i] * count)
        share = anticipation * unseen + (1.0 - anticipation) * math.log(variances[i]) - math.log(value)
        gain += share
        if i == item:
            own = share
    return own, gain


@njit(cache=True)
def _goal(item, sensor, pose, means, misses, standoff):
    """Where to look at an object from: x, y, metres."""
    share, aside = NEARER ** misses[item] * standoff, misses[item] > 0
    x, y, _, length = straight_stop(pose, means[item, 0], means[item, 1], sensor[0], sensor[1], share, aside)
    return x, y, length


@njit(cache=True)
def _best(able, above, pose, means, variances, growth, sensors, costs, misses, stride, config):
    """Object and sensor of the largest utility with a gain above `above`; -1 where none has. `config` : see `run`."""
    chosen, kind, most = -1, 0, -np.inf
    goal, place = np.empty(2), np.empty(2)
    for i in range(len(variances)):
        if not able[i]:
            continue
        for s in range(len(sensors)):
            goal[0], goal[1], length = _goal(i, sensors[s], pose, means, misses, config[5])
            own, gain = _expected(
                i, pose, goal, length, means, variances, growth, sensors[s], stride, config[6]
            )
            if own <= 0.0 or gain <= above:
                continue
            utility = (own + config[4] * (gain - own)) / config[2] - config[1] * (length + costs[s]) / config[
                3
            ]
            if utility > most:
                chosen, kind, most = i, s, utility
                place[:] = goal
    return chosen, kind, place


@njit(cache=True)
def _next(able, touring, pose, means, variances, growth, sensors, costs, misses, stride, config):
    """What to do: object or -1, sensor, place. `touring` (N,) is what is left of the tour; changed in place."""
    count = len(variances)
    threshold, share = config[0], config[7]
    now = np.zeros(count)
    for i in range(count):
        for s in range(len(sensors)):
            now[i] = max(now[i], math.log((variances[i] + sensors[s, 2]) / sensors[s, 2]))
    for attempt in range(2):
        for i in range(count):
            touring[i] = touring[i] and able[i] and now[i] > max(0.5 * share * threshold, SECOND_LOOK)
        left = np.flatnonzero(touring)
        one = np.zeros(count, np.bool_)
        for k in shortest_way(pose[0], pose[1], means[left]):
            touring[left[k]] = False
            one[:] = False
            one[left[k]] = True
            chosen, kind, place = _best(
                one, -np.inf, pose, means, variances, growth, sensors, costs, misses, stride, config
            )
            if chosen >= 0:
                return chosen, kind, place
        if attempt == 1:
            break
        chosen, kind, place = _best(
            able, threshold, pose, means, variances, growth, sensors, costs, misses, stride, config
        )
        if chosen < 0 or share <= 0.0:
            return chosen, kind, place
        worth = np.full(count, -np.inf)
        for i in range(count):
            if able[i] and now[i] > max(share * threshold, SECOND_LOOK):
                far = math.hypot(means[i, 0] - pose[0], means[i, 1] - pose[1]) / config[3]
                worth[i] = now[i] / config[2] - config[1] * far
        along = np.argsort(-worth)[: min(TOUR, np.sum(worth > -np.inf))]
        if len(along) < 2:
            return chosen, kind, place
        for i in along:
            touring[i] = True
        touring[chosen] = True
    return chosen, kind, place


@njit(cache=True)
def run(positions, growth, means, variances, size, noise, sensors, costs, stride, step, retry, config, order):
    """One run; sums over steps of the largest and of all entropies, metres, looks (N,), goals (N,), path (K + 1, 2).

    positions : (N, 2) m. growth : (N,) m² per step. means (N, 2), variances (N,) : beliefs, changed in place. noise :
    (K, S, N, 2) standard normal. sensors : (S, 3) range_min, range_max, variance. costs : (S,) m. stride : m in a
    step of `step` s. retry : s. config : threshold, weight, norm, cost scale, company, stand-off, anticipation, tour.
    order : objects to drive to over and over instead, empty for maintenance.
    """
    count, steps = len(growth), len(noise)
    pose = np.array([0.5 * size, 0.5 * size, 0.0])
    updates, goals = np.zeros(count, np.int64), np.zeros(count, np.int64)
    rests, misses = np.full(count, -np.inf), np.zeros(count, np.int64)
    touring, able = np.zeros(count, np.bool_), np.ones(count, np.bool_)
    path = np.empty((steps + 1, 2))
    path[0] = pose[:2]
    worst = total = distance = now = 0.0
    task, index = -1, 0
    goal = np.empty(2)
    for k in range(steps):
        if len(order) > 0:
            task = order[index]
            goal[:] = positions[task]
        elif task < 0:
            for i in range(count):
                able[i] = not now - rests[i] < retry
            task, _, place = _next(
                able, touring, pose, means, variances, growth, sensors, costs, misses, stride, config
            )
            goal[:] = place
            if task >= 0:
                goals[task] += 1
        if task >= 0:
            distance += drive(pose, goal, stride)
        now += step
        before = updates[task]
        summed, largest = look_around((positions, growth), variances, means, pose, sensors, noise[k], updates)
        total, worst = total + summed, worst + largest
        path[k + 1] = pose[:2]
        if task < 0 or math.hypot(goal[0] - pose[0], goal[1] - pose[1]) > HERE:
            continue
        if len(order) > 0:
            goals[task] += 1
            index = (index + 1) % len(order)
        elif updates[task] > before:
            misses[task], rests[task] = 0, -np.inf
        else:
            misses[task], rests[task] = misses[task] + 1, now
        task = -1
    return worst, total, distance, updates, goals, path
