"""Sections 3.8.1 and 3.8.2 in simulation: a cat before a depth camera, and a robot that clears a room."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np
import numpy.typing as npt
from matplotlib.figure import Figure
from scipy.spatial.distance import cdist
from scipy.special import logsumexp

from estimation.checks import FloatArray, as_floats
from estimation.conversion.particles import log_total, normalise_log, systematic_resample
from estimation.errors import InputError
from estimation.filters import kalman
from evaluation.drawing import saved
from evaluation.maintenance.maintenance_printed import entropy
from world_model.state import WorldObject, WorldState
from world_model.tasks.looks import Sensor
from world_model.tasks.maintenance import Maintenance, MaintenanceConfig

FRAME = 1.0 / 30.0  # s
SECONDS = 5.0
# Of the cat's acceleration, m/s² over a frame; the text prints neither this nor its threshold.
CAT = 6.0
THRESHOLD = 3.2  # nat, three axes
PARTICLES = 150
# A walk grows uncertain faster than a filter that knows the cat's speed, and so has a threshold of its own.
WALK_THRESHOLD = 6.2  # nat
PACE = 2.5 * FRAME  # m a frame and axis, of the particles' random walk
SUPPORTED = 0.7  # m, below which the torso laser does not reach (section 3.8.2)
H = np.eye(3, 6)


@dataclass(frozen=True)
class Film:
    """Frames at 30 Hz: positions (K, 3) x aside, y up, z away, m; variances (K, 3) m² of a measurement."""

    positions: FloatArray
    variances: FloatArray


@dataclass(frozen=True)
class Watched:
    """What a rule did: frames with a look (K,), entropy of the position (K,) nat, error (K,) m."""

    looks: np.ndarray
    entropies: FloatArray
    errors: FloatArray

    def rates(self) -> tuple[float, float, float]:
        """Looks per second: mean, lowest and highest over windows of one second."""
        window = round(1.0 / FRAME)
        counts = np.convolve(self.looks.astype(float), np.ones(window), "valid")
        return float(self.looks.sum() / SECONDS), float(counts.min()), float(counts.max())


def film(seed: int) -> Film:
    """A cat that runs to and fro between 1 and 4 m, and jumps once; depth noise as of a Kinect grows with z²."""
    rng = np.random.default_rng(seed)
    t = np.arange(0.0, SECONDS, FRAME)
    phase = rng.uniform(0.0, 2.0 * np.pi)
    away = 2.5 + 1.5 * np.sin(2.0 * np.pi * t / 4.0 + phase)
    aside = 0.6 * np.sin(2.0 * np.pi * t / 1.7 + rng.uniform(0.0, 6.0))
    since = t - rng.uniform(1.0, 3.5)
    up = np.clip(2.5 * since - 0.5 * 9.81 * since**2, 0.0, None) * (since > 0.0)
    # Khoshelham and Elberink 2012: 1.4 mm at 1 m; a blob of fur is found to some three pixels of 580.
    depth, pixels = 1.425e-3 * away**2, 3.0 * away / 580.0
    return Film(np.stack([aside, up, away], -1), np.stack([pixels, pixels, depth], -1) ** 2)


def _motion() -> tuple[FloatArray, FloatArray]:
    F = np.eye(6)
    F[:3, 3:] = FRAME * np.eye(3)
    G = np.vstack([0.5 * FRAME**2 * np.eye(3), FRAME * np.eye(3)])
    return F, CAT**2 * G @ G.T


def watch(scene: Film, seed: int, ours: bool = False) -> Watched:
    """Kalman filter of constant velocity; a look wherever (3.6) of the frame exceeds the threshold.

    ours : `Maintenance` decides, for a robot whose base is not free.
    """
    rng = np.random.default_rng([seed, 1])
    F, Q = _motion()
    mean, P = np.concatenate([scene.positions[0], np.zeros(3)]), np.diag([1e-3] * 3 + [4.0] * 3)
    looks, entropies, errors = np.zeros(len(scene.positions), bool), [], []
    rule = Maintenance(_settings())
    for k, (truth, variances) in enumerate(zip(scene.positions, scene.variances, strict=True)):
        if k:
            mean, P = kalman.predict(mean, P, F, Q)
        R = np.diag(variances)
        if ours:
            looks[k] = _asked(rule, mean[:3], P[:3, :3], R, k * FRAME)
        else:
            _, after, _ = kalman.update(mean, P, H @ mean, H, R)
            looks[k] = entropy(P[:3, :3]) - entropy(after[:3, :3]) > THRESHOLD
        if looks[k]:
            z = truth + np.sqrt(variances) * rng.standard_normal(3)
            mean, P, _ = kalman.update(mean, P, z, H, R)
        entropies.append(entropy(P[:3, :3]))
        errors.append(float(np.linalg.norm(mean[:3] - truth)))
    return Watched(looks, np.array(entropies), np.array(errors))


def _settings() -> MaintenanceConfig:
    return MaintenanceConfig(
        information_gain_threshold=THRESHOLD, process_noise=0.0, time_step=FRAME, tour=0.0
    )


def _asked(rule: Maintenance, position: FloatArray, P: FloatArray, R: FloatArray, stamp: float) -> bool:
    """Whether `Maintenance` wants a look at the cat now, from where the camera stands."""
    cat = WorldObject("kiwi", position[[2, 0, 1]], np.zeros(3), _turned(P), {}, 1.0, False, stamp)
    task = rule.next_task(
        WorldState((cat,), 1.0, 1.0, stamp), np.zeros(3), [Sensor("kinect", 0.4, 8.0, _turned(R))],
        base_available=False,
    )  # fmt: skip
    if task is not None:
        rule.report(task, "found", stamp)
    return task is not None


def _turned(P: FloatArray) -> FloatArray:
    """From the camera's axes to those of a robot that looks along x."""
    return np.asarray(P[np.ix_([2, 0, 1], [2, 0, 1])])


