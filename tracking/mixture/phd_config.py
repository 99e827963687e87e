"""Every number the PHD filters need, with the values of Table 1 (simulations) of Paper B as defaults."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any

import numpy as np

from estimation.checks import FloatArray, as_finite, as_number, as_own
from estimation.errors import InputError
from estimation.filters.gaussians import repair_covariance

Birth = tuple[float, FloatArray, FloatArray]
FILTERS = ("mixture", "phd", "gmphd")
OCCLUDERS = ("bodies", "bearings")
PARTITIONERS = ("distance", "kmeans", "all", "single")
# Table 1: weights; where targets are born, m along both axes; deviations, m and m/s.
BIRTH_WEIGHT, SPAWN_WEIGHT, BIRTH_PLACE = 0.1, 0.05, 250.0
BIRTH_DEVIATIONS, SPAWN_DEVIATIONS = (10.0, 10.0, 5.0, 5.0), (10.0, 10.0, 20.0, 20.0)


def _default_births() -> list[Birth]:
    """The two birth components of (17)."""
    mean = BIRTH_PLACE * np.array([1.0, 1.0, 0.0, 0.0])
    return [(BIRTH_WEIGHT, side * mean, np.diag(np.square(BIRTH_DEVIATIONS))) for side in (1.0, -1.0)]


def _default_spawn() -> tuple[float, FloatArray]:
    """Weight and covariance of (18)."""
    return SPAWN_WEIGHT, np.diag(np.square(SPAWN_DEVIATIONS))


@dataclass
class PhdConfig:
    """Parameters of `ExtendedTargetPhd` and `PointTargetPhd`. Raises InputError naming the field.

    Probabilities and weights of survival, birth and spawn are per `scan_period`; other intervals scale them.
    """

    filter: str = "mixture"
    """"mixture": Poisson multi-Bernoulli mixture, the best by measurement; "phd": the text's ET-GM-PHD filter, as
    `as_printed` configures it or with more; "gmphd": the GM-PHD filter of Vo and Ma for one return per target."""
    surveillance: tuple[tuple[float, float], tuple[float, float]] = ((-1000.0, 1000.0), (-1000.0, 1000.0))
    """((x0, x1), (y0, y1)), m: where clutter falls, uniformly."""
    clutter_rate: float = 10.0
    """Expected clutter returns per scan, above 0."""
    detection_probability: float = 0.99
    """Probability that a target is seen at all, in (0, 1]."""
    survival_probability: float = 0.99
    """Probability that a target is still there one `scan_period` later, in (0, 1]."""
    measurement_noise: float = 20.0
    """Standard deviation of a return about its target's centre, per axis, m."""
    process_noise: float = 2.0
    """Standard deviation of the acceleration, constant over a scan interval, m/s²."""
    measurement_rate: float = 10.0
    """Expected returns of a detected target per scan (γ)."""
    births: list[Birth] = field(default_factory=_default_births)
    """New targets: (expected number per `scan_period`, mean (4,), covariance (4, 4)), in m and m/s."""
    spawn: tuple[float, FloatArray] | None = field(default_factory=_default_spawn)
    """Targets that split off: (expected number per target and `scan_period`, added covariance (4, 4))."""
    rate_spread: float = 0.0
    """mixture: relative standard deviation of γ over targets: 0 where every target has the configured rate, otherwise
    each one's own is learnt and used (0.5 for people in a laser scan, near and far)."""
    occlusion: bool = True
    """Whether targets hide each other, where `step` is told the pose of the sensor."""
    occluders: str = "bodies"
    """How they do: "bodies" cover what is behind them, of which fewer returns are then expected; "bearings": the text's
    way, p_D is lower behind each component by its weight and bearing deviation."""
    occluder_width: float = 2.5
    """Half of what a target hides, in standard deviations of its returns."""
    sensor_range: float = 1e6
    """How far the sensor sees, m; used with its pose."""
    field_of_view: float = 6.283185307179586
    """Full opening of the sensor, rad; used with its pose."""
    scan_period: float = 1.0
    """Interval the per-scan probabilities refer to, s."""
    partitioner: str = "distance"
    """"distance" (Section 4.1), "kmeans" (4.2), "all" (exhaustive, tiny scans only), "single" (one threshold)."""
    distance_probabilities: tuple[float, float] = (0.30, 0.80)
    """Quantiles of χ² with 2 degrees of freedom between which thresholds are used: σ√δ."""
    subpartitions: bool = True
    """Whether cells are also divided by predicted targets and by likely counts (for targets that meet)."""
    count_reassignments: bool = True
    """Whether a sub-partition also carries the weight of the reassignments of single returns it stands for."""
    max_hypotheses: int = 20
    """mixture: hypotheses kept per group of targets that share returns."""
    hypothesis_margin: float = 9.0
    """mixture: a hypothesis this far below the likeliest in log-weight is dropped."""
    hypothesis_distance: float = 2.0
    """mixture: squared Mahalanobis distance up to which two hypotheses say the same of a target."""
    prune_weight: float = 1e-3
    """Components of less weight are dropped."""
    merge_distance: float = 4.0
    """Squared Mahalanobis distance within which components are merged."""
    merge_targets: bool = False
    """phd, gmphd: whether components that weigh as much as a target each are merged, too, as Vo and Ma do; two targets
    in one place are then reported as one."""
    max_components: int = 300
    """Components kept at most, the heaviest."""
    extraction_weight: float = 0.45
    """Weight from which a target is reported, in (0, 1); below a half, as one scan without returns at
    p_D = p_S = 0.99 leaves 0.4975."""
    confirmation_weight: float = 0.9
    """mixture: weight from which a target is reported for the first time, in (0, 1)."""
    gate_probability: float = 0.9999
    """Probability of a target's own cell falling in its gate, in (0, 1)."""
    memory: float = 10.0
    """Scans over which the estimates of rate and extent forget, at least 1."""
    max_measurements: int = 2000
    """Returns used per scan at most; more are thinned evenly and counted."""
    max_partitions: int = 60
    """Partitions per group of nearby returns at most; more thresholds are thinned evenly and counted."""
    late_window: float = 1.0
    """A stamp this much behind, s, is a late scan and is worked in; further behind is a new run."""
    late_scans: int = 20
    """Scans remembered at most for that; one that comes after more later ones is skipped and counted."""
    max_gap: float = 60.0
    """After a longer silence, s, nothing known is still true: the filter starts anew."""

    def __post_init__(self) -> None:
        area = self._array("surveillance", (2, 2))
        if not (area[:, 0] < area[:, 1]).all():
            raise InputError("surveillance must be ((x0, x1), (y0, y1)) with x0 < x1 and y0 < y1")
        for name in (
            "clutter_rate", "measurement_noise", "measurement_rate", "scan_period", "max_gap",
            "occluder_width", "sensor_range", "field_of_view",
        ):  # fmt: skip
            self._number(name, 0.0, np.inf, open_below=True)
        for name in ("process_noise", "late_window", "rate_spread", "prune_weight", "merge_distance"):
            self._number(name, 0.0, np.inf)
        for name in ("detection_probability", "survival_probability"):
            self._number(name, 0.0, 1.0, open_below=True)
        for name in ("hypothesis_margin", "hypothesis_distance"):
            self._number(name, 0.0, np.inf)
        for name in ("occlusion", "subpartitions", "count_reassignments", "merge_targets"):
            if not isinstance(getattr(self, name), (bool, np.bool_)):
                raise InputError(f"{name} must be true or false, not {getattr(self, name)!r}")
        for name in ("extraction_weight", "confirmation_weight", "gate_probability"):
            self._number(name, 0.0, 1.0, open_below=True, open_above=True)
        self._number("memory", 1.0, np.inf)
        for name in ("max_components", "max_hypotheses", "late_scans", "max_measurements", "max_partitions"):
            value = getattr(self, name)
            if isinstance(value, bool) or not isinstance(value, (int, np.integer)) or value < 1:
                raise InputError(f"{name} must be a whole number of at least 1, not {value!r}")
        low, high = self._array("distance_probabilities", (2,))
        if not 0.0 <= low <= high < 1.0:
            raise InputError("distance_probabilities must be two numbers 0 ≤ low ≤ high < 1")
        if self.filter not in FILTERS:
            raise InputError(f"filter must be one of {FILTERS}, not {self.filter!r}")
        if self.partitioner not in PARTITIONERS:
            raise InputError(f"partitioner must be one of {PARTITIONERS}, not {self.partitioner!r}")
        if self.occluders not in OCCLUDERS:
            raise InputError(f"occluders must be one of {OCCLUDERS}, not {self.occluders!r}")
        self._shapes()

    @classmethod
    def as_printed(cls, **settings: Any) -> PhdConfig:
        """The text's ET-GM-PHD filter as printed in Paper B, with other `settings` where the scene has its own.

        Partitions by distance and none of their sub-partitions, birth (17), spawn (18) and the values of Table 1,
        p_D by weight and bearing deviation (Section 5.3), and whatever weighs more than a half is reported, as Vo
        and Ma do. Raises InputError naming the field.
        """
        printed: dict[str, Any] = {
            "filter": "phd",
            "subpartitions": False,
            "count_reassignments": False,
            "occluders": "bearings",
            "merge_targets": True,
            "extraction_weight": 0.5,
        }
        return cls(**printed | settings)

    def _shapes(self) -> None:
        """Births and spawn as arrays, checked."""
        if not isinstance(self.births, (list, tuple)):
            raise InputError(f"births must be a list of (weight, mean, covariance), not {self.births!r}")
        self.births = [self._birth(birth) for birth in self.births]
        if self.spawn is None:
            return
        if not isinstance(self.spawn, (list, tuple)) or len(self.spawn) != 2:
            raise InputError(f"spawn must be None or (weight, covariance), not {self.spawn!r}")
        weight, covariance = self._weighted("spawn", self.spawn[0]), as_own("spawn", self.spawn[1], (4, 4))
        self.spawn = weight, repair_covariance(covariance, "spawn")

    @property
    def area(self) -> float:
        """Area of the surveillance region, m²."""
        (x0, x1), (y0, y1) = self.surveillance
        return (x1 - x0) * (y1 - y0)

    def _array(self, name: str, shape: tuple[int, ...]) -> FloatArray:
        array = as_finite(name, getattr(self, name))
        if array.shape != shape:
            raise InputError(f"{name} must have shape {shape}, not {array.shape}")
        return array

    def _number(
        self, name: str, low: float, high: float, open_below: bool = False, open_above: bool = False
    ) -> None:
        value = as_number(name, getattr(self, name))
        below = value <= low if open_below else value < low
        above = value >= high if open_above else value > high
        if below or above:
            span = f"{'(' if open_below else '['}{low:g}, {high:g}{')' if open_above else ']'}"
            raise InputError(f"{name} must be a finite number in {span}, not {value!r}")

    @staticmethod
    def _weighted(name: str, weight: float) -> float:
        if as_number(f"weight of {name}", weight) < 0.0:
            raise InputError(f"{name} must have a finite weight of at least 0, not {weight!r}")
        return float(weight)

    def _birth(self, birth: Birth) -> Birth:
        if not isinstance(birth, (list, tuple)) or len(birth) != 3:
            raise InputError(f"births must hold (weight, mean, covariance), not {birth!r}")
        weight, mean, covariance = birth
        mean, covariance = as_own("births", mean, (4,)), as_own("births", covariance, (4, 4))
        return self._weighted("births", weight), mean, repair_covariance(covariance, "births")
