"""Settings of `IntentionModel`; ROS parameters, the YAML file and the README's table come from here."""

from __future__ import annotations

from dataclasses import dataclass

from estimation.settings import check_settings, setting
from tracking.prediction.social_forces import Forces

METHODS = ("routes", "ghmm", "printed")


@dataclass(frozen=True)
class IntentionConfig:
    """Settings of `IntentionModel`; each field's metadata has its unit, meaning and allowed range.

    The first block is Table 4.2 of the anchoring text at 24.7 mm per pixel. Raises InputError naming the field.
    """

    method: str = setting(
        "routes",
        "",
        "how goals are found: routes weighs all learned walks, ghmm is the plain model, printed "
        "also has the reference's own paths, one for each person",
        choices=METHODS,
    )
    resolution: float = setting(0.741, "m", "e_max, resolution of the topological map", 0.05, 20.0)
    window: int = setting(100, "", "N_p,max, points kept per node", 2, 10000)
    initial_transition: float = setting(0.1, "", "a_0, probability of a new transition", 1e-6, 1.0)
    initial_prior: float = setting(
        0.1, "", "pi_0, prior of a new state, as a share of one trajectory", 1e-6, 1.0
    )
    spread: float = setting(1.0, "", "factor on the covariance of a node's points", 0.1, 100.0)
    noise: float = setting(0.6, "m", "least standard deviation of an observation probability", 0.01, 5.0)
    memory: int = setting(
        500, "", "parameters are averaged over this many trajectories; older ones fade", 2, 1000000
    )

    routes: int = setting(1000, "", "number of learned walks that are kept, the latest ones", 1, 100000)
    goal_radius: float = setting(0.716, "m", "goals closer than this are merged", 0.05, 20.0)
    max_goals: int = setting(10, "", "largest number of goals that are reported", 1, 100)
    alternatives: int = setting(3, "", "number of goals for which a path is predicted", 1, 20)
    velocity_memory: float = setting(
        1.5, "s", "time constant of the velocity estimate, at 2 cm of noise", 0.05, 60.0
    )
    manoeuvre: float = setting(
        0.06, "m", "standard deviation of a walking person from a straight line", 0.001, 1.0
    )
    pace_weight: float = setting(0.0, "", "desired speed: 0 is the present speed, 1 the mean speed", 0.0, 1.0)
    time_step: float = setting(0.1, "s", "time step of the predicted paths", 0.01, 1.0)
    relaxation: float = setting(Forces.relaxation, "s", "tau, time to reach the desired velocity", 0.1, 60.0)
    people_strength: float = setting(
        Forces.people_strength, "m/s^2", "acceleration away from other people at contact", 0.0, 100.0
    )
    people_range: float = setting(
        Forces.people_range, "m", "range of the push away from other people", 0.01, 10.0
    )
    radius: float = setting(Forces.radius, "m", "radius of a person", 0.01, 2.0)
    wall_strength: float = setting(
        Forces.wall_strength, "m/s^2", "acceleration away from the nearest obstacle at contact", 0.0, 100.0
    )
    wall_range: float = setting(Forces.wall_range, "m", "range of the push away from obstacles", 0.01, 10.0)
    hardness: float = setting(
        Forces.hardness, "1/s^2", "extra push per metre of overlap with people", 0.0, 1000.0
    )
    wall_hardness: float = setting(
        Forces.wall_hardness, "1/s^2", "extra push per metre of overlap with obstacles", 0.0, 1000.0
    )
    position_sigma: float = setting(
        0.05, "m", "standard deviation of a predicted path at its start", 0.001, 5.0
    )
    speed_sigma: float = setting(
        0.12, "m/s", "growth of the standard deviation along the path, before walks have taught it", 1e-3, 5.0
    )
    course_sigma: float = setting(
        0.10,
        "m/s",
        "growth of the standard deviation across the path, before walks have taught it",
        1e-3,
        5.0,
    )
    min_length: float = setting(0.5, "m", "trajectories shorter than this are not learned", 0.0, 100.0)

    def __post_init__(self) -> None:
        check_settings(self)