def particle_entropy(
    log_likelihood: npt.ArrayLike, log_transition: npt.ArrayLike, log_weights_before: npt.ArrayLike
) -> float:
    """Entropy, nat, of a particle filter's posterior density: (3.4) (Boers et al. 2010).

    log_likelihood : (N,), log p(z | q_i) of the predicted particles. log_transition : (N, N), entry [i, j]
    log p(q_i | q_j of the step before). log_weights_before : (N,). The posterior weights are
    w_i ∝ p(z | q_i) w_i,before. The text calls the unit bits; its logarithm is the natural one, as here.
    """
    likelihood = as_floats("log_likelihood", log_likelihood)
    before = normalise_log(log_weights_before)
    transition = as_floats("log_transition", log_transition)
    if likelihood.shape != before.shape or transition.shape != (before.size, before.size):
        raise InputError("log_likelihood and log_transition must have shapes (N,) and (N, N)")
    joint = likelihood + before
    evidence = log_total(joint)
    after = np.exp(joint - evidence)
    density = likelihood + logsumexp(transition + before, axis=1)
    used = after > 0
    return float(evidence - after[used] @ density[used])


def watch_with_particles(scene: Film, seed: int) -> Watched:
    """The same with a particle filter of the position, a random walk, and entropies by (3.4).

    Before a measurement: the density of the predicted particles, (3.4) with a likelihood that says nothing.
    """
    rng = np.random.default_rng([seed, 2])
    states = scene.positions[0] + 0.03 * rng.standard_normal((PARTICLES, 3))
    looks, entropies, errors = np.zeros(len(scene.positions), bool), [], []
    even = np.full(PARTICLES, -np.log(PARTICLES))
    for k, (truth, variances) in enumerate(zip(scene.positions, scene.variances, strict=True)):
        before = states
        states = before + PACE * rng.standard_normal((PARTICLES, 3))
        log_transition = -0.5 * cdist(states, before, "sqeuclidean") / PACE**2
        log_transition -= 1.5 * np.log(2.0 * np.pi * PACE**2)

        def log_likelihood(
            z: FloatArray, states: FloatArray = states, variances: FloatArray = variances
        ) -> FloatArray:
            return np.asarray(-0.5 * ((z - states) ** 2 / variances).sum(1))

        unseen = particle_entropy(np.zeros(PARTICLES), log_transition, even)
        seen = particle_entropy(log_likelihood(states.mean(0)), log_transition, even)
        looks[k] = unseen - seen > WALK_THRESHOLD
        entropies.append(unseen)
        if looks[k]:
            z = truth + np.sqrt(variances) * rng.standard_normal(3)
            values = log_likelihood(z)
            entropies[-1] = particle_entropy(values, log_transition, even)
            states = states[systematic_resample(normalise_log(values), rng)]
        errors.append(float(np.linalg.norm(states.mean(0) - truth)))
    return Watched(looks, np.array(entropies), np.array(errors))


def draw_cat(out: Path, runs: dict[str, Watched]) -> Path:
    """Figures 3.9 and 3.10: when the cat was looked at, and the entropy of its position."""
    figure = Figure(figsize=(8, 4.6))
    bars, lines = figure.subplots(2, 1, sharex=True)
    for row, (name, run) in enumerate(runs.items()):
        t = FRAME * np.arange(len(run.looks))
        bars.vlines(t[run.looks], row - 0.4, row + 0.4, lw=1, color=f"C{row}")
        lines.plot(t, run.entropies, lw=1, color=f"C{row}", label=name)
    bars.set(yticks=range(len(runs)), yticklabels=list(runs))
    lines.set(xlabel="time, s", ylabel="entropy of the position, nat")
    lines.legend(fontsize=7)
    return saved(figure, out / "figure-3-9-cat.png", 90)


@dataclass(frozen=True)
class Stage:
    """One stage of Table 3.2. action, thing : what the robot is about to do, and with what. theirs : who looked.

    seen : what the object recognition has found by then.
    """

    what: str
    action: str
    thing: str
    theirs: str
    seen: tuple[str, ...] = ()


STAGES = (
    Stage("drive to the cabinet", "navigate_to_place", "", "nobody"),
    Stage("grab the coke on the cabinet", "grab", "coke 1", "laser", ("coke 1", "tea")),
    Stage("throw it into the bin", "release", "coke 1", "nobody"),
    Stage("drive to the low table", "navigate_to_place", "", "nobody"),
    Stage("grab the coke on the low table", "grab", "coke 2", "kinect", ("coke 2",)),
    Stage("throw it into the bin", "release", "coke 2", "nobody"),
    Stage("drive back", "navigate_to_place", "", "nobody"),
)
HEIGHTS = {"coke 1": 0.95, "tea": 0.95, "coke 2": 0.5}
LASER = Sensor("laser", 0.2, 4.0, 0.004**2 * np.eye(3))
KINECT = Sensor("kinect", 0.4, 3.0, 0.012**2 * np.eye(3))
RECOGNISED = 0.03  # m, standard deviation of what the object recognition says from a distance


def clean_up(seed: int) -> list[tuple[str, float, float]]:
    """Every stage: by which sensor what was looked at, and the position's error before and after, m."""
    rng = np.random.default_rng(seed)
    truth = {name: np.array([*rng.uniform(1.0, 1.5, 2), height]) for name, height in HEIGHTS.items()}
    known = {name: truth[name] + RECOGNISED * rng.standard_normal(3) for name in truth}
    spread = {name: RECOGNISED**2 * np.eye(3) for name in truth}
    # Things move only where the robot moves them.
    rule = Maintenance(MaintenanceConfig(process_noise=0.0))
    done = []
    found: list[str] = []
    for stage in STAGES:
        found += stage.seen
        if stage.thing:
            rule.before(stage.action, stage.thing)
        state = WorldState(
            tuple(
                WorldObject(name, known[name], np.zeros(3), spread[name], {}, 1.0, False, 0.0)
                for name in found
            ),
            1.0, float(len(found)), 0.0,
        )  # fmt: skip
        low = stage.thing != "" and HEIGHTS[stage.thing] < SUPPORTED
        # On its way the robot's base belongs to the navigation; in the world model things are where they were seen.
        going = stage.action != "grab"
        task = rule.next_task(
            state, np.array([0.4, 0.4, 0.8]), [KINECT] if low else [LASER, KINECT], base_available=not going
        )
        if task is None:
            done.append(("nobody", 0.0, 0.0))
            if stage.action == "release":
                found.remove(stage.thing)
            continue
        sensor = LASER if task.sensor == "laser" else KINECT
        R, name = np.asarray(sensor.covariance), task.object_id
        before = float(np.linalg.norm(known[name] - truth[name]))
        z = truth[name] + rng.multivariate_normal(np.zeros(3), R)
        known[name], spread[name], _ = kalman.update(known[name], spread[name], z, np.eye(3), R)
        rule.report(task, "found", 0.0)
        done.append((task.sensor, before, float(np.linalg.norm(known[name] - truth[name]))))
    return done
